"""Diffuse reflection by tiles: against closed forms, mirrored rooms, and public Sionna RT, octant by octant."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import dblquad

from tests.support.sionna_scenes import GRID, ONE_ELEMENT, RECEIVER
from xfreqbench.scene.materials import Scattering, SceneMaterial
from xfreqbench.scene.model import ReceiverArray, Scene, Surface
from xfreqbench.scene.prepared import PreparedScene
from xfreqbench.tracing.image.diffuse import roughness_of
from xfreqbench.tracing.image.kernels.diffuse import pattern
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.paths import DIFFUSE, REFRACTION, SPECULAR, Paths
from xfreqbench.tracing.solvers import resolve_solver
from xfreqbench.tracing.tracer import Interaction, TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

CARRIER_HZ = 10e9
TX_M = np.array([1.2, 2.6, 0.8])
ALL: tuple[Interaction, ...] = ("specular", "refraction", "diffraction", "diffuse")
SETTINGS = TraceSettings("image", ("specular", "refraction", "diffuse"), max_depth=2, rays=20_000)
PATTERNS = (
    Scattering(coefficient=0.4, xpd_coefficient=0.2),
    Scattering(coefficient=0.6, pattern="directive", alpha_r=4),
    Scattering(coefficient=0.5, pattern="backscattering", alpha_r=3, alpha_i=6, lambda_=0.7),
)
ROUGH = (
    SceneMaterial("plaster", itu="plasterboard", scattering=PATTERNS[0]),
    SceneMaterial("stone", itu="concrete", scattering=PATTERNS[1]),
    SceneMaterial("felt", relative_permittivity=2.0, conductivity_s_m=0.05, scattering=PATTERNS[2]),
)


def surface(name: str, material: str, low_m: tuple[float, ...], high_m: tuple[float, ...]) -> Surface:
    return Surface(name, material, 0.1, low_m, high_m)  # type: ignore[arg-type]


def scene_of(*surfaces: Surface, materials: tuple[SceneMaterial, ...], receiver: ReceiverArray = ONE_ELEMENT) -> Scene:
    return Scene(name="rough", receiver=receiver, transmitters=GRID, surface=surfaces, material=materials)


def room(receiver: ReceiverArray = ONE_ELEMENT) -> Scene:
    """A room of 4 × 3 × 2.5 m whose walls are of the three rough materials in turn, and a table of the first."""
    corners = [
        ((0.0, 0.0, 0.0), (4.0, 3.0, 0.0)), ((0.0, 0.0, 2.5), (4.0, 3.0, 2.5)), ((0.0, 0.0, 0.0), (0.0, 3.0, 2.5)),
        ((4.0, 0.0, 0.0), (4.0, 3.0, 2.5)), ((0.0, 0.0, 0.0), (4.0, 0.0, 2.5)), ((0.0, 3.0, 0.0), (4.0, 3.0, 2.5)),
        ((2.5, 0.5, 0.7), (3.5, 1.5, 0.7)),
    ]  # fmt: skip
    walls = [surface(f"wall {i}", ROUGH[i % 3].name, *bounds) for i, bounds in enumerate(corners)]
    return scene_of(*walls, materials=ROUGH, receiver=receiver)


def plate(scattering: Scattering | None, *walls: Surface, receiver: ReceiverArray = ONE_ELEMENT) -> Scene:
    """A metal floor of 4 × 4 m below the receiver that scatters, and walls."""
    floor = surface("floor", "rough metal", (0.0, 0.0, 0.0), (4.0, 4.0, 0.0))
    metal = SceneMaterial("rough metal", itu="metal", scattering=scattering)
    return scene_of(floor, *walls, materials=(metal,), receiver=receiver)


def traced(scene: Scene, settings: TraceSettings = SETTINGS, tx_m: NDArray[np.float64] = TX_M, **savings: Any) -> Paths:
    return ImageTracer(PreparedScene.of(scene), [CARRIER_HZ], settings, ImageSavings(**savings)).paths(tx_m)


def octant_powers(gain: NDArray[Any], arrival: NDArray[np.float64], interactions: NDArray[Any]) -> NDArray[np.float64]:
    """Power from each octant by a tile alone, by a mirror and then a tile, and by a tile and then a mirror: (3, 8)."""
    octant = (arrival > 0) @ np.array([1, 2, 4])
    num_tiles, num_mirrors = ((interactions == code).sum(axis=1) for code in (DIFFUSE, SPECULAR))
    ends = np.where(interactions == REFRACTION, 0, interactions)
    is_last = [row[row > 0][-1:] == [DIFFUSE] for row in ends]
    last = np.array([len(codes) > 0 and bool(codes[0]) for codes in is_last], bool)
    kinds = (num_mirrors == 0, (num_mirrors == 1) & last, (num_mirrors == 1) & ~last)
    return np.array([np.bincount(octant, np.abs(gain) ** 2 * (kind & (num_tiles == 1)), minlength=8) for kind in kinds])


def powers(paths: Paths) -> NDArray[np.float64]:
    return octant_powers(paths.gain[0], paths.arrival, paths.interactions)


def test_a_lambertian_floor_scatters_what_lamberts_law_says() -> None:
    """∫ S²·cos θᵢ/(4π rᵢ²)·cos θₛ/π·λ²/(4π rₛ²) dA; P.2040's metal at 10 GHz reflects .999 of the power."""
    receiver_m = np.asarray(ONE_ELEMENT.position_m)

    def per_area(y: float, x: float) -> float:
        to_tx, to_rx = TX_M - (x, y, 0), receiver_m - (x, y, 0)
        return float(to_tx[2] * to_rx[2] / np.linalg.norm(to_tx) ** 3 / np.linalg.norm(to_rx) ** 3)

    wavelength_m = SPEED_OF_LIGHT_M_S / CARRIER_HZ
    integral, _ = dblquad(per_area, 0, 4, 0, 4)
    expected = 0.7**2 * integral * wavelength_m**2 / (4 * np.pi) ** 2 / np.pi
    paths = traced(plate(Scattering(coefficient=0.7)), replace(SETTINGS, max_depth=1))
    assert powers(paths)[0].sum() == pytest.approx(expected, rel=3e-3)
    back = replace(ONE_ELEMENT, position_m=tuple(TX_M))
    swapped = traced(plate(Scattering(0.7), receiver=back), replace(SETTINGS, max_depth=1), receiver_m)
    assert powers(swapped)[0].sum() == pytest.approx(expected, rel=3e-3)  # of metal Lambert's law is reciprocal


