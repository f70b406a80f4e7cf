"""SSIM against time: the learning curves of fits, and the points that no other fit reaches as soon."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf, isnan, nan
from statistics import mean, median
from typing import TypeVar

import numpy as np

from xfreqbench.report.leaderboard.boards import Board, or_nan
from xfreqbench.report.leaderboard.rows import BoardRow
from xfreqbench.runs.records import CURVE_SHARES, CurvePoint, RunRecord, curve_positions

Point = TypeVar("Point")


@dataclass(frozen=True)
class Reached:
    """A method after some seconds of fitting; `ssim` is the median over a fixed sample of test maps."""

    label: str
    seconds: float
    ssim: float


@dataclass(frozen=True)
class LearningCurve:
    """The learning curve of a row on a split: one point for each of `CURVE_SHARES`, and one for the end of the fit.

    Points are means over seeds, and None where a seed has no such point. `seconds_to_beat_trivial` is the time at
    which the curve reached the best trivial predictor, as median over seeds: inf where it never did, nan where the
    predictor's SSIM on the sample is unknown.
    """

    row: BoardRow
    split: str
    points: tuple[Reached | None, ...]
    seconds_to_beat_trivial: float

    @property
    def known_points(self) -> list[Reached]:
        """The points that are not None, by time."""
        return [point for point in self.points if point]


def learning_curves(board: Board, splits: Sequence[str]) -> list[LearningCurve]:
    """The curves of all rows that have any on these splits, in the board's order of rows."""
    trivial = {split: best_trivial(board, split) for split in splits}
    return [
        _learning_curve(row, split, trivial[split])
        for row in board.rows
        for split in splits
        if any(record.curve for record in row.by_split.get(split, ()))
    ]


def best_trivial(board: Board, split: str) -> Reached | None:
    """The trivial predictor with the largest median SSIM on the sample of maps; None where no samples are stored."""
    records = [
        row.by_split[split][0]
        for row in board.rows
        if row.is_trivial and split in row.by_split and row.by_split[split][0].ssim_by_tx
    ]
    reached = [Reached(record.job.method, or_nan(record.fit_seconds), _sampled_median(record)) for record in records]
    return max(reached, key=lambda point: point.ssim, default=None)


def split_front(curves: Sequence[LearningCurve], trivial: Reached | None) -> list[Reached]:
    """The Pareto front of a split's curves and of the best trivial predictor, if there is one."""
    points = [point for curve in curves for point in curve.known_points]
    known = sorted([*([trivial] if trivial else []), *points], key=lambda point: point.label)
    return pareto_front(known, cost=lambda point: point.seconds, score=lambda point: point.ssim)


def pareto_front(
    points: Iterable[Point], cost: Callable[[Point], float], score: Callable[[Point], float]
) -> list[Point]:
    """Points that score more than every other point of the same cost or less, the cheapest first.

    Of points that are equal in both, the first is kept.
    """
    front: list[Point] = []
    for point in sorted(points, key=lambda other: (cost(other), -score(other))):
        if not front or score(point) > score(front[-1]):
            front.append(point)
    return front


def _sampled_median(record: RunRecord) -> float:
    ssim = np.concatenate([np.asarray(samples, np.float64) for samples in record.ssim_by_tx])
    return float(np.median(ssim[curve_positions(record.split_sha256, len(ssim))]))


def _learning_curve(row: BoardRow, split: str, trivial: Reached | None) -> LearningCurve:
    records = [record for record in row.by_split[split] if record.curve]
    by_point = zip(*map(_by_share, records), strict=True)
    points = tuple(_mean_point(row.label, points) for points in by_point)
    level = trivial.ssim if trivial else nan
    return LearningCurve(row, split, points, median(_seconds_to(level, record.curve) for record in records))


def _by_share(record: RunRecord) -> list[CurvePoint | None]:
    *points, end = record.curve
    reached = {max(filter(point.share.__ge__, CURVE_SHARES), default=CURVE_SHARES[0]): point for point in points}
    return [*map(reached.get, CURVE_SHARES), end]


def _mean_point(label: str, points: Sequence[CurvePoint | None]) -> Reached | None:
    known = [point for point in points if point]
    if len(known) < len(points):
        return None
    return Reached(label, mean(point.seconds for point in known), mean(point.ssim for point in known))


def _seconds_to(ssim: float, curve: Sequence[CurvePoint]) -> float:
    """Seconds until a curve first reaches a level: inf where it never does, nan where the level is nan."""
    if isnan(ssim):
        return nan
    return next((point.seconds for point in curve if point.ssim >= ssim), inf)
