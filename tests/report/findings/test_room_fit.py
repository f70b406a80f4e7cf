"""What changes in a learned room when it is traced and compared with training rows, and how a room is scored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from found_box import ALL_PLANES, ARRAY_M, SCENE, SETTINGS, SIZE_M, found_room
from stored_records import make_record

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import plan_generation
from xfreqbench.data.splits import find_split
from xfreqbench.report.findings import room_fit
from xfreqbench.report.findings.compared import ComparedFindings
from xfreqbench.report.findings.materials import NamedSlab
from xfreqbench.report.findings.room import RoomSurface, learned_surfaces
from xfreqbench.report.findings.room_fit import RoomScore, refined_room
from xfreqbench.report.findings.room_score import score_rooms, score_rows

SPLIT = "lofo-24.25GHz"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    plan = plan_generation(SCENE, [2.4e9, 24.25e9, 60e9], SETTINGS, num_transmitters=8)
    return open_dataset(generate_planned(plan, tmp_path_factory.mktemp("data") / "box.h5"))


def compared(dataset: PasDataset, findings: dict[str, object]) -> ComparedFindings:
    record = make_record("virtual-source", dataset_sha256=dataset.sha256, findings=findings, split=SPLIT)
    return ComparedFindings.of(record, dataset)


def front(**changes: object) -> RoomSurface:
    """A square of a metre that the array sees from above, 1 m below it."""
    corners_m = ARRAY_M + np.array(
        [[-0.5, -0.5, -1.0], [0.5, -0.5, -1.0], [0.5, 0.5, -1.0], [-0.5, 0.5, -1.0]]
    )
    slab = NamedSlab("metal", 0.002, 0.0)
    surface = RoomSurface(0, 0, 0, np.array([0.0, 0.0, -1.0]), corners_m, slab, 1.0, is_wall=False)
    return replace(surface, **changes)  # type: ignore[arg-type]


def test_a_face_becomes_the_front_of_a_box() -> None:
    box = front().with_depth(0.4, [])
    shape = trimesh.Trimesh(box.mesh.vertices_m, box.mesh.triangles)
    assert shape.is_watertight
    np.testing.assert_allclose(shape.extents, [1.0, 1.0, 0.4])
    assert shape.bounds[1][2] == pytest.approx(
        ARRAY_M[2] - 1.0
    )  # it lies beyond the front, as the array sees it
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
    score = RoomScore.of(compared(dataset, found_room()))
    train = find_split(dataset, "lofo", SPLIT).train
    assert set(score.samples.rows.tolist()) <= set(train.tolist())
    assert 24.25e9 not in score.samples.carrier_hz


def test_the_true_room_is_nearer_to_the_training_rows_than_one_without_a_floor(dataset: PasDataset) -> None:
    told = compared(dataset, found_room())
    surfaces, score = learned_surfaces(told), RoomScore.of(told)
    assert score(surfaces) > 0.999
    assert score(surfaces) > score(surfaces[1:]) + 0.005


def test_what_training_rows_contradict_is_changed(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room_fit, "_DEPTHS_M", (0.3,))
    monkeypatch.setattr(room_fit, "_THINNER", (1.0,))
    findings = found_room()
    faces = [dict(face) for face in findings["faces"]]  # type: ignore[attr-defined]
    short_m = np.array(faces[-1]["corners_m"])
    short_m[short_m[:, 1] > 2.0, 1] = 2.1  # the screen ends at 2.5 m
    nothing_m = [[3.0, 2.9, 0.2], [3.0, 3.7, 0.2], [3.0, 3.7, 2.2], [3.0, 2.9, 2.2]]
    faces[-1]["corners_m"] = short_m.tolist()
    faces.append({**faces[-1], "corners_m": nothing_m})
    told = compared(dataset, {**findings, "faces": faces})
    surfaces, score, steps = learned_surfaces(told), RoomScore.of(told), []
    room = refined_room(told, surfaces, lambda done, total: steps.append((done, total)))
    assert score(room) > score(surfaces) + 0.01
    (screen,) = [each for each in room if not each.is_wall]
    assert screen.corners_m[:, 1].max() == pytest.approx(2.5, abs=0.1)
    assert screen.depth_m == 0.0
    assert [each.slab.material for each in room] == [surface.material for surface in SCENE.surface]
    assert [done for done, _ in steps] == list(range(1, steps[-1][1] + 1))


def test_an_edge_goes_no_further_than_the_wall(dataset: PasDataset) -> None:
    surfaces = learned_surfaces(compared(dataset, found_room()))
    screen = surfaces[-1]
    for changed in room_fit._edged(screen, surfaces[:-1]):
        assert (changed.corners_m > -1e-9).all()
        assert (changed.corners_m < SIZE_M + 1e-9).all()


def test_a_face_just_behind_another_may_be_its_back(dataset: PasDataset) -> None:
    behind = front(number=1, corners_m=front().corners_m - [0.0, 0.0, 0.1])
    assert room_fit._is_back(behind, front())
    assert not room_fit._is_back(front(), behind)
    (room, *_) = list(room_fit._with_depths(0, [front().slab], [front(), behind]))
    assert [each.number for each in room] == [0]


def test_rooms_are_scored_at_tested_rows(dataset: PasDataset, tmp_path: Path) -> None:
    told = compared(dataset, found_room())
    surfaces = learned_surfaces(told)
    scores = score_rooms(tmp_path, told, {"whole": surfaces, "without a floor": surfaces[1:]})
    assert [len(each) for each in scores.values()] == [8, 8]  # one for each transmitter at 24.25 GHz
    assert scores["whole"].min() > 0.999
    assert np.median(scores["without a floor"]) < np.median(scores["whole"]) - 0.005
    assert [row[0] for row in score_rows(scores)] == ["whole", "without a floor"]


def test_faces_of_old_records_are_none(dataset: PasDataset) -> None:
    assert compared(dataset, ALL_PLANES).findings.faces == ()
