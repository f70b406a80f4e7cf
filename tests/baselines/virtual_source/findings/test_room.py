"""A learned room as a scene: written, read, traced, and compared with the room that it was learned from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source.commands import findings as findings_command
from xfreqbench.baselines.virtual_source.findings.room import claim_room, refinement_of, score_rooms, write_room
from xfreqbench.baselines.virtual_source.room.surfaces import SlabNames, surface_json
from xfreqbench.baselines.virtual_source.stored import FoundSlab

from tests.support.found_box import ALL_PLANES, SCENE, SETTINGS, compared, found_room, record_of, slab
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.generate import generate
from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.runs.records import append
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import load_scene

CARRIERS_HZ = [2.4e9, 24.25e9]
WRITTEN = {"room.toml", "room.glb"}


def write(box: PasDataset, folder: Path, findings: dict[str, object], **changes: object) -> Path:
    """Run the command; returns the folder of the room."""
    (folder / "results").mkdir(exist_ok=True)
    append(folder / "results" / "records.jsonl", record_of(box, findings, **changes))
    output, room = folder / "told", folder / "room"
    findings_command(folder / "results", data=box.path, output=output, room=room, refine=False, quiet=True)
    return room


@pytest.mark.parametrize("error_m", [0.0, 0.01])
def test_a_room_without_errors_is_traced_to_the_channels_of_the_truth_and_no_other(
    box: PasDataset, tmp_path: Path, error_m: float
) -> None:
    room = write(box, tmp_path, found_room(error_m=error_m))
    how: dict[str, Any] = {"solver": "image", "interactions": SETTINGS.interactions, "max_depth": 3}
    tx_m = box.tables["tx_position_m"]
    again = generate(room / "room.toml", tmp_path / "again.h5", [2.4, 24.25], tx_positions=tx_m, **how)
    if error_m:
        assert np.abs(again.pas() - box.pas()).max() > 0.05
        return
    np.testing.assert_array_equal(again.tx_position_m, box.tx_position_m)
    truth = box.tables["cfr"]
    # corners are float32: 2e-7 m of a path, 1e-4 rad at 24 GHz, over some reflections
    assert np.abs(again.tables["cfr"] - truth).max() < 1e-3 * np.abs(truth).max()
    np.testing.assert_allclose(again.pas(), box.pas(), atol=5e-3)


def test_the_scene_says_what_the_surfaces_are_made_of_and_how_near_that_is(box: PasDataset, tmp_path: Path) -> None:
    room = write(box, tmp_path, found_room(seen=0.01))
    assert {path.name for path in room.iterdir()} == WRITTEN
    scene = load_scene(room / "room.toml")
    assert scene.receiver == box.header.receiver
    assert scene.transmitters == SCENE.transmitters
    meshes = surface_meshes(scene)
    assert [mesh.material for mesh in meshes] == [surface.material for surface in SCENE.surface]
    for mesh, surface in zip(meshes, SCENE.surface, strict=True):
        if mesh.material != "concrete":  # of which 0.1 m let nothing through
            assert mesh.thickness_m == pytest.approx(surface.thickness_m, rel=0.01)
    text = (room / "room.toml").read_text()
    assert "|ΔR| 0.000" in text
    assert "unseen: face 6 of plane 6" in text
    assert "traced in the room, as found: SSIM 1.0000 (mean 1.0000) of 10 tested rows" in text
    told = (room.parent / "told" / "findings.md").read_text()
    assert "7 of 7 planes that were found are the scene's" in told
    assert "| traced in the room, as found | 1.0000 " in told


def test_metal_is_known_by_what_it_reflects() -> None:
    names = SlabNames(CARRIERS_HZ)
    metal = FoundSlab(share=1.0, permittivity=8.0, conductivity_s_m=500.0, conductivity_power=0.5, thickness_m=0.1)
    nearest, second = names.nearest(metal)[:2]
    assert nearest.material == "metal"
    assert nearest.distance < 0.2 < second.distance


@pytest.mark.parametrize(("material", "thickness_m"), [("glass", 0.008), ("plasterboard", 0.1), ("wood", 0.015)])
def test_a_material_is_known_by_its_own_reflection_at_every_thickness(material: str, thickness_m: float) -> None:
    learned = FoundSlab.model_validate(slab(material, thickness_m))
    nearest = SlabNames(CARRIERS_HZ).nearest(learned)[0]
    assert nearest.material == material
    assert nearest.thickness_m == pytest.approx(thickness_m)
    assert nearest.distance < 1e-9  # the same arithmetic twice


def test_a_face_on_which_a_transmitter_stands_is_left_out(box: PasDataset) -> None:
    findings = found_room()
    tx_m = box.tables["tx_position_m"][0]
    square_m = np.array([[-0.2, -0.2, 0.0], [0.2, -0.2, 0.0], [0.2, 0.2, 0.0], [-0.2, 0.2, 0.0]])
    through_m = (tx_m + square_m).tolist()
    told = {"plane": 0, "slab": 0, "seen": 1.0, "is_wall": False, "corners_m": through_m}
    findings["faces"] = [*findings["faces"], told]  # type: ignore[misc]
    assert len(refinement_of(compared(box, findings)).found) == len(SCENE.surface)


def test_slivers_are_left_out_and_corners_that_are_one_count_once(box: PasDataset) -> None:
    findings = found_room()
    faces = [dict(face) for face in findings["faces"]]  # type: ignore[attr-defined]
    corners_m = faces[0]["corners_m"]
    faces[0]["corners_m"] = [corners_m[0], (np.array(corners_m[0]) + 1e-6).tolist(), *corners_m[1:]]
    sliver_m = [[1.0, 1.0, 0.5], [2.0, 1.0, 0.5], [2.0, 1.001, 0.5]]
    faces.append({**faces[-1], "corners_m": sliver_m})
    surfaces = refinement_of(compared(box, {**findings, "faces": faces})).found
    assert [len(surface.corners_m) for surface in surfaces] == [4] * len(SCENE.surface)


def test_a_room_without_faces_is_refused_before_anything_is_written(box: PasDataset, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="has no faces from which a room could be made"):
        write(box, tmp_path, ALL_PLANES)
    assert not (tmp_path / "told").exists()
    assert not (tmp_path / "room").exists()


@pytest.mark.parametrize("change", [{"plane": 9}, {"slab": 1}, {"corners_m": [[0, 0, 0], [1, 0, 0]]}], ids=str)
def test_faces_that_name_nothing_are_refused(box: PasDataset, change: dict[str, object]) -> None:
    findings = found_room()
    findings["faces"] = [{**findings["faces"][0], **change}]  # type: ignore[index]
    with pytest.raises(DataError, match="are not planes and images"):
        compared(box, findings)


def test_the_room_that_the_run_refined_is_shown_as_it_is(box: PasDataset) -> None:
    found = refinement_of(compared(box, found_room())).found
    refined = [replace(surface, slab=surface.slab._replace(thickness_m=0.07)) for surface in found[1:]]
    told = {**found_room(), "room": [surface_json(surface) for surface in refined]}
    refinement = refinement_of(compared(box, json.loads(json.dumps(told))))
    assert refinement.is_over
    assert [surface_json(surface) for surface in refinement.room] == [surface_json(surface) for surface in refined]
    assert len(refinement.found) == len(found)


@pytest.mark.parametrize(
    "change", [{"corners_m": [[0, 0, 0], [1, 0, 0]]}, {"depth_m": -1.0}, {"slab": ["wood", None, 0.0]}], ids=str
)
def test_a_room_that_is_none_is_refused(box: PasDataset, change: dict[str, object]) -> None:
    (surface, *_) = refinement_of(compared(box, found_room())).found
    told = {**found_room(), "room": [{**surface_json(surface), **change}]}
    with pytest.raises(DataError, match="are not planes and images"):
        compared(box, told)


def test_the_room_of_the_same_record_is_written_again_and_nothing_else(box: PasDataset, tmp_path: Path) -> None:
    mine, written = compared(box, found_room(), id="mine"), []
    for _ in range(2):
        claim_room("mine", tmp_path)
        write_room(mine, refinement_of(mine).found, [], tmp_path)
        written.append({path.name: path.read_bytes() for path in tmp_path.iterdir()})
    assert set(written[0]) == WRITTEN
    assert written[0] == written[1]
    with pytest.raises(OutputExistsError, match="was not written for record other"):
        claim_room("other", tmp_path)


@pytest.mark.parametrize("name", sorted(WRITTEN))
def test_a_file_of_someone_else_stays(box: PasDataset, tmp_path: Path, name: str) -> None:
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / name).write_text("mine")
    with pytest.raises(OutputExistsError, match=f"{name} exists"):
        write(box, tmp_path, found_room())
    assert (tmp_path / "room" / name).read_text() == "mine"
    assert not (tmp_path / "told").exists()


def test_rooms_are_scored_at_tested_rows(box: PasDataset, tmp_path: Path) -> None:
    told = compared(box, found_room(), split="lofo-24.25GHz")
    surfaces = refinement_of(told).found
    scored = score_rooms(tmp_path, told, {"whole": surfaces, "without a floor": surfaces[1:]})
    (whole, *of_whole), (without, *of_without) = scored
    assert (whole, without) == ("whole", "without a floor")
    assert of_whole[2] == of_without[2] == "10"  # tested rows: one for each transmitter at 24.25 GHz
    assert float(of_whole[1]) > 0.999
    assert float(of_without[0]) < float(of_whole[0]) - 0.005


def test_a_scenes_name_of_any_letters_is_written_to_the_room(box: PasDataset, tmp_path: Path) -> None:
    name = 'büro "名前" \\ 1'
    scene_json = json.dumps({**json.loads(box.header.scene_json), "name": name})
    named = replace(box, header=replace(box.header, scene_json=scene_json))
    told = compared(named, found_room())
    write_room(told, refinement_of(told).found, [], tmp_path)
    assert load_scene(tmp_path / "room.toml").name == f"{name}-learned"


def test_data_that_cannot_be_traced_in_a_room_are_refused_before_it_is_refined(box: PasDataset) -> None:
    settings = {**box.header.settings, "interactions": ["specular", "diffuse"]}
    scattered = replace(box, header=replace(box.header, settings=settings))
    with pytest.raises(DataError, match="specular, diffuse, which the image method does not trace"):
        refinement_of(compared(scattered, found_room()))
