"""The image method in rooms furnished with meshes: its laws, and trees that find what a look at all triangles finds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from tests.support.furnished_room import GRID, RECEIVER, TX_M, furnished_room, plate, write_meshes
from tests.support.reference import cfr_at_centre
from xfreqbench.errors import SceneError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import SurfaceMesh, surface_meshes, triangle_corners_m
from xfreqbench.scene.model import PatchSize, ReceiverArray, Scene, Surface
from xfreqbench.tracing.image.edges import Edge, find_edges
from xfreqbench.tracing.image.kernels.arrays import MAX_BOXES, MIN_SEGMENT_M
from xfreqbench.tracing.image.surfaces import MirrorPlanes, grow
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.paths import DIFFRACTION
from xfreqbench.tracing.solvers import resolve_solver
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

CARRIERS_HZ = [2.4e9, 24.25e9]
SETTINGS = TraceSettings("image", ("specular", "refraction"), max_depth=4, rays=60_000)
DIFFRACTING = TraceSettings("image", ("specular", "refraction", "diffraction"), max_depth=3, rays=60_000)
EXACT = ImageSavings(field_nodes_per_axis=4)
ALONE = ReceiverArray(position_m=(0.1, -0.1, 1.9), rows=1, cols=1)
NEAR_M = 1e-6  # of meshes stored in float32, whose facets are moved into a common plane


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return furnished_room(tmp_path_factory.mktemp("room"))


def error_db(cfr: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Error of each channel (…, M) relative to its norm, in dB."""
    return -20 * np.log10(np.linalg.norm(cfr - truth, axis=-1) / np.linalg.norm(truth, axis=-1))


def test_what_elements_share_is_what_each_finds_alone(room: Scene) -> None:
    shared, alone = (
        ImageTracer(room, CARRIERS_HZ, SETTINGS, replace(EXACT, share_visibility=share)).channel(TX_M)
        for share in (True, False)
    )
    np.testing.assert_allclose(shared.cfr, alone.cfr, rtol=0, atol=1e-12 * np.abs(alone.cfr).max())
    np.testing.assert_array_equal(shared.num_paths, alone.num_paths)


NEAR_CORNERS_M = [[0.03, 0.05, 2.46], [3.96, 0.6, 0.04], [2.97, 1.17, 0.82], [1.92, 1.22, 0.75]]
DOWN = (0.0, 0.0, -1.0)


@pytest.mark.parametrize(
    ("receiver_m", "boresight", "tx_m"),
    [
        # half a metre wide under the ceiling, over the table's edge, by a wall, and by the screen
        *(
            (place_m, DOWN, [*TX_M, *NEAR_CORNERS_M])
            for place_m in ((1.9, 1.4, 2.3), (0.28, 0.9, 2.3), (3.05, 1.9, 1.2))
        ),
        # where a bound to first order in the elements' offset from a plane loses a path
        ((3.486, 2.334, 1.108), (0.494, 0.523, -0.141), [(3.9347, 1.1288, 0.7608)]),
        ((1.116, 2.051, 0.326), (-0.856, -0.219, -0.333), [(3.2369, 2.166, 0.5206)]),
    ],
)
def test_the_rough_test_loses_no_path_where_planes_cut_the_array_or_meet(
    room: Scene, receiver_m: tuple[float, float, float], boresight: tuple[float, float, float], tx_m: list[Any]
) -> None:
    scene = replace(room, receiver=replace(RECEIVER, position_m=receiver_m, boresight=boresight))
    settings = replace(SETTINGS, rays=20_000)
    pruned, every = (
        ImageTracer(scene, [1e9, 5e9], settings, replace(EXACT, prune=prune)).channel(np.array(tx_m))
        for prune in (True, False)
    )
    np.testing.assert_allclose(pruned.cfr, every.cfr, rtol=0, atol=1e-12 * np.abs(every.cfr).max())
    np.testing.assert_array_equal(pruned.num_paths, every.num_paths)


def channel_among(tx: list[list[float]], *surfaces: Surface, receiver: ReceiverArray = ALONE) -> np.ndarray:
    scene = Scene(name="test", receiver=receiver, transmitters=GRID, surface=surfaces)
    settings = replace(SETTINGS, max_depth=2, rays=2000)
    return ImageTracer(scene, [1e9, 5e9], settings, EXACT).channel(np.array(tx)).cfr


