"""Notebooks that can be executed; as a program, it executes those of `examples` and stores them with their outputs."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path
from typing import Any

from tests.support.places import ROOT

NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def read(path: Path) -> Any:
    """The notebook as it is stored; raises where it is none."""
    import nbformat  # here, so that all other tests are found without it

    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    return notebook


def execute(path: Path, folder: Path) -> Any:
    """The notebook with new outputs, after all its cells were run in a folder. Raises what a cell raises."""
    import nbformat
    from nbclient import NotebookClient

    notebook = read(path)
    os.environ.pop("MPLBACKEND", None)  # which our command sets; a notebook draws inline
    NotebookClient(notebook, timeout=240, resources={"metadata": {"path": str(folder)}}).execute()
    return nbformat.reads(nbformat.writes(notebook).replace(f"{folder}/", ""), as_version=4)


def text_outputs(notebook: Any) -> list[str]:
    """What the cells printed on stdout, and their results as plain text; one text for each cell of code."""
    return ["".join(map(_text, cell.outputs)) for cell in notebook.cells if cell.cell_type == "code"]


def words_and_numbers(text: str) -> tuple[list[str], list[float]]:
    """What a text says, each number taken out, and the numbers; how wide its columns are does not count."""
    return _NUMBER.sub("#", text).replace("-", " ").split(), [float(number) for number in _NUMBER.findall(text)]


def _text(output: Any) -> str:
    if output.output_type == "stream":
        return output.text if output.name == "stdout" else ""
    return output.get("data", {}).get("text/plain", "")


def _store(path: Path) -> None:
    import nbformat

    with tempfile.TemporaryDirectory() as folder:
        notebook = execute(path, Path(folder))
    for cell in notebook.cells:
        cell.metadata.clear()
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook.metadata = nbformat.NotebookNode(kernelspec=kernel)
    nbformat.write(notebook, path)


if __name__ == "__main__":
    for notebook in NOTEBOOKS:
        _store(notebook)
