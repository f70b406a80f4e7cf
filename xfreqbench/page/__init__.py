"""Every result as one web page: a single file that loads nothing, the same for the same records."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files
from math import isfinite
from pathlib import Path
from string import Template
from typing import Any

from xfreqbench.boards import Board, boards
from xfreqbench.comparison import Comparison, Resampling
from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.page.content import board_content, figure_content
from xfreqbench.page.gallery import Gallery, gallery, scales
from xfreqbench.page.tables import bench_sections, board_section, header
from xfreqbench.records import RECORDS_FILE, BenchRecord, read
from xfreqbench.report import latest_benches, require_scores
from xfreqbench.storage import require_space, storage_errors, write_text

__all__ = ["write_page"]

_TITLE = b"<title>xfreqbench results</title>"  # of every page, and of no other file


def write_page(results: Path, output_html: Path) -> Path:
    """Write the page of `results`: a results folder, or one file of records; returns the file written.

    The gallery shows predictions that lie in `predictions` beside the records, where their data set is there
    too. Raises `DataError` where there are no runs, or as `boards` does, `OutputExistsError` for a file that is
    no such page, and `StorageError`.
    """
    _claim(output_html)
    path = results / RECORDS_FILE if results.is_dir() else results
    stored = read(path)
    if not stored.records:
        raise DataError(f"{path} holds no runs. Run `xfreqbench run` first, or mend the path.")
    require_scores(path, stored.records)
    ranked = boards(stored.records)
    galleries = [gallery(board, path.parent) for board in ranked]
    write_text(output_html, _page(ranked, galleries, latest_benches(stored.benches)))
    return output_html


def _claim(path: Path) -> None:
    """Raise `OutputExistsError` for a file that this never wrote."""
    require_space(path, 1)
    with storage_errors(path):
        is_foreign = path.exists() and _TITLE not in path.read_bytes()
    if is_foreign:
        raise OutputExistsError(f"{path} exists and is no page of results. Delete it, or give another path.")


def _page(ranked: Sequence[Board], galleries: Sequence[Gallery], benches: Sequence[BenchRecord]) -> str:
    comparisons = [_comparisons(board) for board in ranked]
    sections = [board_section(number, each) for number, each in enumerate(comparisons)]
    shown = zip(comparisons, galleries, strict=True)
    content = {
        "boards": [board_content(each, pictures) for each, pictures in shown],
        "benches": [figure_content(bench) for bench in benches],
        "scales": scales(),
    }
    return Template(_asset("page.html")).substitute(
        style=_asset("page.css"),
        script=_asset("page.js"),
        header=header(ranked),
        boards="\n".join(sections),
        benches=bench_sections(benches),
        content=_embedded(content),
    )


def _comparisons(board: Board) -> list[Comparison]:
    """One for each set of splits, lone ones included, with resamples that are taken once."""
    resampling = Resampling()
    lone = [(split,) for split in board.lone_splits()]
    return [Comparison(board, splits, resampling) for splits in [*board.split_sets(), *lone]]


def _embedded(content: Any) -> str:
    """JSON that no text in it can end, wherever in a page it stands; what is not finite is null."""
    text = json.dumps(_finite(content), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _finite(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return None if isinstance(content, float) and not isfinite(content) else content


def _asset(name: str) -> str:
    return (files(__name__) / name).read_text("utf-8")
