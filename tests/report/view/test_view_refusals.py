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
from xfreqbench.report.view.plan import plan_view
from xfreqbench.report.view.write import write_view


@pytest.mark.parametrize("tx", [-1, 35])
def test_a_transmitter_that_is_not_there_is_refused(dataset: PasDataset, tx: int) -> None:
    with pytest.raises(XFreqBenchError, match=f"room.h5 has transmitters 0 to 34, but --tx {tx} is asked"):
        plan_view(str(dataset.path), tx)


def test_a_carrier_that_is_not_there_is_refused_with_those_that_are(dataset: PasDataset) -> None:
    with pytest.raises(UnknownNameError, match=r"no carrier '5 GHz'.*2.4 GHz, 24.25 GHz, 77 GHz"):
        plan_view(str(dataset.path), carrier_ghz=5.0)


@pytest.mark.parametrize("carrier_ghz", [0.0, -1.0, float("nan"), float("inf")])
def test_a_carrier_is_a_positive_frequency(carrier_ghz: float) -> None:
    with pytest.raises(XFreqBenchError, match=r"--carrier cannot use .* a carrier in GHz is a number above 0"):
        plan_view("empty", carrier_ghz=carrier_ghz)


def test_what_is_neither_data_nor_a_scene_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="There is no file"):
        plan_view(str(tmp_path / "absent.h5"))
    (tmp_path / "folder.h5").mkdir()
    with pytest.raises(DataError, match=r"folder\.h5 is a folder\. Give one of its files"):
        plan_view(str(tmp_path / "folder.h5"))
    with pytest.raises(UnknownNameError, match="Did you mean 'office'"):
        plan_view("ofice")


def test_files_of_others_stay_and_ours_are_replaced(folder: Path, dataset: PasDataset, tmp_path: Path) -> None:
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


@pytest.mark.parametrize("name", ["scene.glb", "scene.png", "pas.png", "carriers.svg"])
def test_a_foreign_file_among_ours_is_not_overwritten(
    folder: Path, dataset: PasDataset, tmp_path: Path, name: str
) -> None:
    shutil.copytree(folder, tmp_path / "again")
    (tmp_path / "again" / name).write_text("mine")
    with pytest.raises(OutputExistsError, match=f"{name} exists"):
        write_view(plan_view(str(dataset.path), 5), tmp_path / "again")
    assert (tmp_path / "again" / name).read_text() == "mine"


def test_a_foreign_file_of_the_same_name_is_not_overwritten(dataset: PasDataset, tmp_path: Path) -> None:
    (tmp_path / "scene.png").write_bytes(b"a photograph")
    with pytest.raises(OutputExistsError, match=r"scene\.png exists"):
        view_command(str(dataset.path), output=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.png"]
    assert (tmp_path / "scene.png").read_bytes() == b"a photograph"


def test_a_damaged_data_set_is_not_shown(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5")
    flip(dataset.path, data_offset(dataset.path, "pas"))
    with pytest.raises(DataError, match=r"is damaged.*dataset 'pas'"):
        write_view(plan_view(str(dataset.path)), tmp_path / "out")
    assert not list(tmp_path.glob("out/*"))
