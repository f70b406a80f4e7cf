"""What `xfreqbench view` writes and shows, what it refuses, and which files it leaves alone."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.support.damage import data_offset, flip
from tests.support.screened_room import SCENE
from tests.support.synthetic import write_dataset
from xfreqbench.cli.data import view as view_command
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.errors import DataError, OutputExistsError, UnknownNameError, XFreqBenchError
from xfreqbench.maps.metrics import ssim
from xfreqbench.report.drawing.templates import Picture, is_of_subject
from xfreqbench.report.view.describe import summarize
from xfreqbench.report.view.figures import plot_carriers
from xfreqbench.report.view.page import view_page
from xfreqbench.report.view.plan import ViewPlan, plan_view
from xfreqbench.report.view.write import FILES, write_view
from xfreqbench.scene.materials import ConstantMaterial

PICTURES = {part: [Picture("", b"")] for part in ("scene", "maps", "carriers")}


def test_all_files_are_written_and_show_something(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    for name in ("scene.png", "pas.png", "overview.png"):
        with Image.open(folder / name) as picture:
            assert min(picture.size) > 300
            assert len(np.unique(np.asarray(picture.convert("L")))) > 50
    drawn = (folder / "carriers.svg").read_text()
    assert all(title in drawn for title in ("median SSIM between carriers", "power: median", "paths a transmitter"))


def page_text(folder: Path) -> str:
    """What a reader sees."""
    return unescape(re.sub(r"<[^>]+>", " ", (folder / "index.html").read_text().partition("<body")[2]))


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


def test_the_page_names_the_command_for_another_transmitter(folder: Path, view: ViewPlan) -> None:
    text = page_text(folder)
    (tx,) = re.findall(r"xfreqbench view room\.h5 --tx (\d+) -o FOLDER", text)
    (shadowed,) = re.findall(r"Transmitter (\d+) is in shadow", text)
    assert int(tx) == view.room.tx + 1 and view.room.in_sight is not None
    assert view.room.in_sight[view.room.tx] and not view.room.in_sight[int(shadowed)]


def test_similarity_is_the_median_ssim_of_each_pair_of_carriers(dataset: PasDataset) -> None:
    found = summarize(dataset)
    assert found.num_compared == dataset.header.num_tx
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
    assert np.isnan(summary.median_ssim[0, 1:]).all()
    assert summary.median_ssim[1, 2] < 1
    written = write_view(plan_view(str(silent.path)), tmp_path / "out")  # nothing is drawn of what is nan
    assert written[0].exists()


def test_of_one_carrier_nothing_is_compared(tmp_path: Path) -> None:
    alone = write_dataset(tmp_path / "alone.h5", carriers_ghz=(10.0,))
    write_view(plan_view(str(alone.path)), tmp_path / "out")
    assert "SSIM" not in (tmp_path / "out" / "carriers.svg").read_text()
    assert "needs two carriers or more" in page_text(tmp_path / "out")
    unknown = replace(summarize(alone), peak_db=None, num_paths=None)  # as of imported maps: there is nothing to draw
    plot_carriers(unknown, tmp_path / "carriers.svg")
    assert not (tmp_path / "carriers.svg").exists()
    assert "From carrier to carrier" in view_page(plan_view(str(alone.path)), unknown, PICTURES, "scene.glb", "pas.png")


def test_imported_maps_show_places_alone_and_say_why(imported: PasDataset, tmp_path: Path) -> None:
    shown = plan_view(str(imported.path)).with_rays()
    assert "does not say which scene" in shown.missing
    assert shown.room.in_sight is None and not shown.room.rays and not shown.room.meshes
    write_view(shown, tmp_path / "out")
    nodes = set(trimesh.load_scene(tmp_path / "out" / "scene.glb").graph.nodes_geometry)
    assert nodes == {"transmitters", f"transmitter {shown.room.tx}", "receiver", "array elements at 1 GHz", "boresight"}
    text = page_text(tmp_path / "out")
    assert "sight of the receiver not published" in text
    assert re.search(r"convention: rows\s+polar angle", text)
    assert "power: median" not in (tmp_path / "out" / "carriers.svg").read_text()


def test_a_scene_without_data_has_no_maps(tmp_path: Path) -> None:
    view_command("empty", output=tmp_path / "out", quiet=True)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(FILES[:3])
    text = page_text(tmp_path / "out")
    assert "line of sight" in text and "Load it" not in text and "24.25 GHz" in text


def test_names_from_the_data_are_shown_as_they_are(dataset: PasDataset, view: ViewPlan, tmp_path: Path) -> None:
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
    pictures = {part: [Picture(f'"{hostile}', b"")] for part in PICTURES}
    html = view_page(shown, summarize(dataset), pictures, hostile, hostile)
    ours = ['<script type="application/gzip" id="orbit-scene">', "<script>", "<script>"]
    assert re.findall("<script[^>]*>", html) == ours and html.count("&lt;script&gt;alert(1)") >= 12
    assert is_of_subject(html, hostile) and not is_of_subject(html, "another")


def test_a_material_of_the_scene_s_own_says_that_it_is_the_same_everywhere(view: ViewPlan) -> None:
    own = ConstantMaterial("<b>foam</b>", 1.5, 0.002)
    first, *others = view.room.meshes
    room = replace(view.room, meshes=[replace(first, material=own), *others])
    shown = view_page(replace(view, room=room, dataset=None), None, PICTURES, "scene.glb", "pas.png")
    assert "&lt;b&gt;foam&lt;/b&gt;" in shown and "<b>foam" not in shown
    assert "none: the scene&#39;s own, the same at every carrier" in shown


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"tx": -1}, "room.h5 has transmitters 0 to 34, but --tx -1 is asked"),
        ({"tx": 35}, "room.h5 has transmitters 0 to 34, but --tx 35 is asked"),
        ({"carrier_ghz": 5.0}, r"no carrier '5 GHz'.*2.4 GHz, 24.25 GHz, 77 GHz"),
        ({"carrier_ghz": 0.0}, r"--carrier cannot use .* a carrier in GHz is a number above 0"),
        ({"carrier_ghz": float("nan")}, r"--carrier cannot use .* a carrier in GHz is a number above 0"),
    ],
)
def test_what_is_not_in_the_data_is_refused_with_what_is(dataset: PasDataset, asked: dict, words: str) -> None:
    with pytest.raises(XFreqBenchError, match=words):
        plan_view(str(dataset.path), **asked)


def test_what_is_neither_data_nor_a_scene_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="There is no file"):
        plan_view(str(tmp_path / "absent.h5"))
    with pytest.raises(UnknownNameError, match="Did you mean 'office'"):
        plan_view("ofice")


def test_ours_are_replaced_by_equal_files_of_equal_data(folder: Path, view: ViewPlan, tmp_path: Path) -> None:
    again = Path(shutil.copytree(folder, tmp_path / "again"))
    (again / "notes.txt").write_text("mine")
    shutil.copy(again / "scene.png", again / "pas.png")
    write_view(view, again)
    for name in FILES:
        assert (again / name).read_bytes() == (folder / name).read_bytes(), name
    assert (again / "notes.txt").read_text() == "mine"


def test_another_data_set_s_folder_is_refused_and_left(folder: Path, tmp_path: Path) -> None:
    other = write_dataset(tmp_path / "other.h5")
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    with pytest.raises(OutputExistsError, match=r"index\.html exists and was not written for this data set"):
        view_command(str(other.path), output=folder)
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == before


def test_a_file_of_somebody_else_is_not_overwritten(folder: Path, dataset: PasDataset, tmp_path: Path) -> None:
    again = Path(shutil.copytree(folder, tmp_path / "again"))
    for name in FILES[1:]:
        ours = (again / name).read_bytes()
        (again / name).write_text("mine")
        with pytest.raises(OutputExistsError, match=f"{name} exists"):
            write_view(plan_view(str(dataset.path), 5), again)
        assert (again / name).read_text() == "mine"
        (again / name).write_bytes(ours)
    (tmp_path / "scene.png").write_bytes(b"a photograph")
    with pytest.raises(OutputExistsError, match=r"scene\.png exists"):
        view_command(str(dataset.path), output=tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"again", "scene.png"}


def test_a_damaged_data_set_is_not_shown(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5")
    flip(dataset.path, data_offset(dataset.path, "pas"))
    with pytest.raises(DataError, match=r"is damaged.*dataset 'pas'"):
        write_view(plan_view(str(dataset.path)), tmp_path / "out")
    assert not list(tmp_path.glob("out/*"))
