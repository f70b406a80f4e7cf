"""What paths say they meet is there, and directions and delays agree with the points on the way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.found_box import SCENE as BOX_ROOM
from tests.support.furnished_room import TX_M, furnished_room
from tests.support.screened_room import SCENE as SCREENED
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Scene, Surface
from xfreqbench.scene.visibility import distance_to_surfaces
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.paths import (
    DIFFRACTION,
    NO_INTERACTION,
    Paths,
    RaggedPaths,
    angles_rad,
    directions,
    element_delays_s,
    spherical_waves,
)
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import SolverName, Tracer, TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

CARRIERS_HZ = [2.4e9, 24.25e9]
SETTINGS = TraceSettings(interactions=("specular", "refraction"), rays=50_000, max_depth=3)
OVER_EDGES = replace(SETTINGS, interactions=("specular", "refraction", "diffraction"))
BOX = Surface("screen, metal", "metal", 0.002, (5.4, 1.5, 0.0), (5.5, 4.5, 2.3))  # Sionna RT diffracts at no rim
SCENE = replace(SCREENED, surface=(*SCREENED.surface[:-1], BOX))
SHADOWED_M = np.array([6.0, 3.0, 1.0])
SOLVERS = [
    pytest.param("image", SETTINGS),
    pytest.param("image", OVER_EDGES),
    pytest.param("sionna", SETTINGS, marks=pytest.mark.sionna),
    pytest.param("sionna", OVER_EDGES, marks=pytest.mark.sionna),
]


def require_on_named_surfaces(scene: Scene, tracer: Tracer, tx: np.ndarray) -> set[int]:
    """Every point where a path meets something lies on the surface that is named; returns the codes that are there."""
    paths, meshes = tracer.paths(tx), surface_meshes(scene)
    is_met = paths.interactions != NO_INTERACTION
    assert is_met.any()
    assert (paths.surfaces[~is_met] == -1).all()
    for surface in np.unique(paths.surfaces[is_met]):
        points_m = paths.vertices_m[is_met & (paths.surfaces == surface)]
        assert distance_to_surfaces([meshes[surface]], points_m).max() < 2e-5  # float32 in Sionna RT
    return set(np.unique(paths.interactions).tolist())


def test_a_path_among_meshes_meets_the_surfaces_that_it_names(tmp_path: Path) -> None:
    room = furnished_room(tmp_path, subdivisions=1)
    tracer = tracer_of(room, CARRIERS_HZ, replace(SETTINGS, solver="image"))
    for tx in TX_M:
        require_on_named_surfaces(room, tracer, tx)


@pytest.mark.parametrize(("solver", "settings"), SOLVERS)
def test_a_path_meets_the_surfaces_that_it_names_and_its_directions_and_delay_are_those_of_these_points(
    solver: SolverName, settings: TraceSettings
) -> None:
    tracer = tracer_of(SCENE, CARRIERS_HZ, replace(settings, solver=solver))
    codes = require_on_named_surfaces(SCENE, tracer, SHADOWED_M)
    assert (DIFFRACTION in codes) == (settings is OVER_EDGES)
    receiver_m, paths = np.asarray(SCENE.receiver.position_m), tracer.paths(SHADOWED_M)
    departure = paths.departure(SHADOWED_M, receiver_m)
    for p, is_met in enumerate(paths.interactions != NO_INTERACTION):
        line_m = np.vstack([SHADOWED_M, paths.vertices_m[p][is_met], receiver_m])
        steps_m = np.diff(line_m, axis=0)
        length_m = np.linalg.norm(steps_m, axis=1)
        assert length_m.sum() == pytest.approx(SPEED_OF_LIGHT_M_S * paths.delay_s[p], rel=1e-6)
        np.testing.assert_allclose(departure[p], steps_m[0] / length_m[0], atol=1e-12)
        np.testing.assert_allclose(paths.arrival[p], -steps_m[-1] / length_m[-1], atol=1e-5)


def test_angles_name_the_direction() -> None:
    direction = np.random.default_rng(0).normal(size=(50, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.vstack([direction, np.eye(3), -np.eye(3)])
    np.testing.assert_allclose(directions(*angles_rad(direction)), direction, atol=1e-15)
    azimuth_rad, elevation_rad = angles_rad(np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8]]))
    np.testing.assert_allclose(azimuth_rad, [-np.pi / 2, 0])
    np.testing.assert_allclose(elevation_rad, [0, -np.arcsin(0.8)])


def test_one_behind_the_other_paths_lose_single_precision_alone() -> None:
    tracer = tracer_of(SCENE, CARRIERS_HZ, replace(SETTINGS, solver="image"))
    tx_m, receiver_m = np.array([[1.0, 1.0, 1.0], [6.0, 3.0, 1.0]]), np.asarray(SCENE.receiver.position_m)
    paths = [tracer.paths(tx) for tx in tx_m]
    ragged = RaggedPaths.of(paths, tx_m, receiver_m)
    assert ragged.num_paths.tolist() == [len(of_tx.delay_s) for of_tx in paths]
    assert len(ragged.interaction) == ragged.num_interactions.sum() == len(ragged.vertex_m)
    second = slice(len(paths[0].delay_s), None)
    np.testing.assert_array_equal(ragged.delay_s[second], paths[1].delay_s)
    np.testing.assert_allclose(ragged.gain[second].T, paths[1].gain, rtol=1e-6)
    arrival = directions(ragged.arrival_azimuth_rad[second], ragged.arrival_elevation_rad[second])
    np.testing.assert_allclose(arrival, paths[1].arrival, atol=1e-6)


def test_a_wave_reaches_each_element_at_the_distance_of_the_image() -> None:
    """The array sees the image of the transmitter in the floor, whatever element it is."""
    element_m = np.random.default_rng(1).uniform(-0.3, 0.3, (5, 3))
    tx_m, receiver_m = np.array([1.0, 1.0, 1.0]), np.asarray(SCENE.receiver.position_m)
    image_m = tx_m * (1, 1, -1)
    offset_m = image_m - receiver_m
    length_m = np.linalg.norm(offset_m)
    delays = element_delays_s(np.array([length_m / SPEED_OF_LIGHT_M_S]), offset_m[None] / length_m, element_m)
    distance_m = np.linalg.norm(receiver_m + element_m - image_m, axis=1)
    np.testing.assert_allclose(delays[0] * SPEED_OF_LIGHT_M_S, distance_m, rtol=1e-13)


def test_a_spherical_wave_reaches_each_element_after_its_own_distance() -> None:
    tx_m = np.array([1.1, 2.9, 0.9])
    direct = spherical_waves(ImageTracer(BOX_ROOM, [2.4e9], SETTINGS).paths(tx_m), 0, BOX_ROOM.receiver)[0]
    wavelength_m = SPEED_OF_LIGHT_M_S / 2.4e9
    distance_m = np.linalg.norm(tx_m - BOX_ROOM.receiver.element_position_m(wavelength_m), axis=1)
    turned_back = direct * np.exp(2j * np.pi * distance_m / wavelength_m)
    assert np.abs(np.angle(turned_back / turned_back[0])).max() < 1e-9  # some 20 turns in double precision
    np.testing.assert_allclose(np.abs(direct), np.abs(direct[0]))


def test_pairs_of_antennas_that_no_path_joins_have_no_paths_together() -> None:
    found = tracer_of(SCREENED, [4e9, 5e9], TraceSettings("image", rays=2000, max_depth=2)).paths(
        np.array([2.0, 2.0, 1.2])
    )
    empty = {
        name: getattr(found, name)[:0] for name in ("delay_s", "arrival", "interactions", "surfaces", "vertices_m")
    }
    without = replace(found, gain=found.gain[:, :0], **empty)
    both = Paths.joined([without, without])
    assert (both.gain.shape, both.vertices_m.shape) == ((4, 0), without.vertices_m.shape)
