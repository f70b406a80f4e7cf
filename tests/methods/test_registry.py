from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import fields
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from tests.support.packages import install
from xfreqbench.errors import MethodError, OutOfMemoryError
from xfreqbench.methods.registry import build_method, method_description, method_names, method_summaries, resolve_method


def test_a_method_is_found_as_module_and_class() -> None:
    assert resolve_method("xfreqbench.baselines.nearest:Nearest") is resolve_method("nearest")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no_such_module:Method", "cannot be imported"),
        ("xfreqbench.baselines.nearest:Absent", "cannot be imported"),
        (":Nearest", "cannot be imported"),
        ("tests.support.synthetic:write_dataset", "must be a class"),
    ],
)
def test_what_is_no_method_is_refused(name: str, words: str) -> None:
    with pytest.raises(MethodError, match=words):
        build_method(name)


@pytest.fixture
def own_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Writes a module with the code of a method, and gives its name."""
    monkeypatch.syspath_prepend(tmp_path)

    def write(code: str) -> str:
        name = f"{tmp_path.name}_own"  # modules stay imported
        (tmp_path / f"{name}.py").write_text(f"from tests.support.stub_methods import Short\n{code}\n")
        return name

    return write


OF_CONTRACT = "fit = predict = save = load = None"
CONFIGURED = "class Method(Short):\n    def __init__(self"


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("class Method(:", "cannot be imported: SyntaxError"),
        ("{}['a']", "cannot be imported: KeyError: 'a'"),
        ("raise SystemExit(0)", "cannot be imported: SystemExit: 0"),
        ("raise GeneratorExit", "cannot be imported: GeneratorExit"),
        (
            f"class Method:\n    {OF_CONTRACT}\n    def __init__(self, config=None): raise SystemExit(0)",
            "cannot be constructed without arguments: SystemExit: 0",
        ),
        (
            "class Method(Short):\n    @property\n    def num_parameters(self): raise SystemExit(0)",
            "failed in num_parameters: SystemExit: 0",
        ),
        (
            "class Method(Short):\n    num_parameters = property(lambda self: 1 / 0)",
            "failed in num_parameters: ZeroDivisionError",
        ),
        ("class Method:\n    def fit(self, train, budget, seed): ...", "lacks predict, save, load"),
        (f"{CONFIGURED}): ...", "has no config"),
        (f"{CONFIGURED}, config): self.config = config", "cannot be constructed without arguments.*with a default"),
        (f"{CONFIGURED}, config=0): self.config = {{}}", "must be an instance of a frozen dataclass"),
    ],
)
def test_a_method_that_fails_lacks_a_part_or_ends_the_process_before_its_fit_is_an_error(
    code: str, words: str, own_module: Callable[[str], str]
) -> None:
    with pytest.raises(MethodError, match=words):
        build_method(f"{own_module(code)}:Method")


def test_a_configuration_that_ends_the_process_is_an_error(own_module: Callable[[str], str]) -> None:
    code = """from dataclasses import dataclass

@dataclass(frozen=True)
class Config:
    width: int = 1
    def __post_init__(self):
        if self.width > 1:
            raise SystemExit(0)

class Method(Short):
    def __init__(self, config=Config()):
        self.config = config
"""
    with pytest.raises(MethodError, match="cannot be configured with width=2: SystemExit: 0"):
        build_method(f"{own_module(code)}:Method", ["width=2"])


def test_an_interruption_while_a_method_is_imported_stays_one(own_module: Callable[[str], str]) -> None:
    with pytest.raises(KeyboardInterrupt):
        resolve_method(f"{own_module('raise KeyboardInterrupt')}:Method")


@pytest.mark.parametrize("raised", ["MemoryError", "ImportError('libtorch.so: cannot allocate memory')"])
def test_a_method_that_lacks_memory_is_not_to_be_installed(raised: str, own_module: Callable[[str], str]) -> None:
    with pytest.raises(OutOfMemoryError, match=r"cannot be imported: .* Memory ran out. [\d,]+ MiB are left.") as found:
        resolve_method(f"{own_module(f'raise {raised}')}:Method")
    assert "Install" not in str(found.value)


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
