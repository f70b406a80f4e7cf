"""The short form of a report: a few tables that answer the first questions, with links to pages that hold the rest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress
from math import isnan, nan

from xfreqbench.methods.contract import LANES
from xfreqbench.report.drawing.markdown import ABSENT, heading, number, paragraph, prose, table
from xfreqbench.report.leaderboard.boards import Board, short_name
from xfreqbench.report.leaderboard.captions import leak_statement, short_legend
from xfreqbench.report.leaderboard.columns import OVERVIEW, leaderboard_columns
from xfreqbench.report.leaderboard.comparison import Comparison
from xfreqbench.report.leaderboard.figures import figure_links
from xfreqbench.report.leaderboard.rows import BoardRow, budget_text, median_ssim
from xfreqbench.report.leaderboard.tables import ranking_table
from xfreqbench.report.leaderboard.unseen_rooms import rooms_overview
from xfreqbench.runs.records import BenchRecord

_BRIEFLY = {  # measurements of which the first rows are shown
    "generate": "Generator",
    "stress": "Stability",
}
_MOST_ROWS = 5
_FEW_MAPS, _MANY_MAPS = (budget_text(LANES[name]) for name in ("quick", "converged"))
_GAIN = "quick → converged"
_FLAT = 0.002  # of SSIM
_ON_ITS_PAGE_ALONE = ("random-samples",)  # it asks for neither unseen carriers nor unseen places


def overview_markdown(
    ranked: Sequence[Board],
    benches: Sequence[BenchRecord],
    pages: Mapping[str, str],
    measurements_page: str,
    rooms_page: str,
) -> str:
    """The generated part of a short report; `pages` holds the link to each scene's page."""
    scene, main = main_scene(ranked), _main_boards(ranked)
    of_scene = [board for board in ranked if board.scene == scene]
    compared = [_first_comparison(board) for board in main]
    is_shown = [board.scene == scene and board.protocol not in _ON_ITS_PAGE_ALONE for board in main]
    rankings = []
    for comparison in compress(compared, is_shown):
        board = comparison.board
        title = heading(" · ".join(filter(None, (board.scene, board.protocol, board.lane_title))))
        more = f"**{leak_statement(board)}** [More]({pages[scene]})"
        rankings.append(f"## {title}\n\n{more}\n\n{ranking_table(comparison, OVERVIEW)}")
    links = ", ".join(f"[{heading(name)}]({link})" for name, link in pages.items())
    parts = [
        *rankings,
        *_budget_tables(of_scene),
        *([_skill_matrix(compared)] if len(main) > 1 else []),
        *rooms_overview(benches, rooms_page),
        *_time_figure(of_scene, pages),
        f"Every carrier, metric, ablation and pair of methods, a page for each scene: {links}.",
        *_measured_parts(benches, measurements_page),
        short_legend(),
    ]
    return "\n\n".join(parts) + "\n"


def _main_boards(ranked: Sequence[Board]) -> list[Board]:
    """Of the boards of each data set and protocol, which differ in their budgets, the one with most runs."""
    return list({_place(board): board for board in reversed(ranked)}.values())[::-1]


def _place(board: Board) -> tuple[str, str, str]:
    return board.scene, board.data, board.protocol


def _first_comparison(board: Board) -> Comparison:
    """The rows of a board without ablations, on the splits that most of them share."""
    whole = replace(board, rows=tuple(row for row in board.rows if row.family != "ablation"))
    return Comparison(whole, whole.split_sets()[0])


def main_scene(ranked: Sequence[Board]) -> str:
    """The scene with the most records."""
    records = Counter[str]()
    for board in ranked:
        records[board.scene] += len(board.records)
    return max(records, key=lambda scene: (records[scene], scene), default="")


def _budget_tables(ranked: Sequence[Board]) -> list[str]:
    """For each protocol that was run with several budgets: the average of each method by budget."""
    parts = []
    for main in _main_boards(ranked):
        lanes = [board for board in ranked if _place(board) == _place(main)]
        if len(lanes) > 1:
            parts += _budget_table(lanes, main)
    return ["## Other budgets", *parts] if parts else []


