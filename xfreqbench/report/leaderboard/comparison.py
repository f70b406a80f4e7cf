"""Whether one method beats another: medians of resampled cells of the floor and seeds, the same draw for both."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain, combinations
from math import nan

import numpy as np
from jaxtyping import Float, Integer
from scipy.special import ndtr, ndtri, stdtrit

from xfreqbench.maps.metrics import NUM_RESAMPLES, quantiles
from xfreqbench.report.leaderboard.boards import Board, BoardRow
from xfreqbench.runs.records import RunRecord
from xfreqbench.system.machine import one_blas_thread
from xfreqbench.types import FloatArray, NDArray

MIN_SEEDS = 3  # a learned method with fewer is not ranked
Interval = tuple[float, float]
UNKNOWN: Interval = (nan, nan)


def medians_of(board: Board, row: BoardRow, splits: Sequence[str]) -> list[Float[FloatArray, "R"]]:
    """Median SSIM of a row of a board on each split in each of R resamples, the mean over drawn seeds.

    A resample draws cells with all their transmitters. Each is computed once for a row, and kept there.
    """
    missing = [split for split in splits if split not in row.drawn]
    if missing:
        with one_blas_thread():
            every = resampled_medians([_by_cell(board, record) for split in missing for record in row.by_split[split]])
    for split in missing:
        medians, every = np.split(every, [len(row.by_split[split])])  # (S, R), and those of the other splits
        seed = int(hashlib.sha256(f"{row.label} {split}".encode()).hexdigest(), 16)
        drawn = np.random.default_rng(seed).integers(len(medians), size=medians.shape)
        row.drawn[split] = np.take_along_axis(_widened(medians), drawn, axis=0).mean(axis=0)
    return [row.drawn[split] for split in splits]


def _by_cell(board: Board, record: RunRecord) -> Sequence[Sequence[float]]:
    """The scores of a record in each cell of the floor; in each transmitter where its cell is not known."""
    cell_of_tx = board.cells.get((record.job.split, len(record.ssim_by_tx)))
    if cell_of_tx is None:
        return record.ssim_by_tx
    scores: dict[int, list[float]] = {}
    for cell, of_tx in zip(cell_of_tx, record.ssim_by_tx, strict=True):
        scores.setdefault(cell, []).extend(of_tx)
    return list(scores.values())


@dataclass(frozen=True, eq=False)
class Comparison:
    """Rows of a board on some splits, compared by their average median SSIM.

    Every resample draws cells of the floor with all transmitters in them, the same ones for every row (paired) and for
    every split that tests as many, and draws seeds for each row. Intervals are 95 % percentile intervals of one number
    or one difference. Ranks, which are of all pairs at once, are corrected for their number.
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
        """The rows with samples and seeds enough that, where their budget is a time, had it on the machine of most.

        The best comes first.
        """
        return [row for row in self.rows if not self.unranked(row)]

    def has_enough_seeds(self, row: BoardRow) -> bool:
        """Whether a row has its samples stored and at least `MIN_SEEDS` seeds; a trivial predictor needs one seed."""
        return self._has_samples(row) and (row.is_trivial or row.num_seeds(self.splits)[0] >= MIN_SEEDS)

    def unranked(self, row: BoardRow) -> str:
        """Why a row has no rank, in two words such as `one seed`; empty where it has one."""
        seeds = row.num_seeds(self.splits)[0]
        if not row.is_trivial and seeds < MIN_SEEDS:
            return "one seed" if seeds == 1 else f"{seeds} seeds"
        if not self._has_samples(row):
            return "no samples"
        return "" if self.is_timed_alike(row) else "other machine"

    @cached_property
    def timed_on(self) -> str:
        """The machine of most of the fits whose budget is a time; empty where there is no such fit."""
        machines = Counter(machine for row in self.rows for machine in row.timing_machines)
        return machines.most_common(1)[0][0] if machines else ""

    def is_timed_alike(self, row: BoardRow) -> bool:
        """Whether all fits of a row whose budget is a time had it on the machine of most, as others do more or less."""
        return set(row.timing_machines) <= {self.timed_on}

    def difference(self, row: BoardRow, other: BoardRow) -> Interval:
        """Interval of a row's average median SSIM minus another's, paired; nan where samples are missing.

        Of one seed it is the interval of transmitters alone.
        """
        if not (self._has_samples(row) and self._has_samples(other)):
            return UNKNOWN
        return _interval(self._average(row) - self._average(other))

    @cached_property
    def _beaten(self) -> set[tuple[str, str]]:
        """The pairs of ranked rows, better and worse, that are told apart at 5 % after Holm's correction.

        The chance that equally good rows differ so much is that of a normal distribution with the difference's variance
        over resamples. Pairs are taken from the least probable on; the first that is above 5 %, divided by the number
        of pairs that are left, ends it.
        """
        found, each = [], [(row.label, row.average(self.splits), self._average(row)) for row in self.ranked_rows]
        for (row, average, drawn), (other, below, drawn_below) in combinations(each, 2):  # the better one comes first
            scatter = float(np.std(drawn - drawn_below))
            chance = float(2 * ndtr((below - average) / scatter)) if scatter else float(average == below)
            found.append((chance, row, other))
        beaten = set()
        for number, (chance, better, worse) in enumerate(sorted(found)):
            if chance * (len(found) - number) > 0.05:
                break
            beaten.add((better, worse))
        return beaten

    def beats(self, row: BoardRow, other: BoardRow) -> bool:
        """Whether a row is better than another, with the number of pairs of ranked rows taken into account."""
        return (row.label, other.label) in self._beaten

    def ranks(self, row: BoardRow) -> tuple[int, int] | None:
        """Best and worst place among the ranked rows that its intervals leave open; None if it is not ranked."""
        if self.unranked(row):
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
            best = np.max([medians_of(self.board, trivial, [split])[0] for trivial in self._trivial(split)], axis=0)
            left_open = np.where(best < 1, 1 - best, nan)
            skills.append(1 - (1 - medians_of(self.board, row, [split])[0]) / left_open)
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

    def _average(self, row: BoardRow) -> Float[FloatArray, "R"]:
        return np.mean(medians_of(self.board, row, self.splits), axis=0)