def test_what_meets_a_facet_in_the_plane_that_it_shares_is_found_in_its_box() -> None:
    sheets = [
        Surface("one", "metal", 0.002, (0.0, 0.0, 1.0), (1.0, 1.0, 1.0)),
        Surface("other", "metal", 0.002, (1.0, 0.0, 1.00009), (1.9, 1.0, 1.00009)),
    ]
    beyond = replace(ALONE, position_m=(5.0, 0.5, 0.96004))  # the second is met in the first one's plane alone
    assert not channel_among([[-4.0, 0.5, 1.05004]], *sheets, receiver=beyond).any()


def test_any_number_of_facets_on_each_other_are_one() -> None:
    tx = [[0.3, 0.2, 0.4], [1.4, -0.3, 0.2], [0.2, 0.1, 2.3]]
    sheet = Surface("sheet", "glass", 0.005, (-2.0, -2.0, 0.9), (2.0, 2.0, 0.9))
    many = (replace(sheet, name=f"sheet {number}") for number in range(40))
    one, several = channel_among(tx, sheet), channel_among(tx, *many)
    np.testing.assert_allclose(several, one, rtol=0, atol=1e-12 * np.abs(one).max())


def test_metal_blocks_on_whichever_side_of_wood_it_lies() -> None:
    wood = Surface("wood", "wood", 0.02, (-2.0, -2.0, 0.9), (2.0, 2.0, 0.9))
    metal = Surface("metal", "metal", 0.002, (-1.0, -1.5, 0.9), (1.5, 1.0, 0.9))
    for sheets in ((wood, metal), (metal, wood)):
        assert not channel_among([[0.1, 0.2, 0.3], [-0.3, -0.2, 0.5]], *sheets).any()


