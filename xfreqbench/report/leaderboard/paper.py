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
from xfreqbench.report.leaderboard.boards import Board, BoardRow, budget_text, pooled_quantiles, published, short_name
from xfreqbench.report.leaderboard.captions import reduced_statement
from xfreqbench.report.leaderboard.columns import metric_title
from xfreqbench.report.leaderboard.comparison import Comparison, contrast
from xfreqbench.report.leaderboard.maps import require_own_maps, stored_maps
from xfreqbench.report.leaderboard.overview import main_boards, main_scene, papers_idea
from xfreqbench.report.leaderboard.results import RankedResults, Results, read_results
from xfreqbench.system.files import write_text

_PAPERS = "xfreq-gs-paper", "xfreq-gs"  # the paper's method as it has it, and with our aids
_LEVEL = 90  # per cent of the maps, as in the paper
_Rows = list[tuple[Board, BoardRow]]


def paper_page(found: RankedResults) -> tuple[str, str, dict[str, Callable[[Path], None]]] | None:
    """The page of the paper's claims with a verdict, and of published numbers beside ours, for the main scene.

    Before it comes its section on the claims, empty without any; behind it come functions that draw its figures to a
    path, by their links from the page. None where the paper has numbers for no method.
    """
    content, ranked = published(), _boards_of(found)
    methods = {each["method"] for part in content["table"].values() for each in part["ours"].values()}
    if not methods & {row.job.method for board in ranked for row in board.rows if not row.is_external}:
        return None
    distributions, cdfs = _distributions(ranked)
    maps, grids = _maps(ranked, found)
    claims, idea = _claims_table(ranked), papers_idea(ranked)[1]
    caption = (
        "Differences of median SSIM × 1000, on the paper's three carriers or, where one is named, on this one. A claim "
        "*holds* where the whole interval, paired by transmitters and with three seeds of each method, lies above "
        "zero, and *does not hold* where it lies below. Data, rooms and sizes are others than the paper's. A data set "
        "is named where it is not that of the boards. A dash: not run yet; presets `paper`, `equal-terms`, "
        "`ablations`, `converged` and `paper-size` have the runs."
    )
    rows = [row for board in ranked for row in board.rows]
    parts = [
        f"{content['citation']}: {content['conditions']}. Their data, rooms and receivers are others than ours, and "
        "the sizes of their models too, so that numbers do not compare. What can be compared are claims: which of two "
        "methods is better, and by how much.",
        "The paper's method is `xfreq-gs-paper`: the choices of the paper, whose fits see 200,000 maps, and of its "
        f"released program. `xfreq-gs` is its model in another size, with four aids of ours. {reduced_statement(rows)}",
        "## Claims",
        caption,
        claims or "None was measured.",
        *(["## What each part of the paper's idea adds", *idea] if idea else []),
        "## The paper's tables",
        "A median SSIM of ours has its 95 % interval.",
        *_papers_tables(ranked),
        *distributions,
        *maps,
    ]
    section = f"## The paper's claims\n\n{caption}\n\n{claims}" if claims else ""
    return section, "\n\n".join(filter(None, parts)) + "\n", cdfs | grids


def _boards_of(found: RankedResults) -> list[Board]:
    """The boards of the main scene, its main data set before others: of each protocol first that with most runs."""
    of_scene = [board for board in found.boards if board.scene == main_scene(found.boards)]
    first = main_boards(of_scene)
    data = {board.data for board in first[:1]}
    return sorted(of_scene, key=lambda board: (board.data not in data, board not in first))


def _is_named(named: Mapping[str, Any], row: BoardRow) -> bool:
    """Whether a row has the named method and, but for the device, the named options and no others."""
    is_method = not row.is_external and row.job.method == named["method"]
    return is_method and row.changed == set(named.get("options", ()))


