"""What `xfreqbench view` draws: rays against geometry, the model read again, figures, and what is refused."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from html import unescape
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from synthetic import make_header, transmitters, write_dataset

from xfreqbench.cli.data import view as view_command
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import plan_generation
from xfreqbench.data.splits import lofo
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.errors import DataError, OutputExistsError, UnknownNameError, XFreqBenchError
from xfreqbench.maps.metrics import ssim
from xfreqbench.report.drawing.document import Picture, is_of_subject
from xfreqbench.report.view.page import view_page
from xfreqbench.report.view.plan import ViewPlan, plan_view
from xfreqbench.report.view.room import MAX_RAYS, RAY_RANGE_DB, Ray, ShownRoom
from xfreqbench.report.view.summary import similarity, summarize
from xfreqbench.report.view.write import FILES, room_model, write_view
from xfreqbench.scene.meshes import surface_meshes, write_mitsuba
from xfreqbench.scene.model import ReceiverArray, Scene, Surface, TransmitterGrid
from xfreqbench.tracing.tracer import TraceSettings

CARRIERS_GHZ = (2.4, 24.25, 77.0)
SETTINGS = TraceSettings(rays=20_000, max_depth=2)
SCENE = Scene(
    name="screened",
    description="A room with a metal screen, for tests.",
    receiver=ReceiverArray(position_m=(4.0, 3.0, 2.5), rows=2, cols=2),
    transmitters=TransmitterGrid(min_m=(1.0, 1.0, 1.0), max_m=(7.0, 5.0, 1.0), step_m=(1.0, 1.0, 1.0)),
    surface=(
        Surface("floor", "concrete", 0.2, (0.0, 0.0, 0.0), (8.0, 6.0, 0.0)),
        Surface("ceiling", "concrete", 0.2, (0.0, 0.0, 2.8), (8.0, 6.0, 2.8)),
        Surface("wall", "plasterboard", 0.1, (8.0, 0.0, 0.0), (8.0, 6.0, 2.8)),
        Surface("screen, metal", "metal", 0.002, (5.5, 1.5, 0.0), (5.5, 4.5, 2.3)),
    ),
)
ONE_LIT_TX, ONE_SHADOWED_TX = 0, 27  # at (1, 1, 1) and, behind the screen, at (6, 3, 1)
ROUNDING_M = 1e-5  # of float32 metres in a room
DEVIATION_RAD = 1e-9  # mirror points are exact to some roundings in float64


def store(scene: Scene, path: Path) -> PasDataset:
    carriers_hz = [carrier * 1e9 for carrier in CARRIERS_GHZ]
    return open_dataset(generate_planned(plan_generation(scene, carriers_hz, SETTINGS), path))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return store(SCENE, tmp_path_factory.mktemp("view") / "room.h5")


@pytest.fixture(scope="module")
def view(dataset: PasDataset) -> ViewPlan:
    return plan_view(str(dataset.path), ONE_LIT_TX).with_rays()


@pytest.fixture(scope="module")
def folder(view: ViewPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "office"
    write_view(view, folder)
    return folder


@pytest.fixture
def imported(tmp_path: Path) -> PasDataset:
    header = replace(make_header(num_tx=3, pas_kind="amplitude"), channels=False)
    maps = write_dataset(tmp_path / "channels.h5", num_tx=3).pas()
    told = replace(header, settings={"imported_from": "somebody", "convention": {"rows": "polar angle"}})
    with PasWriter(tmp_path / "maps.h5", told) as writer:
        samples = SampleBlock.of_maps(maps.reshape(3, 3, *maps.shape[1:]))
        writer.append(transmitters(3), np.ones(3, bool), samples)
    return open_dataset(tmp_path / "maps.h5")


def world(model: trimesh.Scene, node: str) -> trimesh.Trimesh:
    """A node's shape as it stands in the world: glTF's y is up, ours is z."""
    transform, name = model.graph[node]
    shape = model.geometry[name].copy().apply_transform(transform)
    shape.vertices = shape.vertices[:, [0, 2, 1]] * [1, -1, 1]
    return shape


def turns_rad(ray: Ray) -> list[float]:
    """By how much a ray turns at each point it meets."""
    steps = np.diff(ray.points_m, axis=0)
    along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    pairs = pairwise(along)
    return [float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)) for a, b in pairs]


def reflections(rays: Sequence[Ray]) -> list[tuple[np.ndarray, np.ndarray, Surface]]:
    """Unit vectors into and out of each mirror point, with the surface that is said to be there."""
    surfaces = {surface.name: surface for surface in SCENE.surface}
    found = []
    for ray in rays:
        steps = np.diff(ray.points_m, axis=0)
        along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        for number, event in enumerate(ray.events):
            if event.startswith("reflected by "):
                surface = surfaces[event.removeprefix("reflected by ")]
                found.append((along[number], along[number + 1], surface))
    return found


def test_rays_run_from_the_transmitter_to_the_array_centre(view: ViewPlan) -> None:
    assert view.room.rays
    for ray in view.room.rays:
        np.testing.assert_array_equal(ray.points_m[0], view.room.tx_position_m[ONE_LIT_TX])
        np.testing.assert_array_equal(ray.points_m[-1], SCENE.receiver.position_m)
        length_m = np.linalg.norm(np.diff(ray.points_m, axis=0), axis=1).sum()
        assert ray.delay_s * 299_792_458 == pytest.approx(length_m, rel=1e-12)  # float64
        assert len(ray.points_m) == len(ray.events) + 2


def test_reflections_have_equal_angles_at_the_surface_they_are_said_to_be_at(view: ViewPlan) -> None:
    found = reflections(view.room.rays)
    assert {surface.name for *_, surface in found} >= {"floor", "ceiling", "screen, metal"}
    for towards, away, surface in found:
        normal = np.equal(surface.min_m, surface.max_m).astype(float)
        mirrored = towards - 2 * (towards @ normal) * normal
        assert np.linalg.norm(mirrored - away) < DEVIATION_RAD


def test_what_goes_through_a_surface_does_not_turn(dataset: PasDataset) -> None:
    wooden = replace(SCENE, surface=(Surface("pane", "glass", 0.008, (5.5, 0.0, 0.0), (5.5, 6.0, 2.8)),))
    path = store(wooden, dataset.path.parent / "pane.h5").path
    behind = plan_view(str(path), ONE_SHADOWED_TX).with_rays()
    (ray,) = behind.room.rays
    assert ray.label == "through pane"
    assert max(turns_rad(ray)) < DEVIATION_RAD


def test_rays_are_ordered_and_weak_ones_left_out(view: ViewPlan) -> None:
    levels = [ray.level_db for ray in view.room.rays]
    assert levels == sorted(levels, reverse=True)
    assert levels[0] == 0 and levels[-1] >= -RAY_RANGE_DB
    assert view.room.rays[0].label == "line of sight"
    assert 1 < len(levels) <= MAX_RAYS


def test_a_shadowed_transmitter_has_no_line_of_sight(dataset: PasDataset) -> None:
    shadowed = plan_view(str(dataset.path), ONE_SHADOWED_TX)
    assert shadowed.room.in_sight is not None and not shadowed.room.in_sight[ONE_SHADOWED_TX]
    rays = shadowed.with_rays().room.rays
    assert rays and all(ray.label != "line of sight" for ray in rays)


def test_the_strongest_ray_depends_on_the_carrier_asked_for(dataset: PasDataset) -> None:
    low, high = (plan_view(str(dataset.path), ONE_LIT_TX, carrier).with_rays() for carrier in (2.4, 77.0))
    assert (low.carrier_hz, high.carrier_hz) == (2.4e9, 77e9)
    assert [ray.level_db for ray in low.room.rays] != [ray.level_db for ray in high.room.rays]


def test_the_model_holds_every_surface_group_ray_and_the_receiver(folder: Path, view: ViewPlan) -> None:
    model = trimesh.load_scene(folder / "scene.glb")
    nodes = set(model.graph.nodes_geometry)
    assert {f"surface {surface.name}" for surface in SCENE.surface} <= nodes
    assert {"transmitters in sight", "transmitters in shadow", "transmitter 0", "boresight"} <= nodes
    assert {"receiver", "array elements at 2.4 GHz", "ray 1: 0.0 dB, line of sight"} <= nodes
    assert sum(node.startswith("ray ") for node in nodes) == len(view.room.rays)


def test_the_model_is_in_the_places_of_the_scene(folder: Path, dataset: PasDataset) -> None:
    model = trimesh.load_scene(folder / "scene.glb")
    floor = world(model, "surface floor")
    np.testing.assert_allclose(floor.bounds, [[0, 0, 0], [8, 6, 0]], atol=ROUNDING_M)
    position_m, lit = dataset.tables["tx_position_m"], dataset.tables["line_of_sight"].astype(bool)
    for node, members in {"transmitters in sight": lit, "transmitters in shadow": ~lit}.items():
        markers = world(model, node).vertices.reshape(-1, 6, 3)
        np.testing.assert_allclose(markers.mean(axis=1), position_m[members], atol=ROUNDING_M)
    ahead_m = world(model, "boresight").bounds.mean(axis=0) - SCENE.receiver.position_m
    assert ahead_m[2] < -0.2 and abs(ahead_m[:2]).max() < ROUNDING_M  # it looks down


def test_a_ray_of_the_model_touches_both_its_ends(folder: Path, view: ViewPlan) -> None:
    model = trimesh.load_scene(folder / "scene.glb")
    for number, ray in enumerate(view.room.rays, start=1):
        (node,) = [node for node in model.graph.nodes_geometry if node.startswith(f"ray {number}: ")]
        vertices_m = world(model, node).vertices
        for point_m in ray.points_m:
            nearest_m = np.linalg.norm(vertices_m - point_m, axis=1).min()
            assert nearest_m < 0.008 + ROUNDING_M  # the tube's radius


def test_thousands_of_transmitters_stay_one_light_mesh(view: ViewPlan, tmp_path: Path) -> None:
    many = np.random.default_rng(0).uniform(0, 5, size=(5000, 3))
    room = replace(view.room, tx_position_m=many, in_sight=None, tx=0, rays=[])
    room_model(room).write(tmp_path / "many.glb")
    model = trimesh.load_scene(tmp_path / "many.glb")
    assert len(model.geometry["transmitters"].vertices) == 6 * 5000
    assert (tmp_path / "many.glb").stat().st_size < 2_000_000


def test_a_group_without_a_member_is_no_node(view: ViewPlan, tmp_path: Path) -> None:
    lit = np.ones(len(view.room.tx_position_m), dtype=bool)
    room_model(replace(view.room, in_sight=lit)).write(tmp_path / "lit.glb")
    nodes = set(trimesh.load_scene(tmp_path / "lit.glb").graph.nodes_geometry)
    assert "transmitters in sight" in nodes and "transmitters in shadow" not in nodes


def test_all_files_are_written_and_show_something(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    for name in ("scene.png", "pas.png", "overview.png"):
        with Image.open(folder / name) as picture:
            assert min(picture.size) > 300
            assert len(np.unique(np.asarray(picture.convert("L")))) > 50
    drawn = (folder / "carriers.svg").read_text()
    assert all(
        title in drawn for title in ("median SSIM between carriers", "power: median", "without any path")
    )


def test_equal_data_give_equal_files(folder: Path, view: ViewPlan, tmp_path: Path) -> None:
    write_view(view, tmp_path)
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes(), name


def page_text(folder: Path) -> str:
    """What a reader sees."""
    return unescape(re.sub(r"<[^>]+>", " ", (folder / "index.html").read_text().partition("<body")[2]))


def test_the_page_tells_what_the_data_set_holds(folder: Path, dataset: PasDataset) -> None:
    text = page_text(folder)
    lit = int(dataset.tables["line_of_sight"].sum())
    assert f"{lit} in sight of the receiver, {dataset.header.num_tx - lit} in shadow" in text
    assert dataset.sha256 in text and dataset.header.scene_sha256 in text
    assert "image solver, specular, refraction, depth 2, 20,000 rays, seed 1" in text
    assert SCENE.description in text
    assert "reflected by ceiling" in text
    for split in lofo(dataset):
        assert re.search(rf"{split.name}\s+{len(split.train):,}\s+{len(split.test):,}\s", text)
    assert "Protocol 'sparse' needs 1, 10, 37, 60, 94 GHz" in text


def test_the_page_s_lines_of_python_load_the_data(
    folder: Path, dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    (code,) = re.findall(r"<pre>(.*?)</pre>", (folder / "index.html").read_text(), re.DOTALL)
    monkeypatch.chdir(dataset.path.parent)
    names: dict[str, object] = {}
    exec(unescape(code), names)
    maps = names["maps"]
    assert isinstance(maps, np.ndarray)
    assert f"({', '.join(map(str, maps.shape))})" in unescape(code)
    np.testing.assert_array_equal(maps, dataset.pas(np.flatnonzero(dataset.tx_index == 0)))


def test_similarity_is_the_median_ssim_of_each_pair_of_carriers(dataset: PasDataset) -> None:
    found = similarity(dataset)
    assert found.num_tx == dataset.header.num_tx
    maps = dataset.pas().reshape(-1, 3, *dataset.grid.shape)
    heard = dataset.has_path.reshape(-1, 3)
    both = heard[:, 0] & heard[:, 2]
    expected = np.median(ssim(maps[both, 0], maps[both, 2], dataset.grid))
    assert found.median_ssim[0, 2] == found.median_ssim[2, 0] == pytest.approx(expected)
    np.testing.assert_array_equal(np.diag(found.median_ssim), 1)


def test_silent_samples_are_counted_and_compared_with_nothing(tmp_path: Path) -> None:
    silent = write_dataset(tmp_path / "silent.h5", silent=((0, 0), (1, 0), (2, 0), (3, 0), (1, 2)))
    summary = summarize(silent)
    np.testing.assert_array_equal((~summary.has_path).sum(axis=0), [4, 0, 1])
    assert np.isnan(summary.similarity.median_ssim[0, 1:]).all()
    assert summary.similarity.median_ssim[1, 2] < 1
    written = write_view(plan_view(str(silent.path)), tmp_path / "out")  # nothing is drawn of what is nan
    assert written[0].exists()


def test_of_one_carrier_nothing_is_compared(tmp_path: Path) -> None:
    alone = write_dataset(tmp_path / "alone.h5", carriers_ghz=(10.0,))
    write_view(plan_view(str(alone.path)), tmp_path / "out")
    assert "SSIM" not in (tmp_path / "out" / "carriers.svg").read_text()
    assert "needs two carriers or more" in page_text(tmp_path / "out")


def test_imported_maps_show_places_alone_and_say_why(imported: PasDataset, tmp_path: Path) -> None:
    shown = plan_view(str(imported.path)).with_rays()
    assert "does not say which scene" in shown.missing
    assert shown.room.in_sight is None and not shown.room.rays and not shown.room.meshes
    write_view(shown, tmp_path / "out")
    nodes = set(trimesh.load_scene(tmp_path / "out" / "scene.glb").graph.nodes_geometry)
    assert nodes == {
        "transmitters",
        f"transmitter {shown.room.tx}",
        "receiver",
        "array elements at 1 GHz",
        "boresight",
    }
    text = page_text(tmp_path / "out")
    assert "sight of the receiver not published" in text
    assert re.search(r"convention: rows\s+polar angle", text)
    assert "power: median" not in (tmp_path / "out" / "carriers.svg").read_text()


def test_a_scene_without_data_has_no_maps(tmp_path: Path) -> None:
    view_command("empty", output=tmp_path / "out", quiet=True)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(FILES[:3])
    text = page_text(tmp_path / "out")
    assert "line of sight" in text and "Load it" not in text and "24.25 GHz" in text


def test_meshes_beside_the_data_are_drawn_and_others_are_not(tmp_path: Path) -> None:
    write_mitsuba(surface_meshes(SCENE), tmp_path)
    meshed = replace(SCENE, surface=(), scene="scene.xml", folder=tmp_path)
    path = store(meshed, tmp_path / "meshed.h5").path
    shown = plan_view(str(path), ONE_LIT_TX)
    assert not shown.missing and len(shown.room.meshes) == len(SCENE.surface)
    assert shown.with_rays().room.rays
    write_mitsuba(surface_meshes(replace(SCENE, surface=SCENE.surface[:2])), tmp_path)
    other = plan_view(str(path), ONE_LIT_TX)
    assert "scene.xml is missing or another" in other.missing and not other.room.meshes


@pytest.mark.parametrize("tx", [-1, 35])
def test_a_transmitter_that_is_not_there_is_refused(dataset: PasDataset, tx: int) -> None:
    with pytest.raises(XFreqBenchError, match=f"room.h5 has transmitters 0 to 34, but --tx {tx} is asked"):
        plan_view(str(dataset.path), tx)


def test_a_carrier_that_is_not_there_is_refused_with_those_that_are(dataset: PasDataset) -> None:
    with pytest.raises(UnknownNameError, match=r"no carrier '5 GHz'.*2.4 GHz, 24.25 GHz, 77 GHz"):
        plan_view(str(dataset.path), carrier_ghz=5.0)


@pytest.mark.parametrize("carrier_ghz", [0.0, -1.0, float("nan"), float("inf")])
def test_a_carrier_is_a_positive_frequency(carrier_ghz: float) -> None:
    with pytest.raises(XFreqBenchError, match="--carrier takes a frequency in GHz"):
        plan_view("empty", carrier_ghz=carrier_ghz)


def test_what_is_neither_data_nor_a_scene_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="There is no file"):
        plan_view(str(tmp_path / "absent.h5"))
    with pytest.raises(UnknownNameError, match="Did you mean 'office'"):
        plan_view("ofice")


def test_files_of_others_stay_and_ours_are_replaced(
    folder: Path, dataset: PasDataset, tmp_path: Path
) -> None:
    shutil.copytree(folder, tmp_path / "again")
    (tmp_path / "again" / "notes.txt").write_text("mine")
    write_view(plan_view(str(dataset.path), 5), tmp_path / "again")
    assert (tmp_path / "again" / "pas.png").read_bytes() != (folder / "pas.png").read_bytes()
    assert (tmp_path / "again" / "notes.txt").read_text() == "mine"


def test_another_data_set_s_folder_is_refused_and_left(folder: Path, tmp_path: Path) -> None:
    other = write_dataset(tmp_path / "other.h5")
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    with pytest.raises(OutputExistsError, match=r"index\.html exists and was not written for this data set"):
        view_command(str(other.path), output=folder)
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == before


def test_a_foreign_file_of_the_same_name_is_not_overwritten(dataset: PasDataset, tmp_path: Path) -> None:
    (tmp_path / "scene.png").write_bytes(b"a photograph")
    with pytest.raises(OutputExistsError, match=r"scene\.png exists"):
        view_command(str(dataset.path), output=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.png"]
    assert (tmp_path / "scene.png").read_bytes() == b"a photograph"


def test_names_from_the_data_are_shown_as_they_are(
    dataset: PasDataset, view: ViewPlan, tmp_path: Path
) -> None:
    hostile = "</title><script>alert(1)</script>"
    path = tmp_path / "<script>alert(1)<script>.h5"
    shutil.copy(dataset.path, path)
    told = {
        "scene_name": hostile,
        "settings": {hostile: hostile},
        "software": {hostile: hostile},
        "rejected": {hostile: 1},
    }
    shown = replace(
        view,
        header=replace(view.header, **told),
        room=replace(view.room, rays=[replace(view.room.rays[0], events=(hostile,))]),
        dataset=open_dataset(path),
        scene=replace(SCENE, description=hostile),
        subject=hostile,
        missing=f"two\nlines {hostile}",
    )
    pictures = {name: Picture(name, f'"{hostile}', b"") for name in ("scene.png", "pas.png", "carriers.svg")}
    html = view_page(shown, summarize(dataset), pictures, hostile)
    assert "<script" not in html and html.count("&lt;script&gt;alert(1)") >= 12
    assert is_of_subject(html, hostile) and not is_of_subject(html, "another")


def test_a_room_groups_its_transmitters_by_sight(view: ViewPlan) -> None:
    room: ShownRoom = view.room
    assert {name: len(members) for name, members in room.groups().items()} == {
        "transmitters in sight": int(np.sum(room.in_sight)),
        "transmitters in shadow": int(np.sum(~np.asarray(room.in_sight))),
    }
    assert list(replace(room, in_sight=None).groups()) == ["transmitters"]
