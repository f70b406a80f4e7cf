"""Reduced SwiftWRF: Gaussians of the plane are where they say, and add up."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from xfreqbench.baselines.swift_wrf import SwiftWRF, SwiftWRFField

from tests.support.training import tiny
from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.learning.targets import Beams, GridView

pytestmark = pytest.mark.usefixtures("one_thread")


def still(dataset: PasDataset, num_gaussians: int) -> tuple[SwiftWRFField, Beams]:
    """A field that no transmitter deforms, and whose power is not projected on the array's band."""
    training = tiny(SwiftWRF, num_gaussians=num_gaussians, band=False).started(dataset, seed=0)
    for parameter in training.field.network.head.parameters():
        parameter.data.zero_()
    return training.field, training.beams


def power(field: SwiftWRFField, beams: Beams, dataset: PasDataset, carrier_hz: float = 1e9) -> torch.Tensor:
    tx_position_m = torch.as_tensor(np.unique(dataset.tx_position_m, axis=0)[:3], dtype=torch.float32)
    with torch.no_grad():
        return field.power(tx_position_m, torch.full((3,), carrier_hz).double(), GridView(2), beams)


def test_a_gaussian_is_where_it_says_and_as_wide_also_across_the_seam(dataset: PasDataset) -> None:
    field, beams = still(dataset, 1)
    grid = GridView(2).of_grid(beams.grid)
    azimuth_rad, elevation_rad = np.meshgrid(grid.azimuth_rad, grid.elevation_rad)
    for centre_deg in ((40.0, 30.0), (359.0, 60.0), (-1.0, 60.0)):
        field.gaussians.centre_rad.data = torch.tensor([centre_deg]).deg2rad()
        field.gaussians.log_size.data = torch.tensor([[10.0, 20.0]]).deg2rad().log()
        across = np.remainder(azimuth_rad - math.radians(centre_deg[0]) + np.pi, 2 * np.pi) - np.pi
        along = elevation_rad - math.radians(centre_deg[1])
        wide, high = (math.radians(math.hypot(deg, 3)) for deg in (10, 20))  # 3° is the least
        bell = np.exp(-0.5 * ((across / wide) ** 2 + (along / high) ** 2))
        brightness = math.log1p(math.exp(-1.0))
        # float32 angles of up to 2π, of which a deviation is 0.17
        np.testing.assert_allclose(power(field, beams, dataset)[0].numpy(), brightness * bell, atol=1e-5)


def test_powers_of_gaussians_add_up(dataset: PasDataset) -> None:
    field, beams = still(dataset, 2)
    both = power(field, beams, dataset)
    brightness = field.gaussians.brightness.data.clone()
    parts = []
    for dark in range(2):
        field.gaussians.brightness.data = brightness.clone()
        field.gaussians.brightness.data[dark] = -100.0
        parts.append(power(field, beams, dataset))
    torch.testing.assert_close(both, parts[0] + parts[1])


def test_transmitters_and_carriers_are_told_apart_by_the_network_alone(dataset: PasDataset) -> None:
    field, beams = still(dataset, 5)
    one, *others = power(field, beams, dataset)
    assert all(torch.equal(one, other) for other in others)
    torch.nn.init.normal_(field.network.head.weight, generator=torch.Generator().manual_seed(0))
    first, second, _ = power(field, beams, dataset)
    assert not torch.equal(first, second)
    assert not torch.equal(first, power(field, beams, dataset, 37e9)[0])


def test_gaussians_that_the_network_pushes_away_and_shrinks_stay_in_sight_with_a_slope(dataset: PasDataset) -> None:
    field, beams = still(dataset, 8)
    tx_position_m, carrier_hz = torch.zeros(1, 3), torch.tensor([1e9], dtype=torch.float64)
    field.network.head.bias.data = torch.tensor([9.0, 9.0, -9.0, -9.0, 0.0])
    centre_rad, size_rad, _ = field.deformed(tx_position_m, carrier_hz)
    assert math.radians(3) < float(size_rad.detach().min())
    assert float((centre_rad - field.gaussians.centre_rad).detach().abs().max()) < math.radians(46)
    field.power(tx_position_m, carrier_hz, GridView(2), beams).sum().backward()
    slope = field.network.head.bias.grad
    assert slope is not None and (slope[2:] != 0).all()
