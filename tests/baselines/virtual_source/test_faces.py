"""Faces from the cells of planes: synthetic cells, of which it is known what they hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from xfreqbench.baselines.virtual_source.field.images import Mirrors
from xfreqbench.baselines.virtual_source.room.faces import Cells, Face, best_rectangles, faces, walls

from tests.support.box_room import SIZE_M

ARRAY_M = np.array([2.1, 1.7, 2.5])
CELL_M = 0.3
TX_M = np.array([[0.4, 0.4, 0.8], [4.6, 3.6, 1.6]]) - ARRAY_M
EMPTY, THICK, THIN = np.eye(3)
NOWHERE, EVERYWHERE = (lambda point_m: point_m[..., 0] > np.inf), (lambda point_m: point_m[..., 0] > -np.inf)

Where = Callable[[np.ndarray], np.ndarray]


def cells(axis: int, at_m: float, thick: Where, thin: Where = NOWHERE, seen: Where = EVERYWHERE) -> Cells:
    """Cells of a plane across a world axis that hold slabs where functions of world points say so."""
    normal = np.eye(3)[axis] * np.sign(at_m - ARRAY_M[axis])
    distance_m = abs(at_m - ARRAY_M[axis])
    mirror = Mirrors.of_tensors(torch.tensor(normal[None]), torch.tensor([distance_m]))
    axes = mirror.axes[0].numpy()
    low_m, count = np.array([-6.0, -6.0]), (41, 41)
    grid = low_m + CELL_M * np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), -1)
    point_m = ARRAY_M + distance_m * normal + grid @ axes
    share = np.where(thin(point_m)[..., None], THIN, np.where(thick(point_m)[..., None], THICK, EMPTY))
    power = np.where(seen(point_m), 1.0, 0.0)
    return Cells(normal, distance_m, axes, low_m, CELL_M, share, power)


def in_room(point_m: np.ndarray) -> np.ndarray:
    return ((point_m > -1e-9) & (point_m < np.array(SIZE_M) + 1e-9)).all(-1)


def between(low_m: tuple[float, ...], high_m: tuple[float, ...]) -> Where:
    return lambda point_m: ((point_m > np.array(low_m)) & (point_m < np.array(high_m))).all(-1)


def box(**changed: Cells) -> list[Cells]:
    """Six walls that hold a thick slab everywhere, some of them replaced."""
    return [
        changed.get(f"{'xyz'[axis]}{side}", cells(axis, side * SIZE_M[axis], in_room, seen=in_room))
        for axis in range(3)
        for side in range(2)
    ]


def bounds_m(face: Face) -> np.ndarray:
    corners_m = ARRAY_M + face.corners_m
    return np.array([corners_m.min(0), corners_m.max(0)])


def area_m2(face: Face) -> float:
    edges_m = face.corners_m[1:] - face.corners_m[0]
    return float(np.linalg.norm(np.cross(edges_m[:-1], edges_m[1:]).sum(0)) / 2)


def test_the_walls_of_a_box_meet_at_its_edges() -> None:
    found = faces(box(), TX_M)
    assert [(face.plane, face.slab, face.is_wall) for face in found] == [(plane, 0, True) for plane in range(6)]
    for face in found:
        axis, side = divmod(face.plane, 2)
        low_m, high_m = np.zeros(3), np.array(SIZE_M)
        low_m[axis] = high_m[axis] = side * SIZE_M[axis]
        np.testing.assert_allclose(bounds_m(face), [low_m, high_m], atol=1e-9)


def test_a_wall_is_whole_where_furniture_hides_it_and_no_path_tells_of_it() -> None:
    hidden = between((-1.0, 1.0, -1.0), (1.0, 2.5, 1.5))
    shadowed = cells(0, 0.0, lambda at_m: in_room(at_m) & ~hidden(at_m), seen=in_room)
    (wall,) = [face for face in faces(box(x0=shadowed), TX_M) if face.plane == 0]
    assert area_m2(wall) == pytest.approx(SIZE_M[1] * SIZE_M[2])


def test_a_window_is_cut_out_of_its_wall() -> None:
    window = between((-1.0, 1.1, 0.8), (1.0, 2.9, 2.0))
    pane = cells(0, 0.0, in_room, window, seen=in_room)
    found = [face for face in faces(box(x0=pane), TX_M) if face.plane == 0]
    (glass,) = [face for face in found if face.slab == 1]
    np.testing.assert_allclose(bounds_m(glass)[:, 1:], [[1.1, 0.8], [2.9, 2.0]], atol=CELL_M)
    assert sum(map(area_m2, found)) == pytest.approx(SIZE_M[1] * SIZE_M[2])
    assert all(face.is_wall for face in found)


def test_a_partition_reaches_the_walls_that_are_near_and_ends_where_it_ends() -> None:
    sheet = cells(0, 3.4, NOWHERE, between((3.0, 1.9, 0.2), (4.0, 3.8, 2.4)), between((3.0, 0.4, 0.2), (4.0, 3.8, 2.4)))
    (partition,) = [face for face in faces([*box(), sheet], TX_M) if face.plane == 6]
    assert partition.slab == 1
    assert not partition.is_wall
    assert 0 < partition.seen < 1
    low_m, high_m = bounds_m(partition)
    np.testing.assert_allclose([*low_m[::2], *high_m], [3.4, 0.0, 3.4, *SIZE_M[1:]], atol=1e-9)
    assert low_m[1] == pytest.approx(1.9, abs=CELL_M)


def test_a_doorway_is_left_open() -> None:
    doorway = between((3.0, 1.1, -1.0), (4.0, 2.0, 2.0))
    divider = cells(0, 3.4, lambda at_m: in_room(at_m) & ~doorway(at_m), seen=in_room)
    found = [face for face in faces([*box(), divider], TX_M) if face.plane == 6]
    width_m, height_m = 0.9 + CELL_M / 2, 2.0
    expected = SIZE_M[1] * SIZE_M[2] - width_m * height_m
    assert sum(map(area_m2, found)) == pytest.approx(expected, abs=CELL_M * (width_m + 2 * height_m))
    assert len(found) == 3
    in_it_m = np.array([3.4, 1.55, 1.0])
    for low_m, high_m in map(bounds_m, found):
        assert ((in_it_m < low_m - 1e-6) | (in_it_m > high_m + 1e-6)).any()


def test_images_of_surfaces_behind_a_wall_are_no_faces() -> None:
    behind = cells(0, SIZE_M[0] + 0.5, EVERYWHERE)
    found = faces([*box(), behind], TX_M)
    assert {face.plane for face in found} == set(range(6))
    assert 6 not in walls([*box(), behind], TX_M)


def test_a_wall_that_lies_wholly_behind_a_corner_has_no_faces() -> None:
    """A false plane, askew, in front of which all transmitters are, and of which the room's walls leave nothing."""
    corner = cells(0, SIZE_M[0] + 3.0, EVERYWHERE)
    askew = replace(
        corner,
        normal=np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0]),
        axes=np.array([[-np.sqrt(0.5), np.sqrt(0.5), 0.0], [0.0, 0.0, 1.0]]),
        distance_m=float(np.hypot(*SIZE_M[:2])) + 3.0,
    )
    planes = [*box(), askew]
    assert 6 in walls(planes, TX_M)
    assert {face.plane for face in faces(planes, TX_M)} == set(range(6))


