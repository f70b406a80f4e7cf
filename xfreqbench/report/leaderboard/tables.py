"""The tables of one board as Markdown. Numbers are means over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import groupby
from math import inf, isnan, nan

from xfreqbench.report.drawing.markdown import ABSENT, heading, literal, number, paragraph, plain, seconds, table
from xfreqbench.report.leaderboard.boards import Board, short_name
from xfreqbench.report.leaderboard.captions import notes
from xfreqbench.report.leaderboard.columns import ONE_SPLIT, RANKING, leaderboard_columns
from xfreqbench.report.leaderboard.comparison import Comparison, Resampling
from xfreqbench.report.leaderboard.learning_curves import (
    LearningCurve,
    Reached,
    best_trivial,
    learning_curves,
    num_sampled,
    split_front,
)
from xfreqbench.report.leaderboard.rows import BoardRow, median_ssim
from xfreqbench.runs.records import CURVE_SHARES, RunRecord
from xfreqbench.units import format_ghz


def ranking_tables(board: Board, resampling: Resampling) -> list[str]:
    """For every set of splits that rows share: the ranking, and a table of which row beats which."""
    comparisons = [Comparison(board, splits, resampling) for splits in board.split_sets()]
    return [part for comparison in comparisons for part in (ranking_table(comparison), *_pair_table(comparison))]


def ranking_table(comparison: Comparison, columns: Sequence[str] = RANKING) -> str:
    """The rows of a comparison, the best average of median SSIM first, with a caption above and notes below.

    `columns` are names that `leaderboard_columns` knows, such as `BRIEF`.
    """
    num_splits = len(comparison.splits)
    where = f" on {num_splits} splits, best average first" if num_splits > 1 else ", best first"
    caption = f"Median SSIM{where}; order within overlapping ranks means nothing:"
    below = map(paragraph, notes(comparison))
    return "\n\n".join([caption, _leaderboard(comparison, columns), *below])


def split_tables(board: Board, resampling: Resampling) -> list[str]:
    """A table with every metric for each split; tables of splits on which fewer rows were run are folded."""
    first = board.split_sets()[0]
    others = [split for split in board.splits if split not in first]
    folded = [part for split in others for part in _split_parts(board, split, resampling)]
    names = escape(plain(", ".join(map(short_name, others))), quote=False)
    summary = f"<details><summary>{names}</summary>"
    return [
        *(part for split in first for part in _split_parts(board, split, resampling)),
        *([summary, *folded, "</details>"] if others else []),
    ]


def curve_tables(board: Board) -> list[str]:
    """SSIM against time for each fit with a learning curve, and the Pareto front of each split; empty without any."""
    curves = learning_curves(board, board.splits)
    if not curves:
        return []
    shares = [f"1/{1 / share:.0f}" for share in CURVE_SHARES]
    header = ["method", "split", *shares, "end", "best trivial reached after"]
    caption = (
        f"Median SSIM on a fixed sample of {num_sampled(board)} test maps (after seconds of fitting), by share "
        "of the budget:"
    )
    followed = {curve.split for curve in curves}
    fronts = [_front_line(board, curves, split) for split in board.splits if split in followed]
    return [
        "### Error against time",
        f"{caption}\n\n{table(header, map(_curve_cells, curves))}",
        "Pareto front on the same maps, SSIM that nothing else reaches as soon:\n\n" + "\n".join(fronts),
    ]


def _leaderboard(comparison: Comparison, names: Sequence[str]) -> str:
    """A table of the named columns; an interval stands in the cell of its number."""
    columns = leaderboard_columns(comparison, names)
    rows = [[f"{column.text(row)} {column.interval(row)}".strip() for column in columns] for row in comparison.rows]
    return table([column.title for column in columns], rows)


def _split_parts(board: Board, split: str, resampling: Resampling) -> list[str]:
    comparison = Comparison(board, (split,), resampling)
    record = comparison.rows[0].by_split[split][0]
    left_out = f"; {record.num_without_path} without any path are left out" if record.num_without_path else ""
    caption = f"{record.num_test} samples{left_out}. Medians where nothing else is said, means over seeds."
    title = f"### {heading(short_name(split))}"
    alone = [*map(paragraph, notes(comparison)), *_pair_table(comparison)] if split in board.lone_splits() else []
    return [title, caption, _leaderboard(comparison, ONE_SPLIT), *alone, *_carrier_table(board, split)]


def _carrier_table(board: Board, split: str) -> list[str]:
    """Median SSIM at each carrier, where a split tests several; empty where it tests one."""

    def text(row: BoardRow, carrier_hz: str) -> str:
        def at_carrier(record: RunRecord) -> float:
            return record.scores["ssim"].median_by_carrier_hz.get(carrier_hz, nan)

        return number(row.value(split, at_carrier), 4)

    rows = board.rows_on([split])
    carriers = sorted(rows[0].by_split[split][0].scores["ssim"].median_by_carrier_hz, key=float)
    if len(carriers) < 2:
        return []
    header = ["method", *(format_ghz(float(carrier)) for carrier in carriers)]
    body = [[row.label, *(text(row, carrier) for carrier in carriers)] for row in rows]
    return [f"Median SSIM by carrier:\n\n{table(header, body)}"]


def _pair_table(comparison: Comparison) -> list[str]:
    """Which ranked row beats which. Below the diagonal the cells are empty, for they would say the same.

    Trivial predictors behind the best one are left out, unless all rows are trivial.
    """
    ranked = comparison.ranked_rows
    trivial = [row for row in ranked if row.is_trivial]
    rows = [row for row in ranked if len(trivial) == len(ranked) or row not in trivial[1:]]
    if len(rows) < 2:
        return []
    header = ["row beats column", *(f"{place}" for place in range(2, len(rows) + 1))]
    body = [
        [f"{place} {row.label}", *[""] * (place - 1), *(_pair_cell(comparison, row, other) for other in rows[place:])]
        for place, row in enumerate(rows, start=1)
    ]
    caption = "Difference of average median SSIM × 1000 with its interval; “=” where that spans zero:"
    return [f"{caption}\n\n{table(header, body)}"]


def _pair_cell(comparison: Comparison, row: BoardRow, other: BoardRow) -> str:
    low, high = comparison.difference(row, other)
    if low <= 0 <= high:
        return "="
    better, worse = (compared.average(comparison.splits, median_ssim) for compared in (row, other))
    return f"{1000 * (better - worse):+.2f} [{1000 * low:.2f}, {1000 * high:.2f}]"


def _curve_cells(curve: LearningCurve) -> list[str]:
    duration_s = curve.seconds_to_beat_trivial
    beaten = ABSENT if isnan(duration_s) else "never" if duration_s == inf else seconds(duration_s)
    return [curve.row.label, short_name(curve.split), *map(_point_cell, curve.points), beaten]


def _front_line(board: Board, curves: Sequence[LearningCurve], split: str) -> str:
    """The front of a split: `* 2.4GHz: nearest 0.8000 (0.01 s); ours 0.8500 (75 s), 0.9000 (300 s).`"""
    front = split_front([curve for curve in curves if curve.split == split], best_trivial(board, split))
    methods = [
        f"{literal(label)} {', '.join(map(_point_cell, points))}"
        for label, points in groupby(front, lambda point: point.label)
    ]
    return f"* {literal(short_name(split))}: {'; '.join(methods)}."


def _point_cell(point: Reached | None) -> str:
    return f"{point.ssim:.4f} ({seconds(point.seconds)})" if point else ABSENT
