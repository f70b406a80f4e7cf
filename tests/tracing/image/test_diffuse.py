"""Diffuse reflection by tiles: against closed forms, mirrored rooms, and public Sionna RT, octant by octant."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.reference import cfr_at_centre
from tests.support.rough_rooms import (
    CARRIER_HZ,
    PATTERNS,
    RECEIVER_M,
    TX_M,
    lambertian_power,
    octant_powers,
    plate,
    public_paths,
    room,
)
from tests.support.sionna_scenes import ONE_ELEMENT, RECEIVER
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.materials import Scattering
from xfreqbench.scene.model import Scene, Surface
from xfreqbench.tracing.image.diffuse import roughness_of
from xfreqbench.tracing.image.kernels.diffuse import pattern
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.paths import DIFFUSE, REFRACTION, SPECULAR, Paths
from xfreqbench.tracing.solvers import resolve_solver
from xfreqbench.tracing.tracer import Interaction, TraceSettings

ALL: tuple[Interaction, ...] = ("specular", "refraction", "diffraction", "diffuse")
SETTINGS = TraceSettings("image", ("specular", "refraction", "diffuse"), max_depth=2, rays=20_000)


def traced(scene: Scene, settings: TraceSettings = SETTINGS, tx_m: NDArray[np.float64] = TX_M, **savings: Any) -> Paths:
    return ImageTracer(scene, [CARRIER_HZ], settings, ImageSavings(**savings)).paths(tx_m)


def powers_of(gain: NDArray[Any], arrival: NDArray[np.float64], interactions: NDArray[Any]) -> NDArray[np.float64]:
    """Power from each octant by a tile alone, by a mirror and then a tile, and by a tile and then a mirror: (3, 8)."""
    num_tiles, num_mirrors = ((interactions == code).sum(axis=1) for code in (DIFFUSE, SPECULAR))
    ends = np.where(interactions == REFRACTION, 0, interactions)
    is_last = np.array([row[row > 0][-1:].tolist() == [DIFFUSE] for row in ends], bool)
    kinds = num_mirrors == 0, (num_mirrors == 1) & is_last, (num_mirrors == 1) & ~is_last
    return octant_powers(gain, arrival, *(kind & (num_tiles == 1) for kind in kinds))


def powers(paths: Paths) -> NDArray[np.float64]:
    return powers_of(paths.gain[0], paths.arrival, paths.interactions)


@pytest.mark.slow
def test_a_lambertian_floor_scatters_what_lamberts_law_says() -> None:
    """P.2040's metal at 10 GHz reflects .999 of the power; of metal Lambert's law is reciprocal."""
    back = replace(ONE_ELEMENT, position_m=tuple(TX_M))
    for receiver, tx_m in ((ONE_ELEMENT, TX_M), (back, RECEIVER_M)):
        paths = traced(plate(Scattering(0.7), receiver=receiver), replace(SETTINGS, max_depth=1), tx_m)
        assert powers(paths)[0].sum() == pytest.approx(lambertian_power(0.7), rel=3e-3)


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
    wall = Surface("wall", "metal", 0.1, (-20.0, -0.5, 0.0), (20.0, -0.5, 30.0))
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
    tracer = ImageTracer(room(), [2.4e9, CARRIER_HZ], settings)
    channel, paths = tracer.channel(TX_M[None]), tracer.paths(TX_M)
    assert (paths.interactions == DIFFUSE).any(axis=1).sum() > 4000
    np.testing.assert_allclose(cfr_at_centre(paths), channel.cfr[0, :, 0], rtol=1e-6)


def test_a_channel_does_not_depend_on_what_else_is_asked_for() -> None:
    scene, settings = room(RECEIVER), replace(SETTINGS, interactions=ALL, max_depth=3)
    tx_m = np.array([TX_M, [3.0, 2.0, 1.5]])
    many = ImageTracer(scene, [77e9, 2.4e9, CARRIER_HZ], settings).channel(tx_m).cfr
    one = ImageTracer(scene, [CARRIER_HZ], settings).channel(tx_m[1:]).cfr
    np.testing.assert_allclose(one[0, 0], many[1, 2], rtol=0, atol=1e-6 * np.abs(one).max())
    other = ImageTracer(scene, [CARRIER_HZ], replace(settings, seed=2)).channel(tx_m[1:]).cfr
    assert np.abs(other - one).max() > 1e-3 * np.abs(one).max()


def test_phases_are_random_so_that_powers_add() -> None:
    """Mean power over seeds at each of 16 elements is the sum of the paths' powers; the amplitude's mean is none."""
    scene = plate(Scattering(0.7), receiver=RECEIVER)
    settings = replace(SETTINGS, interactions=("diffuse",), max_depth=1, rays=1000)
    total = (np.abs(traced(scene, settings).gain[0]) ** 2)[1:].sum()  # without the line of sight
    seeds = (ImageTracer(scene, [CARRIER_HZ], replace(settings, seed=seed)) for seed in range(60))
    cfr = np.array([tracer.channel(TX_M[None]).cfr[0, 0] for tracer in seeds])
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
    assert resolve_solver(Geometry.of(plate(Scattering(0.6))), TraceSettings()).solver == "image"


@pytest.mark.slow
@pytest.mark.sionna
def test_every_octant_has_the_mean_power_of_the_public_solver() -> None:
    """Over 20 seeds, in a room of three rough materials of three patterns, of paths that a tile scatters at the end.

    Of paths that are reflected after a tile public Sionna RT 2.2.0 keeps one: for them stands
    `test_mirrors_show_a_rough_floor_its_images`.
    """
    from xfreqbench.tracing.sionna.plain import loaded

    ours = powers(traced(room(), diffuse_tile_m=0.125, diffuse_tile_rad=0.075))
    scene, asked = loaded(room(), CARRIER_HZ), (SETTINGS.named_interactions, SETTINGS.max_depth, 40_000)
    public = sum(powers_of(*public_paths(scene, *asked, seed)) for seed in range(1, 21)) / 20
    assert np.abs(10 * np.log10(ours[0] / public[0])).max() < 0.3
    assert np.abs(10 * np.log10(ours[:2].sum(axis=0) / public[:2].sum(axis=0))).max() < 0.3
    assert abs(10 * np.log10(ours[1].sum() / public[1].sum())) < 0.3
