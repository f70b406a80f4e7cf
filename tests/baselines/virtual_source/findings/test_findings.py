from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from xfreqbench.baselines.virtual_source.commands import findings as findings_command
from xfreqbench.baselines.virtual_source.findings.compared import (
    ComparedFindings,
    choose_record,
    reflection_difference,
    virtual_sources,
)
from xfreqbench.baselines.virtual_source.findings.write import MODEL, TEXT, plane_rows, write_findings
from xfreqbench.baselines.virtual_source.stored import FoundSlab, StoredFindings

from tests.support import found_box
from tests.support.found_box import record_of
from tests.support.stored_records import make_record
from tests.support.synthetic import append_all, make_header
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.writer import PasWriter
from xfreqbench.errors import DataError, OutputExistsError, UnknownNameError
from xfreqbench.runs.records import RunRecord, append
from xfreqbench.scene.model import ReceiverArray, Scene, Surface, TransmitterGrid

Captured = pytest.CaptureFixture[str]
ARRAY_M = np.array([4.0, 3.0, 2.6])
EXACT_M = 3e-7  # findings are stored to 1e-7
SCENE = Scene(
    name="small",
    receiver=ReceiverArray(position_m=(4.0, 3.0, 2.6), rows=2, cols=2),
    transmitters=TransmitterGrid(min_m=(1.0, 1.0, 1.0), max_m=(2.0, 2.0, 1.0), step_m=(1.0, 1.0, 1.0)),
    surface=(
        Surface("floor", "concrete", 0.2, (0.0, 0.0, 0.0), (8.0, 6.0, 0.0)),
        Surface("ceiling", "concrete", 0.2, (0.0, 0.0, 2.8), (8.0, 6.0, 2.8)),
        Surface("wall", "plasterboard", 0.1, (8.0, 0.0, 0.0), (8.0, 4.0, 2.8)),
        Surface("window", "glass", 0.008, (8.0, 4.0, 0.0), (8.0, 6.0, 2.8)),
        Surface("desk 1", "wood", 0.015, (1.0, 1.0, 0.72), (2.0, 2.0, 0.75)),
        Surface("desk 2", "metal", 0.002, (5.0, 4.0, 0.72), (6.0, 5.0, 0.75)),
    ),
)
SLAB = {
    "share": 1.0,
    "permittivity": 5.24,
    "conductivity_s_m": 0.0462,
    "conductivity_power": 0.7822,
    "thickness_m": 0.2,
}
CORNERS_M = {  # of what is held, by the plane's place
    ("x", 8.0): [[8.0, 1.0, 1.0], [8.0, 3.0, 1.0], [8.0, 3.0, 2.0], [8.0, 1.0, 2.0]],
    ("z", 2.8): [[1.0, 1.0, 2.8], [7.0, 1.0, 2.8], [7.0, 5.0, 2.8], [1.0, 5.0, 2.8]],
}


def plane(axis: str, at_m: float, error_m: float = 0.0, tilt_rad: float = 0.0, **changes: object) -> dict[str, object]:
    """A found plane, `error_m` too far from the array and turned about the next axis."""
    index = "xyz".index(axis)
    towards = np.sign(at_m - ARRAY_M[index])
    normal = np.zeros(3)
    normal[index], normal[(index + 1) % 3] = towards * np.cos(tilt_rad), np.sin(tilt_rad)
    distance_m = (abs(at_m - ARRAY_M[index]) + error_m) * np.cos(tilt_rad)
    return {
        "normal": normal.tolist(),
        "distance_m": float(distance_m),
        "distance_std_m": 1e-4,
        "tilt_std_rad": 1e-3,
        "held": 0.9,
        "corners_m": CORNERS_M.get((axis, at_m)),
        "slabs": [SLAB],
        **changes,
    }


def findings_of(*planes: dict[str, object], images: tuple[tuple[int, ...], ...] = ((),)) -> dict[str, object]:
    told = [{"planes": list(image), "power": 0.1 ** len(image)} for image in images]
    return {"planes": list(planes), "receiver_m": ARRAY_M.tolist(), "images": told}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    header = replace(make_header(5), scene_json=SCENE.canonical_json, scene_name="small")
    return written(tmp_path_factory.mktemp("data") / "small.h5", header)


