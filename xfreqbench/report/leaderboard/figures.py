"""Which figures a report has, which files they are, and what they show; `plots` draws them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from xfreqbench.report.leaderboard.boards import Board, file_stem, pooled_quantiles, short_name
from xfreqbench.report.leaderboard.learning_curves import Reached, best_trivial, learning_curves, split_front
from xfreqbench.report.leaderboard.rows import BoardRow
from xfreqbench.runs.records import BenchRecord

FIGURES_FOLDER = "figures"  # beside the report
_PAPER_TARGETS = ("2.4GHz", "24.25GHz", "77GHz")
_MAX_PANELS = 4
_MAX_CURVES = 10


def figure_links(board: Board) -> dict[str, str]:
    """Links from the report to a board's figures: `cdf` and, where a fit has a learning curve, `time`."""
    names = ["cdf", *(["time"] if any(record.curve for record in board.records) else [])]
    return {name: f"{FIGURES_FOLDER}/{board.slug}-{name}.svg" for name in names}


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

    links = [link for board in boards for link in figure_links(board).values()]
    for link in [*links, *others, *(bench_figure(record) for record in benches if record.figure)]:
        require_own_figure(folder / link)


def draw_board(board: Board, folder: Path) -> list[Path]:
    """Draw a board's figures and return their paths; `folder` holds the report. Raises `StorageError`."""
    draw = {"cdf": _draw_cdf, "time": _draw_curves}
    paths = {name: folder / link for name, link in figure_links(board).items()}
    for name, path in paths.items():
        draw[name](board, path)
    return list(paths.values())


def draw_bench(record: BenchRecord, folder: Path) -> Path:
    """Draw a measurement's figure and return its path; `folder` holds the report. Raises `StorageError`."""
    from xfreqbench.report.leaderboard.plots import plot_cost

    assert record.figure is not None
    path = folder / bench_figure(record)
    plot_cost(record.figure, path)
    return path


def _draw_cdf(board: Board, path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_score_cdf

    splits = board.split_sets()[0]
    rows = _legible(board.rows_on(splits))
    panels = {
        short_name(split): {row.label: pooled_quantiles(row.by_split[split], "ssim") for row in rows}
        for split in _panels(splits)
    }
    plot_score_cdf(panels, "SSIM", path)


def _draw_curves(board: Board, path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import TimePanel, plot_error_against_time

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
    """At most `_MAX_PANELS` splits to draw; of more, those at the paper's targets."""
    if len(splits) <= _MAX_PANELS:
        return splits
    of_paper = [split for split in splits if short_name(split).rpartition("-")[2] in _PAPER_TARGETS]
    return of_paper or splits[:_MAX_PANELS]


def _legible(rows: Sequence[BoardRow]) -> Sequence[BoardRow]:
    """At most `_MAX_CURVES` rows to draw, the best first; the best trivial predictor is always among them."""
    shown = rows[:_MAX_CURVES]
    trivial = [row for row in rows if row.is_trivial]
    return shown if not trivial or trivial[0] in shown else [*shown[:-1], trivial[0]]
