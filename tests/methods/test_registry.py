from __future__ import annotations

import sys
from dataclasses import fields
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from tests.support.packages import install
from xfreqbench.errors import MethodError, UnknownNameError
from xfreqbench.methods.registry import (
    build_method,
    code_sha256,
    device_option,
    method_description,
    method_names,
    method_summaries,
    resolve_method,
)
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.system import source


def test_the_trivial_predictors_are_installed() -> None:
    assert set(EVERY_TRIVIAL) <= set(method_names())
    for name in EVERY_TRIVIAL:
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


def test_methods_are_listed_without_the_code_of_a_plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "theirs.py").write_text("raise SystemExit(0)")
    install(tmp_path, "their-package", "xfreqbench.methods", theirs="theirs:Method")
    monkeypatch.syspath_prepend(tmp_path)
    summaries = method_summaries()
    assert summaries["theirs"] == "plug-in, from their-package"
    assert summaries["nearest"].startswith("Copies the map of the nearest transmitter")
    assert "theirs" not in sys.modules
    with pytest.raises(MethodError, match="'theirs' cannot be imported: SystemExit: 0"):
        method_description("theirs")


def test_a_plugin_cannot_take_the_name_of_another_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "their-package", "xfreqbench.methods", nearest="theirs:Method")
    monkeypatch.syspath_prepend(tmp_path)
    assert method_names().count("nearest") == 1
    with pytest.raises(MethodError, match="Several packages offer a method 'nearest'"):
        resolve_method("nearest")


def test_a_method_is_described_with_its_options_and_no_other_is_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [EntryPoint("absent", "no_such_module:Method", "xfreqbench.methods")]
    found.append(EntryPoint("endless", "tests.support.stub_methods:Endless", "xfreqbench.methods"))
    monkeypatch.setattr("xfreqbench.methods.registry.entry_points", lambda group: found)
    assert method_summaries() == {"absent": "plug-in", "endless": "plug-in"}
    told, options = method_description("endless")
    assert told == "Trains for ever and predicts `answer`."
    assert options == [("pause_s", "0.0", "number", "")]


@pytest.mark.parametrize("name", method_names())
def test_every_option_of_a_built_in_method_has_a_meaning(name: str) -> None:
    _, options = method_description(name)
    named = [option.name for option in options if option.name != "aided"]
    assert named == [option.name for option in fields(build_method(name).config)]
    assert not [option.name for option in options if not option.meaning]


@pytest.mark.parametrize(
    "code",
    [
        "raise SystemExit(0)",
        "raise GeneratorExit",
        "class Method:\n    def __init__(self, config=None): raise SystemExit(0)",
        "class Method(Short):\n    @property\n    def num_parameters(self): raise SystemExit(0)",
        "class Method(Short):\n    num_parameters = property(lambda self: 1 / 0)",
    ],
)
def test_a_method_that_ends_the_process_before_its_fit_is_an_error(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if code.startswith("class Method:"):
        code += "\n    fit = predict = save = load = None"
    (tmp_path / "leaving_method.py").write_text(f"from tests.support.stub_methods import Short\n{code}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "leaving_method", raising=False)
    with pytest.raises(MethodError, match=r"'leaving_method:Method' (cannot be|failed in num_parameters)"):
        build_method("leaving_method:Method")


def test_a_configuration_that_ends_the_process_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "leaving_config.py").write_text(
        "from dataclasses import dataclass\nfrom tests.support.stub_methods import Short\n\n\n@dataclass(frozen=True)\n"
        "class Config:\n    width: int = 1\n\n    def __post_init__(self):\n        if self.width > 1:\n"
        "            raise SystemExit(0)\n\n\nclass Method(Short):\n    def __init__(self, config=Config()):\n"
        "        self.config = config\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MethodError, match="cannot be configured with width=2: SystemExit: 0"):
        build_method("leaving_config:Method", ["width=2"])


def test_an_interruption_while_a_method_is_imported_stays_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "interrupted_method.py").write_text("raise KeyboardInterrupt")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        resolve_method("interrupted_method:Method")


def test_a_class_that_lacks_part_of_the_contract_is_told_which() -> None:
    with pytest.raises(MethodError, match="lacks predict, save, load"):
        resolve_method("tests.support.stub_methods:Incomplete")


def test_a_function_is_no_method() -> None:
    with pytest.raises(MethodError, match="must be a class"):
        resolve_method("tests.support.synthetic:write_dataset")


def test_a_method_without_configuration_is_told_so() -> None:
    with pytest.raises(MethodError, match="has no config"):
        build_method("tests.support.stub_methods:WithoutConfig")


def test_a_constructor_without_a_default_configuration_is_told_so() -> None:
    with pytest.raises(MethodError, match=r"cannot be constructed without arguments.*with a default"):
        build_method("tests.support.stub_methods:WithoutDefault")


def test_a_configuration_that_is_no_dataclass_is_told_so() -> None:
    with pytest.raises(MethodError, match="must be an instance of a frozen dataclass"):
        build_method("tests.support.stub_methods:ConfiguredByADict")


def test_a_device_is_given_to_methods_that_have_the_choice() -> None:
    assert device_option("xfreq-gs", "cuda") == ("device=cuda",)
    assert device_option("virtual-source", "cuda") == device_option("nearest", "cuda") == ()
    assert device_option("xfreq-gs", "cpu") == ()


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
    monkeypatch.setattr(source, "_file", lambda name: tmp_path / "metrics.py" if name == changed else at(name))
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
        "from tests.support.stub_methods import Short\n\n\n"
        "class Own(Short):\n    def predict(self, tx_position_m, carrier_hz):\n"
        "        import beside_own\n\n        return beside_own.LEVEL\n"
    )
    method = build_method("own_method:Own")
    before = code_sha256(method)
    (tmp_path / "unrelated.py").write_text("LEVEL = 1\n")
    assert code_sha256(method) == before
    (tmp_path / "beside_own.py").write_text("LEVEL = 2\n")
    assert code_sha256(method) != before