def test_a_room_that_is_open_ends_with_what_its_planes_hold() -> None:
    found = faces(box()[2:], TX_M)  # without the walls across x
    floor = next(face for face in found if face.plane == 2)
    np.testing.assert_allclose(bounds_m(floor)[:, 0], [0.0, SIZE_M[0]], atol=CELL_M)


def test_a_plane_that_no_path_tells_of_has_no_faces() -> None:
    unknown = cells(0, 3.4, EVERYWHERE, seen=NOWHERE)
    assert not faces([unknown], TX_M)
    assert not faces([], TX_M)


def test_rectangles_of_largest_sum_are_found_in_turn() -> None:
    signed = np.full((9, 7), -1.0)
    signed[1:4, 1:6] = 1.0
    signed[6:8, 2:5] = 1.0
    signed[5, 0] = 1.0  # a single cell, which is too small
    found = [(low.tolist(), high.tolist()) for low, high in best_rectangles(signed)]
    assert found == [([1, 1], [3, 5]), ([6, 2], [7, 4])]


def test_the_largest_sum_is_that_of_a_search_through_all_rectangles() -> None:
    signed = np.random.default_rng(0).normal(size=(5, 6))
    sums = {
        (a, b, c, d): signed[a : c + 1, b : d + 1].sum()
        for a in range(5)
        for c in range(a, 5)
        for b in range(6)
        for d in range(b, 6)
    }
    low, high = next(best_rectangles(10 * signed))
    assert (*low.tolist(), *high.tolist()) == max(sums, key=lambda place: sums[place])
