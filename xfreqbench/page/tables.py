"""The page's tables as HTML: they stand without a script, which only sorts, filters and hides them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape
from math import isfinite, isinf, isnan, nan

from xfreqbench.boards import (
    Board,
    Quantity,
    Row,
    family,
    median_ssim,
    or_nan,
    short_commit,
    short_name,
)
from xfreqbench.captions import external_statement, leak_statement, machine_name, machine_names, span, tracing
from xfreqbench.comparison import Comparison, Interval
from xfreqbench.published import reduced_statement
from xfreqbench.records import BenchRecord

_ABSENT = "–"


@dataclass(frozen=True)
class Cell:
    """What stands in a table, the number it is sorted by (nan comes last), and a smaller second line."""

    text: str
    value: float = nan
    note: str = ""


@dataclass(frozen=True)
class Column:
    """A column, and whether a first click sorts its largest numbers to the top."""

    title: str
    hint: str
    largest_first: bool
    cell: Callable[[Row], Cell]


def header(ranked: Sequence[Board]) -> str:
    """Data sets, machines, commits and dates of all records."""
    records = [record for board in ranked for record in board.records]
    data = {f"{board.scene}, {board.pas_kind} maps, sha256 {board.dataset_sha256[:16]}" for board in ranked}
    commits = {short_commit(record.git_commit) for record in records}
    days = sorted({record.time_utc[:10] for record in records})
    facts = {
        "Data": sorted(data),
        "Machines": machine_names(records) or ["none: every row is external"],
        "Commits": [", ".join(sorted(commits))],
        "Runs": [f"{len(records):,}, {' to '.join(dict.fromkeys((days[0], days[-1])))}"],
    }
    return "\n".join(
        f"<dt>{name}</dt>{''.join(f'<dd>{_e(v)}</dd>' for v in all_)}" for name, all_ in facts.items()
    )


def board_section(number: int, comparisons: Sequence[Comparison]) -> str:
    """A board's captions and a leaderboard for each of its sets of splits."""
    board = comparisons[0].board
    sets = _lines(_set_section(index, each) for index, each in enumerate(comparisons))
    return (
        f'<section class="board" data-board="{number}" data-title="{_e(board.title)}">\n'
        f"<h2>{_e(board.title)}</h2>\n<p>{_e(_conditions(board))}</p>\n{sets}\n</section>"
    )


def bench_sections(benches: Sequence[BenchRecord]) -> str:
    """Tables of measurements, each with its command; empty without any."""
    if not benches:
        return ""
    tables = _lines(_bench_section(number, bench) for number, bench in enumerate(benches))
    title = "Measurements of generator, savings and stability"
    return f'<details id="benches"><summary>{title}</summary>\n{tables}\n</details>'


def _conditions(board: Board) -> str:
    counts = " or ".join(f"{count:,}" for count in sorted({record.num_test for record in board.records}))
    data = f"Data set {board.dataset_sha256[:16]}: {tracing(board)}; {counts} test maps a split"
    return f"{data}. {leak_statement(board)}"


def _set_section(index: int, comparison: Comparison) -> str:
    splits = [short_name(split) for split in comparison.splits]
    noun = "split" if len(splits) == 1 else "splits"
    title = f"{len(splits)} {noun}: {', '.join(splits)}"
    return (
        f'<div class="set" data-set="{index}" data-title="{_e(title)}">\n<h3>{_e(title)}</h3>\n'
        f"{_leaderboard(comparison)}{_notes(comparison)}</div>"
    )


def _notes(comparison: Comparison) -> str:
    """Whose rows are not this toolkit's own predictions, and whose not their authors' programs."""
    texts = external_statement(comparison.rows), reduced_statement(comparison.rows)
    return "".join(f'<p class="note">{_e(text)}</p>\n' for text in texts if text)


def _leaderboard(comparison: Comparison) -> str:
    columns = _columns(comparison)
    trivial = [row for row in comparison.rows if row.is_trivial]  # the best first
    body = [_row(row, columns, row in trivial[:1]) for row in comparison.rows]
    return _table("leaderboard", [_head(column) for column in columns], body)


def _table(kind: str, heads: Iterable[str], rows: Iterable[str]) -> str:
    """A table in a box of its own to scroll in; with the keyboard too."""
    return (
        f'<div class="scroll" role="region" aria-label="{kind}" tabindex="0"><table class="{kind}">\n'
        f"<thead><tr>{''.join(heads)}</tr></thead>\n<tbody>\n{_lines(rows)}\n</tbody></table></div>\n"
    )


def _lines(parts: Iterable[str]) -> str:
    return "\n".join(parts)


def _head(column: Column) -> str:
    first = "descending" if column.largest_first else "ascending"
    sorting = ' aria-sort="descending"' if column.title == "average" else ""
    name = ' class="name"' if column.title == "method" else ""
    return f'<th scope="col"{name} data-first="{first}"{sorting} title="{_e(column.hint)}">{_e(column.title)}</th>'


def _row(row: Row, columns: Sequence[Column], is_best_trivial: bool) -> str:
    mark = ' class="best-trivial"' if is_best_trivial else ""
    badge = ' <small class="badge">best trivial</small>' if is_best_trivial else ""
    cells = "".join(_cell(column, column.cell(row), badge) for column in columns)
    return f'<tr data-label="{_e(row.label)}" data-family="{family(row)}"{mark}>{cells}</tr>'


