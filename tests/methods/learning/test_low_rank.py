"""The network of low rank: products of a query's vector and a Gaussian's code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import get_args

import pytest
import torch
from torch import Tensor

from xfreqbench.methods.learning.encoding import Scaling
from xfreqbench.methods.learning.low_rank import NUM_SHAPES, Codes, LowRankConfig, LowRankNetwork, Trend
from xfreqbench.methods.learning.network import Attributes

pytestmark = pytest.mark.usefixtures("one_thread")

TRENDS = get_args(Trend)
NUM_GAUSSIANS, RANK = 7, 3
SMALL = LowRankConfig(rank=RANK, width=5, tx_octaves=1, position_octaves=1, tx_levels=1)
BY_PLACE = replace(SMALL, latent=0)
CARRIER_HZ = torch.tensor([1e9, 10e9, 37e9, 94e9], dtype=torch.float64)


def scaling() -> Scaling:
    made = Scaling()
    made.half_size_m.fill_(4.0)
    made.log_band.copy_(torch.tensor([1e9, 94e9], dtype=torch.float64).log())
    return made


def network_of(config: LowRankConfig) -> LowRankNetwork:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return LowRankNetwork(config, scaling())


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def with_random_weights(network: LowRankNetwork) -> LowRankNetwork:
    for parameter in network.parameters():
        parameter.data = random(*parameter.shape, seed=3)
    return network


def codes() -> Codes:
    shapes = (2, RANK), (NUM_SHAPES, RANK), (NUM_SHAPES,), (NUM_SHAPES,)
    return Codes(*(random(NUM_GAUSSIANS, *shape, seed=nth) for nth, shape in enumerate(shapes)))


def asked(network: LowRankNetwork, tx_m: Tensor, carrier_hz: Tensor) -> Attributes:
    with torch.no_grad():
        told = codes() if network.of_place is None else None
        return network(tx_m, carrier_hz, random(NUM_GAUSSIANS, 3), told)


def test_signals_have_at_most_the_rank_of_the_vector() -> None:
    signal = asked(network_of(SMALL), random(20, 3, seed=9), torch.full((20,), 10e9, dtype=torch.float64)).signal
    values = torch.linalg.svdvals(torch.view_as_real(signal[0]).permute(0, 2, 1).flatten(0, 1))
    assert values.shape == (2 * NUM_GAUSSIANS,)
    assert values[RANK - 1] > 1e-3 * values[0] > 1e3 * values[RANK]


@pytest.mark.parametrize("config", [SMALL, BY_PLACE])
def test_at_first_all_carriers_have_the_same_signals_and_one_direct_wave(config: LowRankConfig) -> None:
    tx_m = random(1, 3, seed=9).expand(4, -1)
    attributes = asked(network_of(config), tx_m, CARRIER_HZ)
    torch.testing.assert_close(attributes.signal, attributes.signal[..., :1].expand_as(attributes.signal))
    assert attributes.direct is not None
    torch.testing.assert_close(attributes.direct, attributes.direct[:1].expand(4))


@pytest.mark.parametrize("trend", TRENDS)
def test_signals_are_straight_lines_on_the_trends_axis(trend: Trend) -> None:
    network = with_random_weights(network_of(replace(SMALL, trend=trend)))
    signal = asked(network, random(1, 3, seed=9).expand(4, -1), CARRIER_HZ).signal[0]
    for name, function in (("root", torch.sqrt), ("log", torch.log)):
        on_axis = function(CARRIER_HZ)
        share = (on_axis - on_axis[0]) / (on_axis[-1] - on_axis[0])
        line = signal[:, :1] + share.float() * (signal[:, -1:] - signal[:, :1])
        bend = (signal - line).abs().max() / (signal[:, -1] - signal[:, 0]).abs().max()
        assert (bend < 1e-5) == (name == trend)


@pytest.mark.parametrize("trend", TRENDS)
def test_a_network_that_does_not_see_the_carrier_never_answers_to_it(trend: Trend) -> None:
    network = with_random_weights(network_of(replace(SMALL, sees_carrier=False, trend=trend)))
    with torch.no_grad():
        shape = replace(codes(), shape_trend=torch.zeros(NUM_GAUSSIANS, NUM_SHAPES))
        tx_m = random(1, 3, seed=9).expand(4, -1)
        signal = network(tx_m, CARRIER_HZ, random(NUM_GAUSSIANS, 3), shape).signal
    torch.testing.assert_close(signal, signal[..., :1].expand_as(signal), rtol=1e-6, atol=1e-6)


def test_spreads_lie_between_the_largest_and_its_inverse() -> None:
    network = network_of(replace(SMALL, max_spread=1.3))
    with torch.no_grad():
        network.head.weight.mul_(1e4)
    spread = asked(network, random(50, 3, seed=9), CARRIER_HZ[:1].expand(50)).inverse_spread
    assert 1 / 1.3 - 1e-6 <= float(spread.min()) < 0.8
    assert 1.25 < float(spread.max()) <= 1.3 + 1e-6


def test_carriers_stand_evenly_on_the_axis_of_roots() -> None:
    roots = torch.tensor([1.0, 4.0, 9.0], dtype=torch.float64) * 1e9
    box = scaling()
    box.log_band.copy_(torch.tensor([1e9, 9e9], dtype=torch.float64).log())
    torch.testing.assert_close(box.root_carrier(roots)[:, 0], torch.tensor([-1.0, 0.0, 1.0]), rtol=0, atol=1e-6)
    box.log_band.fill_(float(torch.tensor(9e9, dtype=torch.float64).log()))
    assert float(box.root_carrier(roots[2:]).abs()) < 1e-6  # a band of one carrier


@pytest.mark.parametrize("axis", [Scaling.unit_carrier, Scaling.root_carrier])
def test_carriers_a_fifth_beyond_the_band_are_taken_for_the_middle(axis: Callable[[Scaling, Tensor], Tensor]) -> None:
    box = scaling()
    carrier_hz = torch.tensor([5.0, 60.0, 94.0, 94 * 1.2**0.5, 94 * 1.2, 300.0, 1 / 1.1, 0.1]).double() * 1e9
    inside, outside = axis(box, carrier_hz)[:, 0].split([3, 5])
    torch.testing.assert_close(outside[:3], torch.tensor([0.5, 0.0, 0.0]), rtol=0, atol=1e-6)
    assert -0.5 < float(outside[3]) < 0 == float(outside[4])
    box.log_band[1] = carrier_hz[1].log()  # the highest carrier is held out
    told = axis(box, carrier_hz)[:3, 0]
    assert inside[0] < float(told[0]) < float(told[1]) == 1
    assert float(told[2]) == 0


@pytest.mark.parametrize("config", [SMALL, BY_PLACE, replace(SMALL, trend="none", layers=2)])
def test_gradients_are_those_of_differences(config: LowRankConfig) -> None:
    network = network_of(config).double()
    names, values = zip(*network.named_parameters(), strict=True)
    generator = torch.Generator().manual_seed(1)
    start = [0.3 * torch.randn(value.shape, generator=generator).double() for value in values]
    told = Codes(*(table.double() for table in vars(codes()).values())) if network.of_place is None else None
    tx_m, position_m = random(2, 3, seed=9).double(), random(NUM_GAUSSIANS, 3).double()

    def outputs(*weights: Tensor) -> tuple[Tensor, ...]:
        found = torch.func.functional_call(
            network, dict(zip(names, weights, strict=True)), (tx_m, CARRIER_HZ[:2], position_m, told)
        )
        return torch.view_as_real(found.signal), torch.view_as_real(found.attenuation), found.inverse_spread

    # the carrier's axis is rounded to float32, but it does not depend on the weights
    assert torch.autograd.gradcheck(outputs, [value.requires_grad_() for value in start])
