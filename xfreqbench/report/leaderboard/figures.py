"""Which figures a report has, which files they are, and what they show; `plots` draws them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

from xfreqbench.report.leaderboard.boards import Board, file_stem, short_name
from xfreqbench.report.leaderboard.learning_curves import Reached, best_trivial, learning_curves, split_front
from xfreqbench.runs.records import BenchRecord

FIGURES_FOLDER = "figures"  # beside the report
_PAPER_TARGETS = ("2.4GHz", "24.25GHz", "77GHz")
_MAX_PANELS = 4


def time_link(board: Board) -> str:
    """The link from the report to a board's figure of error against time; empty where no fit has a learning curve."""
    followed = any(record.curve for record in board.records)
    return f"{FIGURES_FOLDER}/{board.slug}-time.svg" if followed else ""


def bench_figure(record: BenchRecord) -> str:
    """The link from the report to a measurement's figure."""
    slug = file_stem(re.sub(r"\W+", "-", f"{record.bench} {record.title}".lower())).strip("-")
    return f"{FIGURES_FOLDER}/bench-{slug}.svg"


def figures_of(boards: Iterable[Board], benches: Iterable[BenchRecord]) -> dict[str, Callable[[Path], None]]:
    """Functions that draw the figures of a report to a path, by their links; they raise `StorageError`."""
    figures: dict[str, Callable[[Path], None]] = {}
    figures |= {link: partial(_draw_time, board) for board in boards if (link := time_link(board))}
    return figures | {bench_figure(record): partial(_draw_bench, record) for record in benches if record.figure}


def _draw_bench(record: BenchRecord, path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_cost

    assert record.figure is not None
    plot_cost(record.figure, path)


def _draw_time(board: Board, path: Path) -> None:
    """Draw a board's figure of error against time."""
    from xfreqbench.report.leaderboard.plots import TimePanel, plot_error_against_time

    panels: dict[str, TimePanel] = {}
    followed = [split for split in board.splits if learning_curves(board, [split])]
    for split in _panels(followed):
        curves, trivial = learning_curves(board, [split]), best_trivial(board, split)
        points = {curve.row.label: _points(curve.known_points) for curve in curves}
        shown = [row for row in board.rows_on([split]) if row.label in points][:10]
        lines = {row.label: points[row.label] for row in shown}
        front = [point for point in split_front(curves, trivial) if point is not trivial]
        panels[short_name(split)] = TimePanel(lines, _points(front), trivial.ssim if trivial else None)
    plot_error_against_time(panels, path)


def _points(reached: Iterable[Reached]) -> list[tuple[float, float]]:
    return [(point.seconds, point.ssim) for point in reached]


def _panels(splits: Sequence[str]) -> Sequence[str]:
    """At most `_MAX_PANELS` splits to draw; of more, those at the paper's targets."""
    if len(splits) <= _MAX_PANELS:
        return splits
    of_paper = [split for split in splits if short_name(split).rpartition("-")[2] in _PAPER_TARGETS]
    return of_paper or splits[:_MAX_PANELS]
