"""What the paper of XFreq-GS reports beside what was measured here, and whether its claims hold.

The figure of maps needs predictions, or the maps that `ship_maps` stores of them in a file beside the records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

from xfreqbench.errors import DataError
from xfreqbench.methods.contract import BUDGETS
from xfreqbench.report.drawing.markdown import ABSENT, heading, number, prose, table, with_interval
from xfreqbench.report.leaderboard.boards import Board, BoardRow, budget_text, pooled_quantiles, short_name
from xfreqbench.report.leaderboard.captions import published
from xfreqbench.report.leaderboard.columns import metric_title
from xfreqbench.report.leaderboard.comparison import Comparison
from xfreqbench.report.leaderboard.maps import require_own_maps, stored_maps
from xfreqbench.report.leaderboard.overview import main_boards, main_scene
from xfreqbench.report.leaderboard.results import RankedResults, Results, read_results
from xfreqbench.system.files import write_text

_DECIMALS = {"ssim": 4, "psnr": 2}
_LEVEL = 90  # per cent of the maps, as in the paper


def paper_page(found: RankedResults) -> tuple[str, str, dict[str, Callable[[Path], None]]] | None:
    """The page of the paper's claims with a verdict, and of published numbers beside ours, for the main scene.

    Before it comes its section on the claims, empty without any; behind it come functions that draw its figures to a
    path, by their links from the page. Claims are judged in several budgets; tables and figures are of the one with
    most runs. None where the paper has numbers for no method.
    """
    main = main_scene(found.boards)
    ranked = [board for board in found.boards if board.scene == main]
    if not any(_is_named(each, row) for each in published()["counterpart"] for board in ranked for row in board.rows):
        return None
    content, shown = published(), main_boards(ranked)
    distributions, cdfs = _distributions(shown)
    maps, grids = _maps(shown, found)
    claims = _claims_table(ranked)
    caption = (
        "A claim *holds* where the whole interval of the difference of median SSIM × 1000, paired by transmitters and "
        "with three seeds of each, lies above zero, and *does not hold* where it lies below. Data, rooms and sizes are "
        "others than the paper's."
    )
    parts = [
        f"{content['citation']}: {content['conditions']}. Their data, rooms and receivers are others than ours, and "
        "the sizes of their models too, so that numbers do not compare. What can be compared are claims: which of two "
        "methods is better, and by how much.",
        "## Claims",
        caption,
        claims or "None was measured.",
        "## The paper's tables",
        "Ours, and the paper's number in round brackets; a median SSIM of ours has its 95 % interval in square ones.",
        *_papers_tables(content, shown),
        *distributions,
        *maps,
    ]
    section = f"## The paper's claims\n\n{caption}\n\n{claims}" if claims else ""
    return section, "\n\n".join(parts) + "\n", cdfs | grids


def _distributions(ranked: Sequence[Board]) -> tuple[list[str], dict[str, Callable[[Path], None]]]:
    """The 90 % level of SSIM and PSNR and a figure of their distributions, for each budget on which the paper's are.

    Our rows of methods whose distribution the paper shows are on the splits that all were run on, beside them the best
    predictor that learns nothing.
    """
    parts: list[str] = []
    drawn: dict[str, Callable[[Path], None]] = {}
    theirs = published()["table"]["cdf"]["rows"]
    for board in ranked:
        rows = _published_rows(board)
        splits = [split for split in board.splits if rows and all(split in row.by_split for row in rows.values())]
        if not splits:
            continue
        rows |= {row.label: row for row in [row for row in board.rows_on(splits) if row.is_trivial][:1]}
        panels: dict[str, dict[str, list[float]]] = {}
        for metric in _DECIMALS:
            of_metric = panels.setdefault(metric_title(metric), {})
            for row in rows.values():
                records = [record for split in splits for record in row.by_split[split]]
                of_metric[row.short_label] = pooled_quantiles(records, metric)
        cells = []
        for name, row in rows.items():
            levels = [quantiles[row.short_label][_LEVEL] for quantiles in panels.values()]
            ours = [number(level, decimals) for level, decimals in zip(levels, _DECIMALS.values(), strict=True)]
            cells.append([row.short_label, *([name, *theirs[name]] if name in theirs else [ABSENT, ABSENT]), *ours])
        title, link = heading(board.lane_title or "no budget"), f"figures/paper-{board.slug}-cdf.svg"
        parts += [
            f"{title}:",
            table(("method", "theirs", "published SSIM", *panels), cells, prose),
            f"![Distributions of SSIM and PSNR, {title}]({link})",
        ]
        drawn[link] = partial(_draw_cdf, panels)
    caption = (
        "Of all splits and seeds together; the paper does not say of which carriers its level is. 90 % of the maps "
        "have a score at or below the level, where the figure has a dashed line."
    )
    return ["## Distributions of SSIM and PSNR", caption, *parts] if parts else [], drawn


def _draw_cdf(panels: Mapping[str, Mapping[str, Sequence[float]]], path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_score_cdf

    plot_score_cdf(panels, _LEVEL / 100, path)


def _published_rows(board: Board) -> dict[str, BoardRow]:
    """Our rows, with default options, of the methods whose distribution the paper shows, by its names; best first."""
    content = published()
    if board.protocol != content["table"]["cdf"]["protocol"]:
        return {}
    found: dict[str, BoardRow] = {}
    for row in board.rows:
        for counterpart in content["counterpart"] if row.family == "learned" else ():
            if counterpart["name"] in content["table"]["cdf"]["rows"] and _is_named(counterpart, row):
                found.setdefault(counterpart["name"], row)
    return found


def _is_named(named: Mapping[str, Any], row: BoardRow) -> bool:
    """Whether a row has the named protocol, method and options; if no options are named, it has the defaults."""
    if row.is_external or (row.job.protocol, row.job.method) != (named["protocol"], named["method"]):
        return False
    config = row.records[0].config
    has_options = all(config.get(name) == value for name, value in named.get("config", {}).items())
    return has_options and ("config" in named or row.family == "learned")


def _claims_table(ranked: Sequence[Board]) -> str:
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
    for claim in published()["claim"]:
        cells = [_claim_cell(claim, ranked, budget_text(BUDGETS[lane]), method) for lane, method in columns.values()]
        is_doubted = any(words in cell for cell in cells for words in ("open", "does not hold"))
        rows.append([f"{claim['claim']} ({claim['theirs']})", *cells, claim.get("why", "") if is_doubted else ""])
    if all(cell == ABSENT for row in rows for cell in row[1:-1]):
        return ""
    return table(("claim (published)", *columns, "why not"), rows, prose)


def _claim_cell(claim: Mapping[str, Any], ranked: Sequence[Board], lane: str, method: str) -> str:
    """The difference and the verdict on the first board of a budget that has both methods; a dash without any."""
    named = [
        claim[end] | ({"method": method} if claim[end]["method"] == "xfreq-gs" else {}) for end in ("better", "worse")
    ]
    for board in ranked:
        better, worse = (next((row for row in board.rows if _is_named(name, row)), None) for name in named)
        if (board.protocol, board.lane) != (claim["protocol"], lane) or better is None or worse is None:
            continue
        comparison = Comparison.of(board, better, worse)
        if splits := comparison.splits:
            difference = better.average(splits) - worse.average(splits)
            low, high = comparison.difference(better, worse)
            bounds = "" if isnan(low) else f" [{1000 * low:+.1f}, {1000 * high:+.1f}]"
            verdict = "holds" if low > 0 else "does not hold" if high < 0 else "open"
            where = f" at {short_name(splits[0])}" if len(splits) == 1 else ""
            return f"{1000 * difference:+.1f}{bounds}{where}: {'too few seeds' if isnan(low) else verdict}"
    return ABSENT


def _papers_tables(content: Mapping[str, Any], ranked: Sequence[Board]) -> list[str]:
    """The paper's tables, with its rows and columns, of which we have a number."""
    statistics = {  # as the published tables name them: metric, statistic, decimals
        "SSIM mean": ("ssim", "mean", 4),
        "SSIM median": ("ssim", "median", 4),
        "PSNR mean (dB)": ("psnr", "mean", 2),
        "PSNR median (dB)": ("psnr", "median", 2),
    }
    ours = {
        (name, row, statistic): (counterpart, place, statistics.get(statistic, statistics["SSIM median"]))
        for counterpart in content["counterpart"]
        for place, (name, row, column) in counterpart["cells"].items()
        for statistic in (statistics if column in statistics else (column,))
    }
    boards = {board.protocol: board for board in ranked}
    parts = []
    for name, theirs in content["table"].items():
        if name == "cdf" or theirs["protocol"] not in boards:
            continue
        board = boards[theirs["protocol"]]
        rows = []
        for row, values in theirs["rows"].items():
            cells = [
                (ours.get((name, row, column)), value) for column, value in zip(theirs["columns"], values, strict=True)
            ]
            rows.append(
                [heading(row), *(f"{_ours(*cell, board) if cell else ABSENT} ({value})" for cell, value in cells)]
            )
        if any(not cell.startswith(ABSENT) for cells in rows for cell in cells[1:]):
            header, title = (theirs["first_column"], *theirs["columns"]), heading(board.lane_title or "no budget")
            parts.append(f"{theirs['title']}; ours in the budget {title}:\n\n{table(header, rows, prose)}")
    return parts


