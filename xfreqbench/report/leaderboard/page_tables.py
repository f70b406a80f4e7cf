"""What the page's tables show, as the templates `page.html` and `page_tables.html` take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

from xfreqbench.report.leaderboard.boards import Board, short_name
from xfreqbench.report.leaderboard.captions import data_statement, leak_statement, machine_names, notes
from xfreqbench.report.leaderboard.columns import PAGE, LeaderboardColumn, leaderboard_columns
from xfreqbench.report.leaderboard.comparison import Comparison
from xfreqbench.report.leaderboard.origins import record_key, short_commit
from xfreqbench.report.leaderboard.rows import BoardRow, median_ssim


@dataclass(frozen=True)
class SetTable:
    """The leaderboard of one set of splits; `best_trivial` is the row to be marked, None without a trivial one."""

    splits: Sequence[str]
    columns: Sequence[LeaderboardColumn]
    rows: Sequence[BoardRow]
    best_trivial: BoardRow | None
    notes: Sequence[str]


@dataclass(frozen=True)
class BoardTables:
    """A board: what its data are in words, and a leaderboard for each of its sets of splits."""

    slug: str
    title: str
    conditions: str
    sets: Sequence[SetTable]


def board_tables(comparisons: Sequence[Comparison]) -> BoardTables:
    """Tables of a board, from one comparison for each of its sets of splits."""
    board = comparisons[0].board
    counts = " or ".join(f"{count:,}" for count in sorted({record.num_test for record in board.records}))
    conditions = f"{data_statement(board)}; {counts} test maps a split. {leak_statement(board)}"
    return BoardTables(board.slug, board.title, conditions, [_set_table(each) for each in comparisons])


@dataclass(frozen=True)
class BoardLink:
    """A link of the overview: the board, its budget in words, and the best method there with its skill."""

    slug: str
    text: str
    standing: str


def overview_protocols(ranked: Sequence[Board]) -> list[str]:
    """The protocols of all boards, each once, in their order."""
    return list(dict.fromkeys(board.protocol for board in ranked))


def overview_rows(compared: Sequence[Comparison]) -> dict[str, list[list[BoardLink]]]:
    """For each scene, for each protocol, links to the boards; given are the first comparisons of all boards."""
    protocols = overview_protocols([each.board for each in compared])
    scenes = dict.fromkeys(each.board.scene for each in compared)
    return {
        scene: [
            [_link(each) for each in compared if (each.board.scene, each.board.protocol) == (scene, protocol)]
            for protocol in protocols
        ]
        for scene in scenes
    }


def _link(comparison: Comparison) -> BoardLink:
    board = comparison.board
    best = next((row for row in comparison.rows if not row.is_trivial and row.family != "ablation"), None)
    standing = "trivial predictors alone"
    if best is not None:
        skill = best.average(comparison.splits, board.skill)
        ssim = f"average {best.average(comparison.splits, median_ssim):.4f}"
        told = ", ".join([ssim, *([f"skill {skill:.3f}"] if isfinite(skill) else [])])
        standing = f"{best.short_label}: {told.replace('-', '−')}"
    return BoardLink(board.slug, board.lane_title or "without budget", standing)


def page_facts(ranked: Sequence[Board]) -> dict[str, list[str]]:
    """Data sets, machines, commits and dates of all records, each fact with its lines."""
    records = list({record_key(each): each for board in ranked for each in board.records}.values())
    data = {f"{board.scene}, {board.pas_kind} maps, {board.data_name}" for board in ranked}
    commits = {short_commit(record.git_commit) for record in records}
    days = sorted({record.time_utc[:10] for record in records})
    return {
        "Data": sorted(data),
        "Machines": machine_names(records) or ["none: every row is external"],
        "Commits": [", ".join(sorted(commits))],
        "Runs": [f"{len(records):,}, {' to '.join(dict.fromkeys((days[0], days[-1])))}"],
    }


def _set_table(comparison: Comparison) -> SetTable:
    trivial = [row for row in comparison.rows if row.is_trivial]  # the best first
    return SetTable(
        splits=[short_name(split) for split in comparison.splits],
        columns=leaderboard_columns(comparison, PAGE),
        rows=comparison.rows,
        best_trivial=trivial[0] if trivial else None,
        notes=notes(comparison.board, comparison.rows),
    )
