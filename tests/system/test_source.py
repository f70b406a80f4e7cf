"""Hashes of source code: what is reached counts, in whichever file it is, and nothing else does."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.support.places import ROOT
from xfreqbench.system import source
from xfreqbench.system.source import package_sha256, reachable_sha256, reachable_sources

PACKAGE = "reached_package"
METHOD = """
from . import first
from .inner import deep
from .bare import within

def fit():
    from reached_package.second import value
    import reached_package.offers as offers
    return first.helper() + value + deep.VALUE + offers.name() + within.VALUE
"""
FILES = {
    "__init__.py": '"""A package."""\n',
    "method.py": METHOD,
    "first.py": "import numpy\n\ndef helper():\n    return 1\n",
    "second.py": "value = 2\n",
    "third.py": "unused = 3\n",
    "inner/__init__.py": '"""An inner package."""\n',
    "inner/deep.py": "from ..fourth import VALUE\n",
    "fourth.py": "VALUE = 4\n",
    "bare/within.py": "VALUE = 7\n",  # in a folder without `__init__`
    "offers/__init__.py": "import lazy_loader as lazy\n\n"
    "__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)\n",
    "offers/__init__.pyi": "from .lazily import name\nfrom .never import other\n",
    "offers/lazily.py": "def name():\n    return 5\n",
    "offers/never.py": "def other():\n    return 6\n",
}
REACHED = {"method", "first", "second", "inner.deep", "fourth", "bare.within", "offers.lazily"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / PACKAGE
    for name, text in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    return folder


def _reached() -> set[str]:
    return {name.removeprefix(f"{PACKAGE}.") for name in reachable_sources([f"{PACKAGE}.method"])}


def _sha256() -> str:
    return reachable_sha256([f"{PACKAGE}.method"])


@pytest.mark.usefixtures("folder")
def test_relative_late_and_lazy_imports_are_followed_and_nothing_is_imported() -> None:
    assert _reached() == REACHED
    assert not [name for name in sys.modules if name.startswith(PACKAGE)]


@pytest.mark.parametrize("name", ["third.py", "offers/never.py", "__init__.py", "inner/__init__.py"])
def test_a_change_of_what_is_not_reached_leaves_the_hash(folder: Path, name: str) -> None:
    before = _sha256()
    text = FILES[name]
    (folder / name).write_text(f'"""Other words."""\n{"" if name.endswith("__init__.py") else text}')
    assert _sha256() == before


@pytest.mark.parametrize("name", sorted(f"{name.replace('.', '/')}.py" for name in REACHED))
def test_a_change_of_anything_that_is_reached_changes_the_hash(folder: Path, name: str) -> None:
    before = _sha256()
    (folder / name).write_text(FILES[name] + "# changed\n")
    assert _sha256() != before
    (folder / name).write_text(FILES[name])
    assert _sha256() == before


def test_a_function_that_moves_to_another_file_counts_there(folder: Path) -> None:
    before, moved = _sha256(), FILES["first.py"]
    (folder / "third.py").write_text(FILES["third.py"] + moved)
    assert _sha256() == before  # nothing imports it there yet
    (folder / "first.py").write_text("from .third import helper\n")
    assert _reached() == REACHED | {"third"}
    after = _sha256()
    assert after != before
    (folder / "third.py").write_text(FILES["third.py"] + moved.replace("return 1", "return 7"))
    assert _sha256() != after


def test_an_init_with_code_counts_for_all_that_is_within_its_package(folder: Path) -> None:
    (folder / "inner" / "__init__.py").write_text("from .. import third\n\nthird.unused = 0\n")
    assert _reached() == REACHED | {"inner", "third"}


def test_imports_for_a_type_checker_alone_do_not_count(folder: Path) -> None:
    text = "from typing import TYPE_CHECKING\n\nif TYPE_CHECKING:\n    from reached_package import third\n"
    (folder / "second.py").write_text(text + FILES["second.py"])
    assert _reached() == REACHED


def test_a_file_that_cannot_be_parsed_counts_with_its_bytes(folder: Path) -> None:
    (folder / "second.py").write_text("value = (")
    assert _reached() == REACHED


def test_of_a_library_only_the_file_of_a_base_class_counts_and_of_python_nothing() -> None:
    assert reachable_sources(["builtins", "typing", "abc"]) == {}
    assert set(reachable_sources(["xfreqbench.units", "pydantic.main"])) == {"xfreqbench.units", "pydantic.main"}


def test_what_another_process_found_counts_as_long_as_files_are_the_same(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, known, search = _sha256(), source.known_sources(), source._reachable
    monkeypatch.setattr(source, "_known", {})
    monkeypatch.delattr(source, "_reachable")
    source.remember_sources(known)
    assert _sha256() == before
    monkeypatch.setattr(source, "_reachable", search, raising=False)
    (folder / "method.py").write_text((folder / "method.py").read_text() + "\nchanged = True")
    assert _sha256() != before


def test_the_hash_of_the_package_covers_every_file_of_it_and_the_built_in_methods(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = source._package_files()
    assert {"xfreqbench/__init__.py", "xfreqbench/cli/main.py", "xfreqbench/baselines/nearest.py"} <= files.keys()
    ours = {path for folder in ("xfreqbench", "baselines") for path in (ROOT / folder).rglob("*.py")}
    assert set(files.values()) == ours
    before = package_sha256()
    edited = tmp_path / "nearest.py"
    edited.write_text("")
    monkeypatch.setattr(source, "_package_files", lambda: files | {"xfreqbench/baselines/nearest.py": edited})
    assert package_sha256() != before


@pytest.fixture
def watched_garbage() -> Iterator[None]:
    """Threads change places often, and so is garbage collected, which calls Python code, as in workers of Dask."""

    def watch(phase: str, info: dict[str, int]) -> None:
        for _ in range(200):
            pass

    interval, thresholds = sys.getswitchinterval(), gc.get_threshold()
    sys.setswitchinterval(1e-5)
    gc.set_threshold(100)
    gc.callbacks.append(watch)
    yield
    gc.callbacks.remove(watch)
    gc.set_threshold(*thresholds)
    sys.setswitchinterval(interval)


@pytest.mark.usefixtures("watched_garbage")
def test_threads_read_sources_at_once() -> None:
    """Python 3.11 raises `SystemError` where two of them parse at the same time."""
    texts = [path.read_bytes() for path in sorted((ROOT / "xfreqbench" / "runs").glob("*.py"))]
    with ThreadPoolExecutor(3) as threads:
        own = [[text + b"# %d" % number for text in texts] for number in range(3)]  # what was parsed is kept
        parsed = list(threads.map(lambda asked: [len(source._parsed(text).body) for text in asked], own))
    assert parsed[0] == parsed[1] == parsed[2]
    assert min(parsed[0]) > 0
