"""What the paper of XFreq-GS reports beside what was measured here: its tables, and whether its claims hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isnan
from typing import Any

from xfreqbench.report.drawing.markdown import ABSENT, heading, number, prose, table, with_interval
from xfreqbench.report.leaderboard.boards import Board, short_name
from xfreqbench.report.leaderboard.captions import leak_statement
from xfreqbench.report.leaderboard.columns import BRIEF
from xfreqbench.report.leaderboard.comparison import Comparison, Interval, Resampling
from xfreqbench.report.leaderboard.paper_figures import cdf_link, level_table
from xfreqbench.report.leaderboard.paper_maps import MapGrid
from xfreqbench.report.leaderboard.published import published_content, published_value, stands_for
from xfreqbench.report.leaderboard.rows import BoardRow, median_ssim
from xfreqbench.report.leaderboard.tables import ranking_table
from xfreqbench.runs.records import RunRecord

_HOLDS = "holds"
_MEDIAN_SSIM = "SSIM median"
_STATISTICS = {  # as the published tables name them: metric, statistic, decimals
    "SSIM mean": ("ssim", "mean", 4),
    _MEDIAN_SSIM: ("ssim", "median", 4),
    "PSNR mean (dB)": ("psnr", "mean", 2),
    "PSNR median (dB)": ("psnr", "median", 2),
}
_RANDOM = "random-samples"
_INTRODUCTION = (
    "Their data, rooms and receivers are others than ours, and the sizes of their models too, so that numbers do not "
    "compare. What can be compared are claims: which of two methods is better, and by how much. A claim *holds* here "
    "where the whole 95 % interval of the difference, paired by transmitters and with three seeds of each, lies above "
    "zero, and *does not hold* where it lies below."
)


def paper_markdown(ranked: Sequence[Board], grids: Mapping[str, MapGrid] | None = None) -> str:
    """Published numbers beside ours, and the paper's claims with a verdict, for the boards of one scene.

    `grids` are maps by the links to their figures.
    """
    content = published_content()
    resampling = {board.slug: Resampling() for board in ranked}
    parts = [
        f"{content['citation']}: {content['conditions']}. {_INTRODUCTION}",
        "## Claims",
        _claims_table(content["claim"], ranked, resampling),
        "## Numbers",
        "Theirs and ours by budget, averages over what is named; a median SSIM has its 95 % interval:",
        _numbers_table(content["counterpart"], ranked, resampling),
        *_distributions(ranked),
        *_random_samples(ranked, resampling),
        *_maps(grids or {}),
    ]
    return "\n\n".join(parts) + "\n"


def has_counterparts(board: Board) -> bool:
    """Whether some row of a board stands for one that the paper has numbers of."""
    return any(_is_named(each, row) for each in published_content()["counterpart"] for row in board.rows)


def _distributions(ranked: Sequence[Board]) -> list[str]:
    """The 90 % level of SSIM and PSNR and a figure of their distributions, for each budget on which the paper's are."""
    parts = []
    for board in ranked:
        link, levels = cdf_link(board), level_table(board)
        if levels:
            title = heading(board.lane_title or "no budget")
            parts += [f"{title}:", levels, f"![Distributions of SSIM and PSNR, {title}]({link})"]
    if not parts:
        return []
    told = (
        "Of all splits and seeds together; the paper does not say of which carriers its level is. 90 % of the maps "
        "have a score at or below the level, where the figure has a dashed line."
    )
    return ["## Distributions of SSIM and PSNR", told, *parts]


def _random_samples(ranked: Sequence[Board], resampling: Mapping[str, Resampling]) -> list[str]:
    """The rankings on random samples, which the paper has no table of; empty where they were not run."""
    boards = [board for board in ranked if board.protocol == _RANDOM]
    if not boards:
        return []
    told = (
        "The released code of XFreq-GS splits samples at random by default. The paper has no numbers of that."
    )
    rankings = [
        part
        for board in boards
        for part in (
            f"{heading(board.lane_title or 'no budget')}:",
            ranking_table(Comparison(board, board.split_sets()[0], resampling[board.slug]), BRIEF),
        )
    ]
    return ["## Random samples", f"{told} **{leak_statement(boards[0])}**", *rankings]


