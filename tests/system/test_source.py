"""Hashes of source code: of the package, and of what a method's class comes with."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

from tests.support.places import ROOT
from xfreqbench.system import source
from xfreqbench.system.source import method_sha256, package_sha256

NAMES = ["hashed_package/__init__.py", "hashed_package/inner/deep.py", "hashed_lone.py", "hashed_beside.py"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in NAMES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("VALUE = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("module", "counts"),
    [("hashed_package.inner.deep", NAMES[:2]), ("hashed_lone", NAMES[2:])],
    ids=["package", "lone"],
)
def test_a_method_is_hashed_with_the_files_of_its_package_or_of_its_folder(
    folder: Path, module: str, counts: list[str]
) -> None:
    import_module(module)
    before = method_sha256([module])
    for name in NAMES:
        (folder / name).write_text("VALUE = 2\n")
        assert (method_sha256([module]) != before) == (name in counts)
        (folder / name).write_text("VALUE = 1\n")
    for name in [loaded for loaded in sys.modules if loaded.startswith("hashed_")]:
        del sys.modules[name]


def test_built_in_methods_in_single_files_are_hashed_together() -> None:
    names = "nearest", "k_nearest", "virtual_source.method"
    modules = [import_module(f"xfreqbench.baselines.{name}").__name__ for name in names]
    single, other, of_package = (method_sha256([module]) for module in modules)
    assert single == other != of_package != method_sha256([]) == method_sha256(["builtins", "typing", "abc"])


def test_the_hash_of_the_package_covers_every_file_of_it_and_the_built_in_methods(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = source._files_of("xfreqbench") | source._files_of("xfreqbench.baselines")
    assert {"xfreqbench/__init__.py", "xfreqbench/cli/main.py", "xfreqbench/baselines/nearest.py"} <= files.keys()
    ours = {path for folder in ("xfreqbench", "baselines") for path in (ROOT / folder).rglob("*.py")}
    assert set(files.values()) == ours
    before, edited = package_sha256(), tmp_path / "nearest.py"
    edited.write_text("")
    monkeypatch.setattr(source, "_files_of", lambda _: files | {"xfreqbench/baselines/nearest.py": edited})
    assert package_sha256() != before
