"""What the paper of XFreq-GS reports beside what was measured here, and whether its claims hold.

The figure of maps needs predictions, or the maps that `ship_maps` stores of them in a file beside the records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isnan
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError
from xfreqbench.methods.contract import LANES
from xfreqbench.report.drawing.markdown import ABSENT, heading, number, prose, table, with_interval
from xfreqbench.report.leaderboard.boards import Board, pooled_quantiles, short_name
from xfreqbench.report.leaderboard.columns import metric_title
from xfreqbench.report.leaderboard.comparison import Comparison
from xfreqbench.report.leaderboard.figures import FIGURES_FOLDER
from xfreqbench.report.leaderboard.gallery import dozen_of, open_data, stored_maps
from xfreqbench.report.leaderboard.overview import main_boards, main_scene
from xfreqbench.report.leaderboard.published import published_content, stands_for
from xfreqbench.report.leaderboard.results import RankedResults, Results, read_results
from xfreqbench.report.leaderboard.rows import BoardRow, budget_text, median_ssim
from xfreqbench.report.leaderboard.shown_maps import Levels, Position, ShownMaps, write_maps
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.records import RunRecord
from xfreqbench.types import IntArray

_HOLDS, _OPEN, _FAILS = "holds", "open", "does not hold"
_MEDIAN_SSIM = "SSIM median"
_STATISTICS = {  # as the published tables name them: metric, statistic, decimals
    "SSIM mean": ("ssim", "mean", 4),
    _MEDIAN_SSIM: ("ssim", "median", 4),
    "PSNR mean (dB)": ("psnr", "mean", 2),
    "PSNR median (dB)": ("psnr", "median", 2),
}
_INTRODUCTION = (
    "Their data, rooms and receivers are others than ours, and the sizes of their models too, so that numbers do not "
    "compare. What can be compared are claims: which of two methods is better, and by how much."
)
CLAIMS_CAPTION = (
    "A claim *holds* where the whole interval of the difference of median SSIM × 1000, paired by transmitters and with "
    "three seeds of each, lies above zero, and *does not hold* where it lies below. Data, rooms and sizes are others "
    "than the paper's."
)
_LEVEL = 90  # per cent of the maps, as in the paper
_METRICS = {"ssim": 4, "psnr": 2}  # with decimals
NUM_CARRIERS, NUM_TX = 5, 5
_PAPERS = "XFreq-GS"
_SAME_M = 1e-3  # positions are rounded

Value = TypeVar("Value")


def paper_markdown(ranked: Sequence[Board], grids: Mapping[str, MapGrid] | None = None) -> str:
    """The paper's claims with a verdict, and published numbers beside ours, for the boards of one scene.

    Claims are judged in several budgets; tables and figures are of the one with most runs. `grids` are maps by the
    links to their figures.
    """
    content, shown = published_content(), main_boards(ranked)
    parts = [
        f"{content['citation']}: {content['conditions']}. {_INTRODUCTION}",
        "## Claims",
        CLAIMS_CAPTION,
        claims_table(ranked) or "None was measured.",
        "## The paper's tables",
        "Ours, and the paper's number in round brackets; a median SSIM of ours has its 95 % interval in square ones.",
        *_papers_tables(content, shown),
        *_distributions(shown),
        *_maps(grids or {}),
    ]
    return "\n\n".join(parts) + "\n"


def has_counterparts(board: Board) -> bool:
    """Whether the paper has numbers for a method of some row of a board."""
    counterparts = published_content()["counterpart"]
    return any(_is_named(counterpart, row) for counterpart in counterparts for row in board.rows)


def _distributions(ranked: Sequence[Board]) -> list[str]:
    """The 90 % level of SSIM and PSNR and a figure of their distributions, for each budget on which the paper's are."""
    parts = []
    published = published_content()["table"]["cdf"]["rows"]
    for board in ranked:
        rows, splits = _shown_rows(board)
        if splits:
            title = heading(board.lane_title or "no budget")
            cells = [
                [
                    row.short_label,
                    *([name, *published[name]] if name in published else [ABSENT, ABSENT]),
                    *(number(_pooled(row, splits, metric)[_LEVEL], digits) for metric, digits in _METRICS.items()),
                ]
                for name, row in rows.items()
            ]
            levels = table(("method", "theirs", "published SSIM", *map(metric_title, _METRICS)), cells, prose)
            parts += [f"{title}:", levels, f"![Distributions of SSIM and PSNR, {title}]({_cdf_link(board)})"]
    if not parts:
        return []
    caption = (
        "Of all splits and seeds together; the paper does not say of which carriers its level is. 90 % of the maps "
        "have a score at or below the level, where the figure has a dashed line."
    )
    return ["## Distributions of SSIM and PSNR", caption, *parts]


