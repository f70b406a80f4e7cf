"""The notebooks of `examples` run from an empty folder, and print what is stored in them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.notebooks import NOTEBOOKS, execute, read, text_outputs, words_and_numbers

TRAINS = "a_method_of_your_own"  # other processors round in other ways, and so it ends at another step
TOLERANCE = 0.02  # of numbers that are printed with two digits, and of draws that rounding may tip


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_prints_what_is_stored_in_it(path: Path, tmp_path: Path) -> None:
    stored, now = (text_outputs(notebook) for notebook in (read(path), execute(path, tmp_path)))
    assert len(stored) == len(now)
    for before, after in zip(stored, now, strict=True):
        words, numbers = words_and_numbers(after)
        words_before, numbers_before = words_and_numbers(before)
        if path.stem == TRAINS:
            assert sorted(words) == sorted(words_before)  # rows of a table may change places
        else:
            assert words == words_before
            assert numbers == pytest.approx(numbers_before, abs=TOLERANCE)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_with_outputs_and_tells_nothing_of_where_it_was_run(path: Path) -> None:
    notebook = read(path)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert any(cell.outputs for cell in cells)
    assert not re.search(r"/tmp|/home|/root|stderr|\"error\"", path.read_text("utf-8"))
    assert path.stat().st_size < 200_000


def test_links_of_notebooks_lead_somewhere() -> None:
    for path in NOTEBOOKS:
        told = "".join(cell.source for cell in read(path).cells if cell.cell_type == "markdown")
        for target in re.findall(r"\]\((?!https?://)([^)#\s]+)", told):
            assert (path.parent / target).exists(), f"{path.name}: {target}"