def written(path: Path, header: object) -> PasDataset:
    with PasWriter(path, header) as writer:  # type: ignore[arg-type]
        append_all(writer, header)  # type: ignore[arg-type]
    return open_dataset(path)


def compared(dataset: PasDataset, *planes: dict[str, object]) -> ComparedFindings:
    return found_box.compared(dataset, findings_of(*planes))


def reflections_of(result: ComparedFindings) -> list[str]:
    """Δ|R| of each found plane, as it is told."""
    return [row[-1] for row in plane_rows(result)[1]]


@pytest.mark.parametrize(("axis", "at_m"), [("x", 8.0), ("z", 0.0), ("z", 2.8)])
@pytest.mark.parametrize("error_m", [-3e-4, 0.0, 2e-4, 0.04])
def test_a_plane_beyond_its_surface_has_that_error(dataset: PasDataset, axis: str, at_m: float, error_m: float) -> None:
    (match,) = compared(dataset, plane(axis, at_m, error_m)).matches
    assert match.distance_error_m == pytest.approx(error_m, abs=EXACT_M)
    assert match.tilt_error_rad == pytest.approx(0.0, abs=EXACT_M)


def test_a_tilted_plane_has_its_tilt_and_no_distance_error_at_the_foot(dataset: PasDataset) -> None:
    (match,) = compared(dataset, plane("x", 8.0, tilt_rad=0.02)).matches
    assert match.tilt_error_rad == pytest.approx(0.02, abs=EXACT_M)
    assert match.distance_error_m == pytest.approx(0.0, abs=EXACT_M)


def test_a_tilted_plane_is_judged_where_the_surface_is(dataset: PasDataset) -> None:
    """The desk's edge nearest to the array is 1 m away from the foot along y, where the plane has risen."""
    corners_m = [[5.2, 4.2, 0.75], [5.8, 4.2, 0.75], [5.8, 4.8, 0.75], [5.2, 4.8, 0.75]]
    found = plane("z", 0.75, corners_m=corners_m)
    found["normal"] = [0.0, float(np.sin(0.01)), float(-np.cos(0.01))]
    found["distance_m"] = float(1.85 * np.cos(0.01))
    (match,) = compared(dataset, found).matches
    assert match.distance_error_m == pytest.approx(-np.tan(0.01) * 1.0, abs=EXACT_M)


@pytest.mark.parametrize(
    "found",
    [plane("y", 6.0), plane("x", 8.0, error_m=0.051), plane("x", 8.0, tilt_rad=np.radians(2.1))],
    ids=["no wall", "5.1 cm", "2.1 degrees"],
)
def test_a_plane_where_nothing_is_shows_no_surface(dataset: PasDataset, found: dict[str, object]) -> None:
    result = compared(dataset, found)
    assert result.matches == [None]
    assert result.surface(0) == "no such surface"
    assert reflections_of(result) == ["–"]


def test_what_is_held_beside_a_surface_is_not_that_surface(dataset: PasDataset) -> None:
    between_m = [[3.0, 2.5, 0.75], [3.5, 2.5, 0.75], [3.5, 3.5, 0.75], [3.0, 3.5, 0.75]]
    desks, gap = plane("z", 0.75), plane("z", 0.75, corners_m=between_m)
    assert compared(dataset, desks).surface(0) == "desk 1; desk 2"
    assert compared(dataset, gap).surface(0) == "no such surface"


def test_the_image_of_a_desk_in_the_ceiling_is_told_as_such(dataset: PasDataset) -> None:
    corners_m = [[5.1, 4.1, 4.85], [5.9, 4.1, 4.85], [5.9, 4.9, 4.85], [5.1, 4.9, 4.85]]
    image = plane("z", 2 * 2.8 - 0.75, error_m=1e-3, corners_m=corners_m)
    result = compared(dataset, plane("z", 2.8), image)
    assert result.surface(1) == "image of desk 2 in ceiling"
    match = result.matches[1]
    assert match.mirror == 0
    assert match.distance_error_m == pytest.approx(1e-3, abs=EXACT_M)
    assert reflections_of(result)[1] == "–"
    assert any(missing.distance_m == pytest.approx(1.85) for missing in result.missing)
    assert compared(dataset, image).surface(0) == "no such surface"  # without a mirror


