"""Diffuse reflection: against a closed form, and against public Sionna RT, octant by octant."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.sionna_scenes import GRID, ONE_ELEMENT, RECEIVER
from xfreqbench.errors import XFreqBenchError
from xfreqbench.scene.materials import Scattering, SceneMaterial
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import ReceiverArray, Scene, Surface
from xfreqbench.scene.prepared import PreparedScene
from xfreqbench.tracing.paths import DIFFUSE
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import Channel, Interaction, TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

pytestmark = pytest.mark.sionna

CARRIER_HZ = 10e9
TX_M = np.array([1.2, 2.6, 0.8])
ALL: tuple[Interaction, ...] = ("specular", "refraction", "diffuse")
SETTINGS = TraceSettings(solver="sionna", interactions=ALL, max_depth=2, rays=2_000)
DIRECTIVE = Scattering(coefficient=0.6, pattern="directive", alpha_r=4)
BACK = Scattering(coefficient=0.5, pattern="backscattering", alpha_r=3, alpha_i=5, lambda_=0.7)


def surface(name: str, material: str, low_m: tuple[float, ...], high_m: tuple[float, ...]) -> Surface:
    return Surface(name, material, 0.1, low_m, high_m)  # type: ignore[arg-type]


def room(*materials: SceneMaterial, receiver: ReceiverArray = ONE_ELEMENT) -> Scene:
    """A room of 4 × 3 × 2.5 m whose walls are of the first three materials in turn."""
    names = [material.name for material in materials] * 3
    corners = [
        ((0.0, 0.0, 0.0), (4.0, 3.0, 0.0)), ((0.0, 0.0, 2.5), (4.0, 3.0, 2.5)), ((0.0, 0.0, 0.0), (0.0, 3.0, 2.5)),
        ((4.0, 0.0, 0.0), (4.0, 3.0, 2.5)), ((0.0, 0.0, 0.0), (4.0, 0.0, 2.5)), ((0.0, 3.0, 0.0), (4.0, 3.0, 2.5)),
    ]  # fmt: skip
    walls = [surface(f"wall {index}", names[index], *bounds) for index, bounds in enumerate(corners)]
    return Scene(name="rough", receiver=receiver, transmitters=GRID, surface=tuple(walls), material=materials)


ROUGH = (
    SceneMaterial("plaster", itu="plasterboard", scattering=Scattering(coefficient=0.4, xpd_coefficient=0.2)),
    SceneMaterial("stone", itu="concrete", scattering=DIRECTIVE),
    SceneMaterial("felt", relative_permittivity=2.0, conductivity_s_m=0.05, scattering=BACK),
)


def metal_plate(scattering: Scattering | None) -> Scene:
    """A metal floor of 4 × 4 m below the receiver, of a metal that scatters."""
    floor = surface("floor", "metal", (0.0, 0.0, 0.0), (4.0, 4.0, 0.0))
    metal = SceneMaterial("metal", scattering=scattering)
    return Scene(name="plate", receiver=ONE_ELEMENT, transmitters=GRID, surface=(floor,), material=(metal,))


def lambertian_power(coefficient: float) -> float:
    """Received over transmitted power by way of a perfectly reflecting floor that scatters by Lambert's law.

    ∫ S² · cos θᵢ/(4π rᵢ²) · cos θₛ/π · λ²/(4π rₛ²) dA: what an area receives of an isotropic transmitter's power, the
    part of it that is scattered, per steradian, and the receiver's effective area over the distance squared.
    """
    along = (np.arange(800) + 0.5) / 200
    point_m = np.stack([*np.meshgrid(along, along, indexing="ij"), np.zeros((800, 800))], axis=-1)
    incident, scattered = (np.asarray(end) - point_m for end in (TX_M, ONE_ELEMENT.position_m))
    r_i, r_s = (np.linalg.norm(way, axis=-1) for way in (incident, scattered))
    per_area = incident[..., 2] / r_i / (4 * np.pi * r_i**2) * scattered[..., 2] / r_s / np.pi
    effective_m2 = (SPEED_OF_LIGHT_M_S / CARRIER_HZ) ** 2 / (4 * np.pi)
    return float(coefficient**2 * (per_area * effective_m2 / r_s**2).sum() / 200**2)


def test_a_lambertian_floor_scatters_what_lamberts_law_says() -> None:
    settings = replace(SETTINGS, max_depth=1, rays=200_000)
    paths = tracer_of(PreparedScene.of(metal_plate(Scattering(coefficient=0.7))), [CARRIER_HZ], settings).paths(TX_M)
    diffuse = paths.interactions[:, 0] == DIFFUSE
    power = (np.abs(paths.gain[0, diffuse]) ** 2).sum()
    assert diffuse.sum() > 10_000
    assert power == pytest.approx(lambertian_power(0.7), rel=0.02)  # of 2e5 rays, the seventh of which meet it


def test_what_is_scattered_is_missing_from_the_specular_reflection() -> None:
    """Whether or not diffuse paths are asked for, the specular reflection keeps √(1 − S²) of its field."""
    smooth_only: tuple[Interaction, ...] = ("specular",)
    reflected = {}
    for coefficient in (0.0, 0.6):
        for interactions in (smooth_only, ("specular", "diffuse")) if coefficient else (smooth_only,):
            settings = replace(SETTINGS, interactions=interactions, max_depth=1)
            scene = metal_plate(Scattering(coefficient=coefficient))
            paths = tracer_of(PreparedScene.of(scene), [CARRIER_HZ], settings).paths(TX_M)
            (gain,) = paths.gain[0, paths.interactions[:, 0] == 1]
            reflected[coefficient, interactions] = abs(gain)
    smooth = reflected.pop((0.0, smooth_only))
    np.testing.assert_allclose(list(reflected.values()), 0.8 * smooth, rtol=1e-5)


def octant_powers(gain: NDArray[Any], arrival: NDArray[np.float64], interactions: NDArray[Any]) -> NDArray[np.float64]:
    """Power from each octant by paths that scatter, and by the others: (2, 8)."""
    octant = (arrival > 0) @ np.array([1, 2, 4])
    scatters = (interactions == DIFFUSE).any(axis=1)
    return np.array([np.bincount(octant, np.abs(gain) ** 2 * kind, minlength=8) for kind in (scatters, ~scatters)])


def test_every_octant_has_the_mean_power_of_the_public_solver() -> None:
    """Over 20 seeds, in a room of three rough materials of three patterns, from the same rays."""
    from xfreqbench.tracing.sionna.forward import ForwardRays
    from xfreqbench.tracing.sionna.plain import loaded, solve
    from xfreqbench.tracing.sionna.scene import RadioScene

    scene = room(*ROUGH)
    radio_scene, public_scene = RadioScene(surface_meshes(scene)), loaded(scene, CARRIER_HZ)
    ours, public = np.zeros((2, 8)), np.zeros((2, 8))  # of paths that scatter, and of the others
    for seed in range(1, 21):
        antenna = scene.transmitter_antenna
        rays = ForwardRays(radio_scene, scene.receiver, antenna, np.array([CARRIER_HZ]), replace(SETTINGS, seed=seed))
        paths = rays.paths(TX_M)
        ours += octant_powers(paths.gain[0], paths.arrival, paths.interactions)
        theirs = solve(public_scene, TX_M[None], ALL, SETTINGS.max_depth, SETTINGS.rays, seed)
        theta, phi = (angle.numpy().ravel().astype(float) for angle in (theirs.theta_r, theirs.phi_r))
        arrival = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
        gain, _ = theirs.cir(normalize_delays=False, out_type="numpy")
        public += octant_powers(gain.ravel(), arrival, theirs.interactions.numpy().reshape(SETTINGS.max_depth, -1).T)
    assert np.abs(10 * np.log10(ours.sum(axis=0) / public.sum(axis=0))).max() < 0.05  # rays in a hash table's order
    assert np.abs(10 * np.log10(ours[0] / public[0])).max() < 0.05
    assert (ours[0] > 0.3 * ours[1]).sum() >= 4  # scattering matters in half of the octants at least


def test_no_path_is_left_out_however_the_elements_are_divided(monkeypatch: pytest.MonkeyPatch) -> None:
    """One seed is one set of rays for the whole array, whether elements are solved together or one by one."""
    from xfreqbench.tracing.sionna import forward
    from xfreqbench.tracing.sionna.plain import plain_channel

    scene = room(*ROUGH, receiver=replace(RECEIVER, rows=2, cols=2))

    def channel(most_paths: int) -> Channel:
        monkeypatch.setattr(forward, "MAX_DIFFUSE_PATHS", most_paths)
        return tracer_of(PreparedScene.of(scene), [CARRIER_HZ], SETTINGS).channel(TX_M[None])

    together, apart = channel(100_000), channel(SETTINGS.rays * SETTINGS.max_depth)
    assert together.num_paths[0, 0] > SETTINGS.rays / 10
    np.testing.assert_array_equal(apart.num_paths, together.num_paths)
    np.testing.assert_allclose(apart.cfr, together.cfr, rtol=0, atol=1e-5 * np.abs(together.cfr).max())
    truth = plain_channel(scene, CARRIER_HZ, TX_M[None], ALL, SETTINGS.max_depth, SETTINGS.rays, SETTINGS.seed)
    np.testing.assert_allclose(together.cfr[:, 0], truth, rtol=0, atol=1e-2 * np.abs(truth).max())


def test_smooth_scenes_scatter_nothing_and_say_so() -> None:
    scene = metal_plate(None)
    with pytest.raises(XFreqBenchError, match=r"no material of the scene scatters.*scattering = \{coefficient"):
        tracer_of(PreparedScene.of(scene), [CARRIER_HZ], SETTINGS)
    with pytest.raises(XFreqBenchError, match="no material of the scene"):
        tracer_of(PreparedScene.of(metal_plate(Scattering(coefficient=0.0))), [CARRIER_HZ], SETTINGS)


def test_more_diffuse_paths_than_memory_holds_are_refused() -> None:
    with pytest.raises(XFreqBenchError, match=r"--rays 2,000,000"):
        tracer_of(PreparedScene.of(room(*ROUGH)), [CARRIER_HZ], replace(SETTINGS, rays=2_000_001))