def _ours(named: Mapping[str, Any], protocol: str, splits: Sequence[str], ranked: Sequence[Board]) -> _Rows:
    """Our rows for a row of the paper: of each method and budget that of the first board that has it on all the splits.

    The paper's method comes before that with our aids.
    """
    methods = _PAPERS if named["method"] == _PAPERS[-1] else (named["method"],)
    rows = [(board, row) for board in ranked if board.protocol == protocol for row in board.rows]
    has_all = [(board, row) for board, row in rows if set(splits) <= set(row.by_split)]
    first = dict[tuple[str, str], tuple[Board, BoardRow]]()
    for method in methods:
        for board, row in has_all:
            if _is_named({**named, "method": method}, row):
                first.setdefault((method, board.lane), (board, row))
    return list(first.values())


def _most_run(named: Mapping[str, Any], protocol: str, ranked: Sequence[Board]) -> _Rows:
    """As `_ours`, of each method its first row alone."""
    first = dict[str, tuple[Board, BoardRow]]()
    for board, row in _ours(named, protocol, (), ranked):
        first.setdefault(row.job.method, (board, row))
    return list(first.values())


def _called(board: Board, row: BoardRow, main: Board) -> str:
    """The method of one of our rows, what is different of it, its budget, and its data if not those of `main`."""
    words = "with our aids" if row.job.method == _PAPERS[-1] else row.whose.removeprefix("ours")
    data = board.data_name if board.data != main.data else ""
    return ", ".join(filter(None, [row.job.method, words, board.lane, data]))


def _distributions(ranked: Sequence[Board]) -> tuple[list[str], dict[str, Callable[[Path], None]]]:
    """The 90 % level of SSIM and PSNR and a figure of their distributions; none where our rows share no split.

    Our rows of methods whose distribution the paper shows are on its three carriers, or on those of them that all were
    run on, beside them the best baseline there.
    """
    theirs = published()["table"]["cdf"]
    found = {
        (name, row.label): (board, row)
        for name, named in theirs["ours"].items()
        for board, row in _most_run(named, theirs["protocol"], ranked)
    }
    splits = [
        split for split in theirs["splits"][0] if found and all(split in row.by_split for _, row in found.values())
    ]
    if not splits:
        return [], {}
    board = next(board for board in ranked if board.protocol == theirs["protocol"])
    found |= {
        (ABSENT, row.label): (board, row) for row in [each for each in board.rows_on(splits) if each.is_trivial][:1]
    }
    panels: dict[str, dict[str, list[float]]] = {"SSIM": {}, metric_title("psnr"): {}}
    cells = []
    for (name, _), (of_row, row) in found.items():
        records = [record for split in splits for record in row.by_split[split]]
        called = _called(of_row, row, board) if row.family == "learned" else row.label
        for metric, panel in zip(("ssim", "psnr"), panels.values(), strict=True):
            panel[called] = pooled_quantiles(records, metric)
        levels = [panel[called][_LEVEL] for panel in panels.values()]
        ours = [number(level, decimals) for level, decimals in zip(levels, (4, 2), strict=True)]
        cells.append([called, name, *theirs["rows"].get(name, [ABSENT]), *ours])
    link = f"figures/paper-{board.slug}-cdf.svg"
    parts = [
        "## Distributions of SSIM and PSNR",
        f"At {', '.join(map(short_name, splits))}, all seeds together; the paper does not say of which carriers its "
        "level is. 90 % of the maps have a score at or below the level, where the figure has a dashed line.",
        table(("ours", "theirs", "published SSIM", *panels), cells, prose),
        f"![Distributions of SSIM and PSNR]({link})",
    ]
    return parts, {link: partial(_draw_cdf, panels)}


