"""A method that imports a module of version 0.1 is told where it is now."""

from __future__ import annotations

import ast
from importlib.util import find_spec
from pathlib import Path

import pytest

from xfreqbench.errors import MethodError
from xfreqbench.methods import moved
from xfreqbench.methods.registry import resolve_method


@pytest.mark.parametrize("new", sorted({*moved._MODULES.values(), *moved._NAMES.values()}))
def test_every_new_place_is_there(new: str) -> None:
    assert find_spec(f"xfreqbench.{new}") is not None


@pytest.mark.parametrize(("old", "name"), moved._NAMES)
def test_every_name_that_moved_alone_is_in_its_new_module(old: str, name: str) -> None:
    spec = find_spec(f"xfreqbench.{moved._NAMES[old, name]}")
    tree = ast.parse(Path(spec.origin).read_bytes())
    defined = {getattr(node, "name", getattr(node, "id", None)) for node in ast.walk(tree)}
    assert name in defined


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        (
            "from xfreqbench.method import Progress, fit_within",
            "xfreqbench.method.Progress is now in xfreqbench.methods.contract. "
            "xfreqbench.method.fit_within is now in xfreqbench.methods.fitting.",
        ),
        ("import xfreqbench.dataset", "xfreqbench.dataset is now in xfreqbench.data.dataset."),
        (
            "from xfreqbench.splatting.learned import (\n    LearnedMethod,\n)",
            "xfreqbench.splatting.learned.LearnedMethod is now in xfreqbench.methods.learning.training.",
        ),
        (
            "from xfreqbench.tracing import TraceSettings",
            "xfreqbench.tracing.TraceSettings is now in xfreqbench.tracing.tracer.",
        ),
        ("from xfreqbench import pas", "xfreqbench.pas is now in xfreqbench.maps.bartlett."),
    ],
)
def test_an_import_of_an_old_module_names_the_new_one(
    statement: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"old_plugin_{abs(hash(statement))}"
    (tmp_path / f"{name}.py").write_text(f"import math\n{statement}\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MethodError) as raised:
        resolve_method(f"{name}:Method")
    assert str(raised.value).endswith(words)


def test_a_method_asked_for_by_its_old_module_is_named_too() -> None:
    with pytest.raises(MethodError, match=r"is now in xfreqbench\.methods\.learning\.training"):
        resolve_method("xfreqbench.splatting.learned:LearnedMethod")


def test_an_import_that_never_worked_is_no_module_that_moved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_plugin.py").write_text("from no_such_library import method\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MethodError, match="Install it, or mend it or its name"):
        resolve_method("broken_plugin:Method")