def _budget_table(lanes: Sequence[Board], main: Board) -> list[str]:
    """The methods that were run with several budgets, on the splits that all of them have; empty without any."""
    fitted = [  # trivial predictors have one value in all columns, and a row in the table above
        (lane, row) for lane in lanes for row in lane.rows if not row.is_trivial and row.family != "ablation"
    ]
    splits = [split for split in _first_comparison(main).splits if all(split in row.by_split for _, row in fitted)]
    every = {(row.short_label, lane.lane): row.average(splits, median_ssim) for lane, row in fitted if splits}
    num_lanes = Counter(label for label, _ in every)
    rows = {place: value for place, value in every.items() if num_lanes[place[0]] > 1}
    header = ["method", *(lane.lane_title or "no budget" for lane in lanes)]
    body = [
        [label, *(number(rows.get((label, lane.lane), nan), 4) for lane in lanes)]
        for label in sorted({label for label, _ in rows})
    ]
    words = heading(f"{main.scene} · {main.protocol}")
    caption = f"{words}, average median SSIM on {', '.join(map(short_name, splits))}"
    if {_FEW_MAPS, _MANY_MAPS} <= {lane.lane for lane in lanes}:
        header.append(_GAIN)
        for line in body:
            few, many = (rows.get((line[0], lane), nan) for lane in (_FEW_MAPS, _MANY_MAPS))
            gain = many - few  # each of the two fits let its learning rate fall to its own end
            line.append(ABSENT if isnan(gain) else f"{gain:+.4f}" + (", flat" if gain < _FLAT else ""))
        caption += f"; *flat*, and so converged, is a method that gains less than {_FLAT} by three times the maps"
    return [f"{caption}:\n\n{table(header, body)}"] if body else []


def _skill_matrix(compared: Sequence[Comparison]) -> str:
    """The skill of each method on each board; trivial predictors are left out."""
    best: list[dict[str, BoardRow]] = [{} for _ in compared]
    for comparison, by_method in zip(compared, best, strict=True):
        for row in reversed(comparison.rows):  # the best comes last
            if not row.is_trivial:
                by_method[row.job.method] = row
    boards = [comparison.board for comparison in compared]
    header = ["method", *(f"{board.scene}, {board.protocol}" for board in boards)]
    rows = [
        [method, *map(_skill_cell, compared, (by_method.get(method) for by_method in best))]
        for method in sorted({method for by_method in best for method in by_method})
    ]
    budgets = dict.fromkeys(board.lane_title for board in boards)
    budget = f", with the budget {next(iter(budgets))}" if len(budgets) == 1 and any(budgets) else ""
    caption = f"Average skill on the splits that most methods share{budget}:"
    return f"## Skill on every scene and protocol\n\n{caption}\n\n{table(header, rows)}"


def _skill_cell(comparison: Comparison, row: BoardRow | None) -> str:
    (column,) = leaderboard_columns(comparison, ("skill",))
    if row is None or column.value is None or isnan(column.value(row)):
        return ABSENT
    return column.text(row)


def _time_figure(shown: Sequence[Board], pages: Mapping[str, str]) -> list[str]:
    """The figure of error against time of the first board that has one."""
    drawn = next((board for board in shown if "time" in figure_links(board)), None)
    if drawn is None:
        return []
    folder = pages[drawn.scene].rpartition("/")[0]
    link = "/".join(filter(None, [folder, figure_links(drawn)["time"]]))
    words = heading(f"{drawn.scene} · {drawn.protocol}")
    return [f"## Error against time\n\n![SSIM against seconds of fitting, {words}]({link})"]


def _measured_parts(benches: Sequence[BenchRecord], page: str) -> list[str]:
    """The first measurement of each kind that `_BRIEFLY` names, and a link to all."""
    first = {record.bench: record for record in reversed(benches)}
    parts = []
    for bench, title in _BRIEFLY.items():
        if bench not in first:
            continue
        record = first[bench]
        columns, rows = _by_area(record) if bench == "stress" else (record.columns, record.rows)
        left = f"{len(rows) - _MOST_ROWS} more rows" if len(rows) > _MOST_ROWS else "More"
        caption = f"{paragraph(record.title, prose)}. [{left}]({page})"
        parts.append(f"## {heading(title)}\n\n{caption}\n\n{table(columns, rows[:_MOST_ROWS], prose)}")
    rest = f"Every measurement with its command and its machine: [measurements]({page})."
    return [*parts, rest] if benches else []


def _by_area(record: BenchRecord) -> tuple[Sequence[str], Sequence[Sequence[str]]]:
    """Cases of the stress suite by area: how many there are, and how many failed, most cases first."""
    area, verdict = 0, len(record.columns) - 1
    cases = Counter(row[area] for row in record.rows)
    failed = Counter(row[area] for row in record.rows if row[verdict].startswith("FAILED"))
    return ("area", "cases", "failed"), [(name, str(number), str(failed[name])) for name, number in cases.most_common()]