@pytest.mark.parametrize("scattering", PATTERNS)
@pytest.mark.parametrize("angle_rad", [0.0, 1.2])
def test_patterns_scatter_all_of_the_power(scattering: Scattering, angle_rad: float) -> None:
    roughness, normal = roughness_of([None, scattering]), np.array([0.0, 0.0, -1.0])
    k_in = np.array([np.sin(angle_rad), 0.0, -np.cos(angle_rad)])
    node, weight = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for cosine, part in zip((1 + node) / 2, weight / 2, strict=True):
        for phi in np.arange(64) / 64 * 2 * np.pi:
            k_out = np.array([*(np.sqrt(1 - cosine**2) * np.array([np.cos(phi), np.sin(phi)])), cosine])
            total += part * 2 * np.pi / 64 * pattern.py_func(roughness, 1, normal, k_in, k_out)
    assert total == pytest.approx(1, abs=1e-9)


def test_mirrors_show_a_rough_floor_its_images() -> None:
    """A smooth metal wall is as good as a second receiver, or transmitter, behind it."""
    wall = surface("wall", "metal", (-20.0, -0.5, 0.0), (20.0, -0.5, 30.0))
    _, before, after = powers(traced(plate(Scattering(0.7), wall))).sum(axis=1)
    x, y, z = ONE_ELEMENT.position_m
    behind = replace(ONE_ELEMENT, position_m=(x, -1.0 - y, z))
    assert after == pytest.approx(powers(traced(plate(Scattering(0.7), receiver=behind))).sum(), rel=0.02)
    tx_m = TX_M * [1, -1, 1] - [0, 1, 0]
    assert before == pytest.approx(powers(traced(plate(Scattering(0.7)), tx_m=tx_m)).sum(), rel=0.02)
    assert before > 1e-11


def test_halved_tiles_give_the_power_of_every_octant() -> None:
    default, halved = (
        powers(traced(room(), diffuse_tile_m=0.25 * scale, diffuse_tile_rad=0.15 * scale)) for scale in (1, 0.5)
    )
    assert np.abs(10 * np.log10(default[0] / halved[0])).max() < 0.15
    assert np.abs(10 * np.log10(default.sum(axis=0) / halved.sum(axis=0))).max() < 0.25
    assert np.abs(10 * np.log10(default.sum(axis=1) / halved.sum(axis=1))).max() < 0.25


def test_the_sum_of_the_paths_is_the_channel_of_a_lone_element() -> None:
    settings = replace(SETTINGS, interactions=ALL, max_depth=3)
    tracer = ImageTracer(PreparedScene.of(room()), [2.4e9, CARRIER_HZ], settings)
    channel, paths = tracer.channel(TX_M[None]), tracer.paths(TX_M)
    assert (paths.interactions == DIFFUSE).any(axis=1).sum() > 4000
    summed = (paths.gain * np.exp(-2j * np.pi * paths.carrier_hz[:, None] * paths.delay_s)).sum(axis=1)
    np.testing.assert_allclose(summed, channel.cfr[0, :, 0], rtol=1e-6)


