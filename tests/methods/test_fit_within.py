from __future__ import annotations

import math
import sys
import time

import numpy as np
import pytest

from tests.support.clock import Clock, set_clock
from tests.support.stub_methods import Endless, Short
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DivergenceError, MethodError
from xfreqbench.methods import fitting
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.fitting import Fit, checked_num_parameters, fit_within, predict_checked


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return set_clock(monkeypatch, fitting, sys.modules[__name__])


class Resumed(Endless):
    """Goes on after `step`, a second each."""

    step = 0

    def fit(self, train, budget, seed):
        try:
            while True:
                time.sleep(1)
                self.step += 1
                yield Progress(self.step, 1 / self.step, {"maps": 16 * self.step})
        finally:
            self.closed = True


@pytest.mark.parametrize(
    ("budget", "step", "share"),
    [(Budget(max_steps=5), 5, 1), (Budget(max_seconds=4.5), 5, 5 / 4.5), (Budget(max_maps=40), 3, 48 / 40)],
)
def test_a_budget_ends_training_with_the_step_that_reaches_it(
    dataset: PasDataset, clock: Clock, budget: Budget, step: int, share: float
) -> None:
    method = Resumed()
    fit = fit_within(method, dataset, budget, seed=0)
    assert fit == Fit(step, 1 / step, float(step), share, {"maps": 16 * step})
    assert (fit.maps, method.closed) == (16 * step, True)
    assert fit_within(method, dataset, budget, seed=0, spent=fit) is fit


class Told(Endless):
    """Remembers the shares of the budget that it is told."""

    def fit(self, train, budget, seed):
        self.shares = []
        for step in range(1, 9):
            time.sleep(1)
            self.shares.append((yield Progress(step, math.nan)))


@pytest.mark.parametrize(
    ("budget", "shares"),
    [
        (Budget(max_steps=4), [0.25, 0.5, 0.75]),  # at the fourth it is over
        (Budget(max_seconds=10), [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]),
        (Budget(), [0.0] * 8),
    ],
)
def test_a_method_is_told_the_spent_share_of_its_budget(
    dataset: PasDataset, clock: Clock, budget: Budget, shares: list[float]
) -> None:
    method = Told()
    assert fit_within(method, dataset, budget, seed=0).share == (1 if budget.max_steps else shares[-1])
    assert method.shares == shares


class Plain(Endless):
    """Its `fit` is no generator, but a plain iterator."""

    def fit(self, train, budget, seed):
        return iter([Progress(1, 1.0), Progress(2, 0.5)])


class Delegating(Endless):
    """A generator that leaves its yields to an iterator that takes no share."""

    def fit(self, train, budget, seed):
        yield from map(Progress, (1, 2, 3), (1.0, 0.5, 0.25))


@pytest.mark.parametrize(("method", "step"), [(Plain(), 2), (Delegating(), 3)])
def test_an_iterator_that_takes_no_share_is_a_fit_too(dataset: PasDataset, method: Endless, step: int) -> None:
    assert fit_within(method, dataset, Budget(max_steps=100), seed=0).step == step


def test_an_observer_sees_every_step_and_its_time_is_not_charged(dataset: PasDataset, clock: Clock) -> None:
    seen = []

    def observe(before, now):
        clock.sleep(1)
        seen.append((before and before.step, now.step))

    fit = fit_within(Short(), dataset, Budget(), seed=0, observe=observe)
    assert seen == [(None, 1), (1, 2), (2, 3)]
    assert fit.seconds == 0


class Untidy(Short):
    """Takes its time when it is closed."""

    def fit(self, train, budget, seed):
        try:
            yield from super().fit(train, budget, seed)
        finally:
            time.sleep(1)


def test_the_cleanup_of_a_method_is_charged(dataset: PasDataset, clock: Clock) -> None:
    assert fit_within(Untidy(), dataset, Budget(max_steps=1), seed=0).seconds == 1


@pytest.mark.parametrize(("loaded", "first", "seconds"), [(5, 6, 105), (0, 1, 10)], ids=["goes on", "starts anew"])
def test_a_fit_that_goes_on_spends_the_rest_and_one_that_starts_anew_all_of_its_budget(
    dataset: PasDataset, clock: Clock, loaded: int, first: int, seconds: float
) -> None:
    method, seen, spent = Resumed(), [], Fit(step=5, loss=1.0, seconds=100.0, share=0.5)
    method.step = loaded
    fit = fit_within(method, dataset, Budget(max_steps=10), 0, spent=spent, observe=lambda *change: seen.append(change))
    assert seen[0][0] == (spent if loaded else None)
    assert [now.step for _, now in seen] == [*range(first, 11)]
    assert fit.seconds == seconds


class Losing(Endless):
    """Yields the losses it is given."""

    losses: tuple[float, ...] = ()

    def fit(self, train, budget, seed):
        yield from map(Progress, range(1, 9), self.losses)


@pytest.mark.parametrize(
    ("losses", "step"),
    [((1.0, math.inf), 2), ((-math.inf,), 1), ((math.nan, 1.0, math.nan), 3), ((1.0, math.nan, 1.0), 2)],
)
def test_a_loss_that_is_no_longer_finite_is_a_divergence(
    dataset: PasDataset, losses: tuple[float, ...], step: int
) -> None:
    method = Losing()
    method.losses = losses
    with pytest.raises(DivergenceError, match=f"loss is not finite at step {step}") as raised:
        fit_within(method, dataset, Budget(), seed=0)
    assert (raised.value.step, raised.value.tensor) == (step, "loss")
    method.losses = (math.nan, math.nan, 0.5)  # it has none at first
    assert fit_within(method, dataset, Budget(), seed=0).step == 3


class Yielding(Endless):
    """Yields what it is given."""

    def __init__(self, *yields: object) -> None:
        super().__init__()
        self.yields = yields

    def fit(self, train, budget, seed):
        yield from self.yields


@pytest.mark.parametrize(
    ("method", "words"),
    [
        (Yielding(), r"Yielding\.fit yielded nothing"),
        (Yielding(0.5), r"Yielding\.fit yielded 0\.5;"),
        (Yielding(Progress(1, 1.0, {"\udcff": 1.0})), r"Yielding\.fit yielded the count"),  # whose name is no text
        (Endless(), r"64000 maps, but Endless\.fit does not tell"),
    ],
)
def test_a_fit_that_breaks_the_contract_is_told_how(dataset: PasDataset, method: Endless, words: str) -> None:
    with pytest.raises(MethodError, match=words):
        fit_within(method, dataset, Budget(max_maps=64_000), seed=0)


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


@pytest.mark.parametrize("count", [math.nan, "many", -1, True, None, 2.0, 10**400])
def test_a_number_of_parameters_that_is_no_count_breaks_the_contract(count: object) -> None:
    method = Endless()
    method.num_parameters = count  # type: ignore[assignment]
    with pytest.raises(MethodError, match=r"Endless\.num_parameters is "):
        checked_num_parameters(method)
