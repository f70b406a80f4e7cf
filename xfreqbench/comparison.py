"""Whether one method beats another: medians resampled over transmitters and seeds, the same draw for both."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from math import nan

import numpy as np
from jaxtyping import Float, Integer
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from xfreqbench.angles import FloatArray
from xfreqbench.boards import Board, Row
from xfreqbench.metrics import NUM_RESAMPLES, quantiles

MIN_SEEDS = 3  # below it a learned method is not ranked
Interval = tuple[float, float]
UNKNOWN: Interval = (nan, nan)


class Resampling:
    """Resampled medians of a board's rows, each taken once however many comparisons ask for it."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str], Float[FloatArray, "R"]] = {}

    def medians(self, row: Row, split: str) -> Float[FloatArray, "R"]:
        """Mean over the drawn seeds, as many as there are, of the medians over the drawn transmitters."""
        key = row.label, split
        if key not in self._known:
            self._known[key] = _resampled(row, split)
        return self._known[key]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Rows of a board on some splits, compared by their average median SSIM.

    Every resample draws transmitters with all their samples, the same ones for every row (paired) and for
    every split that tests as many, and draws seeds for each row. Intervals are 95 % percentile intervals, not
    corrected for how many comparisons are made. Comparisons of one board may share its `resampling`.
    """

    board: Board
    splits: tuple[str, ...]
    resampling: Resampling = field(default_factory=Resampling)

    @cached_property
    def rows(self) -> list[Row]:
        """Rows that were run on all the splits, the best first."""
        return self.board.rows_on(self.splits)

    @cached_property
    def ranked_rows(self) -> list[Row]:
        """The rows that have what a comparison takes, the best first."""
        return [row for row in self.rows if self.is_ranked(row)]

    def is_ranked(self, row: Row) -> bool:
        """Whether a row has the seeds that a comparison takes; a trivial predictor needs one."""
        needed = 1 if row.is_trivial else MIN_SEEDS
        return self._has_samples(row) and row.num_seeds(self.splits)[0] >= needed

    def difference(self, row: Row, other: Row) -> Interval:
        """Interval of how much higher one row's average median SSIM is; nan where one of them is not ranked."""
        if not (self.is_ranked(row) and self.is_ranked(other)):
            return UNKNOWN
        return self._differences[row.label, other.label]

    def beats(self, row: Row, other: Row) -> bool:
        """Whether the whole interval of the difference lies above zero."""
        return self.difference(row, other)[0] > 0

    def ranks(self, row: Row) -> tuple[int, int] | None:
        """Best and worst place among the ranked rows that its intervals leave open; None where not ranked."""
        if not self.is_ranked(row):
            return None
        others = [other for other in self.ranked_rows if other is not row]
        num_better = sum(self.beats(other, row) for other in others)
        num_worse = sum(self.beats(row, other) for other in others)
        return 1 + num_better, 1 + len(others) - num_worse

    def skill_interval(self, row: Row) -> Interval:
        """Interval of the average skill, the best trivial predictor of a split found anew in every resample."""
        if not self._has_samples(row) or not all(map(self._trivial, self.splits)):
            return UNKNOWN
        skills = [
            1 - (1 - self.resampling.medians(row, split)) / self._left_open(split) for split in self.splits
        ]
        return _interval(np.mean(skills, axis=0))

    def interval(self, row: Row) -> Interval:
        """Interval of the average median SSIM itself; nan where a record lacks its samples."""
        return _interval(self._average(row)) if self._has_samples(row) else UNKNOWN

    def _has_samples(self, row: Row) -> bool:
        return all(record.ssim_by_tx for split in self.splits for record in row.by_split.get(split, ()))

    def _trivial(self, split: str) -> list[Row]:
        """The trivial predictors of a split; none where one of them lacks its samples."""
        rows = [row for row in self.board.rows if row.is_trivial and split in row.by_split]
        return rows if all(record.ssim_by_tx for row in rows for record in row.by_split[split]) else []

    def _left_open(self, split: str) -> Float[FloatArray, "R"]:
        """What the best trivial predictor of each resample leaves open; nan where that is nothing."""
        best = np.max([self.resampling.medians(row, split) for row in self._trivial(split)], axis=0)
        return np.where(best < 1, 1 - best, nan)

    def _average(self, row: Row) -> Float[FloatArray, "R"]:
        return np.mean([self.resampling.medians(row, split) for split in self.splits], axis=0)

    @cached_property
    def _differences(self) -> dict[tuple[str, str], Interval]:
        averages = {row.label: self._average(row) for row in self.ranked_rows}
        return {
            (one, other): _interval(averages[one] - averages[other]) for one in averages for other in averages
        }


def resampled_medians(ssim_by_tx: Sequence[Sequence[float]]) -> Float[FloatArray, "R"]:
    """Medians of `NUM_RESAMPLES` resamples of whole transmitters; the draw depends on their number alone.

    A sample counts as often as its transmitter was drawn, so that one sorting serves every resample.
    """
    length = [len(samples) for samples in ssim_by_tx]
    values = np.concatenate([np.asarray(samples, np.float64) for samples in ssim_by_tx])
    order = np.argsort(values, kind="stable")
    drawn = _times_drawn(len(length))[np.repeat(np.arange(len(length)), length)[order]]  # (n, R)
    narrow = np.min_scalar_type(max(length) * len(length))  # summed six times as fast as int64
    num_up_to = drawn.astype(narrow).cumsum(axis=0, dtype=narrow)
    halves = (num_up_to[-1] - 1) // 2, num_up_to[-1] // 2
    middle = [(num_up_to <= half).sum(axis=0, dtype=np.int32) for half in halves]
    return values[order][middle].mean(axis=0)


@cache
def _times_drawn(number: int) -> Integer[NDArray[np.integer], "T R"]:
    """How often each of T transmitters is in each resample."""
    drawn = np.random.default_rng(number).integers(number, size=(NUM_RESAMPLES, number))
    counted = [np.bincount(each, minlength=number) for each in drawn]
    return np.ascontiguousarray(np.transpose(counted).astype(np.min_scalar_type(number)))


def _resampled(row: Row, split: str) -> Float[FloatArray, "R"]:
    records = row.by_split[split]
    medians = np.array([resampled_medians(record.ssim_by_tx) for record in records])  # (S, R)
    generator = np.random.default_rng(int(hashlib.sha256(f"{row.label} {split}".encode()).hexdigest(), 16))
    seeds = generator.integers(len(records), size=medians.shape)
    return np.asarray(np.take_along_axis(_widened(medians), seeds, axis=0).mean(axis=0))


def _widened(medians: Float[FloatArray, "S R"]) -> Float[FloatArray, "S R"]:
    """Deviations of S seeds from their mean, widened: what is drawn from few scatters too little.

    By √(S/(S−1)), as of a standard deviation, and as much as Student's t with the 2(S−1) degrees of freedom of
    a difference of two methods is wider than the normal distribution at 95 %.
    """
    number, mean = len(medians), medians.mean(axis=0)
    if number < 2:
        return medians
    student = stdtrit(2 * (number - 1), 0.975) / ndtri(0.975)
    return mean + np.sqrt(number / (number - 1)) * student * (medians - mean)


def _interval(values: Float[FloatArray, "R"]) -> Interval:
    low, high = quantiles(values, [0.025, 0.975])
    return float(low), float(high)