@pytest.mark.parametrize("num_facets", [1, 2, 700])
def test_the_boxes_of_a_tree_hold_each_facet_once(num_facets: int) -> None:
    generator = np.random.default_rng(5)
    low_m = generator.uniform(0, 4, (num_facets, 3))
    high_m = low_m + generator.exponential(0.1, (num_facets, 3)) * generator.integers(0, 2, (num_facets, 3))
    low_m[: num_facets // 3] = low_m[0]  # many in the same place
    high_m[: num_facets // 3] = high_m[0]
    order, box, child, first, last = grow(low_m, high_m)
    np.testing.assert_array_equal(np.sort(order), np.arange(num_facets))
    held, waiting = [], [(0, 0)]
    while waiting:
        index, depth = waiting.pop()
        assert depth < MAX_BOXES
        if child[index] < 0:
            inside = order[first[index] : last[index]]
            held += inside.tolist()
            assert (low_m[inside] >= box[index, :3]).all()
            assert (high_m[inside] <= box[index, 3:]).all()
            continue
        for part in (child[index], child[index] + 1):
            assert (box[part, :3] >= box[index, :3]).all()
            assert (box[part, 3:] <= box[index, 3:]).all()
            waiting.append((int(part), depth + 1))
    assert sorted(held) == list(range(num_facets))


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


def test_straight_ways_cross_every_triangle_between_their_ends(room: Scene) -> None:
    settings = replace(SETTINGS, interactions=("refraction",))
    tracer, meshes = ImageTracer(room, CARRIERS_HZ, settings), surface_meshes(room)
    corners_m = triangle_corners_m(meshes)
    is_metal = np.repeat([mesh.material == "metal" for mesh in meshes], [len(mesh.triangles) for mesh in meshes])
    receiver_m, seen = np.array(room.receiver.position_m), set()
    for start_m in random_places_m(400, 3):
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


def lone(room: Scene, place_m: np.ndarray) -> Scene:
    """The room with one vertical element at a place."""
    return replace(room, receiver=ReceiverArray(position_m=tuple(place_m.tolist()), rows=1, cols=1))


def test_transmitter_and_receiver_may_change_places(room: Scene) -> None:
    """V antennas, reflections at the shell, crossings of the furniture, and the edges of its flat parts."""
    for ends_m in random_places_m(6, 4).reshape(3, 2, 3):
        forward, backward = (
            ImageTracer(lone(room, rx), CARRIERS_HZ, DIFFRACTING, ImageSavings(diffraction_floor=0.0)).channel(tx[None])
            for rx, tx in (ends_m, ends_m[::-1])
        )
        np.testing.assert_array_equal(forward.num_paths, backward.num_paths)
        np.testing.assert_allclose(forward.cfr, backward.cfr, rtol=0, atol=1e-9 * np.abs(forward.cfr).max())


@pytest.mark.parametrize(("rows", "cols"), [(4, 4), (3, 5)])
def test_an_element_hears_what_a_receiver_in_its_place_hears(room: Scene, rows: int, cols: int) -> None:
    every_path = ImageSavings(field_nodes_per_axis=5, diffraction_floor=0.0)
    settings, receiver = replace(DIFFRACTING, rays=200_000), replace(RECEIVER, rows=rows, cols=cols)
    tx = random_places_m(6, 5)
    array = ImageTracer(replace(room, receiver=receiver), [1e9], settings, every_path).channel(tx).cfr[:, 0]
    places_m = receiver.element_position_m(SPEED_OF_LIGHT_M_S / 1e9)
    for element in (0, 5, rows * cols - 1):
        own = ImageTracer(lone(room, places_m[element]), [1e9], settings, every_path).channel(tx).cfr[:, 0, 0]
        np.testing.assert_allclose(array[:, element], own, rtol=0, atol=1e-9 * np.abs(own).max())


def test_with_weak_paths_left_out_an_element_hears_what_a_lone_one_does_to_a_thousandth(room: Scene) -> None:
    tx_m, settings = random_places_m(12, 7), replace(DIFFRACTING, rays=200_000)
    array = ImageTracer(room, [24.25e9], settings).channel(tx_m).cfr[:, 0]
    places_m = room.receiver.element_position_m(SPEED_OF_LIGHT_M_S / 24.25e9)
    strength = np.sqrt((np.abs(array) ** 2).mean(axis=1))
    for element in (0, 6, 15):
        own = ImageTracer(lone(room, places_m[element]), [24.25e9], settings).channel(tx_m).cfr[:, 0, 0]
        assert (np.abs(array[:, element] - own) / strength).max() < 1e-3


def test_fields_that_are_interpolated_over_the_array_are_off_by_less_than_a_thousandth(room: Scene) -> None:
    tx_m, settings = random_places_m(12, 7), replace(DIFFRACTING, rays=100_000)
    fast, exact = (
        ImageTracer(room, CARRIERS_HZ, settings, savings).channel(tx_m).cfr for savings in (ImageSavings(), EXACT)
    )
    rms = np.sqrt((np.abs(exact) ** 2).mean(axis=2, keepdims=True))
    assert 1e-6 < (np.abs(fast - exact) / rms).max() < 1e-3


@pytest.mark.parametrize(
    "move",
    [
        trimesh.transformations.translation_matrix([8.0, -4.0, 0.5]),  # by float32 coordinates a micrometre off
        trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1]).round(),
    ],
    ids=["shifted", "turned"],
)
def test_a_furnished_room_that_is_moved_has_the_same_channels_to_a_thousandth(
    room: Scene, tmp_path: Path, move: np.ndarray
) -> None:
    tx_m, settings = random_places_m(8, 8), replace(DIFFRACTING, rays=200_000)
    here, there = (
        ImageTracer(lone(scene, np.array(scene.receiver.position_m)), CARRIERS_HZ, settings).channel(places_m).cfr
        for scene, places_m in (
            (room, tx_m),
            (furnished_room(tmp_path, move=move), trimesh.transform_points(tx_m, move)),
        )
    )
    assert (np.abs(there - here) / np.abs(here).max(axis=1, keepdims=True)).max() < 1e-3


def test_the_paths_of_a_furnished_room_add_up_to_its_channel(room: Scene) -> None:
    tracer = ImageTracer(lone(room, np.array(RECEIVER.position_m)), CARRIERS_HZ, replace(DIFFRACTING, rays=20_000))
    num_diffracted = 0
    for tx in random_places_m(6, 6):
        paths, cfr = tracer.paths(tx), tracer.channel(tx[None]).cfr[0, :, 0]
        np.testing.assert_allclose(cfr_at_centre(paths), cfr, rtol=0, atol=1e-8 * np.abs(paths.gain).max())
        num_diffracted += int((paths.interactions == DIFFRACTION).any(axis=1).sum())
    assert num_diffracted > 20


@pytest.mark.sionna
@pytest.mark.parametrize(("mirrors", "limit_db"), [("patches", 40), ("facets", 25)])
def test_both_solvers_reflect_at_the_same_mirrors(tmp_path: Path, mirrors: str, limit_db: float) -> None:
    """Where every facet of a round cushion mirrors, rays find the paths by them by chance."""
    from xfreqbench.tracing.sionna.tracer import SionnaTracer

    scene = replace(furnished_room(tmp_path, subdivisions=2), mirrors=mirrors)
    settings = replace(SETTINGS, max_depth=3)
    image = ImageTracer(scene, CARRIERS_HZ, settings).channel(TX_M).cfr
    sionna = SionnaTracer(scene, CARRIERS_HZ, replace(settings, rays=400_000)).channel(TX_M).cfr
    assert np.median(error_db(image, sionna)) > limit_db


