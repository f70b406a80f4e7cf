"""What the paper of XFreq-GS reports beside what was measured here: its numbers, and whether its claims hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isnan
from typing import Any

from xfreqbench.report.drawing.markdown import ABSENT, heading, number, prose, table
from xfreqbench.report.leaderboard.boards import Board, short_name
from xfreqbench.report.leaderboard.comparison import Comparison, Interval
from xfreqbench.report.leaderboard.published import published_content, published_value, stands_for
from xfreqbench.report.leaderboard.rows import BoardRow, median_ssim

_HOLDS = "holds"
_INTRODUCTION = (
    "Their data, rooms and receivers are others than ours, and the sizes of their models too, so that numbers do not "
    "compare. What can be compared are claims: which of two methods is better, and by how much. A claim *holds* here "
    "where the whole 95 % interval of the difference, paired by transmitters and with three seeds of each, lies above "
    "zero, and *does not hold* where it lies below."
)


def paper_markdown(ranked: Sequence[Board]) -> str:
    """Published numbers beside ours, and the paper's claims with a verdict, for the boards of one scene."""
    content = published_content()
    parts = [
        f"{content['citation']}: {content['conditions']}. {_INTRODUCTION}",
        "## Claims",
        _claims_table(content["claim"], ranked),
        "## Numbers",
        "Median SSIM, theirs and ours by budget:",
        _numbers_table(content["counterpart"], ranked),
    ]
    return "\n\n".join(parts) + "\n"


def has_counterparts(board: Board) -> bool:
    """Whether some row of a board stands for one that the paper has numbers of."""
    return any(_is_named(each, row) for each in published_content()["counterpart"] for row in board.rows)


def _claims_table(claims: Sequence[Mapping[str, Any]], ranked: Sequence[Board]) -> str:
    """A row for each claim and board on which both methods stand; one without a verdict where there is none."""
    rows: list[list[str]] = []
    for claim in claims:
        measured = [
            (board, comparison, better, worse)
            for board in ranked
            if board.protocol == claim["protocol"]
            for comparison, better, worse in _pairs(claim, board)
        ]
        published = f"{claim['claim']} ({claim['theirs']})"
        for board, comparison, better, worse in measured:
            splits, difference, verdict = _verdict(comparison, better, worse)
            why = "" if verdict == _HOLDS else claim.get("why", "")
            rows.append([published, board.lane_title or "no budget", splits, difference, verdict, why])
        if not measured:
            rows.append([published, ABSENT, ABSENT, ABSENT, "not measured here", ""])
    header = ("claim (published)", "budget", "on", "difference × 1000", "here", "why")
    return table(header, rows, prose)


def _pairs(claim: Mapping[str, Any], board: Board) -> list[tuple[Comparison, BoardRow, BoardRow]]:
    """The two rows that a claim compares, on the splits that both were run on; none where one is missing."""
    found = [
        next((row for row in board.rows if _is_named(named, row)), None)
        for named in (claim["better"], claim["worse"])
    ]
    better, worse = found
    if better is None or worse is None:
        return []
    splits = tuple(split for split in board.splits if split in better.by_split and split in worse.by_split)
    return [(Comparison(board, splits), better, worse)] if splits else []


def _is_named(named: Mapping[str, Any], row: BoardRow) -> bool:
    """Whether a row is the one that is named; without options that is the row with the defaults."""
    return stands_for(named, row) and ("config" in named or row.family == "learned")


def _verdict(comparison: Comparison, better: BoardRow, worse: BoardRow) -> list[str]:
    """The splits, the difference with its interval, and whether the claim holds."""
    splits = comparison.splits
    difference = better.average(splits, median_ssim) - worse.average(splits, median_ssim)
    interval = comparison.difference(better, worse)
    low, high = interval
    bounds = "" if isnan(low) else f" [{1000 * low:+.1f}, {1000 * high:+.1f}]"
    return [", ".join(map(short_name, splits)), f"{1000 * difference:+.1f}{bounds}", _told(interval)]


def _told(interval: Interval) -> str:
    low, high = interval
    if isnan(low):
        return "too few seeds"
    return _HOLDS if low > 0 else "does not hold" if high < 0 else "open"


def _numbers_table(counterparts: Sequence[Mapping[str, Any]], ranked: Sequence[Board]) -> str:
    protocols = {counterpart["protocol"] for counterpart in counterparts}
    boards = [board for board in ranked if board.protocol in protocols]
    lanes = dict.fromkeys(board.lane for board in boards)
    titles = {board.lane: board.lane_title or "no budget" for board in boards}
    rows = []
    for counterpart in counterparts:
        for place, cell in counterpart["cells"].items():
            ours = [_ours(counterpart, place, lane, boards) for lane in lanes]
            if any(each != ABSENT for each in ours):
                where = "of one carrier" if place == "any" else ", ".join(map(short_name, place.split()))
                rows.append([heading(counterpart["name"]), where, published_value(cell), *ours])
    return table(("theirs", "on", "published", *(titles[lane] for lane in lanes)), rows, prose)


def _ours(counterpart: Mapping[str, Any], place: str, lane: str, boards: Sequence[Board]) -> str:
    """Our median SSIM for a published cell; of a cell whose carrier the paper does not name, on our row's splits."""
    for board in boards:
        if board.lane == lane and board.protocol == counterpart["protocol"]:
            for row in board.rows:
                splits = tuple(row.by_split) if place == "any" else tuple(place.split())
                if _is_named(counterpart, row) and set(splits) <= set(row.by_split):
                    return number(row.average(splits, median_ssim), 4)
    return ABSENT
