from __future__ import annotations

import fcntl
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.support.damage import data_offset, flip
from tests.support.plans import small_plan
from tests.support.synthetic import write_dataset
from xfreqbench.data import hdf5
from xfreqbench.data.dataset import holds_same_job, open_dataset, verify
from xfreqbench.data.hdf5 import open_foreign, read_errors
from xfreqbench.errors import DataError, StorageError

TABLES = (
    *("carrier_hz", "cfr", "complete", "elevation_deg", "frame_rotation", "line_of_sight", "pas", "rx_position_m"),
    "tx_position_m",
)


def test_verify_and_reading_name_the_dataset_in_which_one_bit_flipped(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "data.h5", num_tx=2).path
    verify(path)
    content = path.read_bytes()
    for name in TABLES:
        flip(path, data_offset(path, name))
        for read in (verify, lambda path: open_dataset(path).pas())[: 1 if name == "complete" else 2]:  # never read
            with pytest.raises(DataError, match=f"dataset '{name}'"):
                read(path)
        path.write_bytes(content)


def test_a_flipped_bit_anywhere_is_found(tmp_path: Path) -> None:
    good = write_dataset(tmp_path / "data.h5", num_tx=1, carriers_ghz=(1.0,), maps=False)
    path, content = good.path, good.path.read_bytes()
    for offset in np.random.default_rng(1).choice(len(content), 150, replace=False):
        flip(path, int(offset))
        with pytest.raises(DataError):
            verify(path)
        with suppress(DataError):  # a flip in what is not read is not seen by whoever only reads
            read = open_dataset(path)
            assert (read.header.attributes(), read.sha256) == (good.header.attributes(), good.sha256)
            assert all((values == good.tables[name]).all() for name, values in read.tables.items())
        path.write_bytes(content)


def test_a_map_that_another_program_changed_is_not_read(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "data.h5", num_tx=2).path
    with h5py.File(path, "r+") as file:
        file["pas"][0, 0] = 1
    with pytest.raises(DataError, match="another program opened it to write"):
        open_dataset(path)


def test_what_is_no_whole_data_set_is_refused(tmp_path: Path) -> None:
    whole = write_dataset(tmp_path / "data.h5", num_tx=2).path.read_bytes()
    (tmp_path / "data.h5").unlink()
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.attrs["schema"] = "other/1"
    for share in (0.99, 0.3, 0.0):
        (tmp_path / f"cut{share}.h5").write_bytes(whole[: int(len(whole) * share)])
    cut = {f"cut{share}": "not written completely|not HDF5" for share in (0.99, 0.3, 0.0)}
    for name, words in {"data": r"no file .*data\.h5", "other": "'other/1'", **cut}.items():
        with pytest.raises(DataError, match=words):
            open_dataset(tmp_path / f"{name}.h5")


def test_a_file_that_another_program_has_opened_to_write_is_in_use_not_damaged(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "data.h5", num_tx=2).path
    with path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # as HDF5 does
        for read in (open_dataset, verify, lambda path: open_foreign(path).__enter__()):
            with pytest.raises(StorageError, match=r"data\.h5 is in use: .*h5clear"):
                read(path)
        header, places = small_plan().header, small_plan().tx_position_m
        with pytest.raises(StorageError, match=r"data\.h5 is in use: .*h5clear"):
            holds_same_job(path, header, places)
    open_dataset(path)
    subprocess.run(
        [sys.executable, "-c", f"import h5py, os; file = h5py.File({str(path)!r}, 'r+'); os.kill(os.getpid(), 9)"]
    )
    with pytest.raises(StorageError, match="is in use"):  # as a mark in the file says, which the killed program left
        open_dataset(path)


def test_too_little_memory_is_not_called_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = write_dataset(tmp_path / "data.h5", num_tx=2, carriers_ghz=(5.0,))

    def no_memory(*_: object) -> None:
        raise MemoryError

    told = r"data\.h5 cannot be read: there is not enough memory"
    with pytest.raises(StorageError, match=told), read_errors(dataset.path):
        no_memory()
    with h5py.File(dataset.path) as file:
        chunk = file["pas"].id.get_chunk_info(0).byte_offset
    flip(dataset.path, chunk)
    monkeypatch.setattr(hdf5, "bytearray", no_memory, raising=False)
    with pytest.raises(StorageError, match="not enough memory"):  # of which HDF5 says the same as of a wrong sum
        dataset.pas(0)
