"""All results as one web page: a single file that loads nothing. Equal records give an equal page."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from xfreqbench.errors import DataError
from xfreqbench.report.drawing.templates import render
from xfreqbench.report.leaderboard.columns import COSTS
from xfreqbench.report.leaderboard.comparison import comparisons_of
from xfreqbench.report.leaderboard.gallery import gallery, scales
from xfreqbench.report.leaderboard.origins import machine_name
from xfreqbench.report.leaderboard.overview import main_scene
from xfreqbench.report.leaderboard.page_content import (
    CHART_COSTS,
    board_content,
    figure_content,
    ordered_labels,
)
from xfreqbench.report.leaderboard.page_tables import (
    board_tables,
    overview_protocols,
    overview_rows,
    page_facts,
)
from xfreqbench.report.leaderboard.published import sources_of
from xfreqbench.report.leaderboard.results import RankedResults, read_results
from xfreqbench.system.files import require_own, require_space, write_text

_TITLE = "xfreqbench results"  # by which a page is known that may be written over


def write_page(results: Path | Sequence[Path], output_html: Path) -> Path:
    """Write the page of `results`, results folders or files of records, and return the file written.

    Pictures of predicted maps are drawn from the predictions beside the records where the data set is found, and
    else from the maps shipped beside them. Raises `DataError` where there are no runs and as `boards` does,
    `OutputExistsError` where `output_html` is another file, and `StorageError`.
    """
    require_space(output_html, 1)
    mark = f"<title>{_TITLE}</title>".encode()
    require_own(output_html, lambda file: None if mark in file.read_bytes() else "is no page of results")
    found = read_results(results)
    if not found.boards:
        raise DataError(
            f"{', '.join(str(folder.records_path) for folder in found.folders)} holds no runs. Run `xfreqbench run` "
            "first, or mend the path."
        )
    write_text(output_html, _page(found))
    return output_html


def _page(found: RankedResults) -> str:
    main = main_scene(found.boards)
    boards = sorted(found.boards, key=lambda board: board.scene != main)
    comparisons = [comparisons_of(board) for board in boards]
    galleries = [gallery(board, found.folders, found.maps) for board in boards]
    content = {
        "boards": [board_content(*each) for each in zip(comparisons, galleries, strict=True)],
        "labels": ordered_labels(boards),
        "benches": [figure_content(bench) for bench in found.benches],
        "scales": scales(),
    }
    return render(
        "leaderboard/page.html",
        title=_TITLE,
        facts=page_facts(boards),
        boards=[board_tables(each) for each in comparisons],
        overview_rows=overview_rows([each[0] for each in comparisons]),
        overview_protocols=overview_protocols(boards),
        costs={name: COSTS[name].hint for name in CHART_COSTS},
        sources=sources_of([row for board in boards for row in board.rows]),
        benches=found.benches,
        machine_name=machine_name,
        content=_finite(content),
    )


def _finite(content: Any) -> Any:
    """The same content with None in place of numbers that are not finite, which JSON cannot say."""
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return None if isinstance(content, float) and not isfinite(content) else content