def _maps(grids: Mapping[str, MapGrid]) -> list[str]:
    """The figures of maps; empty where there are none."""
    parts = []
    for link, grid in grids.items():
        told = (
            f"{grid.method}, {grid.budget}: maps of {len(grid.tx_position_m)} transmitters, spread from easy to hard "
            f"ones, at {len(grid.columns)} carriers that were left out in turn, the truth above the prediction. "
            "Azimuth to the right, elevation upwards, powers down to 30 dB below the peak."
        )
        parts += [prose(told), f"![Maps beside the truth, {heading(grid.method)}]({link})"]
    return ["## Maps", *parts] if parts else []


def _claims_table(
    claims: Sequence[Mapping[str, Any]], ranked: Sequence[Board], resampling: Mapping[str, Resampling]
) -> str:
    """A row for each claim and board on which both methods stand; one without a verdict where there is none."""
    rows: list[list[str]] = []
    for claim in claims:
        measured = [
            (board, comparison, better, worse)
            for board in ranked
            if board.protocol == claim["protocol"]
            for comparison, better, worse in _pairs(claim, board, resampling[board.slug])
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


def _pairs(
    claim: Mapping[str, Any], board: Board, resampling: Resampling
) -> list[tuple[Comparison, BoardRow, BoardRow]]:
    """The two rows that a claim compares, on the splits that both were run on; none where one is missing."""
    found = [
        next((row for row in board.rows if _is_named(named, row)), None)
        for named in (claim["better"], claim["worse"])
    ]
    better, worse = found
    if better is None or worse is None:
        return []
    splits = tuple(split for split in board.splits if split in better.by_split and split in worse.by_split)
    return [(Comparison(board, splits, resampling), better, worse)] if splits else []


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


def _numbers_table(
    counterparts: Sequence[Mapping[str, Any]], ranked: Sequence[Board], resampling: Mapping[str, Resampling]
) -> str:
    protocols = {counterpart["protocol"] for counterpart in counterparts}
    boards = [board for board in ranked if board.protocol in protocols]
    titles = {board.lane: board.lane_title or "no budget" for board in boards}
    rows = []
    for counterpart in counterparts:
        for place, (name, row, column) in counterpart["cells"].items():
            named = _found_rows(counterpart, place, boards)
            if not named:
                continue
            _, _, splits = next(iter(named.values()))
            where = ", ".join(map(short_name, splits)) + (" (not stated)" if place == "any" else "")
            for statistic in _STATISTICS if column in _STATISTICS else (_MEDIAN_SSIM,):
                published = published_value((name, row, statistic if column in _STATISTICS else column))
                ours = [
                    _ours(*named[lane], statistic, resampling) if lane in named else ABSENT for lane in titles
                ]
                rows.append([heading(counterpart["name"]), where, statistic, published, *ours])
    return table(("theirs", "on", "what", "published", *titles.values()), rows, prose)


def _found_rows(
    counterpart: Mapping[str, Any], place: str, boards: Sequence[Board]
) -> dict[str, tuple[Board, BoardRow, tuple[str, ...]]]:
    """By budget our row for a published cell, and its splits; all of the row's if the paper does not say of which."""
    found: dict[str, tuple[Board, BoardRow, tuple[str, ...]]] = {}
    for board in boards:
        for row in board.rows if board.protocol == counterpart["protocol"] else ():
            splits = tuple(row.by_split) if place == "any" else tuple(place.split())
            if _is_named(counterpart, row) and set(splits) <= set(row.by_split):
                found.setdefault(board.lane, (board, row, splits))
    return found


def _ours(
    board: Board,
    row: BoardRow,
    splits: tuple[str, ...],
    statistic: str,
    resampling: Mapping[str, Resampling],
) -> str:
    """Our number for a published one, the mean over splits; of a median SSIM with its interval."""
    metric, name, decimals = _STATISTICS[statistic]

    def quantity(record: RunRecord) -> float:
        return float(getattr(record.scores[metric], name))

    value = row.average(splits, quantity)
    if statistic != _MEDIAN_SSIM:
        return number(value, decimals)
    return with_interval(value, Comparison(board, splits, resampling[board.slug]).interval(row), decimals)
