"""Reduced GSRF, WRF-GS+ and Wideband3DGS: what sets each apart holds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y
from torch.nn.functional import normalize
from xfreqbench.baselines.gsrf import GSRF, FourierLegendre, regular_grid
from xfreqbench.baselines.wideband_3dgs import Wideband3DGS
from xfreqbench.baselines.wrf_gs_plus import WRFGSPlus

from tests.support.training import tiny, trained
from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning.encoding import Scaling
from xfreqbench.methods.learning.targets import Beams, GridView
from xfreqbench.methods.learning.training import LearnedMethod
from xfreqbench.methods.splatting.composite import composite
from xfreqbench.methods.splatting.field import GaussianField
from xfreqbench.methods.splatting.footprints import bin_footprints, squared_distance
from xfreqbench.methods.splatting.projection import angular_centre

pytestmark = pytest.mark.usefixtures("one_thread")


def started(method: type[LearnedMethod], dataset: PasDataset, **options: Any) -> tuple[GaussianField, Beams]:
    training = tiny(method, **{"band": False, **options}).started(dataset, seed=0)
    return training.field, training.beams


def power(field: GaussianField, beams: Beams, tx_position_m: torch.Tensor, carrier_hz: float) -> torch.Tensor:
    carriers_hz = torch.full((len(tx_position_m),), carrier_hz, dtype=torch.float64)
    with torch.no_grad():
        return field.power(tx_position_m, carriers_hz, GridView(2), beams)


def transmitters(dataset: PasDataset, number: int = 3) -> torch.Tensor:
    return torch.as_tensor(np.unique(dataset.tx_position_m, axis=0)[:number], dtype=torch.float32)


def test_gaussians_stand_still_undivided_until_they_move(dataset: PasDataset) -> None:
    """Dividing them before would leave footprints of others; a fit of 20 steps moves them from the tenth on."""
    model = tiny(GSRF, move_from=0.5, densify_every=2, densify_until=1.0, growth=0.2)
    places = []
    saved = model.batch_loss

    def watched(training: Any, targets: Any) -> torch.Tensor:
        places.append(training.field.gaussians.position_m.detach().clone())
        return saved(training, targets)

    model.batch_loss = watched  # type: ignore[method-assign]
    trained(model, dataset, 20)
    assert all(torch.equal(place, places[0]) for place in places[:10])
    assert len(places[10]) == len(places[0]) < len(places[-1])


def test_the_series_is_scipys_spherical_harmonics() -> None:
    direction = normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)), dim=-1).double()
    direction = torch.cat([direction, torch.eye(3).double(), -torch.eye(3).double()])
    series = FourierLegendre(4).double()
    series.degree.fill_(4)
    polar_rad = np.arccos(direction[:, 2].numpy())
    azimuth_rad = np.arctan2(direction[:, 1].numpy(), direction[:, 0].numpy())
    expected = [sph_harm_y(degree, order, polar_rad, azimuth_rad) for degree, order in series.terms]
    # row n of the coefficients has function n alone, and the polynomials' coefficients are float32
    found = series(direction.T.expand(25, 3, -1), torch.eye(25, dtype=torch.complex128)).numpy()
    np.testing.assert_allclose(found, np.stack(expected), rtol=0, atol=1e-6)


def test_functions_beyond_the_present_degree_are_silent() -> None:
    series = FourierLegendre(3)
    for degree in range(4):
        series.degree.fill_(degree)
        direction = normalize(torch.tensor([1.0, 2.0, 3.0]), dim=0)
        values = series(direction.expand(16, 1, 3).mT, torch.eye(16, dtype=torch.complex64))[:, 0]
        assert int((values != 0).sum()) == (degree + 1) ** 2


def test_degrees_are_added_one_by_one_until_half_of_the_training(dataset: PasDataset) -> None:
    model = tiny(GSRF)
    fit, degrees = model.fit(dataset, Budget(max_steps=13), 0), []
    next(fit)
    for step in range(1, 13):
        fit.send(step / 12)
        degrees.append(int(model._training.field.network.degree))
    assert degrees == [0, 1, 1, 2, 2, 3, 3, 3, 3, 3, 3, 3]


def test_a_gaussian_of_gsrf_sends_a_transmitter_what_its_direction_says_whatever_the_distance(
    dataset: PasDataset,
) -> None:
    field, _ = started(GSRF, dataset)
    field.network.degree.fill_(3)
    scaling, seen = field.scaling, torch.arange(len(field.gaussians)) == 4
    away = torch.tensor([[1.0, 0.5, -0.2], [2.0, 1.0, -0.4], [1.0, -0.5, -0.2]])
    tx_position_m = (field.gaussians.position_m[4].detach() + away) @ scaling.rotation.T + scaling.receiver_m
    signal = field.attributes(tx_position_m, torch.ones(3).double(), seen).signal[0, 0]
    # float32 positions of metres, differences of one
    torch.testing.assert_close(signal[0], signal[1], rtol=1e-5, atol=1e-6)
    assert float((signal[2] - signal[0]).detach().abs()) > 1e-3


@pytest.mark.parametrize("size_m", [(8.0, 6.0, 2.8), (8.0, 6.0, 0.1), (1.0, 1.0, 1.0), (100.0, 0.1, 0.1)])
def test_gsrf_starts_on_a_grid_of_the_box_that_holds_no_more_than_is_asked_for(
    size_m: tuple[float, float, float],
) -> None:
    scaling = Scaling()
    scaling.half_size_m.copy_(torch.tensor(size_m) / 2)
    scaling.center_m.fill_(5.0)
    position_m, spacing_m = regular_grid(scaling, 100)
    assert 25 <= len(position_m) <= 100
    assert bool(((position_m - 5).abs() < scaling.half_size_m).all())
    along = torch.pdist(position_m)
    assert float(along.min()) == pytest.approx(spacing_m, rel=1e-4) or spacing_m < float(along.min())


def test_without_deformation_every_transmitter_has_one_map(dataset: PasDataset) -> None:
    field, beams = started(WRFGSPlus, dataset)
    tx_position_m = transmitters(dataset)
    deformed = power(field, beams, tx_position_m, 1e9)
    assert not torch.equal(deformed[0], deformed[1])
    for parameter in field.network.mlp.head.parameters():
        parameter.data.zero_()
    one, *others = power(field, beams, tx_position_m, 1e9)
    assert float(one.max()) > 0
    for other in others:
        assert torch.equal(one, other)


def test_a_deformation_moves_a_footprint_to_where_it_says(dataset: PasDataset) -> None:
    field, beams = started(WRFGSPlus, dataset, num_gaussians=1)
    head = field.network.mlp.head
    head.weight.data.zero_()
    head.bias.data.zero_()
    field.gaussians.position_m.data.copy_(torch.tensor([[2.0, 0.0, 1.0]]))
    grid = GridView(2).of_grid(beams.grid)
    for shift_m in ((0.0, 0.0, 0.0), (0.0, 1.5, 0.0), (0.0, 0.0, 1.0)):
        head.bias.data[:3] = torch.tensor(shift_m)
        row, column = divmod(int(power(field, beams, transmitters(dataset, 1), 1e9)[0].argmax()), grid.shape[1])
        azimuth_rad, elevation_rad, _ = angular_centre(torch.tensor([[2.0, 0.0, 1.0]]) + torch.tensor(shift_m))
        turn_rad = (grid.azimuth_rad[column] - float(azimuth_rad) + np.pi) % (2 * np.pi) - np.pi
        assert abs(turn_rad) <= np.radians(1.01)  # every second degree is looked at
        assert abs(grid.elevation_rad[row] - float(elevation_rad)) <= np.radians(1.01)


def test_footprints_of_each_transmitter_are_accumulated_as_shared_ones_are(dataset: PasDataset) -> None:
    field, beams = started(WRFGSPlus, dataset)
    for parameter in field.network.mlp.head.parameters():
        parameter.data.zero_()
    grid = GridView(2).of_grid(beams.grid)
    with torch.no_grad():
        projection = field.projection()
        lists = bin_footprints(projection, grid, field._support)
        opacity = torch.sigmoid(field.gaussians.opacity_logit)[:, None]
        shared = composite(
            lists,
            squared_distance(projection, lists, grid),
            torch.ones_like(opacity),
            (opacity * field.gaussians.signal[:, None]).to(torch.complex64),
            (1 - opacity).to(torch.complex64),
            backend="torch",
        )
    for one in power(field, beams, transmitters(dataset), 1e9):
        torch.testing.assert_close(one.flatten(), shared[0].real.square(), rtol=1e-4, atol=1e-6)


def test_what_attenuates_does_not_depend_on_the_transmitter_and_what_is_sent_does(dataset: PasDataset) -> None:
    field, _ = started(Wideband3DGS, dataset)
    everyone = torch.ones(len(field.gaussians), dtype=torch.bool)
    carrier_hz = torch.tensor([1e9, 1e9, 37e9], dtype=torch.float64)
    attributes = field.attributes(transmitters(dataset), carrier_hz, everyone)
    attenuation, signal = attributes.attenuation.detach(), attributes.signal[0].detach()
    assert torch.equal(attenuation[:, 0], attenuation[:, 1])
    assert not torch.allclose(attenuation[:, 0], attenuation[:, 2], rtol=1e-4)
    assert not torch.allclose(signal[:, 0], signal[:, 1], rtol=1e-4)
    assert bool((attenuation.abs() <= 1).all())


def test_a_gaussian_twice_as_far_sends_half(dataset: PasDataset) -> None:
    field, _ = started(Wideband3DGS, dataset)
    for parameter in field.network.radiance.parameters():
        parameter.data.zero_()
    field.gaussians.position_m.data[:2] = torch.tensor([[1.0, 0.0, 1.0], [2.0, 0.0, 2.0]])
    everyone = torch.ones(len(field.gaussians), dtype=torch.bool)
    near, far, *_ = field.attributes(transmitters(dataset, 1), torch.ones(1).double(), everyone).signal[0].detach()
    torch.testing.assert_close(near, 2 * far)
