"""Which figures a report has, where they lie, and what they show; `plots` draws them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from xfreqbench.boards import Board, Row, pooled_quantiles, short_name
from xfreqbench.learning_curves import Reached, best_trivial, learning_curves, split_front
from xfreqbench.records import BenchRecord

FIGURES_FOLDER = "figures"  # beside the report
_PAPER_TARGETS = ("2.4GHz", "24.25GHz", "77GHz")
_MAX_PANELS = 4
_MAX_CURVES = 10


def figure_links(board: Board) -> dict[str, str]:
    """Links from the report to a board's figures: `cdf`, and `time` where a fit has a learning curve."""
    names = ["cdf", *(["time"] if any(record.curve for record in board.records) else [])]
    return {name: f"{FIGURES_FOLDER}/{board.slug}-{name}.svg" for name in names}


def bench_figure(record: BenchRecord) -> str:
    """Link from the report to a measurement's figure."""
    slug = re.sub(r"\W+", "-", f"{record.bench} {record.title}".lower()).strip("-")
    return f"{FIGURES_FOLDER}/bench-{slug}.svg"


def draw_board(board: Board, folder: Path) -> list[Path]:
    """Draw a board's figures; their paths, the folder of the report being `folder`. Raises `StorageError`."""
    draw = {"cdf": _draw_cdf, "time": _draw_curves}
    paths = {name: folder / link for name, link in figure_links(board).items()}
    for name, path in paths.items():
        draw[name](board, path)
    return list(paths.values())


def draw_bench(record: BenchRecord, folder: Path) -> Path:
    """Draw a measurement's figure; its path. Raises `StorageError`."""
    from xfreqbench.plots import plot_cost

    assert record.figure is not None
    path = folder / bench_figure(record)
    plot_cost(record.figure, path)
    return path


def _draw_cdf(board: Board, path: Path) -> None:
    from xfreqbench.plots import plot_score_cdf  # matplotlib takes a second to load; tables need none

    splits = board.split_sets()[0]
    rows = _legible(board.rows_on(splits))
    panels = {
        short_name(split): {row.label: pooled_quantiles(row.by_split[split], "ssim") for row in rows}
        for split in _panels(splits)
    }
    plot_score_cdf(panels, "SSIM", path)


def _draw_curves(board: Board, path: Path) -> None:
    from xfreqbench.plots import TimePanel, plot_error_against_time

    panels: dict[str, TimePanel] = {}
    followed = [split for split in board.splits if learning_curves(board, [split])]
    for split in _panels(followed):
        curves, trivial = learning_curves(board, [split]), best_trivial(board, split)
        points = {curve.row.label: _points(curve.known_points) for curve in curves}
        shown = _legible([row for row in board.rows_on([split]) if row.label in points])
        lines = {row.label: points[row.label] for row in shown}
        front = [point for point in split_front(curves, trivial) if point is not trivial]
        panels[short_name(split)] = TimePanel(lines, _points(front), trivial.ssim if trivial else None)
    plot_error_against_time(panels, path)


def _points(reached: Iterable[Reached]) -> list[tuple[float, float]]:
    return [(point.seconds, point.ssim) for point in reached]


def _panels(splits: Sequence[str]) -> Sequence[str]:
    """As many splits as a figure can show, the paper's targets before others."""
    if len(splits) <= _MAX_PANELS:
        return splits
    return [split for split in splits if short_name(split).endswith(_PAPER_TARGETS)] or splits[:_MAX_PANELS]


def _legible(rows: Sequence[Row]) -> Sequence[Row]:
    """As many rows as can be told apart, the best first; the best trivial predictor is one of them."""
    shown = rows[:_MAX_CURVES]
    trivial = [row for row in rows if row.is_trivial]
    return shown if not trivial or trivial[0] in shown else [*shown[:-1], trivial[0]]