def contrast(board: Board, terms: Sequence[tuple[BoardRow, str, float]]) -> tuple[float, Interval]:
    """A sum of median SSIM of rows on splits, each with a weight, and its interval, paired by transmitters.

    The interval is unknown where samples are missing.
    """
    value = sum(weight * row.average([split]) for row, split, weight in terms)
    if not all(record.ssim_by_tx for row, split, _ in terms for record in row.by_split[split]):
        return value, UNKNOWN
    drawn = [weight * medians_of(board, row, [split])[0] for row, split, weight in terms]
    return value, _interval(np.sum(drawn, axis=0))


def comparisons_of(board: Board) -> list[Comparison]:
    """One for each set of splits that rows share, and one for each split of a row that has none of the sets."""
    sets = board.split_sets()
    alone = [row for row in board.rows if not any(row.by_split.keys() >= set(splits) for splits in sets)]
    lone = [(split,) for split in board.splits if any(split in row.by_split for row in alone)]
    return [Comparison(board, splits) for splits in [*sets, *lone]]


def resampled_medians(scores: Sequence[Sequence[Sequence[float]]]) -> Float[FloatArray, "S R"]:
    """Median SSIM of S records in each of R resamples of whole cells.

    `scores` has the scores of each cell, of each record. The draw depends only on the number of cells. A score counts
    as often as its cell was drawn, so that the scores are sorted once for all resamples. How many drawn scores come up
    to each of them is a matrix product, first of those within 4.5 standard deviations of the median alone.
    """
    medians = np.empty((len(scores), NUM_RESAMPLES))
    for place, of_cells in enumerate(scores):
        num_scores = np.array(list(map(len, of_cells)))
        values = np.fromiter(chain.from_iterable(of_cells), np.float64, count=num_scores.sum())
        order = np.argsort(values, kind="stable")
        owner = np.repeat(np.arange(len(num_scores)), num_scores)[order]
        times_drawn = _times_drawn(len(num_scores)).astype(np.float32 if len(values) < 2**22 else np.float64)  # exact
        num_drawn = (num_scores.astype(times_drawn.dtype) @ times_drawn).astype(np.int64)
        middle = len(values) // 2
        num_lower = np.bincount(owner[:middle], minlength=len(num_scores))
        for most in (int(2 + 4.5 * np.linalg.norm(num_lower - num_scores / 2)), len(values)):
            first, last = max(0, middle - most), min(len(values), middle + most)
            is_of_cell = (owner[first:last, None] == np.arange(len(num_scores))).astype(times_drawn.dtype)
            is_of_cell[0] += np.bincount(owner[:first], minlength=len(num_scores))
            up_to = np.cumsum(is_of_cell, axis=0) @ times_drawn
            # the lower and the upper median, by how many drawn scores come before each
            found = np.stack([(up_to <= before).sum(axis=0) for before in ((num_drawn - 1) // 2, num_drawn // 2)])
            if found.max() < last - first and (first == 0 or found.min() > 0):
                break
        medians[place] = values[order][first + found].mean(axis=0)
    return medians


@lru_cache(maxsize=4)
def _times_drawn(num_cells: int) -> Integer[NDArray[np.integer], "C R"]:
    """How often each of C cells is drawn in R resamples."""
    drawn = np.random.default_rng(num_cells).integers(num_cells, size=(NUM_RESAMPLES, num_cells))
    places = drawn * NUM_RESAMPLES + np.arange(NUM_RESAMPLES)[:, None]
    counted = np.bincount(places.ravel(), minlength=num_cells * NUM_RESAMPLES)
    return counted.reshape(num_cells, NUM_RESAMPLES).astype(np.min_scalar_type(counted.max()))


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
    low, high = quantiles(values, [0.025, 0.975])
    return float(low), float(high)