def _maps(grids: Mapping[str, MapGrid]) -> list[str]:
    """The figures of maps; empty where there are none."""
    parts = []
    for link, grid in grids.items():
        caption = (
            f"{grid.method}, {grid.budget}: maps of {len(grid.tx_position_m)} transmitters, spread from easy to hard "
            f"ones, at {len(grid.columns)} carriers that were left out in turn, the truth above the prediction. "
            "Azimuth to the right, elevation upwards, powers down to 30 dB below the peak."
        )
        parts += [prose(caption), f"![Maps beside the truth, {heading(grid.method)}]({link})"]
    return ["## Maps", *parts] if parts else []


def claims_table(ranked: Sequence[Board]) -> str:
    """A row for each claim: ours with its aids at two budgets, and the method as the paper has it.

    A cell has the difference of average median SSIM × 1000 with its interval, and the verdict. Empty where nothing of
    it was measured.
    """
    columns = {
        "ours, 64,000 maps": ("quick", "xfreq-gs"),
        "ours, 200,000 maps": ("converged", "xfreq-gs"),
        "as the paper has it, 200,000 maps": ("converged", "xfreq-gs-paper"),
    }
    rows = []
    for claim in published_content()["claim"]:
        cells = [_claim_cell(claim, ranked, budget_text(LANES[lane]), method) for lane, method in columns.values()]
        why = claim.get("why", "") if any(words in cell for cell in cells for words in (_OPEN, _FAILS)) else ""
        rows.append([f"{claim['claim']} ({claim['theirs']})", *cells, why])
    if all(cell == ABSENT for row in rows for cell in row[1:-1]):
        return ""
    return table(("claim (published)", *columns, "why not"), rows, prose)


def _claim_cell(claim: Mapping[str, Any], ranked: Sequence[Board], lane: str, method: str) -> str:
    """The difference and the verdict on the first board of a budget on which both methods stand; a dash without any."""
    named = [
        claim[end] | ({"method": method} if claim[end]["method"] == "xfreq-gs" else {}) for end in ("better", "worse")
    ]
    for board in ranked:
        better, worse = (next((row for row in board.rows if _is_named(name, row)), None) for name in named)
        if (board.protocol, board.lane) != (claim["protocol"], lane) or better is None or worse is None:
            continue
        comparison = Comparison.of(board, better, worse)
        if splits := comparison.splits:
            difference = better.average(splits, median_ssim) - worse.average(splits, median_ssim)
            low, high = comparison.difference(better, worse)
            bounds = "" if isnan(low) else f" [{1000 * low:+.1f}, {1000 * high:+.1f}]"
            verdict = "too few seeds" if isnan(low) else _HOLDS if low > 0 else _FAILS if high < 0 else _OPEN
            where = f" at {short_name(splits[0])}" if len(splits) == 1 else ""
            return f"{1000 * difference:+.1f}{bounds}{where}: {verdict}"
    return ABSENT


def _is_named(named: Mapping[str, Any], row: BoardRow) -> bool:
    """Whether a row has the named method and options; if no options are named, it has the defaults."""
    return stands_for(named, row) and ("config" in named or row.family == "learned")


