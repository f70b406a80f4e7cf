"""Planes to fractions of a millimetre by all carriers together: free-standing rooms of plane waves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source.search.cross_terms import CrossTerms
from xfreqbench.baselines.virtual_source.search.planes import Plane
from xfreqbench.baselines.virtual_source.search.range_profile import find_more_planes, find_planes, random_planes
from xfreqbench.baselines.virtual_source.search.selection import mirrored_receivers_m

from tests.support.mirrored_room import RECEIVER, Room, Wall, tilt_rad
from xfreqbench.data.dataset import PasDataset

CARRIER_HZ = np.array([1e9, 2.4e9, 5e9, 10e9, 24.25e9, 39e9, 60e9, 94e9])
WALL = Wall(azimuth_deg=17.0, elevation_deg=0.0, distance_m=4.63)
SIDE = Wall(azimuth_deg=-94.0, elevation_deg=0.0, distance_m=3.1, reflection=-0.4)
FLOOR = Wall(azimuth_deg=0.0, elevation_deg=-90.0, distance_m=2.45, reflection=-0.5j)
FACET = Wall(azimuth_deg=197.0, elevation_deg=0.0, distance_m=3.9, lit_beyond_y_m=3.4)
CORNER = Wall(azimuth_deg=17.0 - 90, elevation_deg=0.0, distance_m=3.4, reflection=-0.4)  # with `WALL`
WALLS = WALL, SIDE, FLOOR, FACET  # a third of the room sees the last
ROOM = Room(WALLS, CARRIER_HZ, num_tx=280)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return ROOM.stored(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="module")
def searched(room: PasDataset) -> tuple[list[Plane], int]:
    """The planes found, and how often the search asked whether its time was over."""
    asked: list[bool] = []
    return find_planes(room, 0, lambda: bool(asked.append(False))), len(asked)


@pytest.fixture(scope="module")
def found(searched: tuple[list[Plane], int]) -> list[Plane]:
    return searched[0]


def tried(times: int) -> Callable[[], bool]:
    """An `is_over` that is True once it was asked more than some times."""
    left = iter(range(times))
    return lambda: next(left, None) is None


@pytest.mark.slow
def test_a_search_whose_time_is_over_ends_with_planes_that_it_would_have_found_anyway(
    room: PasDataset, searched: tuple[list[Plane], int]
) -> None:
    found, num_asked = searched
    assert find_planes(room, 0, tried(0)) == find_planes(room, 0, tried(num_asked // 10)) == []
    assert set() < places(find_planes(room, 0, tried(num_asked * 9 // 10))) < places(found)


def test_another_look_whose_time_is_over_finds_nothing_more(room: PasDataset, found: list[Plane]) -> None:
    known = [the_one(found, WALL)]
    assert find_more_planes(room, known, lambda rows: room.cfr[rows][None] * 0.5, tried(1)) == []


def places(planes: Sequence[Plane]) -> set[tuple[float, ...]]:
    return {(*plane.normal, plane.distance_m) for plane in planes}


def the_one(planes: Sequence[Plane], wall: Wall) -> Plane:
    return max(planes, key=lambda plane: float(plane.normal @ wall.normal))


def assert_found(planes: Sequence[Plane], walls: Sequence[Wall]) -> None:
    """Exactly the walls, to a fifteenth of the shortest wavelength."""
    assert len(planes) == len(walls)
    for wall in walls:
        plane = the_one(planes, wall)
        assert abs(plane.distance_m - wall.distance_m) < 2e-4
        assert tilt_rad(plane.normal, wall) < 5e-4  # a quarter of that wavelength over the transmitters' metres


def test_planes_are_found_to_a_fifth_of_a_millimetre_and_one_lit_from_a_third_of_the_room_too(
    found: list[Plane],
) -> None:
    assert_found(found, WALLS)
    scores = [plane.score for plane in found]
    assert scores == sorted(scores, reverse=True)


def test_standard_deviations_cover_errors(found: list[Plane]) -> None:
    for wall in WALLS:
        plane = the_one(found, wall)
        assert abs(plane.distance_m - wall.distance_m) < 4 * plane.distance_std_m < 2e-3
        assert plane.distance_std_m > 5e-5  # because of layers behind a surface, of which these walls have none
        assert tilt_rad(plane.normal, wall) < 4 * plane.tilt_std_rad


@pytest.mark.slow
def test_maps_of_eight_bits_tell_the_planes_that_channels_tell(tmp_path: Path) -> None:
    assert_found(find_planes(ROOM.stored_maps(tmp_path, "amplitude", 255), 0), WALLS)


def test_what_is_explained_is_not_found_again(room: PasDataset, found: list[Plane]) -> None:
    assert find_more_planes(room, found[:1], lambda rows: room.cfr[rows][None].astype(complex)) == []


def test_what_is_not_explained_yet_is_found_along_known_normals(room: PasDataset, found: list[Plane]) -> None:
    known = replace(ROOM, walls=(WALL, SIDE, FLOOR)).cfr().reshape(-1, len(RECEIVER.element_position_wavelengths))
    planes = find_more_planes(room, [the_one(found, WALL)], lambda rows: known[rows][None])
    assert abs(planes[0].distance_m - FACET.distance_m) < 2e-4
    assert tilt_rad(planes[0].normal, FACET) < 5e-4


def test_a_wall_at_right_angles_to_the_only_one_known_is_found_too(tmp_path: Path, found: list[Plane]) -> None:
    corner = Wall(azimuth_deg=WALL.azimuth_deg - 90, elevation_deg=0.0, distance_m=3.4, reflection=0.3)
    room = replace(ROOM, walls=(WALL, FLOOR, corner))
    known = replace(ROOM, walls=(WALL, FLOOR)).cfr().reshape(-1, len(RECEIVER.element_position_wavelengths))
    plane = find_more_planes(room.stored(tmp_path), [the_one(found, WALL)], lambda rows: known[rows][None])[0]
    assert abs(plane.distance_m - CORNER.distance_m) < 2e-4
    assert tilt_rad(plane.normal, CORNER) < 5e-4


@pytest.mark.slow
def test_transmitters_in_one_layer_make_no_floor_and_no_ceiling(tmp_path: Path) -> None:
    """A path from the floor is as long as one from a ceiling as far above the layer, and an array may hear both."""
    layer = replace(ROOM, walls=(WALL, SIDE, FLOOR), corners_m=((0.3, 0.3, 1.2), (6.2, 4.9, 1.2)))
    assert_found(find_planes(layer.stored(tmp_path), 0), (WALL, SIDE))


@pytest.mark.slow
def test_conjugated_channels_come_from_elsewhere_and_have_no_planes(tmp_path: Path) -> None:
    assert find_planes(ROOM.stored(tmp_path, ROOM.cfr().conj()), 0) == []


def test_random_planes_lie_within_the_scene_and_follow_their_seed(room: PasDataset) -> None:
    planes, again = random_planes(room, 3, 5), random_planes(room, 3, 5)
    reach_m = np.linalg.norm(ROOM.offset_m, axis=1).max()
    assert [plane.distance_m for plane in planes] == [plane.distance_m for plane in again]
    assert all(0 < plane.distance_m < reach_m for plane in planes)
    np.testing.assert_allclose([np.linalg.norm(plane.normal) for plane in planes], 1)


def test_few_transmitters_tell_of_walls_that_all_of_them_see(tmp_path: Path) -> None:
    few = replace(ROOM, walls=(WALL, SIDE, FLOOR), num_tx=60)
    planes = find_planes(few.stored(tmp_path), 0)
    for wall in few.walls:
        assert abs(the_one(planes, wall).distance_m - wall.distance_m) < 5e-4
    assert len(planes) == 3


@pytest.mark.slow
@pytest.mark.parametrize(("num_tx", "walls"), [(36, (WALL, CORNER, FLOOR)), (33, (CORNER, FLOOR))])
def test_fewer_tell_of_more_walls_than_show_by_themselves(num_tx: int, walls: Sequence[Wall], tmp_path: Path) -> None:
    """Of 36 one wall shows, and what is at right angles to it; of 33 none does, but where it may be is guessed."""
    room = replace(ROOM, walls=(WALL, CORNER, FLOOR), num_tx=num_tx).stored(tmp_path)
    images_m = mirrored_receivers_m(CrossTerms.of(room), 0)
    assert len(images_m) == len(walls) - 1
    planes = find_planes(room, 0)
    for wall in walls:
        assert abs(the_one(planes, wall).distance_m - wall.distance_m) < 5e-4
    assert len(planes) == len(walls)
