"""Parts of a room that are displaced, and found again by the lengths of the paths that they reflect."""

from __future__ import annotations

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source.room.boxes import BoxFrame
from xfreqbench.baselines.virtual_source.room.lengths import (
    ReflectedPaths,
    RoomPart,
    around,
    motion_of,
    moved,
    parts_at,
    settled,
    sharpened,
)
from xfreqbench.baselines.virtual_source.room.surfaces import NamedSlab, RoomSurface, learned_surfaces, standing
from xfreqbench.baselines.virtual_source.room.traced import channels_in
from xfreqbench.baselines.virtual_source.search.cross_terms import LagAverages, never
from xfreqbench.baselines.virtual_source.stored import StoredFindings

from tests.support.found_box import ARRAY_M, SETTINGS, found_room, generated
from xfreqbench.data.dataset import PasDataset

NOWHERE_M = np.array([[50.0, 50.0, 50.0]])


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return generated(tmp_path_factory.mktemp("data"), settings=SETTINGS, tx=24)


@pytest.fixture(scope="module")
def room(dataset: PasDataset) -> list[RoomSurface]:
    findings = StoredFindings.model_validate(found_room())
    return learned_surfaces(findings, np.unique(dataset.carrier_hz).tolist(), NOWHERE_M)


@pytest.fixture(scope="module")
def lags(dataset: PasDataset) -> LagAverages:
    return LagAverages(dataset, never)


def place_m(room: list[RoomSurface], plane: int) -> float:
    """Distance of a plane from the array centre."""
    wall = next(surface for surface in room if surface.plane == plane)
    return float((wall.corners_m.mean(axis=0) - ARRAY_M) @ wall.normal)


def box(room: list[RoomSurface], low_m: list[float], high_m: list[float]) -> RoomSurface:
    frame = BoxFrame.of(room)
    corners_m = frame.along(np.array([low_m, high_m]))
    return frame.surface(np.sort(corners_m, axis=0), 99, NamedSlab("metal", 0.002, 0.0))


@pytest.mark.slow
def test_displaced_and_tilted_walls_are_put_back(
    dataset: PasDataset, room: list[RoomSurface], lags: LagAverages
) -> None:
    free_m = standing(dataset.header.receiver, dataset.carrier_hz, dataset.tx_position_m)
    planes = sorted({surface.plane for surface in room if surface.is_wall})
    wrong = moved(moved(room, RoomPart("wall", planes[0]), 0.006), RoomPart("wall", planes[1]), -0.003)
    wrong = moved(wrong, RoomPart("tilt", planes[2], 1), 0.001)
    found = settled(wrong, dataset, lags, free_m)
    score = ReflectedPaths.of(found, dataset, lags).score
    assert ReflectedPaths.of(wrong, dataset, lags).score < 0.98
    assert score > 0.995
    for plane in planes[:2]:
        assert place_m(found, plane) == pytest.approx(place_m(room, plane), abs=3e-4)
    normals = [next(surface.normal for surface in of if surface.plane == planes[2]) for of in (found, room)]
    np.testing.assert_allclose(*normals, atol=3e-4)


def test_walls_that_are_off_by_a_share_of_the_shortest_wave_are_put_right_at_once(
    dataset: PasDataset, room: list[RoomSurface], lags: LagAverages
) -> None:
    planes = sorted({surface.plane for surface in room if surface.is_wall})
    wrong = room
    for plane, by_m in zip(planes, (1e-4, -2e-4, 2e-4), strict=False):
        wrong = moved(wrong, RoomPart("wall", plane), by_m)
    wrong = moved(wrong, RoomPart("tilt", planes[-1], 1), 1e-4)
    found = sharpened(wrong, dataset, lags, NOWHERE_M)
    for plane in planes:
        assert place_m(found, plane) == pytest.approx(place_m(room, plane), abs=6e-5)
    normals = [next(surface.normal for surface in of if surface.plane == planes[-1]) for of in (found, room)]
    np.testing.assert_allclose(*normals, atol=3e-5)


