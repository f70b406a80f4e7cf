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
from xfreqbench.errors import DivergenceError, MethodError, UnknownNameError
from xfreqbench.method import (
    TRIVIAL,
    Budget,
    Fit,
    Progress,
    build_method,
    code_sha256,
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


class Told(Endless):
    """Remembers the shares of the budget that it is told."""

    def fit(self, train, budget, seed):
        self.shares = []
        for step in range(1, 9):
            self.shares.append((yield Progress(step, math.nan)))


class Plain(Endless):
    """Its `fit` is no generator, but a plain iterator."""

    def fit(self, train, budget, seed):
        return iter([Progress(1, 1.0), Progress(2, 0.5)])


class Delegating(Endless):
    """A generator that leaves its yields to an iterator that takes no share."""

    def fit(self, train, budget, seed):
        yield from self.steps()

    def steps(self):
        yield from map(Progress, (1, 2, 3), (1.0, 0.5, 0.25))


class Losing(Endless):
    """Yields the losses it is given."""

    losses: tuple[float, ...] = ()

    def fit(self, train, budget, seed):
        for step, loss in enumerate(self.losses, start=1):
            yield Progress(step, loss)


class Untidy(Short):
    """Takes its time when it is closed."""

    def fit(self, train, budget, seed):
        try:
            yield from super().fit(train, budget, seed)
        finally:
            time.sleep(0.05)


class Resumed(Endless):
    """Goes on after `step`."""

    step = 0

    def fit(self, train, budget, seed):
        while True:
            self.step += 1
            yield Progress(self.step, 1.0, {"gaussians": 10 * self.step})


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


@pytest.mark.parametrize(
    ("budget", "share"),
    [
        (Budget(), 0.0),
        (Budget(max_steps=8), 0.25),
        (Budget(max_seconds=4), 0.75),
        (Budget(max_steps=8, max_seconds=4), 0.75),
    ],
)
def test_the_nearer_limit_says_how_much_of_a_budget_is_spent(budget: Budget, share: float) -> None:
    assert budget.share(step=2, seconds=3.0) == share


def test_a_method_is_told_the_spent_share_of_its_budget(train: PasDataset) -> None:
    method = Told()
    fit = fit_within(method, train, Budget(max_steps=4), seed=0)
    assert method.shares == [0.25, 0.5, 0.75]  # at the fourth it is over
    assert fit.share == 1
    fit_within(method, train, Budget(), seed=0)
    assert method.shares == [0.0] * 8


def test_a_method_is_told_the_share_of_its_time(train: PasDataset) -> None:
    method = Told()
    fit_within(method, train, Budget(max_seconds=3600), seed=0)
    assert 0 < method.shares[0] < method.shares[-1] < 0.01  # eight steps of nothing


@pytest.mark.parametrize(("method", "step"), [(Plain(), 2), (Delegating(), 3)])
def test_an_iterator_that_takes_no_share_is_a_fit_too(train: PasDataset, method: Endless, step: int) -> None:
    assert fit_within(method, train, Budget(max_steps=100), seed=0).step == step


def test_the_last_counts_are_those_of_the_fit(train: PasDataset) -> None:
    fit = fit_within(Resumed(), train, Budget(max_steps=3), seed=0)
    assert fit.counts == {"gaussians": 30}


def test_an_observer_sees_every_step_and_its_time_is_not_charged(train: PasDataset) -> None:
    seen = []

    def observe(before, now):
        time.sleep(0.05)
        seen.append((before and before.step, now.step))

    fit = fit_within(Short(), train, Budget(), seed=0, observe=observe)
    assert seen == [(None, 1), (1, 2), (2, 3)]
    assert fit.seconds < 0.05  # one of the three pauses alone


def test_the_cleanup_of_a_method_is_charged(train: PasDataset) -> None:
    assert fit_within(Untidy(), train, Budget(max_steps=1), seed=0).seconds >= 0.05


def test_a_fit_that_goes_on_spends_what_is_left_of_its_budget(train: PasDataset) -> None:
    method, seen = Resumed(), []
    method.step = 5
    spent = Fit(step=5, loss=1.0, seconds=100.0, share=0.5)
    fit = fit_within(
        method, train, Budget(max_steps=10), seed=0, spent=spent, observe=lambda *change: seen.append(change)
    )
    assert seen[0][0] == spent
    assert [now.step for _, now in seen] == [6, 7, 8, 9, 10]
    assert 100 < fit.seconds < 110  # five steps of nothing


def test_a_fit_whose_budget_is_spent_takes_no_step(train: PasDataset) -> None:
    spent = Fit(step=5, loss=1.0, seconds=100.0, share=1.0)
    for budget in (Budget(max_steps=5), Budget(max_seconds=100)):
        assert fit_within(Silent(), train, budget, seed=0, spent=spent) is spent


def test_a_method_that_starts_anew_is_not_charged_for_what_was_lost(train: PasDataset) -> None:
    seen, spent = [], Fit(step=5, loss=1.0, seconds=100.0)
    fit = fit_within(
        Resumed(), train, Budget(max_steps=7), 0, spent=spent, observe=lambda *change: seen.append(change)
    )
    assert seen[0][0] is None
    assert [now.step for _, now in seen] == [1, 2, 3, 4, 5, 6, 7]
    assert fit.seconds < 10  # seven steps of nothing, and not the 100 s before


@pytest.mark.parametrize(
    ("losses", "step"),
    [((1.0, math.inf), 2), ((-math.inf,), 1), ((math.nan, 1.0, math.nan), 3), ((1.0, math.nan, 1.0), 2)],
)
def test_a_loss_that_is_no_longer_finite_is_a_divergence(
    train: PasDataset, losses: tuple[float, ...], step: int
) -> None:
    method = Losing()
    method.losses = losses
    with pytest.raises(DivergenceError, match=f"loss is not finite at step {step}") as raised:
        fit_within(method, train, Budget(), seed=0)
    assert (raised.value.step, raised.value.tensor) == (step, "loss")


def test_a_method_without_a_loss_does_not_diverge(train: PasDataset) -> None:
    method = Losing()
    method.losses = (math.nan, math.nan, 0.5)
    assert fit_within(method, train, Budget(), seed=0).step == 3


SHARED = ("splatting", "virtual_source")


def test_code_that_methods_share_without_inheriting_it_is_part_of_their_hash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared = [b"a"]
    monkeypatch.setattr("xfreqbench.method._shared_sources", lambda package: [package.encode(), *shared])
    monkeypatch.syspath_prepend(tmp_path)
    text = "from test_method import Short\n\nclass Own(Short):\n    # {}\n    pass\n"
    hashes = {}
    texts = {"alone": "Alone.", **{package: f"Builds on xfreqbench.{package}." for package in SHARED}}
    for name, words in texts.items():
        (tmp_path / f"own_{name}.py").write_text(text.format(words))
        method = build_method(f"own_{name}:Own")
        before, shared[0] = code_sha256(method), shared[0] + b"a"
        hashes[name] = code_sha256(method) == before
    assert hashes == {"alone": True, **dict.fromkeys(SHARED, False)}


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
