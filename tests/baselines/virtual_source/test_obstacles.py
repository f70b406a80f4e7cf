"""What stands in a room though no plane of it was found, by the paths that it hides."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from xfreqbench.baselines.virtual_source.room import boxes, refine
from xfreqbench.baselines.virtual_source.room.boxes import BoxFrame, holds_any
from xfreqbench.baselines.virtual_source.room.changes import Trial, without_patches
from xfreqbench.baselines.virtual_source.room.obstacle_kernels import hidden_by
from xfreqbench.baselines.virtual_source.room.obstacles import obstacles
from xfreqbench.baselines.virtual_source.room.refine import BoxFit, Refinement
from xfreqbench.baselines.virtual_source.room.surfaces import NamedSlab, RoomSurface, standing
from xfreqbench.baselines.virtual_source.search.cross_terms import never
from xfreqbench.baselines.virtual_source.stored import StoredFindings

from tests.support.found_box import ARRAY_M, SCENE, found_room, generated
from xfreqbench.data.dataset import PasDataset
from xfreqbench.maps.bartlett import PasKind
from xfreqbench.scene.model import Surface

CRATE_M = np.array([[0.7, 2.2, 0.02], [1.8, 3.1, 0.7]])
CRATE = Surface("crate", "metal", 0.002, tuple(CRATE_M[0].tolist()), tuple(CRATE_M[1].tolist()))
FURNISHED = replace(SCENE, surface=(*SCENE.surface, CRATE))
METAL = NamedSlab("metal", 0.002, 0.0)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return generated(tmp_path_factory.mktemp("data"), FURNISHED, tx=36)


@pytest.fixture(scope="module")
def empty_room(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return generated(tmp_path_factory.mktemp("data"), tx=12)


@pytest.fixture
def unsettled(monkeypatch: pytest.MonkeyPatch) -> None:
    """A box is left where it was put: `test_lengths` settles rooms."""
    monkeypatch.setattr(refine, "settled", lambda room, *_: room)


@pytest.fixture
def without_last_steps(unsettled: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is changed once boxes are in their places: `test_refine` has these steps."""
    monkeypatch.setattr(Refinement, "last_steps", [])


def refinement(dataset: PasDataset) -> Refinement:
    """Of a room that has all of the box but the crate, which may be of metal or wood."""
    made = Refinement.of(StoredFindings.model_validate(found_room()), dataset)
    made._slabs = [slab for slab in made._slabs if slab.material in ("metal", "wood")]
    return made


def standing_in(dataset: PasDataset) -> np.ndarray:
    return standing(dataset.header.receiver, dataset.carrier_hz, np.unique(dataset.tx_position_m, axis=0))


def shared(box_m: np.ndarray) -> float:
    """Volume that a box shares with the crate, over the volume of both together."""
    common = np.prod((np.minimum(box_m[1], CRATE_M[1]) - np.maximum(box_m[0], CRATE_M[0])).clip(0))
    sizes = sum(np.prod(high - low) for low, high in (box_m, CRATE_M))
    return float(common / (sizes - common))


@pytest.mark.parametrize("kind", ["power", "phase-only"])
def test_a_crate_is_found_by_the_paths_that_it_hides(tmp_path: Path, kind: PasKind) -> None:
    dataset = generated(tmp_path, FURNISHED, pas_kind=kind)
    room = refinement(dataset).found
    first, *_ = obstacles(room, dataset, standing_in(dataset))
    frame = BoxFrame.of(room)
    world_m = first @ frame.axes
    assert shared(np.stack([world_m.min(axis=0), world_m.max(axis=0)])) > 0.3
    assert not holds_any(first, frame.along(standing_in(dataset)))


def test_nothing_is_found_where_nothing_is(empty_room: PasDataset) -> None:
    assert obstacles(refinement(empty_room).found, empty_room, standing_in(empty_room)) == []


def test_a_search_whose_time_is_over_finds_nothing(empty_room: PasDataset) -> None:
    assert obstacles(refinement(empty_room).found, empty_room, standing_in(empty_room), lambda: True) == []


