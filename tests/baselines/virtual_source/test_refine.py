"""What changes in a learned room when it is traced and compared with training rows, and which rows are compared."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from xfreqbench.baselines.virtual_source.room import changes, refine, traced
from xfreqbench.baselines.virtual_source.room.boxes import BoxFrame, Faces
from xfreqbench.baselines.virtual_source.room.lengths import RoomPart, moved
from xfreqbench.baselines.virtual_source.room.refine import Refinement
from xfreqbench.baselines.virtual_source.room.surfaces import NamedSlab, RoomSurface
from xfreqbench.baselines.virtual_source.room.traced import COMPARING
from xfreqbench.baselines.virtual_source.stored import StoredFindings

from tests.support.found_box import ARRAY_M, SCENE, SETTINGS, SIZE_M, found_room, generated, plane, slab
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import find_split
from xfreqbench.scene.model import Surface

SPLIT = "lofo-24.25GHz"
AS_DEEP = replace(SETTINGS, max_depth=COMPARING.max_depth)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return generated(tmp_path_factory.mktemp("data"), settings=AS_DEEP, tx=8)


def refinement(dataset: PasDataset, findings: dict[str, object]) -> Refinement:
    """Of a room in which boxes may be of two materials."""
    train = dataset[find_split(dataset, "lofo", SPLIT).train]
    made = Refinement.of(StoredFindings.model_validate(findings), train)
    made._slabs = made._slabs[:2]
    return made


def front(**changes: object) -> RoomSurface:
    """A square of a metre that the array sees from above, 1 m below it."""
    corners_m = ARRAY_M + np.array([[-0.5, -0.5, -1.0], [0.5, -0.5, -1.0], [0.5, 0.5, -1.0], [-0.5, 0.5, -1.0]])
    slab = NamedSlab("metal", 0.002, 0.0)
    surface = RoomSurface(0, 0, 0, np.array([0.0, 0.0, -1.0]), corners_m, slab, 1.0, is_wall=False)
    return replace(surface, **changes)  # type: ignore[arg-type]


def test_a_face_becomes_the_front_of_a_box() -> None:
    box = front().with_depth(0.4, [])
    shape = trimesh.Trimesh(box.mesh.vertices_m, box.mesh.triangles)
    assert shape.is_watertight
    np.testing.assert_allclose(shape.extents, [1.0, 1.0, 0.4])
    assert shape.bounds[1][2] == pytest.approx(ARRAY_M[2] - 1.0)  # it lies beyond the front, as the array sees it
    assert box.name.startswith("box ")
    assert box.with_depth(0.0, []).name.startswith("face ")


def test_a_box_has_no_side_in_a_wall() -> None:
    beside_m = ARRAY_M + np.array([[0.5, -3.0, -4.0], [0.5, 3.0, -4.0], [0.5, 3.0, 4.0], [0.5, -3.0, 4.0]])
    wall = front(normal=np.array([1.0, 0.0, 0.0]), corners_m=beside_m, is_wall=True)
    box = front().with_depth(0.4, [wall])
    assert box.open_sides == (1,)
    shape = trimesh.Trimesh(box.mesh.vertices_m, box.mesh.triangles)
    assert shape.area == pytest.approx(2 * 1.0 + 3 * 0.4)


def test_no_tested_row_is_compared(dataset: PasDataset) -> None:
    rows = refinement(dataset, found_room()).score.samples.rows
    assert set(rows.tolist()) <= set(find_split(dataset, "lofo", SPLIT).train.tolist())


def test_the_true_room_is_nearer_to_the_training_rows_than_one_without_a_floor(dataset: PasDataset) -> None:
    told = refinement(dataset, found_room())
    assert told.score(told.room) > 0.999
    assert told.score(told.room) > told.score(told.room[1:]) + 0.005


def test_a_room_that_was_just_traced_is_not_traced_again(dataset: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    told, seen, channels_in = refinement(dataset, found_room()), [], traced.channels_in

    def counted(room: Sequence[RoomSurface], *rest: Any) -> np.ndarray:
        seen.append(len(room))
        return channels_in(room, *rest)

    monkeypatch.setattr(traced, "channels_in", counted)
    monkeypatch.setattr(traced, "_MOST_KNOWN", 2)
    whole, one, other = told.room, told.room[1:], told.room[2:]
    first = [told.score(room) for room in (whole, one)]
    assert [told.score(list(room)) for room in (whole, one)] == first
    assert seen == [len(whole), len(one)]
    told.score(other)
    assert told.score(whole) == first[0]  # forgotten, and traced anew
    assert seen == [len(room) for room in (whole, one, other, whole)]


def test_rooms_are_compared_roughly_from_one_of_them_on(dataset: PasDataset) -> None:
    score = (told := refinement(dataset, found_room())).score
    near = score.near(told.room)
    assert near(told.room) == pytest.approx(score(told.room), abs=1e-6)  # what is left out here is held
    other = told.room[:-1]
    assert near(other) - near(told.room) == pytest.approx(score(other) - score(told.room), abs=0.03)
    few = score.roughly(other, told.room, num_tx=2)
    assert len(np.unique(few.samples.tx_index)) == 2
    assert few(told.room) > few(other)


def test_a_table_is_put_where_the_lengths_of_its_paths_agree(tmp_path: Path) -> None:
    table = Surface("table", "wood", 0.015, (0.6, 0.7, 0.70), (1.9, 2.4, 0.73))
    scene = replace(SCENE, surface=(*SCENE.surface, table))
    told = refinement(generated(tmp_path, scene, AS_DEEP, tx=14), found_room())
    frame = BoxFrame.of(told.found)
    places_m = [np.sort(frame.along(np.array(corners)), axis=0) for corners in ((table.min_m, table.max_m),)]
    right = frame.surface(places_m[0], 99, NamedSlab("wood", 0.015, 0.0))
    wrong = moved([right], RoomPart("board", 99), 0.06)[0]  # as far down

    def tops_m(held: Faces | None) -> list[float]:
        found = told._box_fit._where_lengths_agree(told.room, told.train, held, wrong)
        return [float(frame.box_of(box)[1, 2]) for box in found]

    assert min(abs(top_m - 0.73) for top_m in tops_m(None)) < 3e-3
    assert set(tops_m((1, 2))) <= {float(frame.box_of(wrong)[1, 2])}


def wrong_room() -> dict[str, object]:
    """Findings of a box whose screen ends too early, and which has a second one that is not there."""
    findings = found_room()
    faces = [dict(face) for face in findings["faces"]]  # type: ignore[attr-defined]
    short_m = np.array(faces[-1]["corners_m"])
    short_m[short_m[:, 1] > 2.0, 1] = 2.1  # the screen ends at 2.5 m
    nothing_m = [[3.0, 2.9, 0.2], [3.0, 3.7, 0.2], [3.0, 3.7, 2.2], [3.0, 2.9, 2.2]]
    faces[-1]["corners_m"] = short_m.tolist()
    faces.append({**faces[-1], "corners_m": nothing_m})
    return {**findings, "faces": faces}


@pytest.mark.slow
def test_what_training_rows_contradict_is_changed(dataset: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(changes, "_DEPTHS_M", (0.3,))
    monkeypatch.setattr(changes, "_THINNER", (1.0,))
    monkeypatch.setattr(refine, "WAYS_M", refine.WAYS_M[:1])
    told = refinement(dataset, wrong_room())
    for _ in told.steps:
        told.step()
    assert told.score(told.room) > told.score(told.found) + 0.01
    (screen,) = [surface for surface in told.room if not surface.is_wall]
    assert screen.corners_m[:, 1].max() == pytest.approx(2.5, abs=0.1)
    assert screen.depth_m == 0.0
    assert [surface.slab.material for surface in told.room] == [surface.material for surface in SCENE.surface]


@pytest.mark.slow
def test_a_partition_of_two_sheets_is_found_by_parts_of_its_front(tmp_path: Path) -> None:
    sheet = Surface("front", "plasterboard", 0.0125, (3.4, 0.0, 0.0), (3.4, 2.5, 2.6))
    back = replace(sheet, name="back", min_m=(3.5, 0.0, 0.0), max_m=(3.5, 2.5, 2.6))
    end = replace(sheet, name="end", min_m=(3.4, 2.5, 0.0), max_m=(3.5, 2.5, 2.6))
    scene = replace(SCENE, surface=(*SCENE.surface[:-1], sheet, back, end))
    findings = found_room()
    planes = [*findings["planes"], plane("x", 3.372, slabs=[slab("wood", 0.011)])]  # type: ignore[misc]
    planes[6]["slabs"] = [slab("plasterboard", 0.0125)]
    faces = [dict(face) for face in findings["faces"]]  # type: ignore[attr-defined]
    for at_plane, x_m, low_z_m, high_z_m in ((6, 3.4, 0.3, 1.2), (6, 3.4, 1.5, 2.6), (7, 3.372, 0.6, 1.5)):
        corners_m = [[x_m, 0, low_z_m], [x_m, 2.45, low_z_m], [x_m, 2.45, high_z_m], [x_m, 0, high_z_m]]
        faces.append({**faces[-1], "plane": at_plane, "corners_m": corners_m})
    del faces[6]
    told = refinement(generated(tmp_path, scene, AS_DEEP, tx=16), {**findings, "planes": planes, "faces": faces})
    assert len(told.found) == len(SCENE.surface) + 2
    for _ in range(12):  # up to the depths of the largest front
        told.step()
    (partition,) = [surface for surface in told.room if not surface.is_wall]
    assert partition.depth_m == pytest.approx(0.1)
    assert partition.corners_m.max(axis=0) == pytest.approx([3.4, 2.5, 2.6], abs=2e-3)
    assert partition.corners_m.min(axis=0) == pytest.approx([3.4, 0.0, 0.0], abs=2e-3)
    assert partition.slab_name == "plasterboard 12.50 mm"


@pytest.mark.slow
def test_faces_are_changed_again_once_boxes_are_in_their_places(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(changes, "_DEPTHS_M", ())
    told = refinement(dataset, wrong_room())
    told.known, told.done, told.boxes = {}, len(told.steps) + 1, []
    for _ in told.last_steps:
        told.step()
    (screen,) = [surface for surface in told.room if not surface.is_wall]
    assert screen.corners_m[:, 1].max() == pytest.approx(2.5, abs=0.1)


def compared_maps(told: Refinement) -> int:
    return sum(len(judge.samples) for judge in told._judges)


def test_only_parts_that_are_better_where_lengths_agree_are_settled(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = refinement(dataset, found_room())
    right, planes = told.room, [surface.plane for surface in told.room if surface.is_wall]
    told.room = moved(right, RoomPart("wall", planes[0]), 0.004)
    wrong = moved(right, RoomPart("wall", planes[1]), 0.004)
    monkeypatch.setattr(refine, "settled", lambda *_: wrong)
    told.settle()
    assert told.is_over
    assert told.room == right
    # one comparison with both walls moved and one without each, and at last two
    assert told.count.maps == 5 * compared_maps(told)


def test_no_part_is_compared_once_the_time_to_settle_is_over(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = refinement(dataset, found_room())
    monkeypatch.setattr(refine, "settled", lambda room, *_: moved(room, RoomPart("wall", room[0].plane), 0.004))
    told.settle(lambda: True)
    assert told.count.maps == 3 * compared_maps(told)


def test_a_refinement_goes_on_where_it_was_stored(dataset: PasDataset) -> None:
    told = refinement(dataset, wrong_room())
    told.step()
    stored = json.loads(json.dumps(told.as_json()))
    again = Refinement.resumed(stored, dataset[find_split(dataset, "lofo", SPLIT).train])
    told.step()
    again.step()
    assert again.done == told.done == 2
    assert again.as_json() == told.as_json()


def test_a_step_without_time_changes_nothing(dataset: PasDataset) -> None:
    told = refinement(dataset, wrong_room())
    told.step(lambda: True)
    assert told.room is told.found
    assert told.done == 1


def test_an_edge_goes_no_further_than_the_wall(dataset: PasDataset) -> None:
    surfaces = refinement(dataset, found_room()).found
    rooms = list(changes.with_edges(surfaces[-1].number, changes.EDGES_M, surfaces))
    assert len(rooms) > 4  # its edges are moved
    for *_, screen in rooms:
        assert screen.number == surfaces[-1].number
        assert (screen.corners_m > -1e-9).all()
        assert (screen.corners_m < SIZE_M + 1e-9).all()


def test_a_face_just_behind_another_may_be_its_back() -> None:
    behind, before, beside = (
        front(number=number, corners_m=front().corners_m + by_m)
        for number, by_m in ((1, [0.0, 0.0, -0.1]), (2, [0.0, 0.0, 0.03]), (3, [1.5, 0.0, 0.0]))
    )
    far, wall = (
        front(number=number, corners_m=front().corners_m - [0.0, 0.0, -0.5], is_wall=is_wall)
        for number, is_wall in ((4, False), (5, True))
    )
    rooms = list(changes.with_depths(0, [front().slab], [front(), behind, before, beside, far, wall]))
    left = [[surface.number for surface in room] for room in rooms]
    assert left == [[0, 2, 3, 4, 5]] * 6 + [[0, 3, 4, 5]] * 6
    only_behind = list(changes.with_depths(0, [front().slab], [front(), behind]))
    assert [[surface.number for surface in room] for room in only_behind] == [[0]] * 6


def test_faces_of_a_plane_may_be_one() -> None:
    beside = front(number=1, corners_m=front().corners_m - [-1.5, -0.2, 0.0])
    near_m = ARRAY_M + np.array([[2.6, -3.0, -4.0], [2.6, 3.0, -4.0], [2.6, 3.0, 4.0], [2.6, -3.0, 4.0]])
    wall = front(number=2, plane=1, normal=np.array([1.0, 0.0, 0.0]), corners_m=near_m, is_wall=True)
    rooms = list(changes.as_one(0, [front(), beside, wall]))
    assert [[surface.number for surface in room] for room in rooms] == [[2, 0]] * 2
    for room, right_m in zip(rooms, (2.0, 2.6), strict=True):
        np.testing.assert_allclose(room[1].corners_m.min(axis=0) - ARRAY_M, [-0.5, -0.5, -1.0])
        np.testing.assert_allclose(room[1].corners_m.max(axis=0) - ARRAY_M, [right_m, 0.7, -1.0])
        assert room[1].area_m2 == pytest.approx((right_m + 0.5) * 1.2)
    assert not list(changes.as_one(1, [front(), wall]))  # walls stay as they are


def test_a_wall_some_waves_off_is_put_where_it_is(dataset: PasDataset) -> None:
    told = refinement(dataset, found_room())
    right, east = (
        told.room,
        next(surface for surface in told.room if surface.is_wall and surface.corners_m[:, 0].min() > 4.9),
    )
    told.room = next(changes.with_wall_at(east.plane, [0.125], [NamedSlab("metal", 0.002, 0.0)], right))
    assert told.room[3].corners_m[:, 0] == pytest.approx(5.125)
    others = [
        surface.corners_m[:, 0].max() for surface in told.room if surface.is_wall and surface.number not in (2, 3)
    ]
    assert others == pytest.approx([5.125] * 4)  # walls still meet
    told.step()
    assert told.done == 1
    assert told.room[3].corners_m[:, 0] == pytest.approx(5.0, abs=0.006)
    assert told.room[3].slab.material == "concrete"


def test_faces_behind_each_other_may_end_at_another_place_together() -> None:
    behind = front(number=1, corners_m=front().corners_m - [0.0, 0.0, 0.1])
    shorter = front(number=2, corners_m=front().corners_m * [1.0, 0.8, 1.0] - [0.0, 0.0, 0.05])
    rooms = list(changes.with_edges(0, [0.1], [front(), behind, shorter]))
    moved = [
        [
            bool((new.corners_m != old.corners_m).any())
            for new, old in zip(room, (front(), behind, shorter), strict=True)
        ]
        for room in rooms
    ]
    assert all(of_room[0] for of_room in moved)
    assert len(rooms) == 2 * 4  # each edge alone, and with those that end there
    assert {tuple(of_room) for of_room in moved[::2]} == {(True, False, False)}
    for room in rooms[1::2]:
        np.testing.assert_allclose((room[1].corners_m - room[0].corners_m), [[0.0, 0.0, -0.1]] * 4, atol=1e-12)


def test_faces_of_a_plane_still_meet_where_an_edge_between_them_moves() -> None:
    beside = front(number=1, corners_m=front().corners_m - [-1.0, 0.0, 0.0])
    edge_m = ARRAY_M[0] + 0.5  # the first ends there, the other begins
    rooms = list(changes.with_edges(0, [0.1], [front(), beside]))
    meeting = [room for room in rooms if room[1].corners_m[:, 0].min() > edge_m + 0.05]
    assert len(meeting) == 1
    assert [surface.corners_m[:, 0].max() for surface in meeting[0]] == pytest.approx([edge_m + 0.1, edge_m + 1.0])
    assert meeting[0][1].corners_m[:, 0].min() == pytest.approx(edge_m + 0.1)
