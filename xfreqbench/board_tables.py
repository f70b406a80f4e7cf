"""The tables of one board, as Markdown: means over seeds, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from math import inf, isnan, nan

from xfreqbench.boards import Board, Quantity, Row, median_ssim, or_nan, short_name
from xfreqbench.captions import external_statement, span
from xfreqbench.comparison import Comparison, Resampling
from xfreqbench.learning_curves import (
    LearningCurve,
    Reached,
    best_trivial,
    learning_curves,
    num_sampled,
    split_front,
)
from xfreqbench.markdown import ABSENT, number, seconds, table, with_interval
from xfreqbench.metrics import METRICS
from xfreqbench.published import COLUMN, published_cell, reduced_statement
from xfreqbench.records import CURVE_SHARES, RunRecord
from xfreqbench.units import format_ghz

_OTHER_METRICS = {  # title, decimals
    "ssim_wrapped": ("wrapped", 4),
    "psnr": ("PSNR", 2),
    "power_error": ("power error", 2),
    "aoa_error": ("AoA error", 2),
    "beam_loss": ("beam loss", 3),
}
_COSTS: tuple[tuple[str, Quantity, str], ...] = (  # title, value, format
    ("fit s", lambda record: or_nan(record.fit_seconds), ".2f"),
    ("ms/map", lambda record: or_nan(record.predict_ms_per_map), ".2f"),
    ("peak MiB", lambda record: or_nan(record.peak_memory_mib), ".0f"),
    ("parameters", lambda record: or_nan(record.parameters), ",.0f"),
    ("Gaussians", lambda record: record.counts.get("gaussians", nan), ",.0f"),
)

Column = tuple[str, Callable[[Row], str]]


def summary_tables(board: Board, resampling: Resampling) -> list[str]:
    """A ranking and its pairs for every set of splits that a row was run on."""
    comparisons = [Comparison(board, splits, resampling) for splits in board.split_sets()]
    return [part for each in comparisons for part in (summary_table(each), *_pair_matrix(each))]


def summary_table(comparison: Comparison) -> str:
    """Rows of a comparison, the best average of median SSIM first, under a caption."""
    board, splits = comparison.board, comparison.splits
    several: list[Column] = [_split_column(split) for split in splits] if len(splits) > 1 else []
    columns: list[Column] = [
        ("rank", lambda row: _rank(comparison.ranks(row))),
        ("method", lambda row: row.label),
        *several,
        (
            "average" if several else short_name(splits[0]),
            lambda row: with_interval(row.average(splits, median_ssim), comparison.interval(row), 4),
        ),
        ("± seeds", lambda row: number(row.seed_spread(splits, median_ssim), 4)),
        ("skill", lambda row: _skill(row, comparison)),
        ("seeds", lambda row: span(row.num_seeds(splits))),
        *_cost_columns(board, splits),
        (COLUMN, lambda row: published_cell(row, splits)),
    ]
    where = (
        f"Median SSIM on {len(splits)} splits, best average first" if several else "Median SSIM, best first"
    )
    caption = f"{where}; order within overlapping ranks means nothing:"
    return "\n\n".join([caption, _table(columns, comparison.rows), *_notes(comparison.rows)])


def _notes(rows: Sequence[Row]) -> list[str]:
    """Whose rows are not this toolkit's own predictions, and whose not their authors' programs."""
    return [each for each in (external_statement(rows), reduced_statement(rows)) if each]


def curve_table(board: Board) -> list[str]:
    """How soon each fit with a budget got where it got, and which no other beat; nothing without curves."""
    curves = learning_curves(board, board.splits)
    if not curves:
        return []
    shares = [f"1/{1 / share:.0f}" for share in CURVE_SHARES]
    header = ["method", "split", *shares, "end", "best trivial reached after"]
    title = (
        f"Median SSIM on a fixed sample of {num_sampled(board)} test maps (after seconds of fitting), by share "
        "of the budget:"
    )
    followed = dict.fromkeys(curve.split for curve in curves)
    fronts = [_front_line(board, curves, split) for split in board.splits if split in followed]
    return [
        "### Error against time",
        f"{title}\n\n{table(header, map(_curve_cells, curves))}",
        "Pareto front on the same maps, SSIM that nothing else reaches as soon:\n\n" + "\n".join(fronts),
    ]


def split_tables(board: Board, resampling: Resampling) -> list[str]:
    """Every metric, a table a split; folded for the splits on which fewer methods were run."""
    first = board.split_sets()[0]
    others = [split for split in board.splits if split not in first]
    folded = [part for split in others for part in _of_split(board, split, resampling)]
    summary = f"<details><summary>{', '.join(map(short_name, others))}</summary>"
    return [
        *(part for split in first for part in _of_split(board, split, resampling)),
        *([summary, *folded, "</details>"] if others else []),
    ]


def _of_split(board: Board, split: str, resampling: Resampling) -> list[str]:
    comparison = Comparison(board, (split,), resampling)
    alone = [*_notes(comparison.rows), *_pair_matrix(comparison)] if split in board.lone_splits() else []
    return [_split_table(comparison), *alone, *_carrier_table(board, split)]


def _pair_matrix(comparison: Comparison) -> list[str]:
    """Who beats whom among the ranked rows: only what stands above the diagonal, for below it is the same."""
    rows = _compared(comparison.ranked_rows)
    if len(rows) < 2:
        return []
    header = ["row beats column", *(f"{place}" for place in range(2, len(rows) + 1))]
    body = [
        [
            f"{place} {row.label}",
            *[""] * (place - 1),
            *(_pair_cell(comparison, row, other) for other in rows[place:]),
        ]
        for place, row in enumerate(rows, start=1)
    ]
    caption = "Difference of average median SSIM × 1000 with its interval; “=” where that spans zero:"
    return [f"{caption}\n\n{table(header, body)}"]


def _compared(ranked: Sequence[Row]) -> list[Row]:
    """Of the trivial predictors only the best, where there is anything else to compare."""
    trivial = [row for row in ranked if row.is_trivial]
    return [row for row in ranked if len(trivial) == len(ranked) or row not in trivial[1:]]


def _pair_cell(comparison: Comparison, row: Row, other: Row) -> str:
    low, high = comparison.difference(row, other)
    if low <= 0 <= high:
        return "="
    better, worse = (each.average(comparison.splits, median_ssim) for each in (row, other))
    return f"{1000 * (better - worse):+.2f} [{1000 * low:.2f}, {1000 * high:.2f}]"


def _split_table(comparison: Comparison) -> str:
    board, (split,) = comparison.board, comparison.splits
    columns: list[Column] = [
        ("rank", lambda row: _rank(comparison.ranks(row))),
        ("method", lambda row: row.label),
        ("SSIM", lambda row: with_interval(row.value(split, median_ssim), comparison.interval(row), 4)),
        ("mean", lambda row: number(row.value(split, lambda record: record.scores["ssim"].mean), 4)),
        ("10th pct.", lambda row: number(row.value(split, lambda record: record.scores["ssim"].p10), 4)),
        *(_metric_column(split, name) for name in METRICS if name != "ssim"),
        ("skill", lambda row: _skill(row, comparison)),
        ("seeds", lambda row: span(row.num_seeds(comparison.splits))),
        *_cost_columns(board, comparison.splits),
        (COLUMN, lambda row: published_cell(row, comparison.splits)),
    ]
    record = comparison.rows[0].by_split[split][0]
    left_out = f"; {record.num_without_path} without any path are left out" if record.num_without_path else ""
    caption = f"{record.num_test} samples{left_out}. Medians where nothing else is said, means over seeds."
    return f"### {short_name(split)}\n\n{caption}\n\n{_table(columns, comparison.rows)}"


def _carrier_table(board: Board, split: str) -> list[str]:
    """Median SSIM at each carrier, where a split tests several."""
    rows = board.rows_on([split])
    carriers = sorted({*rows[0].by_split[split][0].scores["ssim"].median_by_carrier_hz}, key=float)
    if len(carriers) < 2:
        return []
    columns: list[Column] = [
        ("method", lambda row: row.label),
        *(_carrier_column(split, each) for each in carriers),
    ]
    return [f"Median SSIM by carrier:\n\n{_table(columns, rows)}"]


def _carrier_column(split: str, carrier_hz: str) -> Column:
    def value(record: RunRecord) -> float:
        return record.scores["ssim"].median_by_carrier_hz.get(carrier_hz, nan)

    return format_ghz(float(carrier_hz)), lambda row: number(row.value(split, value), 4)


def _split_column(split: str) -> Column:
    return short_name(split), lambda row: number(row.value(split, median_ssim), 4)


def _metric_column(split: str, name: str) -> Column:
    title, decimals = _OTHER_METRICS[name]
    unit = f" ({METRICS[name].unit})" if METRICS[name].unit else ""
    return f"{title}{unit}", lambda row: number(
        row.value(split, lambda record: record.scores[name].median), decimals
    )


def _cost_columns(board: Board, splits: Sequence[str]) -> list[Column]:
    """Means over splits and seeds; what no record counts is left out."""
    return [
        (title, _cost_cell(splits, quantity, form))
        for title, quantity, form in _COSTS
        if not all(isnan(quantity(record)) for record in board.records)
    ]


def _cost_cell(splits: Sequence[str], quantity: Quantity, form: str) -> Callable[[Row], str]:
    def cell(row: Row) -> str:
        value = row.average(splits, quantity)
        return ABSENT if isnan(value) else f"{value:{form}}"

    return cell


def _skill(row: Row, comparison: Comparison) -> str:
    value = row.average(comparison.splits, comparison.board.skill)
    return with_interval(value, comparison.skill_interval(row), 3)


def _rank(places: tuple[int, int] | None) -> str:
    return ABSENT if places is None else span(places)


def _curve_cells(curve: LearningCurve) -> list[str]:
    points = map(_point_cell, curve.points)
    return [curve.row.label, short_name(curve.split), *points, _after(curve.seconds_to_beat_trivial)]


def _after(duration_s: float) -> str:
    if isnan(duration_s):
        return ABSENT
    return "never" if duration_s == inf else seconds(duration_s)


def _front_line(board: Board, curves: Sequence[LearningCurve], split: str) -> str:
    """`2.4GHz: nearest 0.8000 (0.01 s); ours 0.8500 (75 s), 0.9000 (300 s).`"""
    front = split_front([curve for curve in curves if curve.split == split], best_trivial(board, split))
    methods = [
        f"{label} {', '.join(map(_point_cell, points))}"
        for label, points in groupby(front, lambda point: point.label)
    ]
    return f"* {short_name(split)}: {'; '.join(methods)}."


def _point_cell(point: Reached | None) -> str:
    return f"{point.ssim:.4f} ({seconds(point.seconds)})" if point else ABSENT


def _table(columns: Sequence[Column], rows: Sequence[Row]) -> str:
    """Columns that are empty in every row are left out."""
    filled = [(title, [cell(row) for row in rows]) for title, cell in columns]
    kept = [(title, cells) for title, cells in filled if any(cells)]
    return table([title for title, _ in kept], zip(*(cells for _, cells in kept), strict=True))