def test_no_part_moves_where_it_would_be_too_near_to_a_transmitter(
    dataset: PasDataset, room: list[RoomSurface], lags: LagAverages
) -> None:
    wrong = moved(room, RoomPart("wall", room[0].plane), 2e-4)
    beside_m = wrong[0].corners_m.mean(axis=0)[None]
    found = sharpened(wrong, dataset, lags, beside_m)
    assert place_m(found, room[0].plane) == place_m(wrong, room[0].plane)


def test_what_channels_leave_of_rows_has_the_power_that_they_do_not_explain(
    dataset: PasDataset, room: list[RoomSurface], lags: LagAverages
) -> None:
    rows = np.arange(len(dataset))
    told = lags.of_channels(channels_in(room[1:], dataset)), lags.of_channels(2j * dataset.cfr[rows])
    for known in told:
        left = np.linalg.norm(lags.left(lags.measured(rows), known), axis=1)
        np.testing.assert_allclose(left**2, 1 - lags.likeness(lags.measured(rows), known), atol=1e-9)
    assert left.max() < 1e-6


def test_nothing_moves_where_all_is_right_or_no_time_is_left(
    dataset: PasDataset, room: list[RoomSurface], lags: LagAverages
) -> None:
    there = settled(room, dataset, lags, NOWHERE_M)
    for before, after in zip(room, there, strict=True):
        np.testing.assert_allclose(after.corners_m, before.corners_m, atol=3e-4)
    assert settled(room, dataset, lags, NOWHERE_M, lambda: True) == room


def test_likeness_without_tracing_again_is_that_of_the_room_with_the_part_moved(
    dataset: PasDataset, room: list[RoomSurface], lags: LagAverages
) -> None:
    by_m = 1e-3
    paths = ReflectedPaths.of(room, dataset, lags)
    part = next(strongest for strongest in paths.strongest_first if strongest.kind == "wall")
    predicted = paths.likeness(part, np.array([0.0, by_m]), np.arange(len(paths.carrier_hz)))
    rows = np.arange(len(dataset))
    there = moved(room, part, by_m)
    traced = lags.likeness(lags.measured(rows), lags.of_channels(channels_in(there, dataset)))
    assert predicted[1] == pytest.approx(traced.sum(), abs=0.01 * len(rows))
    assert predicted[1] < predicted[0]


@pytest.mark.parametrize("kind", ["front", "back", "side", "board"])
def test_a_face_of_a_box_moves_its_points_and_no_other(room: list[RoomSurface], kind: str) -> None:
    own = box(room, [1.0, 1.0, 0.70], [2.0, 2.0, 0.73])
    part = RoomPart(kind, 99, 1 if kind == "side" else 0)  # type: ignore[arg-type]
    there = moved([own], part, 0.01)[0]
    before, after = own.mesh.vertices_m, there.mesh.vertices_m
    change_m = np.linalg.norm(after - before, axis=1)
    assert (np.isclose(change_m, 0.01) | np.isclose(change_m, 0.0)).all()
    assert np.isclose(change_m, 0.01).sum() == (8 if kind == "board" else 4)
    still = np.flatnonzero(change_m > 1e-6)[0]
    np.testing.assert_allclose(after[still] - before[still], 0.01 * motion_of([own], part)(before[still]))


def test_a_point_belongs_to_the_face_that_it_lies_on(room: list[RoomSurface]) -> None:
    own = box(room, [1.0, 1.0, 0.3], [2.0, 2.0, 0.8])
    assert parts_at(own, np.array([1.5, 1.5, 0.8])) == [RoomPart("front", 99)]
    assert parts_at(own, np.array([1.5, 1.5, 0.3])) == [RoomPart("back", 99)]
    (side,) = parts_at(own, np.array([2.0, 1.5, 0.5]))
    np.testing.assert_allclose(own.outward[side.nth], [1.0, 0.0, 0.0], atol=1e-9)
    thin = box(room, [1.0, 1.0, 0.77], [2.0, 2.0, 0.8])
    assert parts_at(thin, np.array([1.5, 1.5, 0.8])) == [RoomPart("front", 99), RoomPart("board", 99)]


def test_displacements_begin_with_none_and_reach_as_far_as_asked() -> None:
    by_m = around(0.01, 0.03)
    assert by_m[0] == 0
    assert sorted(by_m.tolist()) == pytest.approx([-0.03, -0.02, -0.01, 0, 0.01, 0.02, 0.03])
