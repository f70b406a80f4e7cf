"""Error against time: how soon each fit gets where, and which fits no other reaches sooner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isnan, nan
from statistics import mean, median

import numpy as np

from xfreqbench.boards import Board, Row, or_nan
from xfreqbench.pareto import pareto_front
from xfreqbench.records import CURVE_SHARES, CurvePoint, RunRecord, curve_positions


@dataclass(frozen=True)
class Reached:
    """A method after some seconds of fitting: `ssim` is the median over the sample of test maps."""

    label: str
    seconds: float
    ssim: float


@dataclass(frozen=True)
class LearningCurve:
    """Points of a row on a split, means over seeds: one a share of `CURVE_SHARES` and one at the end.

    A point is None where a seed has none. `seconds_to_beat_trivial` is the median over seeds of when the best
    trivial predictor was first reached: inf for never, nan where its SSIM on the sample is unknown.
    """

    row: Row
    split: str
    points: tuple[Reached | None, ...]
    seconds_to_beat_trivial: float

    @property
    def known_points(self) -> list[Reached]:
        """The points there are, in the order of time."""
        return [point for point in self.points if point]


def learning_curves(board: Board, splits: Sequence[str]) -> list[LearningCurve]:
    """Curves of every row that has them, the rows in the board's order."""
    trivial = {split: best_trivial(board, split) for split in splits}
    return [
        _learning_curve(row, split, trivial[split])
        for row in board.rows
        for split in splits
        if any(record.curve for record in row.by_split.get(split, ()))
    ]


def best_trivial(board: Board, split: str) -> Reached | None:
    """The trivial predictor with the largest median on the sample of maps; None where none stored its samples."""
    records = [
        row.by_split[split][0]
        for row in board.rows
        if row.is_trivial and split in row.by_split and row.by_split[split][0].ssim_by_tx
    ]
    reached = [
        Reached(record.job.method, or_nan(record.fit_seconds), _sampled_median(record)) for record in records
    ]
    return max(reached, key=lambda point: point.ssim, default=None)


def num_sampled(board: Board) -> int:
    """Number of maps that a point of a curve is taken on, the most of any split."""
    records = (record for record in board.records if record.curve)
    return max((len(curve_positions(record.split_sha256, record.num_test)) for record in records), default=0)


def split_front(curves: Sequence[LearningCurve], trivial: Reached | None) -> list[Reached]:
    """Front of a split's curves, from the best trivial predictor on where there is one."""
    points = [point for curve in curves for point in curve.known_points]
    known = sorted([*([trivial] if trivial else []), *points], key=lambda point: point.label)
    return pareto_front(known, cost=lambda point: point.seconds, score=lambda point: point.ssim)


def _sampled_median(record: RunRecord) -> float:
    ssim = np.concatenate([np.asarray(samples, np.float64) for samples in record.ssim_by_tx])
    return float(np.median(ssim[curve_positions(record.split_sha256, len(ssim))]))


def _learning_curve(row: Row, split: str, trivial: Reached | None) -> LearningCurve:
    records = [record for record in row.by_split[split] if record.curve]
    by_point = zip(*map(_by_share, records), strict=True)
    points = tuple(_mean_point(row.label, points) for points in by_point)
    level = trivial.ssim if trivial else nan
    return LearningCurve(row, split, points, median(_seconds_to(level, record.curve) for record in records))


def _by_share(record: RunRecord) -> list[CurvePoint | None]:
    *points, end = record.curve
    spent = {point: record.job.budget.share(point.step, point.seconds) for point in points}
    reached = {max(filter(spent[point].__ge__, CURVE_SHARES)): point for point in points}
    return [*map(reached.get, CURVE_SHARES), end]


def _mean_point(label: str, points: Sequence[CurvePoint | None]) -> Reached | None:
    known = [point for point in points if point]
    if len(known) < len(points):
        return None
    return Reached(label, mean(point.seconds for point in known), mean(point.ssim for point in known))


def _seconds_to(ssim: float, curve: Sequence[CurvePoint]) -> float:
    """Seconds after which a curve first stands at a level or above it; inf for never."""
    if isnan(ssim):
        return nan
    return next((point.seconds for point in curve if point.ssim >= ssim), inf)
