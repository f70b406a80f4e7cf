"""Fields of Gaussians: where they start, the direct wave, the array's band, and what is computed only once."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from xfreqbench.data.dataset import PasDataset
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.learning.low_rank import LowRankConfig
from xfreqbench.methods.learning.targets import Beams, GridView
from xfreqbench.methods.splatting import field as fields
from xfreqbench.methods.splatting.field import SplatConfig, SplatField
from xfreqbench.scene.array import planar_array

pytestmark = pytest.mark.usefixtures("one_thread")

CPU = torch.device("cpu")
NETWORK = LowRankConfig(width=8, rank=4, tx_levels=1)
STANDING = SplatConfig(num_gaussians=128, move_from=1.0)
TX_M = torch.tensor([[1.0, 2.0, 1.0], [6.0, 4.0, 1.5]])
CARRIER_HZ = torch.tensor([1e9, 37e9], dtype=torch.float64)


@pytest.fixture
def beams(dataset: PasDataset) -> Beams:
    return Beams(dataset.beam, CPU)


def started(dataset: PasDataset, config: SplatConfig = STANDING) -> SplatField:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        field = SplatField(config, NETWORK)
        field.adapt(dataset, torch.Generator().manual_seed(0))
    return field


def silent(field: SplatField) -> SplatField:
    """The field with no signals of its own, and nothing that hides another."""
    with torch.no_grad():
        for parameter in field.network.parameters():
            parameter.zero_()
    return field


def test_a_lattice_leaves_no_direction_without_a_gaussian(dataset: PasDataset) -> None:
    largest = {}
    for start in ("lattice", "random"):
        position_m = started(dataset, replace(STANDING, start=start)).gaussians.position_m.detach().numpy()
        direction = position_m / np.linalg.norm(position_m, axis=1, keepdims=True)
        to_all = np.arccos(np.clip(dataset.grid.directions.reshape(-1, 3) @ direction.T, -1, 1))
        largest[start] = math.degrees(to_all.min(axis=1).max())
    assert largest["lattice"] < 13 < 20 < largest["random"]


def test_the_lattice_covers_what_the_grid_covers(dataset: PasDataset) -> None:
    field = started(dataset)
    sphere = AngularGrid(np.radians(np.arange(-90.0, 91.0, 10.0)), np.radians(np.arange(0.0, 360.0, 10.0)))
    field.gaussians.spread_out(field.scaling, 0.1, sphere, torch.Generator().manual_seed(0))
    position_m = field.gaussians.position_m.detach()
    z = position_m[:, 2] / position_m.norm(dim=-1)
    assert float(z.min()) < -0.98 < 0.98 < float(z.max())
    assert abs(float(z.mean())) < 1e-3


def test_the_direct_wave_is_the_beam_of_the_line_of_sight(dataset: PasDataset, beams: Beams) -> None:
    """With no other signal, the map is the Bartlett map of a plane wave from the transmitter, blurred by footprints."""
    field = silent(started(dataset, replace(STANDING, num_gaussians=400, max_gaussians=400, angular_size_deg=4.0)))
    with torch.no_grad():
        power = field.unit_power(TX_M, CARRIER_HZ, GridView(), beams)
    offset_m = field.scaling.in_frame(TX_M).double().numpy()
    direction = offset_m / np.linalg.norm(offset_m, axis=1, keepdims=True)
    waves = np.exp(2j * np.pi * direction @ dataset.beam.element_position_wavelengths.T)
    expected, _ = dataset.beam.maps(waves)
    similarity = torch.nn.functional.cosine_similarity(power.flatten(1), torch.as_tensor(expected).flatten(1))
    assert float(similarity.min()) > 0.98
    with torch.no_grad():
        without = silent(started(dataset, replace(STANDING, direct_wave=False)))
        assert not without.power(TX_M, CARRIER_HZ, GridView(), beams).any()


@pytest.mark.parametrize("side", [2, 4])
def test_what_the_array_can_give_survives_its_band(side: int) -> None:
    """A Bartlett map on few directions gives its own lags, and these the whole map: law of band limit."""
    beams = Beams(BartlettBeam(planar_array(side, side, 0.5), AngularGrid.hemisphere()), CPU)
    generator = torch.Generator().manual_seed(0)
    cfr = torch.randn(5, side**2, generator=generator, dtype=torch.complex64)
    coarse = beams.coarse_view(8)
    assert coarse == GridView(8)
    lags = beams.lags_of(beams.power(cfr, coarse), coarse)
    power = beams.power(cfr, GridView())
    error = (beams.power_of_lags(lags, GridView()) - power).abs().amax() / power.amax()
    assert float(error) < 2e-3  # the ridge


def test_a_large_array_is_looked_at_in_more_directions() -> None:
    beams = Beams(BartlettBeam(planar_array(12, 12, 0.5), AngularGrid.hemisphere()), CPU)
    stride = beams.coarse_view(8).stride
    rows, columns = -(-90 // stride), -(-360 // stride)
    assert stride < 8
    assert rows * columns >= 4 * 2 * (23 * 23 // 2 + 1) > -(-90 // (stride + 1)) * -(-360 // (stride + 1))


def test_splatting_within_the_band_projects_what_is_splatted_without_it(dataset: PasDataset, beams: Beams) -> None:
    field, view = started(dataset), GridView(6, 1, 2)
    with torch.no_grad():
        within = field.power(TX_M, CARRIER_HZ, view, beams)
        every = field.splatted(TX_M, CARRIER_HZ, GridView(2), beams)
        expected = beams.power_of_lags(beams.lags_of(every, GridView(2)), view)
    assert float((within - expected).abs().max() / expected.max()) < 0.06  # footprints of 8 degrees on steps of 8


def test_footprints_are_binned_once_until_gaussians_move(
    dataset: PasDataset, beams: Beams, monkeypatch: pytest.MonkeyPatch
) -> None:
    field, binned = started(dataset, replace(STANDING, move_from=0.5)), []
    bin_all = fields.bin_footprints
    monkeypatch.setattr(fields, "bin_footprints", lambda *args: binned.append(args) or bin_all(*args))
    optimizer = torch.optim.Adam(field.parameters())
    for step, share in enumerate((0.0, 0.2, 0.6, 0.8), start=1):
        field.power(TX_M, CARRIER_HZ, GridView(6, step, 0), beams).sum().backward()
        moved = field.gaussians.position_m.grad
        assert (moved is not None) == (share > 0.6), share
        field.after_step(optimizer, step, share)
    assert len(binned) == 2


def test_without_transmittance_the_order_of_gaussians_does_not_matter(dataset: PasDataset, beams: Beams) -> None:
    for transmittance in (True, False):
        near, far = (started(dataset, replace(STANDING, transmittance=transmittance)) for _ in range(2))
        with torch.no_grad():
            for field in (near, far):
                field.gaussians.shape_start[:, 0] = -6.0  # nearly opaque
            range_m = far.gaussians.position_m.norm(dim=-1, keepdim=True)
            far.gaussians.position_m.mul_((12.0 - range_m) / range_m)  # the nearest becomes the farthest
            far.gaussians.log_scale.add_(((12.0 - range_m) / range_m).log())
            one, other = (field.splatted(TX_M, CARRIER_HZ, GridView(8), beams) for field in (near, far))
        difference = float((one - other).abs().max() / one.max())
        assert (difference > 0.1) if transmittance else (difference < 1e-4)
