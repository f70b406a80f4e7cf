"""All results as one web page: a single file that loads nothing. Equal records give an equal page."""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Sequence
from itertools import chain
from math import isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np

from xfreqbench.errors import DataError
from xfreqbench.maps.metrics import METRICS
from xfreqbench.report.drawing.templates import COLOURS, render
from xfreqbench.report.leaderboard.boards import Board, BoardRow, machine_name, pooled_quantiles, short_name
from xfreqbench.report.leaderboard.captions import data_statement, facts, leak_statement, notes, sources_of
from xfreqbench.report.leaderboard.columns import COSTS, columns, cost_of, metric_title
from xfreqbench.report.leaderboard.comparison import Comparison, comparisons_of
from xfreqbench.report.leaderboard.figures import best_trivial
from xfreqbench.report.leaderboard.maps import gallery
from xfreqbench.report.leaderboard.overview import main_scene
from xfreqbench.report.leaderboard.results import RankedResults, Results, read_results
from xfreqbench.report.leaderboard.side_by_side import NOTHING_WORSE, WORSE_HEADER, got_worse
from xfreqbench.report.leaderboard.tables import require_own_table, write_tables
from xfreqbench.runs.records import RunRecord
from xfreqbench.system.files import require_own, require_space, write_text

_TITLE = "xfreqbench results"  # a page with this title was written by us, and may be replaced
_CHART_COSTS = ("seconds", "milliseconds", "parameters")  # against which the page draws accuracy


def write_page(results: Results, output_html: Path, since: Path | None = None) -> Path:
    """Write the page of `results`, read ones, results folders or files of records, and return the file written.

    Its tables are written beside it, as `write_tables` does. With earlier results `since` it says what got worse.

    Pictures of predicted maps are drawn from the predictions beside the records where the data set is found, and
    otherwise from the maps shipped beside them. Raises `DataError` where there are no runs and as `boards` does,
    `OutputExistsError` where `output_html` is another file, and `StorageError`.
    """
    found = read_results(results)
    require_page(found, output_html)
    main = main_scene(found.boards)
    boards = sorted(found.boards, key=lambda board: board.scene != main)
    # those first in which methods compete, and not trivial predictors alone
    compared = [
        sorted(comparisons_of(board), key=lambda found: not any(map(_competes, found.rows))) for board in boards
    ]
    protocols = list(dict.fromkeys(board.protocol for board in boards))
    content = {
        "boards": [
            _board_content(of_board) | {"gallery": gallery(board, found.folders, found.maps)}
            for board, of_board in zip(boards, compared, strict=True)
        ],
        "styles": _styles(boards),
        "colours": COLOURS,
        "benches": [bench.figure and bench.figure.model_dump() for bench in found.benches],
        "scales": {"power": _scale("magma"), "error": _scale("viridis")},
    }
    html = render(
        "leaderboard/page.html",
        title=_TITLE,
        facts=facts(boards),
        boards=list(map(_tables, compared)),
        links=_overview([of_board[0] for of_board in compared], protocols),
        protocols=protocols,
        costs={name: COSTS[name][1] for name in _CHART_COSTS},
        sources=sources_of([row for board in boards for row in board.rows]),
        worse=None if since is None else got_worse(read_results(since).records, found.records),
        worse_header=WORSE_HEADER,
        nothing_worse=NOTHING_WORSE,
        benches=found.benches,
        machine_name=machine_name,
        content=_finite(content),
    )
    write_text(output_html, html)
    write_tables(chain.from_iterable(compared), output_html.with_suffix(".csv"))
    return output_html


def _scale(colours: str) -> str:
    """A colour bar from low to high, as a PNG file in base64."""
    from xfreqbench.report.drawing.figures import map_png

    return b64encode(map_png(np.linspace(0, 1, 64, dtype=np.float32)[None], colours)).decode()


def require_page(found: RankedResults, output_html: Path) -> None:
    """Raise what `write_page` would raise for these results and this file, before anything is written."""
    if not found.boards:
        raise DataError(
            f"{', '.join(str(folder.records_path) for folder in found.folders)} has no runs in known rooms, which are "
            "what a page shows. Leave out --html: the report has the tables of unseen rooms and of measurements."
        )
    require_space(output_html, 1)
    mark = f"<title>{_TITLE}</title>".encode()
    require_own(output_html, lambda file: None if mark in file.read_bytes() else "is no page of results")
    for path in map(output_html.with_suffix, (".csv", ".parquet")):
        require_own_table(path)


def _competes(row: BoardRow) -> bool:
    return row.family not in ("trivial", "ablation")


def _finite(content: Any) -> Any:
    """The same content with None in place of numbers that are not finite, which JSON cannot say."""
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return None if isinstance(content, float) and not isfinite(content) else content


def _tables(compared: Sequence[Comparison]) -> dict[str, Any]:
    """A board: what its data are in words, and a leaderboard for each of its sets of splits.

    `more` of its columns are shown when they are asked for, those of over five splits among them.
    """
    board = compared[0].board
    sets = []
    for comparison in compared:
        is_long = len(comparison.splits) > 5
        splits = [] if is_long else ["splits"]
        shown = columns(
            comparison,
            ("rank", "method", "average", "skill", *splits, "beam_loss", "aoa_error", "seconds", "milliseconds"),
        )
        more = ("seeds", "p10", "psnr", "power_error", "memory", "parameters", "whose", "origin", "trained on")
        hidden = columns(comparison, (*more, *(["splits"] if is_long else [])))
        sets.append(
            {
                "splits": list(map(short_name, comparison.splits)),
                "columns": [*shown, *hidden],
                "more": hidden,
                "rows": comparison.rows,
                "best_trivial": next((row for row in comparison.rows if row.is_trivial), None),
                "notes": notes(comparison),
            }
        )
    conditions = f"{data_statement(board)}. {leak_statement(board)}"
    return {"slug": board.slug, "title": board.title, "conditions": conditions, "sets": sets}