def test_a_channel_does_not_depend_on_what_else_is_asked_for() -> None:
    scene, settings = PreparedScene.of(room(RECEIVER)), replace(SETTINGS, interactions=ALL, max_depth=3)
    tx_m = np.array([TX_M, [3.0, 2.0, 1.5]])
    many = ImageTracer(scene, [77e9, 2.4e9, CARRIER_HZ], settings).channel(tx_m).cfr
    one = ImageTracer(scene, [CARRIER_HZ], settings).channel(tx_m[1:]).cfr
    np.testing.assert_allclose(one[0, 0], many[1, 2], rtol=0, atol=1e-6 * np.abs(one).max())
    other = ImageTracer(scene, [CARRIER_HZ], replace(settings, seed=2)).channel(tx_m[1:]).cfr
    assert np.abs(other - one).max() > 1e-3 * np.abs(one).max()


def test_phases_are_random_so_that_powers_add() -> None:
    """Mean power over seeds at each of 16 elements is the sum of the paths' powers; the amplitude's mean is none."""
    scene, settings = PreparedScene.of(plate(Scattering(0.7), receiver=RECEIVER)), replace(SETTINGS, max_depth=1)
    tracer = ImageTracer(scene, [CARRIER_HZ], replace(settings, interactions=("diffuse",)))
    total = (np.abs(tracer.paths(TX_M).gain[0]) ** 2)[1:].sum()  # without the line of sight
    seeds = (replace(settings, interactions=("diffuse",), seed=seed) for seed in range(60))
    cfr = np.array([ImageTracer(scene, [CARRIER_HZ], settings).channel(TX_M[None]).cfr[0, 0] for settings in seeds])
    spread = cfr - cfr.mean(axis=0)
    np.testing.assert_allclose((np.abs(spread) ** 2).mean(axis=0), total, rtol=0.5)  # 1/√60, four times
    assert (np.abs(spread) ** 2).mean() == pytest.approx(total, rel=0.15)


def test_what_is_scattered_is_missing_from_the_specular_reflection() -> None:
    """Whether or not diffuse paths are asked for, the specular reflection keeps √(1 − S²) of its field."""
    cases: tuple[tuple[Interaction, ...], ...] = (("specular",), ("specular", "diffuse"), ("specular", "diffraction"))
    for asked in cases:
        smooth: tuple[Interaction, ...] = tuple(name for name in asked if name != "diffuse")
        both = (
            traced(plate(scattering), replace(SETTINGS, interactions=names))
            for scattering, names in ((None, smooth), (Scattering(0.6), asked))
        )
        kept = [np.abs(paths.gain[0, (paths.interactions == [SPECULAR, 0]).all(axis=1)]) for paths in both]
        assert len(kept[0])
        np.testing.assert_allclose(kept[1], 0.8 * kept[0], rtol=1e-9)
    assert resolve_solver(PreparedScene.of(plate(Scattering(0.6))).geometry, TraceSettings()).solver == "image"


@pytest.mark.slow
@pytest.mark.sionna
def test_every_octant_has_the_mean_power_of_the_public_solver() -> None:
    """Over 20 seeds, in a room of three rough materials of three patterns, of paths that a tile scatters at the end.

    Of paths that are reflected after a tile public Sionna RT 2.2.0 keeps one: for them stands
    `test_mirrors_show_a_rough_floor_its_images`.
    """
    from xfreqbench.tracing.sionna.plain import loaded, solve

    ours = powers(traced(room(), diffuse_tile_m=0.125, diffuse_tile_rad=0.075))
    public, public_scene = np.zeros((3, 8)), loaded(room(), CARRIER_HZ)
    for seed in range(1, 21):
        theirs = solve(public_scene, TX_M[None], SETTINGS.named_interactions, SETTINGS.max_depth, 40_000, seed)
        theta, phi = (angle.numpy().ravel().astype(float) for angle in (theirs.theta_r, theirs.phi_r))
        arrival = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
        gain, _ = theirs.cir(normalize_delays=False, out_type="numpy")
        public += octant_powers(gain.ravel(), arrival, theirs.interactions.numpy().reshape(SETTINGS.max_depth, -1).T)
    public /= 20
    assert np.abs(10 * np.log10(ours[0] / public[0])).max() < 0.3
    assert np.abs(10 * np.log10(ours[:2].sum(axis=0) / public[:2].sum(axis=0))).max() < 0.3
    assert abs(10 * np.log10(ours[1].sum() / public[1].sum())) < 0.3