def _cell(column: Column, cell: Cell, badge: str) -> str:
    if column.title == "method":
        return f'<th scope="row" class="name">{_e(cell.text)}{badge}</th>'
    value = "" if isnan(cell.value) else repr(cell.value)
    note = f"<small>{_e(cell.note)}</small>" if cell.note else ""
    return f'<td data-value="{value}">{_e(cell.text)}{note}</td>'


def _columns(comparison: Comparison) -> list[Column]:
    splits = [_split_column(split) for split in comparison.splits]
    return [
        Column("rank", "places that the intervals leave open", False, lambda row: _rank(comparison, row)),
        Column("method", "with what differs from a plain run", False, lambda row: Cell(row.label)),
        *splits,
        _average_column(comparison),
        _skill_column(comparison),
        Column("seeds", "runs of each split", True, lambda row: _seeds(comparison, row)),
        *(_metric_column(comparison, *each) for each in _METRIC_COLUMNS),
        *(_cost_column(comparison, *each) for each in _COST_COLUMNS),
    ]


_METRIC_COLUMNS = (
    ("PSNR dB", "psnr", "peak signal-to-noise ratio", True, 2),
    ("power error dB", "power_error", "mean absolute error within 30 dB of the peak", False, 2),
    ("AoA error °", "aoa_error", "angle between predicted and true peak", False, 2),
    ("beam loss dB", "beam_loss", "power lost by steering at the predicted peak", False, 3),
)

_COST_COLUMNS: tuple[tuple[str, str, bool, Quantity, str], ...] = (
    ("p10 SSIM", "a tenth of the maps lies below", True, lambda record: record.scores["ssim"].p10, ".4f"),
    ("fit s", "seconds of fitting", False, lambda record: or_nan(record.fit_seconds), ",.2f"),
    (
        "ms/map",
        "milliseconds a predicted map",
        False,
        lambda record: or_nan(record.predict_ms_per_map),
        ",.2f",
    ),
    ("MiB", "largest memory of the process", False, lambda record: or_nan(record.peak_memory_mib), ",.0f"),
    ("parameters", "numbers that training sets", False, lambda record: or_nan(record.parameters), ",.0f"),
)


def _split_column(split: str) -> Column:
    hint = f"median SSIM of {split}, mean over the seeds"
    return Column(short_name(split), hint, True, lambda row: _number(row.value(split, median_ssim), ".4f"))


def _average_column(comparison: Comparison) -> Column:
    average = _average(comparison, median_ssim)
    hint = "mean over the splits of the median SSIM, and its 95 % interval"
    return Column("average", hint, True, lambda row: _number(average(row), ".4f", comparison.interval(row)))


def _skill_column(comparison: Comparison) -> Column:
    average = _average(comparison, comparison.board.skill)
    hint = "share of what the best trivial predictor leaves open that is closed, and its 95 % interval"
    return Column(
        "skill", hint, True, lambda row: _number(average(row), ".3f", comparison.skill_interval(row))
    )


def _metric_column(
    comparison: Comparison, title: str, name: str, hint: str, largest_first: bool, decimals: int
) -> Column:
    average = _average(comparison, lambda record: record.scores[name].median)
    hint = f"median, mean over splits and seeds: {hint}"
    return Column(title, hint, largest_first, lambda row: _number(average(row), f".{decimals}f"))


def _cost_column(
    comparison: Comparison, title: str, hint: str, largest_first: bool, quantity: Quantity, form: str
) -> Column:
    average = _average(comparison, quantity)
    return Column(
        title, f"mean over splits and seeds: {hint}", largest_first, lambda row: _number(average(row), form)
    )


def _average(comparison: Comparison, quantity: Quantity) -> Callable[[Row], float]:
    return lambda row: row.average(comparison.splits, quantity)


def _rank(comparison: Comparison, row: Row) -> Cell:
    ranks = comparison.ranks(row)
    if ranks is None:
        return Cell(_ABSENT)
    best, worst = ranks
    return Cell(span(ranks), best + worst / 1e4)


def _seeds(comparison: Comparison, row: Row) -> Cell:
    numbers = row.num_seeds(comparison.splits)
    return Cell(span(numbers), float(numbers[0]))


def _number(value: float, form: str, interval: Interval = (nan, nan)) -> Cell:
    """A number as `form` has it, hyphens as minus signs; without an interval there is no second line."""
    if isnan(value):
        return Cell(_ABSENT)
    decimals = form if form.startswith(".") else ".3g"
    note = f"[{interval[0]:{decimals}}, {interval[1]:{decimals}}]" if isfinite(sum(interval)) else ""
    text = ("∞" if value > 0 else "-∞") if isinf(value) else f"{value:{form}}"
    return Cell(text.replace("-", "−"), value, note.replace("-", "−"))


def _bench_section(number: int, bench: BenchRecord) -> str:
    heads = [f'<th scope="col">{_e(column)}</th>' for column in bench.columns]
    source = (
        f"<code>{_e(bench.command)}</code> on {_e(machine_name(bench.hardware))}, {_e(bench.time_utc[:10])}"
    )
    return (
        f'<section class="bench" data-bench="{number}"><h3>{_e(bench.title)}</h3>\n<p>{_e(bench.note)}</p>\n'
        f"{_table('measurement', heads, map(_bench_row, bench.rows))}<p>{source}</p></section>"
    )


def _bench_row(cells: Iterable[str]) -> str:
    first, *rest = cells
    return f'<tr><th scope="row">{_e(first)}</th>{"".join(f"<td>{_e(cell)}</td>" for cell in rest)}</tr>'


def _e(text: str) -> str:
    return escape(text, quote=True)
