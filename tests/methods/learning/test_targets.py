"""Beams and training targets in view are parts of the data set's own maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from tests.support.synthetic import append_all, make_header, write_dataset
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.writer import PasWriter
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.learning.targets import Beams, GridView, Targets, as_kind
from xfreqbench.scene.array import ArrayPlane, planar_array

CPU = torch.device("cpu")
VIEWS = [GridView(), GridView(3, 1, 2), GridView(30, 29, 0)]
FLOAT16_STEP = 2.0**-11  # of a map near its peak, as the data set stores it


def random_channels(num_maps: int, num_elements: int) -> NDArray[np.complex128]:
    real, imaginary = np.random.default_rng(0).standard_normal((2, num_maps, num_elements))
    return real + 1j * imaginary


@pytest.mark.parametrize("plane", ["xy", "yz"])
@pytest.mark.parametrize("size", [2, 4])
@pytest.mark.parametrize("view", VIEWS)
def test_beams_give_the_bartlett_maps_in_view(size: int, plane: ArrayPlane, view: GridView) -> None:
    beam = BartlettBeam(planar_array(size, size, 0.5, plane), AngularGrid.hemisphere())
    cfr = random_channels(3, size * size)
    maps, peak_power = beam.maps(cfr)
    expected = view.of_maps(torch.from_numpy(maps))
    power = Beams(beam, CPU).power(torch.as_tensor(cfr, dtype=torch.complex64), view)
    # of the peak: float32 adds up 49 waves
    torch.testing.assert_close(power / torch.as_tensor(peak_power)[:, None, None].float(), expected, rtol=0, atol=1e-5)


def test_channels_that_do_not_interfere_add_up_in_power() -> None:
    beams = Beams(BartlettBeam(planar_array(2, 2, 0.5), AngularGrid.hemisphere(9, 36)), CPU)
    cfr = torch.as_tensor(random_channels(6, 4), dtype=torch.complex64).reshape(3, 2, 4)
    apart = torch.stack([beams.power(channel, GridView()) for channel in cfr])
    torch.testing.assert_close(beams.power(cfr, GridView()), apart.sum(0), rtol=1e-5, atol=1e-5)
    assert float((beams.power(cfr.sum(0), GridView()) - apart.sum(0)).abs().max()) > 0.1  # they would interfere


def test_the_peak_of_lags_is_that_of_the_maps_in_view_with_its_slope() -> None:
    beams = Beams(BartlettBeam(planar_array(2, 2, 0.5), AngularGrid.hemisphere(9, 36)), CPU)
    views = GridView(3, 1, 2), GridView(2, 0, 1)
    lags = torch.randn(5, 10, generator=torch.Generator().manual_seed(0)).abs().requires_grad_()
    maps = torch.cat([beams.power_of_lags(lags, view).flatten(1) for view in views], dim=1)
    found, expected = beams.peak_of_lags(lags, *views), maps.amax(dim=1, keepdim=True)
    torch.testing.assert_close(found, expected)
    slopes = [torch.autograd.grad(peak.sum(), lags, retain_graph=True)[0] for peak in (found, expected)]
    torch.testing.assert_close(*slopes)
    assert float(beams.peak_of_lags(torch.zeros(1, 10), *views)) > 0


def test_every_direction_is_in_exactly_one_of_the_views_of_a_stride() -> None:
    grid, numbered = AngularGrid.hemisphere(9, 36), torch.arange(9 * 36).reshape(9, 36)
    views = [GridView(3, row, column) for row in range(3) for column in range(3)]
    seen = torch.cat([view.of_maps(numbered).flatten() for view in views])
    assert torch.equal(seen.sort().values, torch.arange(9 * 36))
    for view in views:
        part = view.of_grid(grid)
        assert view.of_maps(numbered).shape == part.shape
        rows, columns = view.of_maps(numbered) // 36, view.of_maps(numbered) % 36
        np.testing.assert_array_equal(grid.elevation_rad[rows[:, 0]], part.elevation_rad)
        np.testing.assert_array_equal(grid.azimuth_rad[columns[0]], part.azimuth_rad)


def test_drawn_views_reach_every_offset_of_the_stride() -> None:
    generator = torch.Generator().manual_seed(0)
    assert {GridView.draw(2, generator) for _ in range(60)} == {
        GridView(2, row, col) for row in (0, 1) for col in (0, 1)
    }


@pytest.mark.parametrize("pas_kind", ["power", "amplitude", "phase-only"])
@pytest.mark.parametrize("from_channels", [True, False])
def test_targets_are_the_stored_maps_in_view(pas_kind: PasKind, from_channels: bool, tmp_path: Path) -> None:
    header = make_header(num_tx=3, pas_kind=pas_kind)
    with PasWriter(tmp_path / "data.h5", header) as writer:
        append_all(writer, header, silent=((1, 0),))
    train = open_dataset(tmp_path / "data.h5")
    targets = Targets(train, Beams(train.beam, CPU), from_channels)
    nth, view = torch.tensor([7, 0, 3, 0]), GridView(3, 2, 1)
    stored = torch.from_numpy(train.pas(train.has_path.nonzero()[0][nth.numpy()]))
    torch.testing.assert_close(targets.maps(nth, view), view.of_maps(stored), rtol=0, atol=FLOAT16_STEP)


def test_rows_without_a_path_are_no_targets(tmp_path: Path) -> None:
    train = write_dataset(tmp_path / "data.h5", silent=((0, 0), (2, 1)))
    targets = Targets(train, Beams(train.beam, CPU))
    assert len(targets) == len(train) - 2
    tx_position_m, carrier_hz = targets.queries(torch.arange(len(targets)), 0.0, torch.Generator())
    np.testing.assert_allclose(tx_position_m, train.tx_position_m[train.has_path], rtol=1e-6)
    np.testing.assert_array_equal(carrier_hz, train.carrier_hz[train.has_path])
    peaks = targets.maps(torch.arange(len(targets)), GridView()).amax(dim=(1, 2))
    torch.testing.assert_close(peaks, torch.ones(len(targets)), rtol=0, atol=1e-5)


def test_carriers_are_blurred_by_parts_of_the_band_on_a_logarithmic_axis_and_stay_in_it(tmp_path: Path) -> None:
    train = write_dataset(tmp_path / "data.h5", num_tx=1, carriers_ghz=(1.0, 10.0, 100.0))
    every_row = torch.arange(3).repeat(2000)
    generator = torch.Generator().manual_seed(0)
    _, carrier_hz = Targets(train, Beams(train.beam, CPU)).queries(every_row, 0.5, generator)
    decades = torch.log10(carrier_hz).reshape(-1, 3) - torch.tensor([9.0, 10.0, 11.0])
    # half the band is a decade; 2,000 draws leave 2 % of their deviation
    assert float(decades[:, 1].std()) == pytest.approx(0.5, rel=0.06)
    assert float(decades[:, 1].mean()) == pytest.approx(0, abs=0.05)
    assert (carrier_hz.min(), carrier_hz.max()) == (1e9, 1e11)
    for end, inwards in ((0, 1), (2, -1)):  # half of the draws would leave the band
        assert float((decades[:, end] == 0).double().mean()) == pytest.approx(0.5, abs=0.05)
        assert bool((inwards * decades[:, end] >= 0).all())


@pytest.mark.parametrize("pas_kind", ["power", "amplitude"])
def test_maps_of_any_scale_have_peak_one(pas_kind: PasKind) -> None:
    power = torch.rand(4, 6, 12, generator=torch.Generator().manual_seed(0))
    scaled = power * torch.tensor([1e-20, 1e-3, 1.0, 1e12])[:, None, None]
    maps, expected = as_kind(scaled, pas_kind), power / power.amax(dim=(1, 2), keepdim=True)
    if pas_kind == "amplitude":
        expected = expected.sqrt()
    torch.testing.assert_close(maps, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("pas_kind", ["power", "amplitude"])
def test_a_map_of_zeros_stays_one_and_its_field_has_a_finite_gradient(pas_kind: PasKind) -> None:
    field = torch.zeros(1, 6, 12, requires_grad=True)
    maps = as_kind(field.square(), pas_kind)
    assert not maps.detach().any()
    (gradient,) = torch.autograd.grad((maps - 1).abs().mean(), field)
    assert bool(gradient.isfinite().all())
