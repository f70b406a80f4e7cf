"""Which figures a report has, which files they are, and what they show; `plots` draws them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from xfreqbench.report.leaderboard.boards import Board, file_stem, short_name
from xfreqbench.report.leaderboard.learning_curves import Reached, best_trivial, learning_curves, split_front
from xfreqbench.runs.records import BenchRecord

FIGURES_FOLDER = "figures"  # beside the report
_PAPER_TARGETS = ("2.4GHz", "24.25GHz", "77GHz")
_MAX_PANELS = 4
_MAX_CURVES = 10


def time_link(board: Board) -> str:
    """The link from the report to a board's figure of error against time; empty where no fit has a learning curve."""
    followed = any(record.curve for record in board.records)
    return f"{FIGURES_FOLDER}/{board.slug}-time.svg" if followed else ""


def bench_figure(record: BenchRecord) -> str:
    """The link from the report to a measurement's figure."""
    slug = file_stem(re.sub(r"\W+", "-", f"{record.bench} {record.title}".lower())).strip("-")
    return f"{FIGURES_FOLDER}/bench-{slug}.svg"


def require_own_figures(
    boards: Iterable[Board], benches: Iterable[BenchRecord], others: Iterable[str], folder: Path
) -> None:
    """Raise `OutputExistsError` where a figure of the report in `folder` would replace a file that we did not write.

    `others` are links to further figures.
    """
    from xfreqbench.report.drawing.figures import require_own_figure

    links = filter(None, map(time_link, boards))
    for link in [*links, *others, *(bench_figure(record) for record in benches if record.figure)]:
        require_own_figure(folder / link)


def draw_bench(record: BenchRecord, folder: Path) -> Path:
    """Draw a measurement's figure and return its path; `folder` holds the report. Raises `StorageError`."""
    from xfreqbench.report.leaderboard.plots import plot_cost

    assert record.figure is not None
    path = folder / bench_figure(record)
    plot_cost(record.figure, path)
    return path


def draw_time(board: Board, folder: Path) -> list[Path]:
    """Draw a board's figure of error against time, if it has one, and return its path; `folder` holds the report.

    Raises `StorageError`.
    """
    from xfreqbench.report.leaderboard.plots import TimePanel, plot_error_against_time

    if not time_link(board):
        return []
    path = folder / time_link(board)
    panels: dict[str, TimePanel] = {}
    followed = [split for split in board.splits if learning_curves(board, [split])]
    for split in _panels(followed):
        curves, trivial = learning_curves(board, [split]), best_trivial(board, split)
        points = {curve.row.label: _points(curve.known_points) for curve in curves}
        shown = [row for row in board.rows_on([split]) if row.label in points][:_MAX_CURVES]
        lines = {row.label: points[row.label] for row in shown}
        front = [point for point in split_front(curves, trivial) if point is not trivial]
        panels[short_name(split)] = TimePanel(lines, _points(front), trivial.ssim if trivial else None)
    plot_error_against_time(panels, path)
    return [path]


def _points(reached: Iterable[Reached]) -> list[tuple[float, float]]:
    return [(point.seconds, point.ssim) for point in reached]


def _panels(splits: Sequence[str]) -> Sequence[str]:
    """At most `_MAX_PANELS` splits to draw; of more, those at the paper's targets."""
    if len(splits) <= _MAX_PANELS:
        return splits
    of_paper = [split for split in splits if short_name(split).rpartition("-")[2] in _PAPER_TARGETS]
    return of_paper or splits[:_MAX_PANELS]
