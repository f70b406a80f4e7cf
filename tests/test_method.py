from __future__ import annotations

import math
import time
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from synthetic import write_dataset

from xfreqbench.dataset import PasDataset
from xfreqbench.errors import MethodError, UnknownNameError
from xfreqbench.method import (
    TRIVIAL,
    Budget,
    Progress,
    build_method,
    fit_within,
    method_names,
    method_summaries,
    parse_budget,
    predict_checked,
    resolve_method,
)


@dataclass(frozen=True)
class EndlessConfig:
    pause_s: float = 0.0


class Endless:
    """Trains for ever and predicts `answer`."""

    num_parameters = 0
    answer: object = None

    def __init__(self, config=EndlessConfig()):
        self.config = config
        self.closed = False

    def fit(self, train, budget, seed):
        try:
            for step in range(1, 10**9):
                time.sleep(self.config.pause_s)
                yield Progress(step, 1 / step)
        finally:
            self.closed = True

    def predict(self, tx_position_m, carrier_hz):
        return self.answer

    def save(self, directory): ...

    @classmethod
    def load(cls, directory): ...


class Short(Endless):
    """Ends by itself after three steps."""

    def fit(self, train, budget, seed):
        for step in (1, 2, 3):
            yield Progress(step, math.nan)


class Silent(Endless):
    def fit(self, train, budget, seed):
        yield from ()


class Loose(Endless):
    def fit(self, train, budget, seed):
        yield 0.5


class Incomplete:
    def fit(self, train, budget, seed): ...


class WithoutConfig(Short):
    def __init__(self): ...


class WithoutDefault(Short):
    def __init__(self, config):
        self.config = config


class ConfiguredByADict(Short):
    def __init__(self, config=None):
        self.config = config or {"hidden": 1}


@pytest.fixture(scope="module")
def train(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=1, maps=False)


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
        "endless": f"{__name__}:Endless",
        "incomplete": f"{__name__}:Incomplete",
        "silent": f"{__name__}:Silent",
    }
    found = [EntryPoint(name, value, "xfreqbench.methods") for name, value in entries.items()]
    monkeypatch.setattr("xfreqbench.method.entry_points", lambda group: found)
    summaries = method_summaries()
    assert summaries["absent"] == "cannot be imported: No module named 'no_such_module'"
    assert summaries["endless"] == "Trains for ever and predicts `answer`."
    assert "lacks predict" in summaries["incomplete"]
    assert summaries["silent"] == ""  # it has no docstring


@pytest.mark.parametrize(
    ("text", "budget"),
    [
        (None, Budget()),
        ("300s", Budget(max_seconds=300)),
        ("0.5 m", Budget(max_seconds=30)),
        ("2h", Budget(max_seconds=7200)),
        ("2000steps", Budget(max_steps=2000)),
    ],
)
def test_a_budget_is_read_with_its_unit(text: str | None, budget: Budget) -> None:
    assert parse_budget(text) == budget


@pytest.mark.parametrize("text", ["", "300", "0s", "0steps", "0.2steps", "2.5steps", "-1s", "1d"])
def test_a_budget_without_a_unit_or_of_part_of_a_step_is_refused(text: str) -> None:
    with pytest.raises(MethodError, match="A budget is written as in 300s"):
        parse_budget(text)


def test_a_class_that_lacks_part_of_the_contract_is_told_which() -> None:
    with pytest.raises(MethodError, match="lacks predict, save, load"):
        resolve_method(f"{__name__}:Incomplete")


def test_a_function_is_no_method() -> None:
    with pytest.raises(MethodError, match="must be a class"):
        resolve_method(f"{__name__}:train")


def test_a_method_without_configuration_is_told_so() -> None:
    with pytest.raises(MethodError, match="has no config"):
        build_method(f"{__name__}:WithoutConfig")


def test_a_constructor_without_a_default_configuration_is_told_so() -> None:
    with pytest.raises(MethodError, match=r"cannot be constructed without arguments.*with a default"):
        build_method(f"{__name__}:WithoutDefault")


def test_a_configuration_that_is_no_dataclass_is_told_so() -> None:
    with pytest.raises(MethodError, match="must be an instance of a frozen dataclass"):
        build_method(f"{__name__}:ConfiguredByADict")


def test_options_reach_the_configuration() -> None:
    assert build_method("mean-over-frequency", ["num_nearest=3"]).config.num_nearest == 3


def test_the_budget_in_steps_is_kept_exactly_and_the_generator_closed(train: PasDataset) -> None:
    method = Endless()
    fit = fit_within(method, train, Budget(max_steps=5), seed=0)
    assert (fit.step, fit.loss) == (5, 0.2)
    assert method.closed


def test_the_budget_in_seconds_ends_training_with_the_step_that_crosses_it(train: PasDataset) -> None:
    method = Endless(EndlessConfig(pause_s=0.02))
    fit = fit_within(method, train, Budget(max_seconds=0.05), seed=0)
    assert fit.seconds >= 0.05
    assert fit.step <= 3  # each takes 0.02 s or more
    assert method.closed


def test_without_a_budget_the_method_ends_itself(train: PasDataset) -> None:
    assert fit_within(Short(), train, Budget(), seed=0).step == 3


def test_a_fit_that_yields_nothing_breaks_the_contract(train: PasDataset) -> None:
    with pytest.raises(MethodError, match=r"Silent\.fit yielded nothing"):
        fit_within(Silent(), train, Budget(), seed=0)


def test_a_fit_that_yields_something_else_breaks_the_contract(train: PasDataset) -> None:
    with pytest.raises(MethodError, match=r"Loose\.fit yielded 0\.5"):
        fit_within(Loose(), train, Budget(), seed=0)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (None, "NoneType; it must be a NumPy array"),
        (np.zeros((2, 90, 361), np.float32), "for 2 transmitters it must be"),
        (np.zeros((2, 90, 360)), "dtype float64"),
        (np.full((2, 90, 360), np.nan, np.float32), "not finite"),
        (np.full((2, 90, 360), 1.01, np.float32), "from 1.01 to 1.01"),
        (np.full((2, 90, 360), -0.01, np.float32), "from -0.01"),
    ],
)
def test_predictions_that_break_the_contract_are_described(answer: object, words: str) -> None:
    method = Endless()
    method.answer = answer
    with pytest.raises(MethodError, match=f"Endless.predict returned .*{words}"):
        predict_checked(method, np.zeros((2, 3)), np.full(2, 1e9), (90, 360))


def test_good_predictions_pass_unchanged() -> None:
    method = Endless()
    method.answer = np.ones((2, 90, 360), np.float32)
    assert predict_checked(method, np.zeros((2, 3)), np.full(2, 1e9), (90, 360)) is method.answer
