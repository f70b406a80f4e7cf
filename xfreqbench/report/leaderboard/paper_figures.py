"""The figures of the page on the paper's claims, from records alone: distributions of SSIM and PSNR."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from xfreqbench.report.drawing.markdown import ABSENT, number, prose, table
from xfreqbench.report.leaderboard.boards import Board, pooled_quantiles
from xfreqbench.report.leaderboard.columns import metric_title
from xfreqbench.report.leaderboard.figures import FIGURES_FOLDER
from xfreqbench.report.leaderboard.published import published_content, stands_for
from xfreqbench.report.leaderboard.rows import BoardRow

_LEVEL = 90  # per cent of the maps, as in the paper
_METRICS = {"ssim": 4, "psnr": 2}  # with decimals


def paper_figures(ranked: Sequence[Board]) -> dict[str, Callable[[Path], None]]:
    """For each figure of the page its link from the page, and what draws it to a path and may raise `StorageError`."""
    return {cdf_link(board): partial(_draw_cdf, board) for board in ranked if _splits(board)}


def cdf_link(board: Board) -> str:
    """The link from the page to the figure of the distributions on a board."""
    return f"{FIGURES_FOLDER}/paper-{board.slug}-cdf.svg"


def level_table(board: Board) -> str:
    """SSIM and PSNR at the 90 % level of their distributions, theirs and ours; empty where `_splits` are none."""
    published = published_content()["table"]["cdf"]["rows"]
    splits = _splits(board)
    if not splits:
        return ""
    rows = _rows(board)
    cells = [
        [
            row.short_label,
            *([name, *published[name]] if name in published else [ABSENT, ABSENT]),
            *(number(_pooled(row, splits, metric)[_LEVEL], digits) for metric, digits in _METRICS.items()),
        ]
        for name, row in rows.items()
    ]
    return table(("method", "theirs", "published SSIM", *map(metric_title, _METRICS)), cells, prose)


def _draw_cdf(board: Board, path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_score_cdf

    rows, splits = _rows(board).values(), _splits(board)
    panels = {
        metric_title(metric): {row.short_label: _pooled(row, splits, metric) for row in rows}
        for metric in _METRICS
    }
    plot_score_cdf(panels, "", path, _LEVEL / 100)


def published_rows(board: Board) -> dict[str, BoardRow]:
    """Our rows with default options for those whose distribution the paper shows, by its names, the best first."""
    content = published_content()
    if board.protocol != content["table"]["cdf"]["protocol"]:
        return {}
    found: dict[str, BoardRow] = {}
    for row in board.rows:
        for each in content["counterpart"] if row.family == "learned" else ():
            if each["name"] in content["table"]["cdf"]["rows"] and stands_for(each, row):
                found.setdefault(each["name"], row)
    return found


def _rows(board: Board) -> dict[str, BoardRow]:
    """The paper's rows, and beside them the best predictor that learns nothing."""
    found, splits = published_rows(board), _splits(board)
    trivial = [row for row in board.rows_on(splits) if row.is_trivial][:1] if found else []
    return found | {row.label: row for row in trivial}


def _splits(board: Board) -> tuple[str, ...]:
    """The splits that all of the paper's rows were run on; none where there are no such rows."""
    rows = published_rows(board).values()
    return tuple(split for split in board.splits if rows and all(split in row.by_split for row in rows))


def _pooled(row: BoardRow, splits: Sequence[str], metric: str) -> list[float]:
    return pooled_quantiles([record for split in splits for record in row.by_split[split]], metric)