def test_auto_takes_the_image_method_where_few_patches_mirror(room: Scene) -> None:
    plain, facets = TraceSettings(interactions=("specular", "refraction")), replace(room, mirrors="facets")
    assert resolve_solver(Geometry(surface_meshes(room)), plain).solver == "image"
    many = Geometry([*surface_meshes(facets)] * 2)
    assert resolve_solver(many, plain).solver == "sionna"
    with pytest.raises(SceneError, match="mirrors = 'patches'"):
        ImageTracer(facets, CARRIERS_HZ, SETTINGS, geometry=many)


def test_many_triangles_in_a_plane_mirror_and_diffract_as_one_rectangle(tmp_path: Path) -> None:
    xml = write_meshes(tmp_path, {"plate": ("wood", plate(2.0, 0.5, pieces=31))})
    cut = Scene("cut", RECEIVER, GRID, scene=xml, folder=tmp_path)
    whole = replace(cut, scene=None, surface=(Surface("plate", "wood", 0.02, (0, 0, 0.5), (2, 2, 0.5)),))
    tx = np.array([[1.3, 0.8, 1.2], [1.1, 1.9, 0.2]])
    cfr, expected = (
        ImageTracer(scene, CARRIERS_HZ, replace(DIFFRACTING, rays=2000), EXACT).channel(tx).cfr
        for scene in (cut, whole)
    )
    np.testing.assert_allclose(cfr, expected, rtol=0, atol=1e-6 * np.abs(expected).max())  # PLY: float32


def test_a_small_facet_stands_beside_a_large_one(tmp_path) -> None:
    """A millimetre of metal on the line of sight blocks it, under a floor of a kilometre."""
    speck = plate(1e-3, 0.0).apply_translation([0.9995, 0.9995, 1.5])
    xml = write_meshes(tmp_path, {"floor": ("wood", plate(1000.0, 0.0)), "speck": ("metal", speck)})
    receiver = replace(RECEIVER, rows=1, cols=1, position_m=(1.0, 1.0, 2.0))
    scene = Scene("speck", receiver, GRID, scene=xml, folder=tmp_path)
    tracer = ImageTracer(scene, CARRIERS_HZ, replace(SETTINGS, rays=1000))
    assert len(tracer.paths(np.array([1.0002, 1.0, 1.0])).delay_s) == 0  # the way by the floor is blocked too
    beside = tracer.paths(np.array([1.01, 1.0, 1.0]))
    np.testing.assert_allclose(beside.delay_s * SPEED_OF_LIGHT_M_S, np.hypot(0.01, [1.0, 3.0]), rtol=1e-7)


def test_an_array_may_straddle_a_shadow(tmp_path) -> None:
    """The edge of a metal sheet lets half of the elements see the transmitter."""
    sheet = plate(1.0, 1.5).apply_translation([RECEIVER.position_m[0] - 1.0, 1.0, 0.0])
    xml = write_meshes(tmp_path, {"sheet": ("metal", sheet)})
    scene = Scene("shadow", RECEIVER, GRID, scene=xml, folder=tmp_path)
    x, y, z = RECEIVER.position_m
    below = np.array([[x, y, 2 * 1.5 - z]])  # as far below the sheet as the array is above
    h = ImageTracer(scene, [2.4e9], replace(SETTINGS, rays=1000)).channel(below).cfr[0, 0]
    is_seen = RECEIVER.element_position_m(SPEED_OF_LIGHT_M_S / 2.4e9)[:, 0] > x
    np.testing.assert_array_equal(h != 0, is_seen)


def test_a_channel_depends_neither_on_the_order_of_carriers_nor_on_what_else_is_asked_for(room: Scene) -> None:
    settings = replace(DIFFRACTING, rays=2000)
    forward, backward, some = (
        ImageTracer(room, hz, settings) for hz in (CARRIERS_HZ, CARRIERS_HZ[::-1], CARRIERS_HZ[1:])
    )
    whole = forward.channel(TX_M).cfr
    np.testing.assert_array_equal(backward.channel(TX_M).cfr, whole[:, ::-1])
    np.testing.assert_array_equal(forward.paths(TX_M[0]).gain, backward.paths(TX_M[0]).gain[::-1])
    np.testing.assert_allclose(some.channel(TX_M[::-2]).cfr, whole[::-2, 1:], rtol=0, atol=1e-6 * np.abs(whole).max())


