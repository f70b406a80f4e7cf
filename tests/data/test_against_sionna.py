"""Channels over a band, from the paths of a data set, against the public `Paths.cfr` and `Paths.cir` of Sionna RT."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.sionna_scenes import ONE_ELEMENT, RECEIVER, simple_scenes
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.generate import generate
from xfreqbench.errors import DataError
from xfreqbench.scene.model import Scene

pytestmark = pytest.mark.sionna

CARRIERS_GHZ = [2.4, 24.25]
OFFSETS_HZ = np.linspace(-200e6, 200e6, 33)
TRANSMITTERS_M = np.array([[3.1, 4.2, 1.1], [1.35, 3.9, 1.7]])
ASKED: Any = {"interactions": ("specular", "refraction"), "rays": 100_000, "max_depth": 3, "maps": False, "paths": True}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    path = tmp_path_factory.mktemp("data") / "data.h5"
    return stored(path, simple_scenes(ONE_ELEMENT)["a wall and a pane between"])


def stored(path: Path, scene: Scene, solver: Any = "image") -> PasDataset:
    return generate(scene, path, CARRIERS_GHZ, tx_positions=TRANSMITTERS_M, solver=solver, **ASKED)


def public_paths(scene: Scene, carrier_hz: float, tx: NDArray[np.float64]) -> Any:
    from xfreqbench.tracing.sionna.plain import loaded, solve

    return solve(loaded(scene, carrier_hz), tx[None], ASKED["interactions"], 3, ASKED["rays"], seed=1)


def public_cfr(paths: Any) -> NDArray[np.complex128]:
    """Channel (M, K) at the offsets, by Sionna RT."""
    response = paths.cfr(OFFSETS_HZ.astype(np.float32), normalize_delays=False, out_type="numpy")
    return response.astype(np.complex128).reshape(-1, len(OFFSETS_HZ))


@pytest.mark.parametrize("solver", ["image", "sionna"])
def test_the_channel_over_a_band_is_that_of_sionna_rt(tmp_path: Path, solver: str) -> None:
    data = stored(tmp_path / "data.h5", simple_scenes(ONE_ELEMENT)["a wall and a pane between"], solver)
    for sample, (tx, carrier_hz) in enumerate(zip(data.tx_position_m, data.carrier_hz.tolist(), strict=True)):
        public = public_cfr(public_paths(data.scene, carrier_hz, tx))
        ours = data.paths(sample).impulse_response().cfr(OFFSETS_HZ).T
        # delays are float32 in Sionna RT: 6e-8 · 2πfτ is 2e-4 rad at 24.25 GHz and 6 m
        np.testing.assert_allclose(ours, public, rtol=0, atol=1e-3 * np.abs(public).max())
        flat = np.abs(ours).max() - np.abs(ours).min()
        assert flat > 0.05 * np.abs(ours).max()  # there is a band to speak of


def test_at_the_array_a_path_is_the_spherical_wave_that_every_element_solves_for_itself(tmp_path: Path) -> None:
    data = stored(tmp_path / "data.h5", simple_scenes(replace(RECEIVER, rows=2, cols=3))["a wall"])
    for sample, (tx, carrier_hz) in enumerate(zip(data.tx_position_m, data.carrier_hz.tolist(), strict=True)):
        public = public_cfr(public_paths(data.scene, carrier_hz, tx))
        ours = data.paths(sample).impulse_response().cfr(OFFSETS_HZ).T
        # gains are those at the centre, which change over the array as it is wide: measured 1.8e-2 and 1.8e-3
        atol = (3e-2 if carrier_hz < 3e9 else 3e-3) * np.abs(public).max()
        np.testing.assert_allclose(ours, public, rtol=0, atol=atol)


def test_the_impulse_response_is_that_of_sionna_rt_path_by_path(data: PasDataset) -> None:
    gain, delay_s = public_paths(data.scene, 2.4e9, TRANSMITTERS_M[0]).cir(normalize_delays=False, out_type="numpy")
    order = np.argsort(delay_s.reshape(-1))
    ours = data.paths(0).impulse_response()
    np.testing.assert_allclose(ours.delay_s[:, 0], delay_s.reshape(-1)[order], rtol=1e-6)
    np.testing.assert_allclose(ours.gain[:, 0], gain.reshape(-1)[order], atol=1e-3 * np.abs(gain).max())


def test_for_one_element_the_band_runs_through_the_stored_channel(data: PasDataset) -> None:
    for sample in range(len(data)):
        response = data.paths(sample).impulse_response()
        atol = 1e-6 * np.abs(response.gain).sum()  # both are rounded to complex64, the paths one by one
        np.testing.assert_allclose(response.cfr([0.0])[0], data.cfr[sample], rtol=0, atol=atol)


def test_an_absolute_frequency_is_no_offset(data: PasDataset) -> None:
    for wrong in ([24.25e9], [0.0, np.nan], [-2.4e9]):
        with pytest.raises(DataError, match=r"offsets from the carrier, 2\.4 GHz"):
            data.paths(0).impulse_response().cfr(wrong)