def _ours(counterpart: Mapping[str, Any], place: str, statistic: tuple[str, str, int], board: Board) -> str:
    """Our number beside a published one, the mean over splits; a median SSIM has its interval. A dash without any.

    The splits are those that the paper names, or all of the row where it names none.
    """
    metric, name, decimals = statistic
    for row in board.rows:
        splits = tuple(row.by_split) if place == "any" else tuple(place.split())
        if _is_named(counterpart, row) and set(splits) <= set(row.by_split):
            value = row.average(splits, lambda record: float(getattr(record.scores[metric], name)))
            if (metric, name) != ("ssim", "median"):
                return number(value, decimals)
            return with_interval(value, Comparison(board, splits).interval(row), decimals)
    return ABSENT


def ship_maps(results: Results, path: Path) -> Path:
    """Write the maps of a dozen samples of every board of the main scene to a file, and return it.

    They are the maps that the page shows, of all rows but ablations, and those of the paper's method at further
    carriers. Raises `DataError` where no predictions or no data set are found, `OutputExistsError` and `StorageError`.
    """
    found = read_results(results)
    main, shown, known = main_scene(found.boards), [], set[str]()
    for board in found.boards:
        papers = _published_rows(board).get("XFreq-GS")
        for maps in stored_maps(board, found.folders, papers) if board.scene == main else ():
            new = {key: run for key, run in maps.predicted.items() if key not in known}
            known |= new.keys()
            shown += [maps.model_copy(update={"predicted": new})] if new else []
    if not shown:
        raise DataError(
            "No predictions of a data set that is here lie beside these records. Give a results folder that "
            "`xfreqbench run` or `xfreqbench benchmark` wrote, and leave its data set where it was."
        )
    require_own_maps(path)
    write_text(path, "".join(maps.sealed_json().decode() + "\n" for maps in shown))
    return path