@pytest.mark.usefixtures("without_last_steps")
def test_a_box_is_put_where_something_is(dataset: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refine, "WAYS_M", refine.WAYS_M[:1])
    told = refinement(dataset)
    told.known, told.done = {}, len(told.steps)
    told.step()
    assert told.boxes
    told.boxes = told.boxes[:1]
    while not told.is_over:
        told.step()
    (crate,) = told.room[len(told.found) :]
    assert crate.slab.material == "metal"
    assert crate.name.startswith("box ")
    vertices_m = crate.mesh.vertices_m
    assert shared(np.stack([vertices_m.min(axis=0), vertices_m.max(axis=0)])) > 0.6
    assert vertices_m[:, 2].max() == pytest.approx(CRATE_M[1, 2], abs=0.02)  # its top mirrors
    assert told.score(told.room) > told.score(told.found) + 0.005
    stored = json.loads(json.dumps(told.as_json()))
    assert Refinement.resumed(stored, dataset).as_json() == told.as_json()


@pytest.mark.slow
def test_a_box_takes_the_place_of_its_echo(dataset: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is put to the floor and to where path lengths agree, and an upright face within it goes."""
    monkeypatch.setattr(refine, "WAYS_M", (dict.fromkeys(boxes.WAYS_M[0], ()),))
    told = refinement(dataset)
    frame, (low_m, high_m) = BoxFrame.of(told.found), CRATE_M
    y_m = low_m[1] + 0.2
    corners_m = [[low_m[0], y_m, 0.1], [low_m[0], y_m, 0.7], [high_m[0], y_m, 0.7], [high_m[0], y_m, 0.1]]
    echo = RoomSurface(89, 6, 0, np.array([0.0, 1.0, 0.0]), np.array(corners_m), METAL, 1.0, is_wall=False)
    told.room = [*told.found, echo]
    rough = np.sort(frame.along(CRATE_M + np.array([[0.15, 0.1, 0.3], [0.05, -0.1, 0.05]])), axis=0)
    told._fit_obstacle(0, rough, 0, never)
    (crate,) = told.room[len(told.found) :]
    assert crate is not echo
    assert shared(np.sort(frame.box_of(crate) @ frame.axes, axis=0)) > 0.8


def test_no_box_is_put_through_a_wall(dataset: PasDataset) -> None:
    told = refinement(dataset)
    frame = BoxFrame.of(told.found)
    through = frame.along(CRATE_M - [[0, 0, 0.1], [0, 0, 0]])
    assert told._box_fit._fits(frame.surface(np.sort(frame.along(CRATE_M), axis=0), 90, METAL))
    assert not told._box_fit._fits(frame.surface(np.sort(through, axis=0), 90, METAL))


def test_boxes_that_overlap_are_tried_as_one(dataset: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refine, "WAYS_M", (dict.fromkeys(boxes.WAYS_M[0], ()),))
    monkeypatch.setattr(BoxFit, "_where_lengths_agree", lambda *_: iter(()))  # no face is moved
    told = refinement(dataset)
    frame, middle_m = BoxFrame.of(told.found), CRATE_M.mean(axis=0)[0]
    west_m, east_m = CRATE_M.copy(), CRATE_M.copy()
    west_m[1, 0], east_m[0, 0] = middle_m + 0.1, middle_m - 0.1
    west, east = (np.sort(frame.along(half_m), axis=0) for half_m in (west_m, east_m))
    wood, apart = NamedSlab("wood", 0.015, 0.0), np.array([0.0, 0.0, 1.5])
    away = frame.surface(west + apart, 92, wood)
    told.room = [*told.found, frame.surface(west, 90, METAL), frame.surface(east, 91, wood), away]
    told._join(91, never)
    crate, other = told.room[-1], told.room[-2]
    assert other is away
    assert [surface.number for surface in told.room[len(told.found) :]] == [92, 90]
    assert crate.slab.material == "metal"
    assert shared(np.sort(frame.box_of(crate) @ frame.axes, axis=0)) > 0.99


@pytest.mark.slow
@pytest.mark.usefixtures("unsettled")
def test_another_round_goes_on_in_the_room_that_was_found(dataset: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Boxes are sought in that room, and those that it has are fitted again."""
    told, sought = refinement(dataset), []
    assert told.again() is None  # nothing has changed
    frame = BoxFrame.of(told.found)
    lower = np.sort(frame.along(CRATE_M - [[0, 0, 0], [0, 0, 0.1]]), axis=0)
    told.known, told.room = {}, [*told.found, frame.surface(lower, 90, METAL)]
    again = Refinement.resumed(json.loads(json.dumps(told.as_json())), dataset).again()
    monkeypatch.setattr(refine, "obstacles", lambda room, *_: sought.append(room) or [])
    monkeypatch.setattr(refine, "trials_of_face", lambda *_: [Trial(without_patches, repeats=0)] * 3)
    while not again.is_over:
        again.step()
    assert [room[-1].number for room in sought] == [90]
    crate = again.room[-1]
    assert crate.number == 90
    assert frame.box_of(crate)[1, 2] == pytest.approx(CRATE_M[1, 2], abs=0.01)
    assert again.score(again.room) > told.score(told.room)


@pytest.mark.slow
@pytest.mark.usefixtures("without_last_steps")
def test_no_box_is_put_where_nothing_is(empty_room: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    told = refinement(empty_room)
    told.known, told.done = {}, len(told.steps) + 1
    told.boxes = [np.sort(BoxFrame.of(told.found).along(CRATE_M), axis=0)]
    monkeypatch.setattr(refine, "WAYS_M", (dict.fromkeys(boxes.WAYS_M[0], ()),))
    while not told.is_over:
        told.step()
    assert told.room is told.found


def test_a_box_hides_the_paths_that_run_through_it() -> None:
    generator = np.random.default_rng(3)
    corner = generator.uniform(0, 1, (20, 2, 3))
    box = np.stack([corner.min(axis=1), corner.max(axis=1)], axis=1)
    start, end = generator.uniform(-0.5, 1.5, (2, 90, 3))
    end[:30, 2] = start[:30, 2]  # some are level
    along = np.linspace(0, 1, 4001)[:, None, None]
    points = start + along * (end - start)
    inside = ((points > box[:, None, None, 0]) & (points < box[:, None, None, 1])).all(-1).any(1)  # (20, 90)
    first = np.arange(0, 91, 3)
    expected = inside.reshape(20, 30, 3).any(-1)
    found = hidden_by(box, first, start, end - start)
    assert (found >= expected).all()
    assert np.count_nonzero(found != expected) < 5  # corners that are cut between two points


def test_a_box_stands_along_the_walls() -> None:
    turned = trimesh.transformations.rotation_matrix(0.4, [0, 0, 1])[:3, :3]
    corners_m = np.array([[0.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 4.0, 2.5], [0.0, 0.0, 2.5]]) @ turned.T
    west = wall(turned @ [-1.0, 0.0, 0.0], corners_m)
    frame = BoxFrame.of([west])
    box = np.array([[-3.0, -2.0, 0.1], [-1.0, -1.0, 0.9]])
    surface = frame.surface(box, 7, METAL)
    np.testing.assert_allclose(frame.box_of(surface), box)
    np.testing.assert_allclose(frame.axes @ frame.axes.T, np.eye(3), atol=1e-12)
    shape = trimesh.Trimesh(surface.mesh.vertices_m, surface.mesh.triangles)
    assert shape.is_watertight
    assert shape.area == pytest.approx(2 * (2 * 1 + 2 * 0.8 + 1 * 0.8))
    np.testing.assert_allclose(np.sort(np.abs(shape.face_normals @ west.normal)), [0] * 8 + [1] * 4, atol=1e-9)


def test_the_faces_that_the_array_sees_are_moved_in_finer_steps() -> None:
    kinds = dict(boxes._faces(CRATE_M, ARRAY_M))
    assert kinds[1, 2] == "top"
    assert kinds[1, 0] == "shown"
    assert kinds[0, 1] == "shown"
    assert {kinds[face] for face in ((0, 0), (1, 1), (0, 2))} == {"hidden"}
    shown, hidden = (np.abs(np.concatenate(boxes.WAYS_M[0][kind])).min() for kind in ("shown", "hidden"))
    assert shown < hidden


def wall(normal: np.ndarray, corners_m: list[list[float]] | np.ndarray) -> RoomSurface:
    return RoomSurface(0, 0, 0, normal, np.array(corners_m), METAL, 1.0, is_wall=True)


def changed(
    own_box: boxes.Box, ways_m: Any = boxes.WAYS_M[0], walls: Sequence[RoomSurface] = (), held: Any = None
) -> list[boxes.Box]:
    """The boxes that a box may become, with these ways to move its faces."""
    frame = BoxFrame(list(walls), np.eye(3))
    changes = frame.changes(own_box, [METAL], ARRAY_M, dict.fromkeys(boxes.WAYS_M[0], ()) | dict(ways_m), held)
    own = frame.surface(own_box, 7, METAL)
    return [frame.box_of(box) for change in changes for box in change(own)]


def test_a_box_is_moved_as_a_whole_too() -> None:
    moved = changed(CRATE_M)
    shifts_m = [box[0] - CRATE_M[0] for box in moved if np.allclose(np.diff(box - CRATE_M, axis=0), 0)]
    for axis in (0, 1):
        along_m = sorted(float(shift[axis]) for shift in shifts_m if abs(shift[axis]) > 1e-9)
        np.testing.assert_allclose(along_m, boxes.WAYS_M[0]["across"][0])


def test_a_hidden_face_is_moved_with_the_edge_that_is_seen_against_the_room() -> None:
    by_m = (-0.2, 0.1)
    moved = changed(CRATE_M, {"in line": (by_m,)})
    behind = [box for box in moved if box[0, 0] != CRATE_M[0, 0] and box[1, 2] != CRATE_M[1, 2]]
    np.testing.assert_allclose([box[0, 0] - CRATE_M[0, 0] for box in behind], by_m)
    for box in behind:  # the edge of the top and the side that is turned away stays in line with the array
        before_m, after_m = (box_m[[0, 1], [0, 2]] - ARRAY_M[[0, 2]] for box_m in (CRATE_M, box))
        assert before_m[1] / before_m[0] == pytest.approx(after_m[1] / after_m[0])
        np.testing.assert_allclose(box[[1, 0, 1], [0, 1, 1]], CRATE_M[[1, 0, 1], [0, 1, 1]])
    assert len({tuple((box != CRATE_M).reshape(-1)) for box in moved}) == 3 * 2 + 1  # pairs, and the floor


def test_a_box_may_be_the_table_below_or_above_its_top() -> None:
    heights_m = [-0.3, 0.0, 0.3]
    tables = [box for box in changed(CRATE_M, {"board": (heights_m,)}) if np.ptp(box[:, 2]) < 0.05]
    np.testing.assert_allclose([box[1, 2] - CRATE_M[1, 2] for box in tables], heights_m, atol=1e-9)
    for box in tables:
        np.testing.assert_allclose(box[:, :2], CRATE_M[:, :2], atol=1e-9)


def test_the_top_of_a_table_moves_with_all_of_it() -> None:
    table = CRATE_M.copy()
    table[0, 2] = table[1, 2] - 0.03
    raised = [box for box in changed(table, {"top": ((0.1,),)}) if box[1, 2] > table[1, 2] + 0.05]
    assert len(raised) == 1
    np.testing.assert_allclose(raised[0] - table, [[0, 0, 0.1]] * 2, atol=1e-9)


def test_what_was_found_above_the_floor_may_stand_on_it() -> None:
    high = CRATE_M + np.array([0.0, 0.0, 1.0])
    west = wall(np.array([-1.0, 0, 0]), [[0.0, 0.0, 0.1], [0.0, 4.0, 0.1], [0.0, 4.0, 2.5], [0.0, 0.0, 2.5]])
    standing = [box for box in changed(high, {}, [west]) if box[0, 2] < high[0, 2] - 0.5]
    assert len(standing) == 1
    np.testing.assert_allclose(standing[0][0, 2], 0.1 + boxes.GAP_M)
    np.testing.assert_allclose(standing[0][1], high[1])


def test_the_face_of_a_box_that_is_held_is_not_moved() -> None:
    held = (1, 0)
    moved = changed(CRATE_M, held=held)
    np.testing.assert_allclose([box[held] for box in moved], CRATE_M[held], atol=1e-9)
    assert any(abs(box[0, 0] - CRATE_M[0, 0]) > 0.1 for box in moved)


@pytest.mark.parametrize(
    ("normal", "face"),
    [((1, 0, 0), (0, 0)), ((-1, 0, 0), (1, 0)), ((0, -1, 0), (1, 1)), ((0, 0, -1), None), ((0.6, 0.8, 0), None)],
)
def test_an_upright_polygon_along_the_walls_is_a_face_of_the_box_behind_it(
    normal: tuple[float, ...], face: tuple[int, int] | None
) -> None:
    frame = BoxFrame([], np.eye(3))
    away, up = np.array(normal, float), np.array([0.0, 0.0, 1.0])
    along = np.cross(up, away) if face else np.array([1.0, 0.0, 0.0])
    corners_m = np.array([0 * up, along, along + up, up])
    polygon = replace(wall(away, corners_m), is_wall=False)
    assert frame.face_of(polygon) == face
    if face:
        assert frame.box_of(polygon.with_depth(0.3, []))[face] == pytest.approx(0.0)