@pytest.mark.parametrize(
    ("outline_m", "area_m2", "num_facets"),
    [
        ([[0, 0], [1, 0], [1, 1], [0, 1]], 1.0, 1),
        ([[0, 0], [2, 0], [2.5, 1], [0.5, 1]], 2.0, 1),
        ([[0, 0], [1, 0], [0, 1]], 0.5, 1),
        ([[0, 0], [2, 0], [2, 1], [1, 2], [0, 1]], 3.0, 3),  # a fan
        ([[1, 1], [1, 2], [0, 2], [0, 0], [2, 0], [2, 1]], 3.0, None),  # an L, which stays as it is divided
    ],
)
def test_a_convex_patch_is_as_few_facets_as_it_can_be(
    outline_m: list[list[float]], area_m2: float, num_facets: int | None
) -> None:
    fan = [[0, k, k + 1] for k in range(1, len(outline_m) - 1)]
    sheet = trimesh.Trimesh([[*at, 0.0] for at in outline_m], fan, process=False).subdivide().subdivide()
    tilted_m = trimesh.transformations.euler_matrix(0.3, 0.7, -0.4)[:3, :3] @ sheet.vertices.T
    mesh = SurfaceMesh("sheet", "wood", 0.02, tilted_m.T, sheet.faces, least_patch=PatchSize(0.1, 0.1))
    mirrors = MirrorPlanes(Geometry([mesh]))
    corners_m = [corners for corners, *_ in mirrors.facets]
    sides_m = [(corners[1] - corners[0], corners[-1] - corners[0]) for corners in corners_m]
    share = [0.5 if len(corners) == 3 else 1.0 for corners in corners_m]
    areas_m2 = np.linalg.norm([np.cross(*sides) for sides in sides_m], axis=1) * share
    assert np.isclose(areas_m2.sum(), area_m2)
    assert len(mirrors.planes) == 1
    assert len(mirrors.facets) == num_facets if num_facets else len(mirrors.facets) > 10
    # a sheet that shows its front to both sides is not one facet
    both = replace(mesh, triangles=np.concatenate([sheet.faces, sheet.faces[:, ::-1]]))
    assert len(MirrorPlanes(Geometry([both])).facets) > 1


def test_an_edge_that_is_hidden_from_the_array_is_left_out_for_all_transmitters(room: Scene) -> None:
    lid = Surface("lid", "metal", 0.002, (0.0, 0.0, 2.2), (4.0, 3.0, 2.2))
    open_, closed = (
        ImageTracer(replace(room, surface=(*room.surface, *lids)), CARRIERS_HZ, DIFFRACTING).diffraction
        for lids in ((), (lid,))
    )
    assert open_ is not None and closed is not None
    lowest_m = [diffraction.room.wedges.start[:, 2].min() for diffraction in (open_, closed)]
    assert lowest_m[0] < 1 and lowest_m[1] > 2.1  # the furniture is below the lid


def edges_of(*surfaces: Surface) -> list[Edge]:
    mirrors = Geometry(surface_meshes(Scene("edges", RECEIVER, GRID, surface=surfaces))).facets
    return find_edges(mirrors, np.zeros((0, 3, 3)), np.zeros(0, np.int64))


@pytest.mark.parametrize(("gap_m", "num_edges"), [(0.004, 6), (0.02, 8)])
def test_a_groove_between_two_planks_has_no_edges(gap_m: float, num_edges: int) -> None:
    planks = [
        Surface(name, "wood", 0.02, (left_m, 0.0, 0.0), (left_m + 1.0, 1.0, 0.0))
        for name, left_m in (("left", 0.0), ("right", 1.0 + gap_m))
    ]
    edges = edges_of(*planks)
    assert len(edges) == num_edges
    assert all(edge.length_m == 1.0 and np.isclose(edge.angle_rad, 2 * np.pi) for edge in edges)


def test_a_side_is_an_edge_only_beyond_the_plate_on_which_a_part_of_it_stands() -> None:
    plate = Surface("plate", "wood", 0.02, (-1.0, -1.0, 0.0), (1.3, 1.0, 0.0))
    screen = Surface("screen", "wood", 0.02, (0.0, 0.0, 0.0), (2.0, 0.0, 1.0))
    below = [edge for edge in edges_of(plate, screen) if edge.start_m[2] == edge.start_m[1] == edge.along[2] == 0]
    assert [edge.surfaces for edge in below] == [(1, 1)]
    ends_m = sorted(edge_m[0] for edge in below for edge_m in (edge.start_m, edge.start_m + edge.length_m * edge.along))
    np.testing.assert_allclose(ends_m, [1.3, 2.0])
