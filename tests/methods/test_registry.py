from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from xfreqbench.errors import MethodError, UnknownNameError
from xfreqbench.methods.contract import TRIVIAL
from xfreqbench.methods.registry import (
    build_method,
    code_sha256,
    method_names,
    method_summaries,
    resolve_method,
)
from xfreqbench.system import source


def test_the_trivial_predictors_are_installed() -> None:
    assert set(TRIVIAL) <= set(method_names())
    for name in TRIVIAL:
        assert build_method(name).num_parameters == 0


def test_an_unknown_method_names_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'nearest'"):
        resolve_method("nearst")


def test_a_method_is_found_as_module_and_class() -> None:
    assert resolve_method("xfreqbench.baselines.nearest:Nearest") is resolve_method("nearest")


@pytest.mark.parametrize("name", ["no_such_module:Method", "xfreqbench.baselines.nearest:Absent", ":Nearest"])
def test_a_method_that_cannot_be_imported_says_so(name: str) -> None:
    with pytest.raises(MethodError, match="cannot be imported"):
        resolve_method(name)


@pytest.mark.parametrize(
    ("code", "error"), [("class Method(:", "SyntaxError"), ("{}['a']", "KeyError: 'a'"), ("1 / 0", "ZeroDiv")]
)
def test_a_module_that_fails_while_it_is_imported_says_how(
    code: str, error: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_method.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MethodError, match=f"cannot be imported: {error}"):
        resolve_method("broken_method:Method")


def test_a_broken_plugin_does_not_hide_the_other_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = {
        "absent": "no_such_module:Method",
        "endless": "stub_methods:Endless",
        "incomplete": "stub_methods:Incomplete",
        "silent": "stub_methods:Silent",
    }
    found = [EntryPoint(name, value, "xfreqbench.methods") for name, value in entries.items()]
    monkeypatch.setattr("xfreqbench.methods.registry.entry_points", lambda group: found)
    summaries = method_summaries()
    assert summaries["absent"] == "cannot be imported: No module named 'no_such_module'"
    assert summaries["endless"] == "Trains for ever and predicts `answer`."
    assert "lacks predict" in summaries["incomplete"]
    assert summaries["silent"] == ""  # it has no docstring


def test_a_class_that_lacks_part_of_the_contract_is_told_which() -> None:
    with pytest.raises(MethodError, match="lacks predict, save, load"):
        resolve_method("stub_methods:Incomplete")


def test_a_function_is_no_method() -> None:
    with pytest.raises(MethodError, match="must be a class"):
        resolve_method("synthetic:write_dataset")


def test_a_method_without_configuration_is_told_so() -> None:
    with pytest.raises(MethodError, match="has no config"):
        build_method("stub_methods:WithoutConfig")


def test_a_constructor_without_a_default_configuration_is_told_so() -> None:
    with pytest.raises(MethodError, match=r"cannot be constructed without arguments.*with a default"):
        build_method("stub_methods:WithoutDefault")


def test_a_configuration_that_is_no_dataclass_is_told_so() -> None:
    with pytest.raises(MethodError, match="must be an instance of a frozen dataclass"):
        build_method("stub_methods:ConfiguredByADict")


def test_options_reach_the_configuration() -> None:
    assert build_method("mean-over-frequency", ["num_nearest=3"]).config.num_nearest == 3


def test_the_hash_of_a_methods_code_covers_the_modules_of_ours_that_it_can_reach(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = "xfreqbench.maps.metrics"
    files, at = {name: source._file(name) for name in [changed]}, source._file
    (tmp_path / "metrics.py").write_bytes(files[changed].read_bytes() + b"# changed")
    methods = {name: build_method(name) for name in ("aperture-gs", "nearest")}
    before = {name: code_sha256(method) for name, method in methods.items()}
    source._known.clear()
    monkeypatch.setattr(
        source, "_file", lambda name: tmp_path / "metrics.py" if name == changed else at(name)
    )
    now = {name: code_sha256(method) for name, method in methods.items()}
    source._known.clear()
    assert now["aperture-gs"] != before["aperture-gs"]  # its loss is made of metrics
    assert now["nearest"] == before["nearest"]


def test_a_method_from_elsewhere_is_hashed_with_the_modules_that_it_imports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "beside_own.py").write_text("LEVEL = 1\n")
    (tmp_path / "own_method.py").write_text(
        "from stub_methods import Short\n\n\nclass Own(Short):\n    def predict(self, tx_position_m, carrier_hz):\n"
        "        import beside_own\n\n        return beside_own.LEVEL\n"
    )
    method = build_method("own_method:Own")
    before = code_sha256(method)
    (tmp_path / "unrelated.py").write_text("LEVEL = 1\n")
    assert code_sha256(method) == before
    (tmp_path / "beside_own.py").write_text("LEVEL = 2\n")
    assert code_sha256(method) != before
