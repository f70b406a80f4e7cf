"""What `xfreqbench view` refuses to show, and which files it leaves alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.support.damage import data_offset, flip
from tests.support.synthetic import write_dataset
from xfreqbench.cli.data import view as view_command
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError, OutputExistsError, UnknownNameError, XFreqBenchError
from xfreqbench.report.view.plan import ViewPlan, plan_view
from xfreqbench.report.view.write import FILES, write_view


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
