"""Whether one method beats another: medians of resampled transmitters and seeds, the same draw for both."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import chain
from math import isqrt, nan

import numpy as np
from jaxtyping import Float, Integer
from scipy.special import ndtri, stdtrit

from xfreqbench.maps.metrics import NUM_RESAMPLES, quantiles
from xfreqbench.report.leaderboard.boards import Board
from xfreqbench.report.leaderboard.rows import BoardRow
from xfreqbench.types import FloatArray, NDArray

MIN_SEEDS = 3  # a learned method with fewer is not ranked
MANY_RESAMPLES = 16 * NUM_RESAMPLES  # where a bound is near zero
_LEVELS = 0.025, 0.975  # of the bounds of an interval
_KNOWN = 0.1  # standard error of a bound that decides, of its distance from zero
Interval = tuple[float, float]
UNKNOWN: Interval = (nan, nan)


def medians_of(row: BoardRow, split: str, number: int = NUM_RESAMPLES) -> Float[FloatArray, "R"]:
    """Median SSIM over the drawn transmitters in each of R = `number` resamples, mean over the drawn seeds.

    It is computed once for a row, and kept there.
    """
    if (split, number) not in row.drawn:
        records = row.by_split[split]
        medians = np.array([resampled_medians(record.ssim_by_tx, number) for record in records])  # (S, R)
        seed = int(hashlib.sha256(f"{row.label} {split}".encode()).hexdigest(), 16)
        drawn = np.random.default_rng(seed).integers(len(records), size=medians.shape)
        resampled = np.take_along_axis(_widened(medians), drawn, axis=0).mean(axis=0)
        row.drawn[split, number] = np.asarray(resampled)
    return row.drawn[split, number]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Rows of a board on some splits, compared by their average median SSIM.

    Every resample draws transmitters with all their samples, the same ones for every row (paired) and for
    every split that tests as many, and draws seeds for each row. Intervals are 95 % percentile intervals, not
    corrected for how many comparisons are made.

    Of a difference, the sign of a bound decides. Where a bound is not known to a tenth of its distance from zero, there
    are sixteen times as many resamples; where it is not known so well even then, it is 0, and the difference open.
    """

    board: Board
    splits: tuple[str, ...]

    @classmethod
    def of(cls, board: Board, *rows: BoardRow) -> Comparison:
        """The comparison on the splits that all the rows were run on."""
        return cls(board, tuple(split for split in board.splits if all(split in row.by_split for row in rows)))

    @cached_property
    def rows(self) -> list[BoardRow]:
        """Rows that were run on all the splits, the best first."""
        return self.board.rows_on(self.splits)

    @cached_property
    def ranked_rows(self) -> list[BoardRow]:
        """The rows that can be ranked, the best first."""
        return [row for row in self.rows if self.is_ranked(row)]

    def is_ranked(self, row: BoardRow) -> bool:
        """Whether a row has samples and seeds enough and, where its budget is a time, had it on the machine of most."""
        return self.has_enough_seeds(row) and self.is_timed_alike(row)

    def has_enough_seeds(self, row: BoardRow) -> bool:
        """Whether a row has its samples stored and at least `MIN_SEEDS` seeds; a trivial predictor needs one seed."""
        needed = 1 if row.is_trivial else MIN_SEEDS
        return self._has_samples(row) and row.num_seeds(self.splits)[0] >= needed

    def unranked(self, row: BoardRow) -> str:
        """Why a row has no rank, in two words such as `one seed`; empty where it has one."""
        if self.is_ranked(row):
            return ""
        seeds = row.num_seeds(self.splits)[0]
        if not row.is_trivial and seeds < MIN_SEEDS:
            return "one seed" if seeds == 1 else f"{seeds} seeds"
        return "other machine" if self._has_samples(row) else "no samples"

    @cached_property
    def timed_on(self) -> str:
        """The machine of most of the fits whose budget is a time; empty where there is no such fit."""
        machines = Counter(machine for row in self.rows for machine in row.timing_machines)
        return machines.most_common(1)[0][0] if machines else ""

    def is_timed_alike(self, row: BoardRow) -> bool:
        """Whether all fits of a row whose budget is a time had it on the machine of most, as others do more or less."""
        return set(row.timing_machines) <= {self.timed_on}

    def difference(self, row: BoardRow, other: BoardRow) -> Interval:
        """Interval of a row's average median SSIM minus another's; nan where one of the two is not ranked."""
        if not (self.is_ranked(row) and self.is_ranked(other)):
            return UNKNOWN
        return self.paired_difference(row, other)

    def paired_difference(self, row: BoardRow, other: BoardRow) -> Interval:
        """As `difference`, but for rows of few seeds too: of one seed it is the interval of transmitters alone.

        nan where samples are missing.
        """
        if not (self._has_samples(row) and self._has_samples(other)):
            return UNKNOWN
        key = self.splits, other.label
        if key not in row.differences:
            bounds = _known_bounds(self._average(row) - self._average(other))
            if 0 in bounds:
                bounds = _known_bounds(self._average(row, MANY_RESAMPLES) - self._average(other, MANY_RESAMPLES))
            row.differences[key] = bounds
        return row.differences[key]

    def beats(self, row: BoardRow, other: BoardRow) -> bool:
        """Whether the whole interval of the difference lies above zero."""
        return self.difference(row, other)[0] > 0

    def ranks(self, row: BoardRow) -> tuple[int, int] | None:
        """Best and worst place among the ranked rows that its intervals leave open; None if it is not ranked."""
        if not self.is_ranked(row):
            return None
        others = [other for other in self.ranked_rows if other is not row]
        num_better = sum(self.beats(other, row) for other in others)
        num_worse = sum(self.beats(row, other) for other in others)
        return 1 + num_better, 1 + len(others) - num_worse

    def skill_interval(self, row: BoardRow) -> Interval:
        """Interval of the average skill; nan where samples or trivial predictors are missing.

        Every resample finds the best trivial predictor of each split anew.
        """
        if not self._has_samples(row) or not all(map(self._trivial, self.splits)):
            return UNKNOWN
        skills = []
        for split in self.splits:
            best = np.max([medians_of(trivial, split) for trivial in self._trivial(split)], axis=0)
            left_open = np.where(best < 1, 1 - best, nan)
            skills.append(1 - (1 - medians_of(row, split)) / left_open)
        return _interval(np.mean(skills, axis=0))

    def interval(self, row: BoardRow) -> Interval:
        """Interval of the average median SSIM; nan where samples are missing."""
        return _interval(self._average(row)) if self._has_samples(row) else UNKNOWN

    def _has_samples(self, row: BoardRow) -> bool:
        return all(record.ssim_by_tx for split in self.splits for record in row.by_split.get(split, ()))

    def _trivial(self, split: str) -> list[BoardRow]:
        """The trivial predictors of a split; empty where one has no samples, or a needed one was not run."""
        rows = self.board.trivial_rows(split)
        return rows if all(record.ssim_by_tx for row in rows for record in row.by_split[split]) else []

    def _average(self, row: BoardRow, number: int = NUM_RESAMPLES) -> Float[FloatArray, "R"]:
        return np.mean([medians_of(row, split, number) for split in self.splits], axis=0)


