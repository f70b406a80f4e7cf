"""Imports of the example that Wideband3DGS published, against what its authors and others say of it."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from tests.support.places import PUBLISHED
from tests.support.png_folders import imported
from tests.support.stub_methods import run_job
from xfreqbench.data.dataset import PasDataset
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within
from xfreqbench.methods.registry import build_method
from xfreqbench.runs.records import Job
from xfreqbench.scene.array import steering_vector
from xfreqbench.units import SPEED_OF_LIGHT_M_S


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    if not PUBLISHED.is_dir():
        pytest.skip(f"the published example is not at {PUBLISHED}")
    return imported(PUBLISHED, tmp_path_factory.mktemp("published") / "example1.h5")


def misfit(dataset: PasDataset, grid: AngularGrid, spacing: float = 1.0) -> float:
    """Part of the squared maps that no array of these elements could have received, over their rounding.

    |a(d)ᴴh|² is a sum of cosines and sines of 2π d·(r_m − r_n), one of each for every lag of the array.
    """
    element = dataset.beam.element_position_wavelengths * spacing
    lag = np.unique((element[:, None] - element[None]).reshape(-1, 3).round(9), axis=0)
    every = slice(None, None, 7)  # the fit has 49 unknowns: 4,629 directions are plenty
    phase = 2 * np.pi * grid.directions.reshape(-1, 3)[every] @ lag[: len(lag) // 2 + 1].T
    basis = np.linalg.svd(np.hstack([np.cos(phase), np.sin(phase[:, :-1])]), full_matrices=False)[0]
    maps = dataset.pas(np.arange(0, len(dataset), 7)).astype(float)
    amplitude = maps.reshape(len(maps), -1).T[every]
    power = amplitude**2
    rest = power - basis @ (basis.T @ power)
    rounding = 2 * amplitude / 255 / np.sqrt(12)  # of 8 bits, at first order
    return float(np.sqrt((rest**2).mean() / (rounding**2).mean()))


def test_published_maps_are_those_of_the_array_on_the_grid_to_the_rounding_of_their_pngs(published: PasDataset) -> None:
    grid = published.grid
    elevation, azimuth = grid.elevation_rad, grid.azimuth_rad
    assert grid.shape == (90, 360)
    assert misfit(published, grid) < 1.03  # 1.003, and 2 % to spare
    others = {
        "zenith left out": AngularGrid(np.radians(np.arange(90.0)), azimuth),
        "equator left out": AngularGrid(np.radians(np.arange(1.0, 91.0)), azimuth),
        "azimuth half-open": AngularGrid(elevation, np.radians(np.arange(-180.0, 180.0))),
        "row 0 at the horizon": AngularGrid(elevation[::-1], azimuth),
    }
    for name, other in others.items():
        assert misfit(published, other) > 1.06, name
    assert misfit(published, grid, spacing=0.98) > 1.06
    assert misfit(published, grid, spacing=1.02) > 1.06


def test_the_last_published_column_repeats_the_first(published: PasDataset) -> None:
    maps = published.pas()
    assert abs(maps[..., 0] - maps[..., -1]).max() <= 1.01 / 255  # one level, of rounding
    assert abs(maps[..., 0] - maps[..., 1]).max() > 10 / 255


def test_the_published_frame_is_the_one_in_which_waves_come_from_their_transmitters(published: PasDataset) -> None:
    """Of all permutations and reflections of the axes only x → −x, which the array cannot see, does as well."""
    every = slice(None, None, 6)
    coarse = AngularGrid(published.grid.elevation_rad[every], published.grid.azimuth_rad[every])
    maps = published.pas()[:, every, every].reshape(len(published), -1)
    offset_m = published.tx_position_m - np.array(published.header.receiver.position_m)
    arrival = offset_m / np.linalg.norm(offset_m, axis=1, keepdims=True)
    element = published.beam.element_position_wavelengths
    looks = steering_vector(element, coarse.directions.reshape(-1, 3), SPEED_OF_LIGHT_M_S).conj()

    def agreement(turned: np.ndarray) -> float:
        waves = abs(steering_vector(element, turned, SPEED_OF_LIGHT_M_S) @ looks.T)
        return float(np.median([np.corrcoef(*pair)[0, 1] for pair in zip(waves, maps, strict=True)]))

    turns = itertools.product(itertools.permutations(range(3)), itertools.product((1, -1), repeat=3))
    found = {(axes, signs): agreement(arrival[:, axes] * signs) for axes, signs in turns}
    ranked = sorted(found, key=found.__getitem__, reverse=True)
    assert set(ranked[:2]) == {((0, 1, 2), (1, 1, 1)), ((0, 1, 2), (-1, 1, 1))}
    assert found[ranked[0]] > 0.75 > 0.6 > found[ranked[2]]  # measured: 0.81, then 0.50


def test_the_nearest_published_transmitter_looks_like_a_lone_wave_from_where_it_is(published: PasDataset) -> None:
    offset_m = published.tx_position_m - np.array(published.header.receiver.position_m)
    distance_m = np.where(offset_m[:, 2] > 0, np.linalg.norm(offset_m, axis=1), np.inf)  # above the horizon
    nearest = published[np.flatnonzero(distance_m == distance_m.min())]
    assert len(nearest) == published.header.num_carriers
    method = build_method("line-of-sight")
    fit_within(method, nearest, Budget(), seed=0)
    maps = method.predict(nearest.tx_position_m, nearest.carrier_hz)
    assert np.median(ssim(maps, nearest.pas(), nearest.grid)) > 0.9  # 0.96 measured; the room adds the rest


@pytest.mark.parametrize(
    ("target", "of_the_mean", "with_peak_1"),
    [("2.4GHz", 0.808, 0.8047), ("24.25GHz", 0.816, 0.8118), ("77GHz", 0.830, 0.8249)],
)
def test_the_mean_over_frequency_scores_on_published_maps_what_others_measured(
    published: PasDataset, tmp_path: Path, target: str, of_the_mean: float, with_peak_1: float
) -> None:
    """Others scored the bare mean; a method here divides it by its peak, which costs it a little."""
    tolerance = 0.002  # three digits are known
    record = run_job(Job(str(published.path), "mean-over-frequency", "lofo", f"lofo-{target}"), tmp_path)
    assert record.scores["ssim"].median == pytest.approx(with_peak_1, abs=tolerance)
    maps = published.pas().reshape(-1, published.header.num_carriers, *published.grid.shape)
    is_tested = np.isclose(published.header.carrier_hz, float(target.removesuffix("GHz")) * 1e9)
    mean, truth = maps[:, ~is_tested].mean(axis=1), maps[:, is_tested][:, 0]
    assert np.median(ssim(mean, truth, published.grid)) == pytest.approx(of_the_mean, abs=tolerance)