def _draw_cdf(panels: Mapping[str, Mapping[str, Sequence[float]]], path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_score_cdf

    plot_score_cdf(panels, _LEVEL / 100, path)


def _claims_table(ranked: Sequence[Board]) -> str:
    """A row for each claim, of the method as the paper has it and with our aids; empty where nothing was measured."""
    columns = {
        "xfreq-gs-paper, 200,000 maps": ("converged", "xfreq-gs-paper", ()),
        "xfreq-gs-paper, 64,000 maps": ("quick", "xfreq-gs-paper", ()),
        "xfreq-gs without our aids, 64,000 maps": ("quick", "xfreq-gs", ("aided=false",)),
        "xfreq-gs with our aids, 64,000 maps": ("quick", "xfreq-gs", ()),
    }
    rows = []
    for claim in published()["claim"]:
        cells = [_claim_cell(claim, ranked, *column) for column in columns.values()]
        is_doubted = any(words in cell for cell in cells for words in (": open", "does not hold"))
        why = claim.get("why", "") if is_doubted else ""
        rows.append([f"{claim['claim']} ({claim['theirs']})", *cells, why])
    if all(cell == ABSENT for row in rows for cell in row[1:-1]):
        return ""
    return table(("claim (published)", *columns, "why not"), rows, prose)


def _claim_cell(
    claim: Mapping[str, Any], ranked: Sequence[Board], lane: str, method: str, options: tuple[str, ...]
) -> str:
    """The difference and the verdict on the first board of a lane that has both methods; a dash without any.

    `method` with `options` is compared in the place of the paper's method.
    """
    ends = [claim[end] for end in ("better", "worse") if end in claim]
    ends = [
        {"method": method, "options": [*end.get("options", ()), *options]} if end["method"] == _PAPERS[-1] else end
        for end in ends
    ]
    along, carriers = claim.get("along", []), published()["table"]["cdf"]["splits"][0]
    for board in ranked:
        rows = [next((row for row in board.rows if _is_named(named, row)), None) for named in ends]
        known = [row for row in rows if row is not None]
        splits = [split for split in along or carriers if all(split in row.by_split for row in known)]
        is_whole = len(known) == len(ends) and (len(splits) == len(along) if along else bool(splits))
        if (board.protocol, board.lane) != (claim.get("protocol", "lofo"), budget_text(BUDGETS[lane])) or not is_whole:
            continue
        signed = list(zip(known, (1, -1), strict=False))
        weights = {splits[-1]: 1.0, splits[0]: -1.0} if along else dict.fromkeys(splits, 1 / len(splits))
        terms = [(row, split, sign * weight) for row, sign in signed for split, weight in weights.items()]
        difference, (low, high) = contrast(board, terms)
        steps = [1000 * sum(sign * row.average([split]) for row, sign in signed) for split in along]
        levels = f"{', '.join(f'{step:.1f}' for step in steps)}: " if along else ""
        is_known = all(Comparison(board, tuple(splits)).has_enough_seeds(row) for row in known) and not isnan(low)
        verdict = "holds" if low > 0 else "does not hold" if high < 0 else "open"
        verdict = verdict if is_known else "too few seeds"
        where = f" at {short_name(splits[0])}" if len(splits) == 1 else ""
        where += f" ({board.data_name})" if board.data != ranked[0].data else ""
        bounds = f" [{1000 * low:+.1f}, {1000 * high:+.1f}]" if is_known else ""
        return f"{levels}{1000 * difference:+.1f}{bounds}{where}: {verdict}"
    return ABSENT


def _papers_tables(ranked: Sequence[Board]) -> list[str]:
    """The paper's tables, below each of its rows ours; without the rows and the tables of which we have none."""
    statistics: dict[str, tuple[str, str, int]] = {  # as the published tables name them: metric, statistic, decimals
        "SSIM mean": ("ssim", "mean", 4),
        "PSNR mean (dB)": ("psnr", "mean", 2),
        "PSNR median (dB)": ("psnr", "median", 2),
    }
    parts = []
    for name, theirs in published()["table"].items():
        rows: list[list[str]] = []
        for of_paper, values in theirs["rows"].items() if name != "cdf" else ():
            named = theirs["ours"][of_paper]
            of_columns = theirs.get("splits") or [named["splits"]] * len(values)
            found = _ours(named, theirs["protocol"], of_columns[-1], ranked)
            rows += [[heading(of_paper), "published", *values]] if found else []
            for board, row in found:
                cells = []
                for column, splits in zip(theirs["columns"], of_columns, strict=True):
                    of_column = statistics.get(column, ("ssim", "median", 4))
                    cells.append(_statistic(Comparison(board, tuple(splits)), row, *of_column))
                rows.append(["", _called(board, row, ranked[0]), *cells])
        if rows:
            header = (theirs["first_column"], "by", *theirs["columns"])
            parts.append(f"{theirs['title']}:\n\n{table(header, rows, prose)}")
    return parts


def _statistic(comparison: Comparison, row: BoardRow, metric: str, name: str, decimals: int) -> str:
    """A statistic of a metric, the mean over splits and seeds; a median SSIM has its interval."""
    value = row.average(comparison.splits, lambda record: float(getattr(record.scores[metric], name)))
    if (metric, name) != ("ssim", "median"):
        return number(value, decimals)
    return with_interval(value, comparison.interval(row), decimals)


def ship_maps(results: Results, path: Path) -> Path:
    """Write the maps of a dozen samples of every board of the main scene to a file, and return it.

    They are the maps that the page shows, of all rows but ablations, and those of the paper's method at further
    carriers. Raises `DataError` where no predictions or no data set are found, `OutputExistsError` and `StorageError`.
    """
    found = read_results(results)
    main, shown, known = main_scene(found.boards), [], set[str]()
    for board in found.boards:
        papers = [row for _, row in _most_run({"method": _PAPERS[-1]}, "lofo", [board])]
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
    for board, row in _most_run({"method": _PAPERS[-1]}, "lofo", ranked):
        stored = stored_maps(board, found.folders, [row])
        known = found.maps | {key: maps for maps in stored for key in maps.predicted}
        ids = {split: row.by_split[split][0].id for split in board.splits if split in row.by_split}
        of_split = {split: known[key] for split, key in ids.items() if key in known}
        splits = _spread(list(of_split))
        shared = [maps.tx_position_m for maps in of_split.values()]
        positions = [tx for tx in (shared[0] if shared else ()) if all(tx in others for others in shared)]
        if not positions:
            parts += [
                f"Maps of `{row.job.method}` are not stored beside these records: `xfreqbench benchmark --preset "
                f"{'paper-size' if row.job.method == _PAPERS[0] else 'paper-maps'}` predicts them, and "
                "`docs/remake.py` with its folder ships and shows them."
            ]
            continue
        shown_m, columns = _spread(positions), {}
        for split in splits:
            maps, key = of_split[split], ids[split]
            places = [maps.tx_position_m.index(position) for position in shown_m]
            ssim = [maps.predicted[key].ssim[place] for place in places]
            columns[short_name(split)] = maps.levels()[places], maps.levels(key)[places], ssim
        caption = (
            f"{_called(board, row, ranked[0])}: maps of {len(shown_m)} transmitters, spread from easy to hard ones, at "
            f"{len(columns)} carriers that were left out in turn, the truth above the prediction. Azimuth to the "
            "right, elevation upwards, powers down to 30 dB below the peak."
        )
        link = f"figures/paper-{board.slug}-{row.job.method}-maps.png"
        names = [f"({', '.join(f'{coordinate:.1f}' for coordinate in position)}) m" for position in shown_m]
        parts += [prose(caption), f"![Maps beside the truth, {heading(row.short_label)}]({link})"]
        drawn[link] = partial(_draw_maps, columns, names)
    return ["## Maps", *parts] if drawn else [], drawn


def _draw_maps(columns: Mapping[str, Any], names: Sequence[str], path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_map_grid

    plot_map_grid(columns, names, path)


def _spread(values: Sequence[Any], most: int = 5) -> list[Any]:
    """At most `most` of the values, equally spaced in their order."""
    places = np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int)
    return [values[place] for place in places]