def _papers_tables(content: Mapping[str, Any], ranked: Sequence[Board]) -> list[str]:
    """The paper's tables, with its rows and columns, of which we have a number."""
    ours = {
        (name, row, statistic): (counterpart, place, statistic if column in _STATISTICS else _MEDIAN_SSIM)
        for counterpart in content["counterpart"]
        for place, (name, row, column) in counterpart["cells"].items()
        for statistic in (_STATISTICS if column in _STATISTICS else (column,))
    }
    boards = {board.protocol: board for board in ranked}
    parts = []
    for name, published in content["table"].items():
        if name == "cdf" or published["protocol"] not in boards:
            continue
        board = boards[published["protocol"]]
        rows = []
        for row, theirs in published["rows"].items():
            found = [_ours(ours.get((name, row, column)), board) for column in published["columns"]]
            rows.append([heading(row), *(f"{cell} ({value})" for cell, value in zip(found, theirs, strict=True))])
        if any(not cell.startswith(ABSENT) for cells in rows for cell in cells[1:]):
            header, title = (published["first_column"], *published["columns"]), heading(board.lane_title or "no budget")
            parts.append(f"{published['title']}; ours in the budget {title}:\n\n{table(header, rows, prose)}")
    return parts


def _ours(cell: tuple[Mapping[str, Any], str, str] | None, board: Board) -> str:
    """Our number beside a published one, the mean over splits; a median SSIM has its interval. A dash without any.

    The splits are those that the paper names, or all of the row where it names none.
    """
    counterpart, place, statistic = cell or ({}, "", "")
    for row in board.rows if cell else ():
        splits = tuple(row.by_split) if place == "any" else tuple(place.split())
        if not (_is_named(counterpart, row) and set(splits) <= set(row.by_split)):
            continue
        metric, name, decimals = _STATISTICS[statistic]

        def quantity(record: RunRecord, metric: str = metric, name: str = name) -> float:
            return float(getattr(record.scores[metric], name))

        value = row.average(splits, quantity)
        if statistic != _MEDIAN_SSIM:
            return number(value, decimals)
        return with_interval(value, Comparison(board, splits).interval(row), decimals)
    return ABSENT


def paper_figures(ranked: Sequence[Board]) -> dict[str, Callable[[Path], None]]:
    """Functions that draw the figures of the page to a path, by their links from the page; may raise `StorageError`."""
    return {_cdf_link(board): partial(_draw_cdf, board) for board in main_boards(ranked) if _shown_rows(board)[1]}


def _cdf_link(board: Board) -> str:
    return f"{FIGURES_FOLDER}/paper-{board.slug}-cdf.svg"


