"""Batches of an unfinished generation: whose they are is never a guess, and what is not ours is left alone."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.damage import flip
from tests.support.plans import small_plan, unfinished
from xfreqbench.data.batches import BatchStore
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.errors import DataError, OutputExistsError, StorageError
from xfreqbench.system.files import sole_writer

OURS, OTHER = small_plan(num_transmitters=20), small_plan(num_transmitters=20, pas_kind="amplitude")


@pytest.fixture(scope="module")
def left_by_other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return unfinished(OTHER, tmp_path_factory.mktemp("other") / "rooms.h5")


@pytest.fixture(scope="module")
def left_by_ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return unfinished(OURS, tmp_path_factory.mktemp("ours") / "rooms.h5")


@pytest.fixture
def folder(left_by_ours: Path, tmp_path: Path) -> Path:
    """Our unfinished batches, beside `rooms.h5`."""
    return Path(shutil.copytree(left_by_ours, tmp_path / "rooms.h5.parts"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return generate_planned(OURS, tmp_path_factory.mktemp("whole") / "rooms.h5").read_bytes()


def test_unfinished_batches_of_another_job_are_left_alone(tmp_path: Path, left_by_other: Path) -> None:
    folder = shutil.copytree(left_by_other, tmp_path / "rooms.h5.parts")
    names = {path.name for path in folder.iterdir()}
    with pytest.raises(OutputExistsError, match=r"another unfinished run: pas_kind amplitude there, power here\. Run"):
        generate_planned(OURS, tmp_path / "rooms.h5")
    assert {path.name for path in folder.iterdir()} == names


def test_batches_of_other_code_or_software_are_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: bytes
) -> None:
    path = tmp_path / "rooms.h5"
    monkeypatch.setattr("xfreqbench.data.plan.package_sha256", lambda: "edited")
    monkeypatch.setattr("xfreqbench.data.plan.software_versions", lambda solver: OURS.header.software | {"numba": "9"})
    folder = unfinished(small_plan(num_transmitters=20), path)
    with pytest.raises(
        OutputExistsError, match=r"run: software\.code edited there, \w{16} here; software\.numba 9 there"
    ):
        generate_planned(OURS, path)
    shutil.rmtree(folder)
    assert generate_planned(OURS, path).read_bytes() == whole


def test_a_sample_of_every_batch_that_was_kept_is_traced_again(tmp_path: Path) -> None:
    plan, path = small_plan(num_transmitters=96), tmp_path / "rooms.h5"
    folder = unfinished(plan, path)
    store, third = BatchStore(folder, plan), next(folder.glob("000002-*"))
    channel = store.read(2)
    third.unlink()
    store.write(2, replace(channel, cfr=2 * channel.cfr))  # whole, and yet not what this code traces
    with pytest.raises(DataError, match=r"transmitter (3[2-9]|4[0-7]) at .* differs by"):
        generate_planned(plan, path)
    assert not path.exists()


def test_a_file_that_somebody_writes_in_the_meantime_stays(tmp_path: Path) -> None:
    path = tmp_path / "rooms.h5"
    with pytest.raises(OutputExistsError, match="in the meantime"):
        generate_planned(OURS, path, write_progress=lambda done, total: path.write_text("theirs"))
    assert path.read_text() == "theirs"


def test_batches_without_a_marker_are_refused(tmp_path: Path, left_by_other: Path) -> None:
    """A removal that was killed left such a folder, and every job took it for its own."""
    folder = shutil.copytree(left_by_other, tmp_path / "rooms.h5.parts")
    (folder / "job.json").unlink()
    with pytest.raises(OutputExistsError, match=r"not a folder of batches"):
        generate_planned(OURS, tmp_path / "rooms.h5")
    assert len(list(folder.glob("*.npz"))) == 2


@pytest.mark.parametrize("named", ["theirs", "ours"])
def test_batches_of_another_job_are_not_taken_even_with_our_marker(
    tmp_path: Path, left_by_other: Path, whole: bytes, named: str
) -> None:
    folder = shutil.copytree(left_by_other, tmp_path / "rooms.h5.parts")
    (folder / "job.json").write_text(json.dumps(OURS.job))
    for path in folder.glob("*.npz") if named == "ours" else ():
        path.rename(folder / path.name.replace(OTHER.sha256[:16], OURS.sha256[:16]))
    assert generate_planned(OURS, tmp_path / "rooms.h5").read_bytes() == whole


def test_a_batch_under_another_ones_number_is_not_taken(tmp_path: Path, folder: Path, whole: bytes) -> None:
    first, second = sorted(folder.glob("*.npz"))
    first.unlink()
    second.rename(folder / second.name.replace("000001", "000000", 1))
    assert generate_planned(OURS, tmp_path / "rooms.h5").read_bytes() == whole


def test_a_damaged_batch_is_traced_again(tmp_path: Path, folder: Path, whole: bytes) -> None:
    first, second = sorted(folder.glob("*.npz"))
    flip(first, first.stat().st_size // 2)
    second.write_bytes(b"cut short")
    sha256 = hashlib.sha256(b"cut short").hexdigest()  # whole by its name, and yet no batch
    second.rename(re.sub(r"[0-9a-f]{64}", sha256, str(second)))
    assert generate_planned(OURS, tmp_path / "rooms.h5").read_bytes() == whole


def test_a_kill_before_the_folder_is_marked_does_not_block_it(tmp_path: Path, whole: bytes) -> None:
    folder = tmp_path / "rooms.h5.parts"
    folder.mkdir()
    (tmp_path / ".rooms.h5.lock").write_text("process 1 on elsewhere", encoding="utf-8")
    (folder / ".job.json.lock").write_text("process 1 on elsewhere", encoding="utf-8")
    (folder / ".job.json.elsewhere-1.partial").write_text("half", encoding="utf-8")
    assert generate_planned(OURS, tmp_path / "rooms.h5").read_bytes() == whole
    assert [path.name for path in tmp_path.iterdir()] == ["rooms.h5"]


def test_a_folder_of_somebody_else_is_refused_by_name(tmp_path: Path) -> None:
    folder = tmp_path / "rooms.h5.parts"
    folder.mkdir()
    (folder / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputExistsError, match=r"rooms\.h5\.parts holds 'thesis\.tex'"):
        generate_planned(OURS, tmp_path / "rooms.h5")
    assert [path.name for path in folder.iterdir()] == ["thesis.tex"]
    shutil.rmtree(folder)
    folder.write_text("a file")
    with pytest.raises(OutputExistsError, match="is in the way"):
        generate_planned(OURS, tmp_path / "rooms.h5")
    assert folder.read_text() == "a file"


def test_what_somebody_adds_to_the_folder_stays(tmp_path: Path, folder: Path, whole: bytes) -> None:
    (folder / "notes.txt").write_text("mine")
    outside = tmp_path / "outside.npz"
    outside.write_text("elsewhere")
    (folder / "000000-link.npz").symlink_to(outside)
    assert generate_planned(OURS, tmp_path / "rooms.h5").read_bytes() == whole
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]
    assert outside.read_text() == "elsewhere"


def test_a_link_in_the_folders_place_is_not_followed(tmp_path: Path, folder: Path) -> None:
    elsewhere = folder.rename(tmp_path / "elsewhere.h5.parts")
    names = {path.name for path in elsewhere.iterdir()}
    (tmp_path / "rooms.h5.parts").symlink_to(elsewhere, target_is_directory=True)
    with pytest.raises(OutputExistsError, match="symbolic link, which is not followed"):
        generate_planned(OURS, tmp_path / "rooms.h5")
    assert {path.name for path in elsewhere.iterdir()} == names
    (tmp_path / "rooms.h5.parts").unlink()
    (tmp_path / "rooms.h5.parts").symlink_to(tmp_path / "nowhere")
    with pytest.raises(OutputExistsError, match="symbolic link"):
        generate_planned(OURS, tmp_path / "rooms.h5")
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.usefixtures("folder")
def test_one_process_at_a_time_writes_an_output(tmp_path: Path, whole: bytes) -> None:
    refusal = r"rooms\.h5 is being written by process \d+ on .*, since .*\. Wait"
    with sole_writer(tmp_path / "rooms.h5"), ThreadPoolExecutor(1) as other, pytest.raises(StorageError, match=refusal):
        other.submit(generate_planned, OURS, tmp_path / "rooms.h5").result()
    assert generate_planned(OURS, tmp_path / "rooms.h5").read_bytes() == whole


def test_what_a_kill_leaves_of_a_removal_goes_with_the_next_run(tmp_path: Path, left_by_ours: Path) -> None:
    path = tmp_path / "rooms[1].h5"
    for name in ("rooms[1].h5.parts", ".rooms[1].h5.parts.killed.removed"):
        shutil.copytree(left_by_ours, tmp_path / name)
    generate_planned(OURS, path)
    assert list(tmp_path.iterdir()) == [path]
    shutil.copytree(left_by_ours, tmp_path / "rooms[1].h5.parts")  # killed when the data set already had its name
    before = path.stat().st_mtime_ns
    generate_planned(OURS, path)
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mtime_ns == before
    assert open_dataset(path).header.num_tx == 20
