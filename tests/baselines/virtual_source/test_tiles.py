"""A door in a wall: its sides are moved to where they are, and the wall stays whole around it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source.room.changes import Trial, with_patches, without_patches
from xfreqbench.baselines.virtual_source.room.faces import tidied
from xfreqbench.baselines.virtual_source.room.refine import Refinement
from xfreqbench.baselines.virtual_source.room.surfaces import NamedSlab, RoomSurface, learned_surfaces
from xfreqbench.baselines.virtual_source.room.traced import COMPARING
from xfreqbench.baselines.virtual_source.search.cross_terms import never
from xfreqbench.baselines.virtual_source.stored import StoredFindings

from tests.support.found_box import SCENE, SETTINGS, SIZE_M, found_room, generated
from xfreqbench.scene.model import Surface

GLASS, METAL = NamedSlab("glass", 0.01, 0.0), NamedSlab("metal", 0.002, 0.0)
NORTH = [surface.name for surface in SCENE.surface].index("north")
NOWHERE_M = np.array([[50.0, 50.0, 50.0]])
Sides = tuple[float, float, float, float]  # west, east, bottom, top


def wall_of(*parts: tuple[Sides, NamedSlab]) -> list[Surface]:
    """The north wall in parts."""
    return [
        Surface(f"north {number}", slab.material, slab.thickness_m, (west, 4.0, low), (east, 4.0, high))
        for number, ((west, east, low, high), slab) in enumerate(parts)
    ]


def with_door(west: float, east: float, top: float) -> list[tuple[Sides, NamedSlab]]:
    """The parts of the wall with a door, which stands on the floor."""
    around = [(0.0, west, 0.0, 2.6), (east, 5.0, 0.0, 2.6), (west, east, top, 2.6)]
    return [((west, east, 0.0, top), METAL), *((sides, GLASS) for sides in around)]


def room_with(parts: list[tuple[Sides, NamedSlab]]) -> list[RoomSurface]:
    """The learned box with the north wall in parts."""
    room = learned_surfaces(StoredFindings.model_validate(found_room()), [2.4e9, 60e9], NOWHERE_M)
    north = room[NORTH]
    tiles = [
        replace(
            north,
            number=20 + number,
            slab=slab,
            found_slab=int(slab == METAL),
            corners_m=np.array([[west, 4.0, low], [east, 4.0, low], [east, 4.0, top], [west, 4.0, top]]),
        )
        for number, ((west, east, low, top), slab) in enumerate(parts)
    ]
    return [*(tile for tile in room if tile is not north), *tiles]


def door_of(room: list[RoomSurface]) -> RoomSurface:
    (door,) = [tile for tile in room if tile.plane == NORTH and tile.slab == METAL]
    return door


def test_one_side_of_a_door_moves_and_the_wall_stays_whole() -> None:
    room = room_with(with_door(1.0, 2.0, 2.0))
    changed = list(with_patches(NORTH, room))
    assert len(changed) > 20
    for there in changed:
        numbers = [tile.number for tile in there]
        assert len(set(numbers)) == len(numbers)
        tiles = [tile for tile in there if tile.plane == NORTH]
        assert sum(tile.area_m2 for tile in tiles) == pytest.approx(SIZE_M[0] * SIZE_M[2])
        inside_m = np.random.default_rng(0).uniform([0, 0], [5, 2.6], (200, 2))
        low_m, high_m = (
            np.array([side(tile.corners_m[:, [0, 2]], axis=0) for tile in tiles]) for side in (np.min, np.max)
        )
        holds = ((inside_m[:, None] > low_m) & (inside_m[:, None] < high_m)).all(axis=2)
        assert (holds.sum(axis=1) == 1).all()
        moved_m = door_of(there).corners_m - door_of(room).corners_m
        assert np.count_nonzero(np.abs(moved_m).max(axis=1) > 1e-9) == 2
        assert [tile for tile in there if tile.plane != NORTH] == [tile for tile in room if tile.plane != NORTH]


def test_patches_that_would_overlap_are_not_tried() -> None:
    parts = [((1.0, 2.0, 0.0, 2.6), METAL), ((2.1, 3.0, 0.0, 2.6), METAL)]
    parts += [(sides, GLASS) for sides in ((0, 1.0, 0, 2.6), (2.0, 2.1, 0, 2.6), (3.0, 5.0, 0, 2.6))]
    for there in with_patches(NORTH, room_with(parts)):
        west, east = sorted(
            (tile.corners_m[:, 0].min(), tile.corners_m[:, 0].max()) for tile in there if tile.slab == METAL
        )
        assert west[1] <= east[0] + 1e-9


def test_a_wall_of_one_slab_has_nothing_to_move() -> None:
    assert list(with_patches(0, room_with(with_door(1.0, 2.0, 2.0)))) == []


@pytest.mark.slow
def test_a_door_is_put_where_paths_tell_of_it(tmp_path: Path) -> None:
    others = [surface for surface in SCENE.surface if surface.name != "north"]
    scene = replace(SCENE, surface=(*others, *wall_of(*with_door(1.0, 2.0, 2.0))))
    settings = replace(SETTINGS, max_depth=COMPARING.max_depth)
    dataset = generated(tmp_path, scene, settings, tx=60)
    told = Refinement.of(StoredFindings.model_validate(found_room()), dataset)
    told.room = room_with(with_door(1.2, 2.0, 2.3))
    told._change(Trial(partial(with_patches, NORTH), at_lowest=True), never)
    door_m = door_of(told.room).corners_m
    np.testing.assert_allclose(door_m.min(axis=0), [1.0, 4.0, 0.0], atol=0.06)
    np.testing.assert_allclose(door_m.max(axis=0), [2.0, 4.0, 2.0], atol=0.06)


def test_corners_that_are_hardly_there_are_left_out() -> None:
    square = np.array([[0.0, 0.0], [0.5, 1e-7], [1.0, 0.0], [1.0, 1e-9], [1.0, 1.0], [0.0, 1.0]])
    assert len(tidied(square)) == 4
    assert len(tidied(square[:4])) == 0


def test_a_rectangle_that_is_not_there_becomes_the_wall_around_it() -> None:
    room = room_with([*with_door(1.0, 2.0, 2.0)[:1], *with_door(3.0, 4.0, 2.0)[:1], *with_door(1.0, 2.0, 2.0)[1:]])
    rooms = list(without_patches(NORTH, room))
    numbers = [[tile.number for tile in one if tile.slab == METAL] for one in rooms]
    assert numbers == [[], [21], [20]]
    assert {(tile.slab, tile.found_slab) for tile in rooms[0] if tile.plane == NORTH} == {(GLASS, 0)}
    assert not list(without_patches(NORTH, rooms[0]))