def test_planes_that_were_not_found_are_the_others(dataset: PasDataset) -> None:
    result = compared(dataset, plane("z", 2.8), plane("z", 0.0))
    names = [result.names(missing.surfaces) for missing in result.missing]
    assert names[0] == "wall; window"
    assert "floor" not in names
    assert "ceiling" not in names
    assert len(result.planes) == 3 + 2 + 4 + 4  # shell, desks' tops and bottoms, sides of each


def test_a_plane_that_holds_nothing_has_no_reflection_to_compare(dataset: PasDataset) -> None:
    empty = plane("z", 0.0, held=0.0, corners_m=None, slabs=[{**SLAB, "share": 0.0}])
    result = compared(dataset, empty, plane("z", 2.8))
    assert result.surface(0) == "floor"
    assert reflections_of(result)[0] == "–" != reflections_of(result)[1]


def test_slabs_mix_by_their_shares_and_an_opening_reflects_nothing() -> None:
    """What one slab reflects is that of the recommendation: `test_materials`."""
    carrier_hz = np.array([2.4e9, 60e9])
    whole = FoundSlab.model_validate(SLAB)
    half = whole.model_copy(update={"share": 0.5})
    truth = {("concrete", 0.2): 1.0}
    np.testing.assert_allclose(reflection_difference([half, half], truth, carrier_hz), 0, atol=1e-12)
    alone = reflection_difference([whole], {}, carrier_hz)
    np.testing.assert_allclose(reflection_difference([half], truth, carrier_hz), alone / 2, atol=1e-12)
    np.testing.assert_allclose(reflection_difference([], truth, carrier_hz), alone, atol=1e-12)


def test_a_wall_with_a_window_is_mixed_by_what_the_rectangle_shows(dataset: PasDataset) -> None:
    corners_m = [[8.0, 3.0, 1.0], [8.0, 5.0, 1.0], [8.0, 5.0, 2.0], [8.0, 3.0, 2.0]]
    result = compared(dataset, plane("x", 8.0, corners_m=corners_m))
    (match,) = result.matches
    assert match.slabs(result.meshes) == pytest.approx({("plasterboard", 0.1): 0.5, ("glass", 0.008): 0.5})


def test_virtual_sources_are_mirrored_in_the_order_of_the_bounces() -> None:
    images = ((), (0,), (0, 1), (1, 0), (0, 1, 0))
    told = findings_of(plane("x", 8.0), plane("x", 0.0), images=images)
    sources = virtual_sources(StoredFindings.model_validate(told), np.array([1.0, 2.0, 1.0]))
    assert list(sources) == [(0,), (0, 1), (1, 0)]
    expected_m = [[15.0, 2.0, 1.0], [-15.0, 2.0, 1.0], [17.0, 2.0, 1.0]]
    np.testing.assert_allclose(list(sources.values()), expected_m, atol=EXACT_M)


def full_record(dataset: PasDataset, **changes: object) -> RunRecord:
    planes = plane("x", 8.0, 2e-4), plane("z", 2.8), plane("y", 6.0, corners_m=CORNERS_M["x", 8.0])
    return record_of(dataset, findings_of(*planes, images=((), (0,), (1,), (0, 1))), **changes)


def test_the_text_and_the_model_say_the_same(dataset: PasDataset, tmp_path: Path, capsys: Captured) -> None:
    append(tmp_path / "records.jsonl", full_record(dataset))
    folder = tmp_path / "out"
    findings_command(tmp_path, data=dataset.path, output=folder)
    assert {path.name for path in folder.iterdir()} == {TEXT, MODEL}
    model = trimesh.load_scene(folder / MODEL)
    nodes = set(model.graph.nodes_geometry)
    assert {f"surface {surface.name}" for surface in SCENE.surface} <= nodes
    assert {"receiver", "found plane 0: wall", "found plane 2: no such surface", "virtual source 0 1"} <= nodes
    transform, name = model.graph["found plane 0: wall"]
    corners_m = trimesh.transform_points(model.geometry[name].vertices, transform)[:, [0, 2, 1]] * [1, -1, 1]
    np.testing.assert_allclose(corners_m, CORNERS_M["x", 8.0], atol=1e-5)  # float32 metres; glTF's y is up
    text = (folder / TEXT).read_text()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| ")]
    (wall,), (nothing,) = ([row for row in rows if row[0].startswith(place)] for place in ("0 +x 4.000", "2 +y"))
    assert (wall[1], wall[2]) == ("wall", "+0.20")
    assert float(wall[-1]) > float(wall[-2]) > 0
    assert (nothing[1], nothing[2], nothing[-1]) == ("no such surface", "–", "–")
    assert ["floor", "-z 2.600 m", "48.0", "80%"] in rows
    assert "2 of 3 planes that were found are the scene's; half of those are within 0.1 mm of it." in text
    assert capsys.readouterr().out == f"{text}\nwrote {folder / TEXT}\nwrote {folder / MODEL}\n"


