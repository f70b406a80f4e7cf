from __future__ import annotations

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from xfreqbench.bench.phase_blind import STRIDE, BandOfArray, _ExpectedSsim, _windows, random_phase_maps
from xfreqbench.maps.bartlett import PAS_KINDS, BartlettBeam, PasKind, pas_kind_named
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import SSIM_WINDOW, ssim
from xfreqbench.scene.array import planar_array, steering_vector
from xfreqbench.types import Maps
from xfreqbench.units import SPEED_OF_LIGHT_M_S

pytestmark = pytest.mark.usefixtures("one_thread")

SINGLE = 1e-5  # maps and their windows are float32
BEAM = BartlettBeam(planar_array(4, 4, 0.5), AngularGrid.hemisphere())


def waves_from(number: int, seed: int = 0) -> np.ndarray:
    """Plane waves from random directions, each some decibels weaker than the one before."""
    generator = np.random.default_rng(seed)
    arrival = generator.normal(size=(number, 3))
    arrival = np.abs(arrival / np.linalg.norm(arrival, axis=1, keepdims=True))
    steering = steering_vector(BEAM.element_position_wavelengths, arrival, SPEED_OF_LIGHT_M_S)
    return 0.7 ** np.arange(number)[:, None] * steering


def drawn(number_of_waves: int, kind: PasKind = "power", number: int = 24) -> Maps:
    return random_phase_maps(
        waves_from(number_of_waves), BEAM, kind, number, np.random.default_rng(number_of_waves)
    )


def mean_ssim(shown: Maps, maps: Maps) -> float:
    return float(ssim(np.broadcast_to(shown, maps.shape), maps, BEAM.grid).mean())


@pytest.mark.parametrize("name", PAS_KINDS)
def test_a_single_wave_has_no_phase_to_know(name: str) -> None:
    kind = pas_kind_named(name)
    maps = drawn(1, kind, number=3)
    assert np.abs(maps - maps[0]).max() < SINGLE
    assert mean_ssim(BandOfArray(BEAM).best_map(maps), maps) > 1 - SINGLE


@pytest.mark.parametrize("name", PAS_KINDS)
def test_the_best_map_is_on_average_more_like_the_draws_than_their_mean_and_each_of_them(name: str) -> None:
    kind = pas_kind_named(name)
    maps = drawn(6, kind)
    best = BandOfArray(BEAM).best_map(maps)
    assert best.min() >= 0
    assert best.max() <= 1
    reached = mean_ssim(best, maps)
    assert reached > mean_ssim(maps.mean(axis=0), maps)
    assert reached > max(mean_ssim(each, maps) for each in maps)


def test_no_map_near_the_best_one_is_better() -> None:
    """The optimum is one of all maps of the band, to what every tenth window says of all windows."""
    maps, band = drawn(6), BandOfArray(BEAM)
    best = band.best_map(maps)
    reached, generator = mean_ssim(best, maps), torch.Generator().manual_seed(0)
    for _ in range(10):
        step = torch.randn(len(band.waves), generator=generator) @ band.waves
        moved = best + 0.01 * (step / step.abs().max()).reshape(band.shape).numpy()
        assert mean_ssim(moved.astype(np.float32), maps) < reached + 1e-5


def test_the_band_of_sixteen_elements_has_49_functions_and_holds_every_map() -> None:
    band = BandOfArray(BEAM)
    assert len(band.waves) == 49
    maps = torch.from_numpy(drawn(5, number=4)).flatten(1)
    assert (maps @ band.waves.T @ band.waves - maps).abs().max() < SINGLE


def test_the_expected_ssim_is_the_mean_of_the_scores_windows() -> None:
    maps = drawn(4, number=3)
    shown, truth = maps[0], maps[1:]
    middle = SSIM_WINDOW // 2
    by_window = [
        structural_similarity(shown, each, win_size=SSIM_WINDOW, data_range=1.0, full=True)[1]
        for each in truth
    ]
    scores = np.array(by_window)[:, middle:-middle:STRIDE, middle:-middle:STRIDE]
    expected = _ExpectedSsim(_windows(torch.from_numpy(truth)))(_windows(torch.from_numpy(shown[None]))[0])
    assert float(expected) == pytest.approx(
        scores.mean(), abs=1e-4
    )  # details below a thousandth are left out
