"""Diffuse reflection: against a closed form, and against public Sionna RT, octant by octant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.rough_rooms import CARRIER_HZ, TX_M, lambertian_power, octant_powers, plate, public_paths, room
from tests.support.sionna_scenes import RECEIVER
from xfreqbench.errors import XFreqBenchError
from xfreqbench.scene.materials import Scattering
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.tracing.paths import DIFFUSE
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import Channel, Interaction, TraceSettings

pytestmark = pytest.mark.sionna

ALL: tuple[Interaction, ...] = ("specular", "refraction", "diffuse")
SETTINGS = TraceSettings(solver="sionna", interactions=ALL, max_depth=2, rays=2_000)


def test_a_lambertian_floor_scatters_what_lamberts_law_says() -> None:
    settings = replace(SETTINGS, max_depth=1, rays=200_000)
    paths = tracer_of(plate(Scattering(coefficient=0.7)), [CARRIER_HZ], settings).paths(TX_M)
    diffuse = paths.interactions[:, 0] == DIFFUSE
    power = (np.abs(paths.gain[0, diffuse]) ** 2).sum()
    assert diffuse.sum() > 10_000
    assert power == pytest.approx(lambertian_power(0.7), rel=0.02)  # of 2e5 rays, the seventh of which meet it


def test_what_is_scattered_is_missing_from_the_specular_reflection() -> None:
    """Whether or not diffuse paths are asked for, the specular reflection keeps √(1 − S²) of its field."""
    specular: tuple[Interaction, ...] = ("specular",)
    reflected = []
    for coefficient, interactions in ((0.0, specular), (0.6, specular), (0.6, (*specular, "diffuse"))):
        settings = replace(SETTINGS, interactions=interactions, max_depth=1)
        paths = tracer_of(plate(Scattering(coefficient)), [CARRIER_HZ], settings).paths(TX_M)
        (gain,) = paths.gain[0, paths.interactions[:, 0] == 1]
        reflected.append(abs(gain))
    np.testing.assert_allclose(reflected[1:], 0.8 * reflected[0], rtol=1e-5)


@pytest.mark.slow
def test_every_octant_has_the_mean_power_of_the_public_solver() -> None:
    """Over 20 seeds, in a room of three rough materials of three patterns, from the same rays."""
    from xfreqbench.tracing.sionna.forward import ForwardRays
    from xfreqbench.tracing.sionna.plain import loaded
    from xfreqbench.tracing.sionna.scene import RadioScene

    def powers(gain, arrival, interactions):
        scatters = (interactions == DIFFUSE).any(axis=1)
        return octant_powers(gain, arrival, scatters, ~scatters)

    scene = room()
    radio_scene, public_scene = RadioScene(surface_meshes(scene)), loaded(scene, CARRIER_HZ)
    ours, public = np.zeros((2, 8)), np.zeros((2, 8))  # of paths that scatter, and of the others
    for seed in range(1, 21):
        antenna = scene.transmitter_antenna
        rays = ForwardRays(radio_scene, scene.receiver, antenna, np.array([CARRIER_HZ]), replace(SETTINGS, seed=seed))
        paths = rays.paths(TX_M)
        ours += powers(paths.gain[0], paths.arrival, paths.interactions)
        public += powers(*public_paths(public_scene, ALL, SETTINGS.max_depth, SETTINGS.rays, seed))
    assert np.abs(10 * np.log10(ours.sum(axis=0) / public.sum(axis=0))).max() < 0.05  # rays in a hash table's order
    assert np.abs(10 * np.log10(ours[0] / public[0])).max() < 0.05
    assert (ours[0] > 0.3 * ours[1]).sum() >= 4  # scattering matters in half of the octants at least


@pytest.mark.slow
def test_no_path_is_left_out_however_the_elements_are_divided(monkeypatch: pytest.MonkeyPatch) -> None:
    """One seed is one set of rays for the whole array, whether elements are solved together or one by one."""
    from xfreqbench.tracing.sionna import forward
    from xfreqbench.tracing.sionna.plain import plain_channel

    scene = room(replace(RECEIVER, rows=2, cols=2))

    def channel(most_paths: int) -> Channel:
        monkeypatch.setattr(forward, "MAX_DIFFUSE_PATHS", most_paths)
        return tracer_of(scene, [CARRIER_HZ], SETTINGS).channel(TX_M[None])

    together, apart = channel(100_000), channel(SETTINGS.rays * SETTINGS.max_depth)
    assert together.num_paths[0, 0] > SETTINGS.rays / 10
    np.testing.assert_array_equal(apart.num_paths, together.num_paths)
    np.testing.assert_allclose(apart.cfr, together.cfr, rtol=0, atol=1e-5 * np.abs(together.cfr).max())
    truth = plain_channel(scene, CARRIER_HZ, TX_M[None], ALL, SETTINGS.max_depth, SETTINGS.rays, SETTINGS.seed)
    np.testing.assert_allclose(together.cfr[:, 0], truth, rtol=0, atol=1e-2 * np.abs(truth).max())


def test_smooth_scenes_scatter_nothing_and_say_so() -> None:
    scene = plate(None)
    with pytest.raises(XFreqBenchError, match=r"no material of the scene scatters.*scattering = \{coefficient"):
        tracer_of(scene, [CARRIER_HZ], SETTINGS)
    with pytest.raises(XFreqBenchError, match="no material of the scene"):
        tracer_of(plate(Scattering(coefficient=0.0)), [CARRIER_HZ], SETTINGS)


def test_more_diffuse_paths_than_memory_holds_are_refused() -> None:
    with pytest.raises(XFreqBenchError, match=r"--rays 2,000,000"):
        tracer_of(room(), [CARRIER_HZ], replace(SETTINGS, rays=2_000_001))
