"""Laws of the image method among many facets: trees of boxes find what a look at every triangle finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.furnished_room import furnished_room
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import ReceiverArray, Scene
from xfreqbench.tracing.image.kernels.arrays import MIN_SEGMENT_M, new_walk
from xfreqbench.tracing.image.kernels.tree import first_hit
from xfreqbench.tracing.image.surfaces import MirrorPlanes, facets_of
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.paths import DIFFRACTION
from xfreqbench.tracing.tracer import Interaction, TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

CARRIERS_HZ = [2.4e9, 24.25e9]
DIFFRACTING: tuple[Interaction, ...] = ("specular", "refraction", "diffraction")
NUM_RAYS = 400
NEAR_M = 1e-6  # of meshes stored in float32, whose facets are moved into a common plane


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return furnished_room(tmp_path_factory.mktemp("room"))


def shares_met(corners_m: np.ndarray, start_m: np.ndarray, way_m: np.ndarray) -> np.ndarray:
    """Share of the way from a start at which each triangle (K, 3, 3) is met, or infinity: Möller and Trumbore."""
    origin, along, across = (corners_m[:, 0], corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    normal_to_way = np.cross(way_m, across)
    volume = (along * normal_to_way).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = start_m - origin
        u = (offset * normal_to_way).sum(-1) / volume
        turned = np.cross(offset, along)
        v = turned @ way_m / volume
        share = (across * turned).sum(-1) / volume
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (share > 0), share, np.inf)


def random_places_m(number: int, seed: int) -> np.ndarray:
    """Places in the room, above its furniture and below."""
    return np.random.default_rng(seed).uniform([0.2, 0.2, 0.1], [3.8, 2.8, 2.4], (number, 3))


def test_rays_meet_first_what_is_nearest_of_all_triangles(room: Scene) -> None:
    geometry = Geometry(surface_meshes(room))
    corners_m = np.concatenate([mesh.corners_m for mesh in geometry.meshes])
    one_kind = np.zeros((2, len(geometry.meshes)), np.int64)
    facets, *_ = facets_of(geometry, MirrorPlanes(geometry), one_kind, np.zeros(1, np.bool_))
    direction = np.random.default_rng(1).normal(size=(NUM_RAYS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    num_hits = 0
    for start_m, way_m in zip(random_places_m(NUM_RAYS, 2), direction, strict=True):
        facet, distance_m = first_hit(facets, start_m, way_m, new_walk(1, 1, 1, start_m))
        nearest_m = shares_met(corners_m, start_m, way_m).min()
        assert (facet >= 0) == np.isfinite(nearest_m)
        if facet >= 0:
            assert distance_m == pytest.approx(nearest_m, abs=NEAR_M)
            num_hits += 1
    assert NUM_RAYS / 2 < num_hits < NUM_RAYS  # two walls are missing


def test_straight_ways_cross_every_triangle_between_their_ends(room: Scene) -> None:
    settings = TraceSettings("image", interactions=("refraction",), max_depth=4)
    tracer, meshes = ImageTracer(room, CARRIERS_HZ, settings), surface_meshes(room)
    corners_m = np.concatenate([mesh.corners_m for mesh in meshes])
    number = [len(mesh.triangles) for mesh in meshes]
    is_metal = np.repeat([str(mesh.material) == "metal" for mesh in meshes], number)
    receiver_m, seen = np.array(room.receiver.position_m), set()
    for start_m in random_places_m(NUM_RAYS, 3):
        share = shares_met(corners_m, start_m, receiver_m - start_m)
        is_met = share < 1
        crossed = np.sort(share[is_met])
        crossed = crossed[np.diff(crossed, prepend=-1) > NEAR_M]  # on the edge between two triangles
        stretch_m = np.diff(crossed, prepend=0, append=1) * np.linalg.norm(receiver_m - start_m)
        paths = tracer.paths(start_m)
        if is_metal[is_met].any() or len(crossed) > settings.max_depth or stretch_m.min() < MIN_SEGMENT_M:
            assert len(paths.delay_s) == 0
            seen.add("blocked")
            continue
        met_m = paths.vertices_m[0, : len(crossed)]
        np.testing.assert_allclose(met_m, start_m + crossed[:, None] * (receiver_m - start_m), atol=NEAR_M)
        assert np.isnan(paths.vertices_m[0, len(crossed) :]).all()
        seen.add(len(crossed))
    assert {"blocked", 0, 1, 2} <= seen


@pytest.mark.parametrize("interactions", [("specular", "refraction"), DIFFRACTING])
def test_transmitter_and_receiver_may_change_places(room: Scene, interactions: tuple[Interaction, ...]) -> None:
    """V antennas, reflections at the shell, crossings of the furniture, and the edges of its flat parts."""
    settings = TraceSettings("image", interactions, max_depth=3, rays=60_000)
    every_path = ImageSavings(diffraction_floor=0.0)
    for here, there in random_places_m(8, 4).reshape(4, 2, 3):
        forward, backward = (
            ImageTracer(
                replace(room, receiver=ReceiverArray(position_m=tuple(rx.tolist()), rows=1, cols=1)),
                CARRIERS_HZ,
                settings,
                every_path,
            ).channel(tx[None])
            for rx, tx in ((here, there), (there, here))
        )
        np.testing.assert_array_equal(forward.num_paths, backward.num_paths)
        np.testing.assert_allclose(forward.cfr, backward.cfr, rtol=0, atol=1e-9 * np.abs(forward.cfr).max())


@pytest.mark.parametrize("element", [0, 5, 15])
def test_an_element_hears_over_edges_what_a_receiver_in_its_place_hears(room: Scene, element: int) -> None:
    every_path = ImageSavings(field_nodes_per_axis=4, diffraction_floor=0.0)
    settings = TraceSettings("image", DIFFRACTING, max_depth=3, rays=200_000)
    tx = random_places_m(6, 5)
    array = ImageTracer(room, [1e9], settings, every_path).channel(tx).cfr[:, 0, element]
    place_m = room.receiver.element_position_m(SPEED_OF_LIGHT_M_S / 1e9)[element]
    alone = replace(room, receiver=replace(room.receiver, rows=1, cols=1, position_m=tuple(place_m.tolist())))
    own = ImageTracer(alone, [1e9], settings, every_path).channel(tx).cfr[:, 0, 0]
    np.testing.assert_allclose(array, own, rtol=0, atol=1e-9 * np.abs(own).max())


def test_the_paths_of_a_furnished_room_add_up_to_its_channel(room: Scene) -> None:
    centre = replace(room, receiver=replace(room.receiver, rows=1, cols=1))
    settings = TraceSettings("image", DIFFRACTING, max_depth=3, rays=20_000)
    tracer, num_diffracted = ImageTracer(centre, CARRIERS_HZ, settings), 0
    for tx in random_places_m(6, 6):
        paths = tracer.paths(tx)
        turns = np.array(CARRIERS_HZ)[:, None] * paths.delay_s
        total = (paths.gain * np.exp(-2j * np.pi * (turns % 1))).sum(axis=1)
        h = tracer.channel(tx[None]).cfr[0, :, 0]
        np.testing.assert_allclose(total, h, rtol=0, atol=1e-8 * np.abs(paths.gain).max())
        num_diffracted += int((paths.interactions == DIFFRACTION).any(axis=1).sum())
    assert num_diffracted > 20