def _overview(compared: Sequence[Comparison], protocols: Sequence[str]) -> dict[str, list[list[dict[str, str]]]]:
    """Links to the boards, by scene and then by protocol; `compared` holds one comparison of every board."""
    num_data = Counter(scene for scene, _ in {(each.board.scene, each.board.data) for each in compared})
    links: dict[str, dict[str, list[dict[str, str]]]] = {}
    for comparison in compared:
        scene = comparison.board.scene
        of_scene = links.setdefault(scene, {protocol: [] for protocol in protocols})
        of_scene[comparison.board.protocol].append(_link(comparison, num_data[scene] > 1))
    return {scene: list(of_scene.values()) for scene, of_scene in links.items()}


def _link(comparison: Comparison, names_data: bool) -> dict[str, str]:
    """A link of the overview: the board, its budget in words, and the best method there with its skill."""
    board = comparison.board
    competing = list(filter(_competes, comparison.rows))
    if competing:
        best = competing[0]
        skill = best.average(comparison.splits, board.skill)
        only = short_name(comparison.splits[0]) if len(comparison.splits) == 1 else board.protocol
        ssim = f"{'average' if only == board.protocol else only} {best.average(comparison.splits):.4f}"
        scores = ", ".join([ssim, *([f"skill {skill:.3f}".replace("-", "−")] if isfinite(skill) else [])])
        among = f"; best of {len(competing)} methods" if len(competing) > 1 else ""
        standing = f"{best.short_label}: {scores}{among}"
    else:
        plurals = {"trivial": "trivial predictors", "ablation": "ablations"}
        standing = f"{' and '.join(dict.fromkeys(plurals[row.family] for row in comparison.rows))} alone"
    data = f", {board.data_name}" if names_data else ""
    return {"slug": board.slug, "text": (board.lane_title or "without budget") + data, "standing": standing}


def _board_content(compared: Sequence[Comparison]) -> dict[str, Any]:
    """A board's curves, and the averages of its rows in each comparison, one for each set of splits."""
    board = compared[0].board
    trivial = {split: best_trivial(board, split) for split in board.splits}
    return {
        "slug": board.slug,
        "title": board.title,
        "splits": {
            split: {"name": short_name(split), "trivial": _rounded(point[1]) if point else nan}
            for split, point in trivial.items()
        },
        "rows": {
            row.short_label: {
                "family": row.family,
                "splits": {split: _curves(records) for split, records in row.by_split.items()},
            }
            for row in board.rows
        },
        "sets": [
            {
                "splits": list(comparison.splits),
                "rows": {row.short_label: _standing(comparison, row) for row in comparison.rows},
            }
            for comparison in compared
        ],
        "metrics": {name: metric_title(name) for name in METRICS if all(name in each.scores for each in board.records)},
    }


def _styles(boards: Sequence[Board]) -> dict[str, tuple[int, int]]:
    """Places of the colour and of the dashes of each row, the same on every board.

    A method has one colour; its plain row is a whole line, and its variants are dashed. With more methods than
    colours, the second that has a colour is dashed too.
    """
    rows = {row.short_label: row for board in boards for row in board.rows}
    places = {}
    for colour, method in enumerate(sorted({row.job.method for row in rows.values()})):
        labels = sorted(label for label, row in rows.items() if row.job.method == method)
        for variant, label in enumerate(sorted(labels, key=lambda label: rows[label].family == "ablation")):
            places[label] = colour % len(COLOURS), colour // len(COLOURS) + variant
    return places


def _curves(records: Sequence[RunRecord]) -> dict[str, Any]:
    """Distributions of scores, the median SSIM at each carrier in GHz, mean over seeds, and the learning curve."""
    medians = [record.scores["ssim"].median_by_carrier_hz for record in records]
    return {
        "cdf": {
            name: list(map(_rounded, pooled_quantiles(records, name)))
            for name in records[0].scores
            if all(name in each.scores for each in records)
        },
        "carriers": [
            [float(carrier) / 1e9, _rounded(float(np.mean([by_hz.get(carrier, nan) for by_hz in medians])))]
            for carrier in sorted(medians[0], key=float)
        ],
        "curve": [[_rounded(point.seconds), _rounded(point.ssim)] for point in records[0].curve],
    }


def _standing(comparison: Comparison, row: BoardRow) -> dict[str, Any]:
    def average(name: str) -> float:
        return row.average(comparison.splits, lambda record: cost_of(record, name))

    return {
        "ssim": _rounded(row.average(comparison.splits)),
        "interval": [_rounded(bound) for bound in comparison.interval(row)],
        "skill": _rounded(row.average(comparison.splits, comparison.board.skill)),
        **{name: average(name) for name in _CHART_COSTS},
    }


def _rounded(value: float) -> float:
    return float(f"{value:.4g}") if isfinite(value) else value
