from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.places import ROOT
from tests.support.synthetic import append_all, make_header, transmitters, write_dataset
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.errors import DataError, StorageError


def test_equal_content_gives_equal_bytes(tmp_path: Path) -> None:
    first = write_dataset(tmp_path / "first.h5").path.read_bytes()
    time.sleep(1.1)  # a time stamp of one second's resolution would show
    assert write_dataset(tmp_path / "second.h5").path.read_bytes() == first


def test_batch_size_does_not_change_the_hash(tmp_path: Path) -> None:
    hashes = []
    for batch in (1, 4):
        header = make_header(maps=False)
        with PasWriter(tmp_path / "data.h5", header) as writer:
            append_all(writer, header, batch=batch)
        hashes.append(open_dataset(tmp_path / "data.h5").sha256)
    assert hashes[0] == hashes[1]


def test_missing_transmitters_leave_no_file(tmp_path: Path) -> None:
    header = make_header(num_tx=4)
    with pytest.raises(DataError, match="3 of its 4 rows"), PasWriter(tmp_path / "data.h5", header) as writer:
        append_all(writer, make_header(num_tx=3))
    assert list(tmp_path.iterdir()) == []


def test_too_many_transmitters_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="do not fit"), PasWriter(tmp_path / "data.h5", make_header(num_tx=2)) as writer:
        append_all(writer, make_header(num_tx=3))


@pytest.mark.parametrize("wrong", [-0.1, 1.2, np.nan, np.inf])
def test_maps_that_are_not_from_0_to_1_are_refused(tmp_path: Path, wrong: float) -> None:
    header = replace(make_header(1, (1.0,)), channels=False)
    maps = np.full((1, 1, 90, 360), 0.5, np.float32)
    maps[0, 0, 3, 4] = wrong
    with pytest.raises(DataError, match="numbers from 0 to 1"), PasWriter(tmp_path / "data.h5", header) as writer:
        writer.append(transmitters(1), np.array([True]), SampleBlock.of_maps(maps))
    assert list(tmp_path.iterdir()) == []


def test_an_exception_leaves_the_former_file_and_no_other(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "data.h5").path
    before = path.read_bytes()
    header = make_header()
    with pytest.raises(KeyboardInterrupt), PasWriter(path, header):
        raise KeyboardInterrupt
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_of_the_caller_is_not_taken_for_one_of_the_disk(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), PasWriter(tmp_path / "data.h5", make_header()):
        raise FileNotFoundError("the caller's")


_WRITER = """
import sys
sys.path.insert(0, {root!r})
from pathlib import Path
from tests.support.synthetic import append_all, make_header
from xfreqbench.data.writer import PasWriter, SampleBlock
{prelude}
header = make_header()
with PasWriter(Path({path!r}), header) as writer:
    {before}
    append_all(writer, header)
"""


def _script(path: Path, prelude: str = "", before: str = "pass") -> list[str]:
    text = _WRITER.format(root=str(ROOT), path=str(path), prelude=prelude, before=before)
    return [sys.executable, "-c", text]


def test_a_killed_writer_leaves_the_target_alone(tmp_path: Path) -> None:
    path = tmp_path / "data.h5"
    before = "append_all(writer, make_header(num_tx=2)); import os; os.kill(os.getpid(), 9)"
    killed = subprocess.run(_script(path, before=before), check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not path.exists()
    assert sorted(file.suffix for file in tmp_path.iterdir()) == [".lock", ".partial"]


def test_a_disk_that_fills_up_is_a_storage_error_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "data.h5"
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))"
    failed = subprocess.run(_script(path, prelude=limit), capture_output=True, text=True, check=False)
    assert failed.returncode == 1
    assert f"StorageError: {path}, which needs" in failed.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_room_is_refused_before_the_first_byte(tmp_path: Path) -> None:
    header = make_header(num_tx=10**9)
    with pytest.raises(StorageError, match=r"data\.h5 needs [\d,]+ bytes"), PasWriter(tmp_path / "data.h5", header):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_place_of_a_folder_is_a_storage_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(StorageError, match="cannot be written"),
        PasWriter(tmp_path / "file" / "data.h5", make_header()),
    ):
        pass


def test_a_folder_in_the_place_of_the_file_is_a_storage_error(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="is a folder"), PasWriter(tmp_path, make_header()):
        pass
