"""Dividing and pruning Gaussians between two steps of an optimiser."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from xfreqbench.methods.splatting.density import DensityConfig, DensityControl
from xfreqbench.methods.splatting.gaussians import RFGaussians

NUM_GAUSSIANS = 20
EVERY = 4
RATE = 0.01


class Training:
    """Gaussians pulled in proportion to a weight each, with signals of a magnitude each."""

    def __init__(self, **options: float) -> None:
        generator = torch.Generator().manual_seed(0)
        self.gaussians = RFGaussians(NUM_GAUSSIANS)
        with torch.no_grad():
            for parameter in self.gaussians.parameters():
                parameter.copy_(torch.randn(parameter.shape, generator=generator))
        self.optimizer = torch.optim.Adam(self.gaussians.parameters(), lr=RATE, fused=True)
        self.control = DensityControl(DensityConfig(**{"densify_every": EVERY, **options}))
        self.step = 0

    def run(self, num_steps: int, magnitude: Tensor, pull: Tensor, share: float = 0.0) -> None:
        for _ in range(num_steps):
            seen = magnitude > 0
            signal = magnitude[seen][None, :, None].to(torch.complex64).requires_grad_()
            self.optimizer.zero_grad(set_to_none=True)
            self.control.watch(seen, signal)
            loss = signal.abs().sum() + (pull[:, None] * self.gaussians.position_m).sum()
            (loss + self.gaussians.log_scale.square().sum() + self.gaussians.quaternion.sum()).backward()
            self.optimizer.step()
            self.step += 1
            self.control.after_step(self.gaussians, self.optimizer, self.step, share)

    def moments(self) -> dict[str, Tensor]:
        return {
            f"{key} of {name}": self.optimizer.state[parameter][key].clone()
            for name, parameter in self.gaussians.named_parameters()
            for key in ("exp_avg", "exp_avg_sq")
        }

    def values(self) -> dict[str, Tensor]:
        return {name: parameter.detach().clone() for name, parameter in self.gaussians.named_parameters()}


def ones() -> Tensor:
    return torch.ones(NUM_GAUSSIANS)


def ones_but(index: int, value: float) -> Tensor:
    return torch.ones(NUM_GAUSSIANS).index_fill(0, torch.tensor([index]), value)


def twin_of_next_step(magnitude: Tensor, pull: Tensor, **options: float) -> Training:
    """A training that never divides, after as many steps as one that did at the last of them."""
    twin = Training(**{**options, "densify_every": EVERY + 1})
    twin.run(EVERY, magnitude, pull)
    return twin


def test_a_gaussian_that_contributes_nothing_goes() -> None:
    training, magnitude = Training(growth=0, max_gaussians=NUM_GAUSSIANS - 1), ones_but(7, 0.0)
    twin = twin_of_next_step(magnitude, ones())
    training.run(EVERY, magnitude, ones())
    kept = torch.arange(NUM_GAUSSIANS) != 7
    assert len(training.gaussians) == NUM_GAUSSIANS - 1
    for name, value in twin.values().items():
        assert torch.equal(training.values()[name], value[kept])
    for name, moments in twin.moments().items():
        assert torch.equal(training.moments()[name], moments[kept])


def test_the_most_strained_gaussian_is_divided_along_its_longest_axis_and_others_stay_as_they_are() -> None:
    pull = ones_but(3, 5.0)
    training, twin = Training(growth=1 / NUM_GAUSSIANS), twin_of_next_step(ones(), pull)
    training.run(EVERY, ones(), pull)
    before, after = twin.values(), training.values()
    assert len(training.gaussians) == NUM_GAUSSIANS + 1
    apart_m = after["position_m"][3] - after["position_m"][-1]
    eigenvalues, axes = torch.linalg.eigh(twin.gaussians.covariance.detach()[3])
    assert float(apart_m.norm()) == pytest.approx(math.sqrt(eigenvalues[-1]), rel=1e-4)
    assert abs(float(apart_m @ axes[:, -1])) == pytest.approx(float(apart_m.norm()), rel=1e-4)
    middle_m = (after["position_m"][3] + after["position_m"][-1]) / 2
    torch.testing.assert_close(middle_m, before["position_m"][3], rtol=1e-5, atol=1e-5)
    for half in (3, -1):
        assert bool((after["log_scale"][half] < before["log_scale"][3]).all())
        assert torch.equal(after["quaternion"][half], before["quaternion"][3])
    others = torch.arange(NUM_GAUSSIANS) != 3
    for name, value in before.items():
        assert torch.equal(after[name][:-1][others], value[others])
    for name, moments in twin.moments().items():
        renewed = training.moments()[name]
        assert torch.equal(renewed[:-1], moments)
        assert float(renewed[-1].abs().max()) == 0


def test_the_number_of_gaussians_never_exceeds_its_limit_and_training_goes_on() -> None:
    training, counts = Training(growth=0.4, max_gaussians=37), []
    for _ in range(6):
        pull = torch.linspace(1, 2, len(training.gaussians))
        training.run(EVERY, torch.ones_like(pull), pull)
        counts.append(len(training.gaussians))
    assert counts == [28, 37, 37, 37, 37, 37]
    parameters = list(training.gaussians.parameters())
    assert [id(p) for group in training.optimizer.param_groups for p in group["params"]] == list(map(id, parameters))
    assert set(training.optimizer.state) == set(parameters)
    for parameter in parameters:
        assert training.optimizer.state[parameter]["exp_avg"].shape == parameter.shape
        assert bool(parameter.isfinite().all())


def test_gaussians_added_by_a_division_are_trained() -> None:
    training = Training(growth=1 / NUM_GAUSSIANS)
    training.run(EVERY, ones(), ones())
    before = training.values()["position_m"]
    training.run(1, torch.ones(NUM_GAUSSIANS + 1), torch.ones(NUM_GAUSSIANS + 1))
    assert bool((training.values()["position_m"] < before).all())


@pytest.mark.parametrize(
    ("options", "magnitude", "pull", "share"),
    [
        ({"growth": 0}, 0 * ones(), ones(), 0.0),  # all contribute alike
        ({"growth": 0}, ones(), ones(), 0.0),
        ({"growth": 0}, ones_but(7, 0.0), ones_but(3, 5.0), 0.0),  # the place of the dropped is given to the strained
        ({"growth": 1, "densify_every": 0}, ones_but(7, 0.0), ones(), 0.0),
        ({"growth": 1, "densify_until": 0.5}, ones_but(7, 0.0), ones(), 0.5),
    ],
)
def test_the_number_of_gaussians_stays_where_none_is_to_go_or_come_or_control_is_over(
    options: dict[str, float], magnitude: Tensor, pull: Tensor, share: float
) -> None:
    training = Training(**options)
    for _ in range(2):
        training.run(EVERY, magnitude, pull, share)
        assert len(training.gaussians) == NUM_GAUSSIANS


def test_what_is_seen_without_a_gradient_counts_for_nothing() -> None:
    training = Training(growth=0)
    training.control.watch(torch.ones(NUM_GAUSSIANS).bool(), torch.ones(1, NUM_GAUSSIANS, 1, dtype=torch.complex64))
    training.control.after_step(training.gaussians, training.optimizer, EVERY, 0.0)
    assert len(training.control.contribution) == 0