def test_the_same_record_is_written_again_and_another_is_not(dataset: PasDataset, tmp_path: Path) -> None:
    result = ComparedFindings.of(full_record(dataset), dataset)
    write_findings(result, tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    write_findings(result, tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    other = ComparedFindings.of(full_record(dataset, id="other"), dataset)
    with pytest.raises(OutputExistsError, match="was not written for record other"):
        write_findings(other, tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("name", [TEXT, MODEL])
def test_a_foreign_file_among_ours_stays(dataset: PasDataset, tmp_path: Path, name: str) -> None:
    result = ComparedFindings.of(full_record(dataset), dataset)
    write_findings(result, tmp_path)
    (tmp_path / name).write_text("mine")
    with pytest.raises(OutputExistsError, match=f"{name} exists"):
        write_findings(result, tmp_path)
    assert (tmp_path / name).read_text() == "mine"


def test_the_newest_of_the_records_asked_for_is_taken(dataset: PasDataset, tmp_path: Path) -> None:
    told = findings_of(plane("x", 8.0))
    for name, split, day in (("aa1", "lofo-2.4GHz", 1), ("aa2", "lofo-77GHz", 3), ("bb", "lofo-77GHz", 2)):
        time = f"2026-01-0{day}T00:00:00+00:00"
        append(tmp_path / "records.jsonl", record_of(dataset, told, id=name, split=split, time_utc=time))
    append(tmp_path / "records.jsonl", make_record("nearest", time_utc="2026-02-01T00:00:00+00:00"))
    assert choose_record(tmp_path).id == "aa2"
    assert choose_record(tmp_path, split="lofo-2.4GHz").id == "aa1"
    assert choose_record(tmp_path / "records.jsonl", id_prefix="b", seed=0).id == "bb"
    for asked in ({"id_prefix": "c"}, {"split": "lofo-10GHz"}, {"seed": 4}):
        with pytest.raises(UnknownNameError):
            choose_record(tmp_path, **asked)  # type: ignore[arg-type]


def test_mistakes_are_told_before_anything_is_written(dataset: PasDataset, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds no records"):
        choose_record(tmp_path)
    append(tmp_path / "records.jsonl", make_record("nearest"))
    with pytest.raises(DataError, match="has findings; its methods are nearest"):
        findings_command(tmp_path, data=dataset.path, output=tmp_path / "out")
    imported = written(tmp_path / "imported.h5", make_header())
    for record, data, words in (
        (make_record("virtual-source", findings=findings_of()), dataset, "Give --data the file of the run"),
        (record_of(dataset, findings_of(plane("x", 8.0, distance_m="far"))), dataset, r"planes\.0\.distance_m"),
        (record_of(dataset, findings_of(images=((0,),))), dataset, "an image names a plane"),
        (record_of(imported, findings_of()), imported, "does not say which scene"),
    ):
        with pytest.raises(DataError, match=words):
            ComparedFindings.of(record, data)
    assert not (tmp_path / "out").exists()


def test_names_from_a_scene_are_no_markup_and_steer_no_terminal(tmp_path: Path) -> None:
    surface = replace(SCENE.surface[0], name="<b>*floor*\x1b[2J | ")
    scene = replace(SCENE, surface=(surface, *SCENE.surface[1:]), name="_small_")
    header = replace(make_header(5), scene_json=scene.canonical_json, scene_name="small")
    result = compared(written(tmp_path / "small.h5", header), plane("z", 0.0))
    text = write_findings(result, tmp_path)
    assert r"\<b\>\*floor\* \[2J \|" in text
    assert "\x1b" not in text


def test_no_planes_at_all_still_make_a_report(dataset: PasDataset, tmp_path: Path) -> None:
    text = write_findings(compared(dataset), tmp_path)
    assert text.count("None.") == 3  # planes that were found, slabs, and how they reflect
    assert {path.name for path in tmp_path.iterdir()} == {TEXT, MODEL}
