from __future__ import annotations

import math

import numpy as np
import pytest

from tests.support import stub_methods
from tests.support.clock import Clock, set_clock
from tests.support.stub_methods import (
    Delegating,
    Endless,
    EndlessConfig,
    Loose,
    Losing,
    Plain,
    Resumed,
    Short,
    Silent,
    Told,
    Untidy,
)
from tests.support.synthetic import write_dataset
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DivergenceError, MethodError
from xfreqbench.methods import fitting
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.fitting import Fit, checked_num_parameters, fit_within, predict_checked


@pytest.fixture(scope="module")
def train(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=1, maps=False)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return set_clock(monkeypatch, fitting, stub_methods)


def test_the_budget_in_steps_is_kept_exactly_and_the_generator_closed(train: PasDataset) -> None:
    method = Endless()
    fit = fit_within(method, train, Budget(max_steps=5), seed=0)
    assert (fit.step, fit.loss) == (5, 0.2)
    assert method.closed


def test_the_budget_in_seconds_ends_training_with_the_step_that_crosses_it(train: PasDataset, clock: Clock) -> None:
    method = Endless(EndlessConfig(pause_s=2))
    fit = fit_within(method, train, Budget(max_seconds=5), seed=0)
    assert (fit.step, fit.seconds, fit.share) == (3, 6, 6 / 5)
    assert method.closed


def test_a_method_is_told_the_spent_share_of_its_budget(train: PasDataset) -> None:
    method = Told()
    fit = fit_within(method, train, Budget(max_steps=4), seed=0)
    assert method.shares == [0.25, 0.5, 0.75]  # at the fourth it is over
    assert fit.share == 1
    fit_within(method, train, Budget(), seed=0)
    assert method.shares == [0.0] * 8


def test_a_method_is_told_the_share_of_its_time(train: PasDataset, clock: Clock) -> None:
    method = Told(EndlessConfig(pause_s=1))
    fit_within(method, train, Budget(max_seconds=10), seed=0)
    assert method.shares == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]


@pytest.mark.parametrize(("method", "step"), [(Plain(), 2), (Delegating(), 3)])
def test_an_iterator_that_takes_no_share_is_a_fit_too(train: PasDataset, method: Endless, step: int) -> None:
    assert fit_within(method, train, Budget(max_steps=100), seed=0).step == step


def test_the_last_counts_are_those_of_the_fit(train: PasDataset) -> None:
    fit = fit_within(Resumed(), train, Budget(max_steps=3), seed=0)
    assert fit.counts == {"gaussians": 30}


def test_an_observer_sees_every_step_and_its_time_is_not_charged(train: PasDataset, clock: Clock) -> None:
    seen = []

    def observe(before, now):
        clock.sleep(1)
        seen.append((before and before.step, now.step))

    fit = fit_within(Short(), train, Budget(), seed=0, observe=observe)
    assert seen == [(None, 1), (1, 2), (2, 3)]
    assert fit.seconds == 0


def test_the_cleanup_of_a_method_is_charged(train: PasDataset, clock: Clock) -> None:
    assert fit_within(Untidy(EndlessConfig(pause_s=1)), train, Budget(max_steps=1), seed=0).seconds == 1


def test_a_fit_that_goes_on_spends_what_is_left_of_its_budget(train: PasDataset, clock: Clock) -> None:
    method, seen = Resumed(EndlessConfig(pause_s=1)), []
    method.step = 5
    spent = Fit(step=5, loss=1.0, seconds=100.0, share=0.5)
    fit = fit_within(
        method, train, Budget(max_steps=10), seed=0, spent=spent, observe=lambda *change: seen.append(change)
    )
    assert seen[0][0] == spent
    assert [now.step for _, now in seen] == [6, 7, 8, 9, 10]
    assert fit.seconds == 100 + 5


def test_a_fit_whose_budget_is_spent_takes_no_step(train: PasDataset) -> None:
    spent = Fit(step=5, loss=1.0, seconds=100.0, share=1.0)
    for budget in (Budget(max_steps=5), Budget(max_seconds=100)):
        assert fit_within(Silent(), train, budget, seed=0, spent=spent) is spent


def test_a_method_that_starts_anew_is_not_charged_for_what_was_lost(train: PasDataset, clock: Clock) -> None:
    seen, spent = [], Fit(step=5, loss=1.0, seconds=100.0)
    method = Resumed(EndlessConfig(pause_s=1))
    fit = fit_within(method, train, Budget(max_steps=7), 0, spent=spent, observe=lambda *change: seen.append(change))
    assert seen[0][0] is None
    assert [now.step for _, now in seen] == [1, 2, 3, 4, 5, 6, 7]
    assert fit.seconds == 7


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
    method.losses = (math.nan, math.nan, 0.5)  # it has none at first
    assert fit_within(method, train, Budget(), seed=0).step == 3


class Counting(Endless):
    def fit(self, train, budget, seed):
        yield Progress(1, 1.0, {"\udcff": 1.0})


@pytest.mark.parametrize(
    ("method", "words"),
    [
        (Silent(), r"Silent\.fit yielded nothing"),
        (Loose(), r"Loose\.fit yielded 0\.5;"),
        (Counting(), r"Counting\.fit yielded the count"),  # whose name is no text
        (Endless(), r"64000 maps, but Endless\.fit does not tell"),
    ],
)
def test_a_fit_that_breaks_the_contract_is_told_how(train: PasDataset, method: Endless, words: str) -> None:
    with pytest.raises(MethodError, match=words):
        fit_within(method, train, Budget(max_maps=64_000), seed=0)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (None, "NoneType; it must be a NumPy array"),
        (np.ma.masked_less(np.ones((2, 90, 360), np.float32), 0), "MaskedArray; it must be a NumPy array"),
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


class Mapping16(Endless):
    def fit(self, train, budget, seed):
        for step in range(1, 100):
            yield Progress(step, 1.0, {"maps": 16 * step})


def test_a_budget_in_maps_ends_with_the_step_that_reaches_it(train: PasDataset) -> None:
    fit = fit_within(Mapping16(), train, Budget(max_maps=40), seed=0)
    assert (fit.step, fit.maps, fit.share) == (3, 48, 48 / 40)
    assert fit_within(Mapping16(), train, Budget(max_maps=40), seed=0, spent=fit) is fit


@pytest.mark.parametrize("count", [math.nan, "many", -1, True, None, 2.0, 10**400])
def test_a_number_of_parameters_that_is_no_count_breaks_the_contract(count: object) -> None:
    method = Endless()
    method.num_parameters = count  # type: ignore[assignment]
    with pytest.raises(MethodError, match=r"Endless\.num_parameters is "):
        checked_num_parameters(method)