def comparisons_of(board: Board) -> list[Comparison]:
    """One for each set of splits that rows share, and one for each lone split."""
    lone = [(split,) for split in board.lone_splits()]
    return [Comparison(board, splits) for splits in [*board.split_sets(), *lone]]


def resampled_medians(ssim_by_tx: Sequence[Sequence[float]], number: int = NUM_RESAMPLES) -> Float[FloatArray, "R"]:
    """Median SSIM in each of R = `number` resamples of whole transmitters, a multiple of `NUM_RESAMPLES`.

    `ssim_by_tx` has the scores of each transmitter. The draw depends only on the number of transmitters. A score
    counts as often as its transmitter was drawn, so that the scores are sorted once for all resamples, and counted in
    blocks: the scores of a block are looked at only where the median lies in it.
    """
    length = [len(samples) for samples in ssim_by_tx]
    values = np.fromiter(chain.from_iterable(ssim_by_tx), np.float64, count=sum(length))
    order = np.argsort(values, kind="stable")
    ordered, owner = values[order], np.repeat(np.arange(len(length)), length)[order]
    size = isqrt(len(values))  # of a block
    num_empty = -len(values) % size
    blocks = np.pad(owner, (0, num_empty)).reshape(-1, size)
    medians = []
    for times_drawn in _times_drawn(len(length), number):
        times = times_drawn[blocks]  # of each score: (B, size, NUM_RESAMPLES)
        times[-1, size - num_empty :] = 0
        num_up_to = times.sum(axis=1, dtype=np.int32).cumsum(axis=0)
        middle = []
        for half in (num_up_to[-1] - 1) // 2, num_up_to[-1] // 2:
            block = (num_up_to <= half).sum(axis=0)
            inside = times[block, :, np.arange(NUM_RESAMPLES)].cumsum(axis=1, dtype=np.int32)  # (NUM_RESAMPLES, size)
            before = np.take_along_axis(num_up_to, block[None], axis=0)[0] - inside[:, -1]
            middle.append(block * size + (inside <= (half - before)[:, None]).sum(axis=1))
        medians.append(ordered[middle].mean(axis=0))
    return np.concatenate(medians)


@cache
def _times_drawn(num_tx: int, number: int) -> list[Integer[NDArray[np.integer], "T R"]]:
    """How often each of T transmitters is drawn in `number` resamples, `NUM_RESAMPLES` at a time: shapes (T, R)."""
    generator, parts = np.random.default_rng(num_tx), []
    for _ in range(number // NUM_RESAMPLES):
        drawn = generator.integers(num_tx, size=(NUM_RESAMPLES, num_tx))
        counted = [np.bincount(places, minlength=num_tx) for places in drawn]
        parts.append(np.ascontiguousarray(np.transpose(counted).astype(np.min_scalar_type(num_tx))))
    return parts


def _widened(medians: Float[FloatArray, "S R"]) -> Float[FloatArray, "S R"]:
    """The medians of S seeds with wider deviations from their mean, since draws from few seeds scatter too little.

    The first factor is √(S/(S−1)), as in a standard deviation. The second is how much wider at 95 % Student's t is
    than the normal distribution, with the 2(S−1) degrees of freedom of a difference of two methods.
    """
    number, mean = len(medians), medians.mean(axis=0)
    if number < 2:
        return medians
    student = stdtrit(2 * (number - 1), 0.975) / ndtri(0.975)
    return mean + np.sqrt(number / (number - 1)) * student * (medians - mean)


def _interval(values: Float[FloatArray, "R"]) -> Interval:
    low, high = quantiles(values, list(_LEVELS))
    return float(low), float(high)


def _known_bounds(values: Float[FloatArray, "R"]) -> Interval:
    """As `_interval`, with 0 for a bound whose standard error is more than a tenth of it.

    The error follows from the values whose ranks are one standard deviation of the bound's rank above and below it.
    """
    bounds = []
    for level in _LEVELS:
        error = np.sqrt(level * (1 - level) / len(values))
        below, bound, above = quantiles(values, [level - error, level, level + error])
        bounds.append(float(bound) if above - below <= 2 * _KNOWN * abs(bound) else 0.0)
    return bounds[0], bounds[1]
