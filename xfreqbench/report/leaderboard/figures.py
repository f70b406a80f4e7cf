"""SSIM against time: the learning curves of fits; and which figures a report has, in which files."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import product
from math import inf, isnan, nan
from operator import itemgetter
from pathlib import Path
from statistics import mean, median
from typing import Any, TypeVar

import numpy as np

from xfreqbench.report.leaderboard.boards import Board, short_name, slug_of
from xfreqbench.report.leaderboard.columns import cost_of
from xfreqbench.runs.records import CURVE_SHARES, BenchFigure, BenchRecord, CurvePoint, curve_positions

Point = TypeVar("Point")


def learning_curves(board: Board, splits: Sequence[str]) -> list[dict[str, Any]]:
    """The points of the learning curves of all rows on these splits, in the board's order of rows.

    A point is that of a share of the budget, one of `CURVE_SHARES` or 1 at the end of the fit: `method` is the label of
    its row, `seconds` of fitting and `ssim`, the median over a fixed sample of test maps, are means over seeds. A
    point that a seed does not have is left out. `reached_s` is the time at which the curve reached the best trivial
    predictor, as median over seeds: inf where it never did, nan where the predictor's SSIM on the sample is unknown.
    """
    trivial = {split: best_trivial(board, split) or (nan, nan) for split in splits}
    points = []
    for row, split in product(board.rows, splits):
        curves = [record.curve for record in row.by_split.get(split, ()) if record.curve]
        if not curves:
            continue
        level = trivial[split][1]
        reached = (next((at.seconds for at in curve if at.ssim >= level), inf) for curve in curves)
        reached_s = nan if isnan(level) else median(reached)
        for share, of_seeds in zip((*CURVE_SHARES, 1.0), zip(*map(_by_share, curves), strict=True), strict=True):
            known = [point for point in of_seeds if point]
            if len(known) == len(of_seeds):
                at = {"seconds": mean(point.seconds for point in known), "ssim": mean(point.ssim for point in known)}
                points.append({"method": row.label, "split": split, "share": share, **at, "reached_s": reached_s})
    return points


def best_trivial(board: Board, split: str) -> tuple[float, float] | None:
    """Seconds and median SSIM on the sample of maps of the best trivial predictor; None where no samples are stored."""
    rows = [row for row in board.rows if row.is_trivial and split in row.by_split]
    records = [row.by_split[split][0] for row in rows if row.by_split[split][0].ssim_by_tx]
    reached = []
    for record in records:
        ssim = np.concatenate([np.asarray(samples, np.float64) for samples in record.ssim_by_tx])
        shown = ssim[curve_positions(record.split_sha256, len(ssim))]
        reached.append((cost_of(record, "seconds"), float(np.median(shown))))
    return max(reached, key=lambda point: point[1], default=None)


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


def _by_share(curve: Sequence[CurvePoint]) -> list[CurvePoint | None]:
    *points, end = curve
    reached = {max(filter(point.share.__ge__, CURVE_SHARES), default=CURVE_SHARES[0]): point for point in points}
    return [*map(reached.get, CURVE_SHARES), end]


def bench_figure(record: BenchRecord) -> str:
    """The link from the report to a measurement's figure."""
    slug = slug_of(re.sub(r"\W+", "-", f"{record.bench} {record.title}".lower())).strip("-")
    return f"figures/bench-{slug}.svg"


def figures_of(boards: Iterable[Board], benches: Iterable[BenchRecord]) -> dict[str, Callable[[Path], None]]:
    """Functions that draw the figures of a report to a path, by their links; they raise `StorageError`."""
    figures: dict[str, Callable[[Path], None]] = {
        board.time_figure: partial(_draw_time, board) for board in boards if board.time_figure
    }
    return figures | {bench_figure(record): partial(_draw_bench, record.figure) for record in benches if record.figure}


def _draw_bench(figure: BenchFigure, path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_cost

    plot_cost(figure, path)


def _draw_time(board: Board, path: Path) -> None:
    """Draw a board's figure of error against time, with a panel for each split: of over four, the paper's targets."""
    from xfreqbench.report.leaderboard.plots import plot_error_against_time

    followed = [split for split in board.splits if learning_curves(board, [split])]
    if len(followed) > 4:
        targets = ("2.4GHz", "24.25GHz", "77GHz")
        of_paper = [split for split in followed if short_name(split).rpartition("-")[2] in targets]
        followed = of_paper or followed[:4]
    panels = {}
    for split in followed:
        lines: dict[str, list[tuple[float, float]]] = {}
        for point in learning_curves(board, [split]):
            lines.setdefault(point["method"], []).append((point["seconds"], point["ssim"]))
        trivial, points = best_trivial(board, split), [point for line in lines.values() for point in line]
        front = pareto_front([*points, *([trivial] if trivial else [])], itemgetter(0), itemgetter(1))
        best = [row.label for row in board.rows_on([split]) if row.label in lines][:10]
        shown = {label: lines[label] for label in best}
        panels[short_name(split)] = shown, [point for point in front if point != trivial], trivial and trivial[1]
    plot_error_against_time(panels, path)