def _maps(ranked: Sequence[Board], found: RankedResults) -> tuple[list[str], dict[str, Callable[[Path], None]]]:
    """The section on the maps of the paper's method, stored or shipped, with what draws its figures; or none.

    There are at most five transmitters and five carriers, equally spaced in their order.
    """
    parts: list[str] = []
    drawn: dict[str, Callable[[Path], None]] = {}
    for board in ranked:
        row = _published_rows(board).get("XFreq-GS")
        stored = stored_maps(board, found.folders, row) if row else []
        known = found.maps | {key: maps for maps in stored for key in maps.predicted}
        ids = {split: row.by_split[split][0].id for split in board.splits if row and split in row.by_split}
        of_split = {split: known[key] for split, key in ids.items() if key in known}
        if row is None or not of_split:
            continue
        splits = _spread(list(of_split))
        first, *others = (of_split[split] for split in splits)
        positions = [tx for tx in first.tx_position_m if all(tx in maps.tx_position_m for maps in others)]
        if not positions:
            continue
        shown_m, columns = _spread(positions), {}
        for split in splits:
            maps, key = of_split[split], ids[split]
            places = [maps.tx_position_m.index(position) for position in shown_m]
            ssim = [maps.predicted[key].ssim[place] for place in places]
            columns[short_name(split)] = maps.levels()[places], maps.levels(key)[places], ssim
        caption = (
            f"{row.short_label}, {board.lane_title or 'no budget'}: maps of {len(shown_m)} transmitters, spread from "
            f"easy to hard ones, at {len(columns)} carriers that were left out in turn, the truth above the prediction."
            " Azimuth to the right, elevation upwards, powers down to 30 dB below the peak."
        )
        link = f"figures/paper-{board.slug}-maps.png"
        names = [f"({', '.join(f'{coordinate:.1f}' for coordinate in position)}) m" for position in shown_m]
        parts += [prose(caption), f"![Maps beside the truth, {heading(row.short_label)}]({link})"]
        drawn[link] = partial(_draw_maps, columns, names)
    return ["## Maps", *parts] if parts else [], drawn


def _draw_maps(columns: Mapping[str, Any], names: Sequence[str], path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_map_grid

    plot_map_grid(columns, names, path)


def _spread(values: Sequence[Any], most: int = 5) -> list[Any]:
    """At most `most` of the values, equally spaced in their order."""
    places = np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int)
    return [values[place] for place in places]
