"""The rules of the house for folders. What may import what is in `.importlinter`."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests.support.places import ROOT

SOURCES = [
    path for folder in (ROOT / "xfreqbench", ROOT / "baselines", ROOT / "scenes") for path in folder.rglob("*.py")
]
FOLDERS = [path for path in SOURCES if path.name == "__init__.py"]
OFFERS_NAMES = {f"{folder}/__init__.py" for folder in ("scenes", "xfreqbench", "xfreqbench/maps", "xfreqbench/methods")}


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("path", FOLDERS, ids=named)
def test_the_init_of_a_folder_is_a_docstring(path: Path) -> None:
    """But where names are offered that are imported when they are used, and no more is said than that."""
    parsed = ast.parse(path.read_text("utf-8"))
    assert ast.get_docstring(parsed)
    if named(path) not in OFFERS_NAMES:
        assert len(parsed.body) == 1
    assert not [node for node in parsed.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    imported = {
        (node.module if isinstance(node, ast.ImportFrom) else node.names[0].name).partition(".")[0]
        for node in ast.walk(parsed)
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert imported <= {"lazy_loader", "os", "pathlib", "sys", "xfreqbench"}


def test_every_folder_with_sources_is_a_package() -> None:
    assert {path.parent for path in SOURCES} == {path.parent for path in FOLDERS}


def test_the_toolkit_imports_no_method_by_its_installed_name() -> None:
    """Import-linter, which knows the folder as `baselines`, cannot see this."""
    imports = re.compile(r"^\s*(from|import) xfreqbench\.baselines", re.MULTILINE)
    toolkit = [path for path in SOURCES if path.is_relative_to(ROOT / "xfreqbench")]
    assert not [named(path) for path in toolkit if imports.search(path.read_text("utf-8"))]