def _draw_cdf(board: Board, path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_score_cdf

    rows, splits = _shown_rows(board)
    panels = {
        metric_title(metric): {row.short_label: _pooled(row, splits, metric) for row in rows.values()}
        for metric in _METRICS
    }
    plot_score_cdf(panels, _LEVEL / 100, path)


def published_rows(board: Board) -> dict[str, BoardRow]:
    """Our rows, with default options, of the methods whose distribution the paper shows, by its names; best first."""
    content = published_content()
    if board.protocol != content["table"]["cdf"]["protocol"]:
        return {}
    found: dict[str, BoardRow] = {}
    for row in board.rows:
        for counterpart in content["counterpart"] if row.family == "learned" else ():
            if counterpart["name"] in content["table"]["cdf"]["rows"] and stands_for(counterpart, row):
                found.setdefault(counterpart["name"], row)
    return found


def _shown_rows(board: Board) -> tuple[dict[str, BoardRow], tuple[str, ...]]:
    """The paper's rows, beside them the best predictor that learns nothing, and the splits that all were run on."""
    found = published_rows(board)
    splits = tuple(split for split in board.splits if found and all(split in row.by_split for row in found.values()))
    trivial = [row for row in board.rows_on(splits) if row.is_trivial][:1] if splits else []
    return found | {row.label: row for row in trivial}, splits


def _pooled(row: BoardRow, splits: Sequence[str], metric: str) -> list[float]:
    return pooled_quantiles([record for split in splits for record in row.by_split[split]], metric)


@dataclass(frozen=True, eq=False)
class MapGrid:
    """Levels of the maps of T transmitters, true and predicted, and the SSIM of the latter, for each split by its name.

    `tx_position_m` are the positions of the transmitters, `method` is the label of what predicted the maps.
    """

    method: str
    budget: str
    tx_position_m: Sequence[Position]
    columns: Mapping[str, tuple[Levels, Levels, Sequence[float]]]


def ship_maps(results: Results, path: Path) -> Path:
    """Write the maps of a dozen samples of every board of the main scene to a file, and return it.

    They are the maps that the page shows, of all rows but ablations, and those of the paper's method at further
    carriers. Raises `DataError` where no predictions or no data set are found, `OutputExistsError` and `StorageError`.
    """
    found = read_results(results)
    main, shown, known = main_scene(found.boards), [], set[str]()
    for board in found.boards:
        dataset = open_data(board) if board.scene == main else None
        for maps in _maps_of(board, dataset, found.folders) if dataset else ():
            new = {key: run for key, run in maps.predicted.items() if key not in known}
            known |= new.keys()
            shown += [maps.model_copy(update={"predicted": new})] if new else []
    if not shown:
        raise DataError(
            "No predictions of a data set that is here lie beside these records. Give a results folder that "
            "`xfreqbench run` or `xfreqbench benchmark` wrote, and leave its data set where it was."
        )
    write_maps(path, shown)
    return path


def paper_maps(ranked: Sequence[Board], found: RankedResults) -> dict[str, MapGrid]:
    """The paper's maps of every board whose maps are stored or shipped, by the links to their figures."""
    grids = {f"{FIGURES_FOLDER}/paper-{board.slug}-maps.png": _grid(board, found) for board in main_boards(ranked)}
    return {link: grid for link, grid in grids.items() if grid}


def _maps_of(board: Board, dataset: PasDataset, folders: Sequence[ResultsFolder]) -> list[ShownMaps]:
    """The maps of the shown split, and those of the paper's method and the same transmitters on other splits."""
    dozen = dozen_of(board, dataset, folders)
    papers = published_rows(board).get(_PAPERS)
    if dozen is None or papers is None:
        return [dozen] if dozen else []
    distance_m = np.abs(dataset.tx_position_m[:, None] - np.asarray(dozen.tx_position_m)).max(axis=2)
    is_shown = distance_m.min(axis=1) < _SAME_M

    def choose(rows: IntArray) -> IntArray:
        return rows[is_shown[rows]]

    others = [
        stored_maps(dataset, records[:1], folders, choose)
        for split, records in papers.by_split.items()
        if split != dozen.split
    ]
    return [dozen, *(other for other in others if other)]


def _grid(board: Board, found: RankedResults) -> MapGrid | None:
    row = published_rows(board).get(_PAPERS)
    if row is None:
        return None
    dataset = open_data(board)
    stored = _maps_of(board, dataset, found.folders) if dataset else []
    known = found.maps | {key: maps for maps in stored for key in maps.predicted}
    ids = {split: row.by_split[split][0].id for split in board.splits if split in row.by_split}
    of_split = {split: known[key] for split, key in ids.items() if key in known}
    if not of_split:
        return None
    splits = _spread(list(of_split), NUM_CARRIERS)
    first, *others = (of_split[split] for split in splits)
    shared = [maps.tx_position_m for maps in others]
    shown = _spread([tx for tx in first.tx_position_m if all(tx in known for known in shared)], NUM_TX)
    columns = {short_name(split): _column(of_split[split], ids[split], shown) for split in splits}
    return MapGrid(row.short_label, board.lane_title or "no budget", shown, columns) if shown else None


def _column(maps: ShownMaps, record_id: str, shown: Sequence[Position]) -> tuple[Levels, Levels, Sequence[float]]:
    """The levels of true and of predicted maps at some transmitters, and the SSIM of the latter."""
    places = [maps.tx_position_m.index(position) for position in shown]
    ssim = [maps.predicted[record_id].ssim[place] for place in places]
    return maps.true_levels()[places], maps.levels_of(record_id)[places], ssim


def _spread(values: Sequence[Value], most: int) -> list[Value]:
    """At most `most` of the values, equally spaced in their order."""
    places = np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int)
    return [values[place] for place in places]
