"""Whether one method beats another: medians of resampled cells of the floor and seeds, the same draw for both."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain, combinations
from math import isqrt, nan

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
        return [row for row in self.rows if self.has_enough_seeds(row) and self.is_timed_alike(row)]

    @cached_property
    def _ranked_labels(self) -> set[str]:
        return {row.label for row in self.ranked_rows}

    def is_ranked(self, row: BoardRow) -> bool:
        """Whether a row is one of `ranked_rows`."""
        return row.label in self._ranked_labels

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
        return _interval(self._average(row) - self._average(other))

    @cached_property
    def _beaten(self) -> set[tuple[str, str]]:
        """The pairs of ranked rows, better and worse, that are told apart at 5 % after Holm's correction.

        The chance that equally good rows differ so much is that of a normal distribution with the difference's variance
        over resamples. Pairs are taken from the least probable on; the first that is above 5 %, divided by the number
        of pairs that are left, ends it.
        """
        drawn, found = {row.label: self._average(row) for row in self.ranked_rows}, []
        for row, other in combinations(self.ranked_rows, 2):  # the better average comes first
            difference = row.average(self.splits) - other.average(self.splits)
            scatter = float(np.std(drawn[row.label] - drawn[other.label]))
            chance = float(2 * ndtr(-difference / scatter)) if scatter else float(difference == 0)
            found.append((chance, row.label, other.label))
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
    """One for each set of splits that rows share, and one for each lone split."""
    lone = [(split,) for split in board.lone_splits()]
    return [Comparison(board, splits) for splits in [*board.split_sets(), *lone]]


def resampled_medians(scores: Sequence[Sequence[Sequence[float]]]) -> Float[FloatArray, "S R"]:
    """Median SSIM of S records in each of R resamples of whole cells.

    `scores` has the scores of each cell, of each record. The draw depends only on the number of cells. A score counts
    as often as its cell was drawn, so that the scores are sorted once for all resamples. Of those well below the median
    only their number is needed, which one matrix product finds for all records.
    """
    medians = np.empty((len(scores), NUM_RESAMPLES))
    lengths = [tuple(map(len, of_cells)) for of_cells in scores]
    for num_scores in set(lengths):
        records = [place for place, of_record in enumerate(lengths) if of_record == num_scores]
        bands = [_Band.of(scores[place]) for place in records]
        counted = np.array([num_scores, *(band.num_below for band in bands)])  # (1 + S, C)
        exact = np.float32 if max(num_scores) * len(num_scores) < 2**24 else np.float64
        times_drawn = _times_drawn(len(num_scores))
        num_drawn, *below = (counted.astype(exact) @ times_drawn.astype(exact)).astype(np.int32)
        before = np.stack([(num_drawn - 1) // 2, num_drawn // 2])  # the lower and the upper median
        for place, band, num_below in zip(records, bands, below, strict=True):
            middle = band.places_of(before - num_below, times_drawn)
            if middle is None:
                middle = _Band.of(scores[place], is_whole=True).places_of(before, times_drawn)
            medians[place] = band.ordered[middle].mean(axis=0)
    return medians


@dataclass(frozen=True, eq=False)
class _Band:
    """The scores of a record in ascending order, and a band of them that has nearly all medians, cut into blocks.

    `num_below` is how many scores of each of C cells come before the band, which begins at place `first`. `owner` has
    the cell of each score of a block; the last `num_empty` of the last block are of none.
    """

    ordered: Float[FloatArray, "N"]
    num_below: Integer[NDArray[np.integer], "C"]
    first: int
    owner: Integer[NDArray[np.integer], "B size"]
    num_empty: int

    @classmethod
    def of(cls, of_cells: Sequence[Sequence[float]], is_whole: bool = False) -> _Band:
        """The band within 4.5 standard deviations of how many scores of a resample are below the median, or all."""
        num_scores = np.array(list(map(len, of_cells)))
        values = np.fromiter(chain.from_iterable(of_cells), np.float64, count=num_scores.sum())
        order = np.argsort(values, kind="stable")
        owner = np.repeat(np.arange(len(num_scores)), num_scores)[order]
        middle = len(values) // 2
        num_lower = np.bincount(owner[:middle], minlength=len(num_scores))
        most = len(values) if is_whole else int(2 + 4.5 * np.linalg.norm(num_lower - num_scores / 2))
        first, last = max(0, middle - most), min(len(values), middle + most)
        size = 1 + isqrt(last - first) // 2
        num_empty = (first - last) % size
        blocks = np.pad(owner[first:last], (0, num_empty)).reshape(-1, size)
        num_below = np.bincount(owner[:first], minlength=len(num_scores))
        return cls(values[order], num_below, first, blocks, num_empty)

    def places_of(
        self, before: Integer[NDArray[np.integer], "2 R"], times_drawn: Integer[NDArray[np.integer], "C R"]
    ) -> Integer[NDArray[np.integer], "2 R"] | None:
        """Places in `ordered` of the drawn scores that have so many drawn ones of the band before them.

        None where the band does not have all of them. Scores are counted in blocks; those of a block are looked at one
        by one only where the place lies in it.
        """
        num_blocks, size = self.owner.shape
        times = times_drawn.take(self.owner, axis=0)  # (B, size, R)
        times[-1, size - self.num_empty :] = 0
        in_block = times.sum(axis=1, dtype=np.min_scalar_type(size * np.iinfo(times.dtype).max))
        num_up_to = np.zeros((num_blocks + 1, NUM_RESAMPLES), np.int32)
        for number, counted in enumerate(in_block):  # faster than numpy.cumsum along this axis
            np.add(num_up_to[number], counted, out=num_up_to[number + 1])
        block = np.count_nonzero(num_up_to[1:] <= before[:, None], axis=1)
        if before.min() < 0 or block.max() == num_blocks:
            return None
        resample, place = np.arange(NUM_RESAMPLES), block * size
        num_so_far, looked_at = num_up_to[block, resample], place * NUM_RESAMPLES + resample
        for _ in range(size - 1):
            num_so_far += times.take(looked_at)
            place += num_so_far <= before
            looked_at += NUM_RESAMPLES
        return self.first + place


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
