from __future__ import annotations

import os
import signal
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray

from tests.support.damage import data_offset, flip
from tests.support.prediction_files import SPLITS, hand_out, killed
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.hdf5 import verify_sealed
from xfreqbench.data.splits import make_splits
from xfreqbench.errors import DataError, OutputExistsError, ProtocolError, StorageError
from xfreqbench.exchange.split_file import SCHEMA, write_splits

GEOMETRY = {
    *("axis", "receiver_axis", "element", "elevation_deg", "azimuth_deg", "rx_position_m", "frame_rotation"),
    "element_position_wavelengths",
}
ROWS = {f"{part}_{name}" for part in ("train", "test") for name in ("row", "tx_position_m", "carrier_hz")}


def test_a_split_file_holds_the_rows_of_the_protocol_and_their_coordinates(
    dataset: PasDataset, split_file: Path
) -> None:
    with h5py.File(split_file) as file:
        assert list(file) == SPLITS
        for split in make_splits(dataset, "lofo"):
            group = file[split.name]
            for part, rows in (("train", split.train), ("test", split.test)):
                samples = dataset[rows]
                np.testing.assert_array_equal(group[f"{part}_row"], rows)
                np.testing.assert_array_equal(group[f"{part}_tx_position_m"], samples.tx_position_m)
                np.testing.assert_array_equal(group[f"{part}_carrier_hz"], samples.carrier_hz)
            assert group.attrs["split_sha256"].decode() == split.sha256
            assert group.attrs["dataset_sha256"].decode() == dataset.sha256
            assert group.attrs["protocol_version"].decode() == split.version
            assert group.attrs["pas_kind"].decode() == "power"
            np.testing.assert_array_equal(group["rx_position_m"], dataset.header.receiver.position_m)
            np.testing.assert_allclose(np.radians(group["azimuth_deg"]), dataset.grid.azimuth_rad)


def test_a_split_file_is_sealed_groups_included(split_file: Path, tmp_path: Path) -> None:
    verify_sealed(split_file, SCHEMA)
    damaged = tmp_path / "split.h5"
    damaged.write_bytes(split_file.read_bytes())
    flip(damaged, data_offset(damaged, "lofo-77GHz/test_carrier_hz"))
    with pytest.raises(DataError, match="lofo-77GHz/test_carrier_hz"):
        verify_sealed(damaged, SCHEMA)


@pytest.mark.parametrize("maps", [False, True])
def test_no_test_map_and_no_channel_is_in_a_split_file(dataset: PasDataset, tmp_path: Path, maps: bool) -> None:
    path = hand_out(dataset, tmp_path / "split.h5", targets=[24.25], maps=maps)
    (split,) = make_splits(dataset, "lofo", [24.25])
    with h5py.File(path) as file:
        assert set(file["lofo-24.25GHz"]) == GEOMETRY | ROWS | ({"train_pas"} if maps else set())
    content = path.read_bytes()
    for row in split.test.tolist():
        for kind in ("<f2", "<f4", "<f8"):
            assert dataset.pas([row]).astype(kind).tobytes() not in content
    for row in dataset.rows:
        assert dataset.cfr[row].tobytes() not in content
    is_there = dataset.pas(split.train[:1]).astype("<f4").tobytes() in content
    assert is_there == maps  # the search finds a map that is there


def test_training_maps_come_along_where_they_are_asked_for(dataset: PasDataset, tmp_path: Path) -> None:
    path = hand_out(dataset, tmp_path / "split.h5", "sparse", maps=True)
    for split in make_splits(dataset, "sparse"):
        with xarray.open_dataset(path, group=split.name, engine="h5netcdf") as group:
            assert group["train_pas"].dims == ("train_row", "elevation_deg", "azimuth_deg")
            np.testing.assert_array_equal(group["train_row"], split.train)
            np.testing.assert_array_equal(group["train_pas"], dataset.pas(split.train))


def test_maps_that_another_split_tests_are_not_handed_out(dataset: PasDataset, tmp_path: Path) -> None:
    with pytest.raises(ProtocolError, match=r"'lofo-2\.4GHz' contains maps that 'lofo-24\.25GHz' tests"):
        hand_out(dataset, tmp_path / "split.h5", maps=True)
    for protocol in ("sparse", "held-out-tx", "lofo-unseen-tx"):
        hand_out(dataset, tmp_path / f"{protocol}.h5", protocol, maps=True)


def test_a_split_file_that_is_there_is_left_and_another_is_never_overwritten(
    dataset: PasDataset, tmp_path: Path
) -> None:
    path = tmp_path / "split.h5"
    splits = make_splits(dataset, "lofo")
    assert write_splits(dataset, splits, path)
    before = path.read_bytes()
    assert not write_splits(dataset, splits, path)
    with pytest.raises(OutputExistsError, match="holds other splits"):
        hand_out(dataset, path, "sparse")
    assert path.read_bytes() == before
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputExistsError, match="no splits that can be read"):
        write_splits(dataset, splits, tmp_path / "notes.txt")
    with pytest.raises(StorageError, match="not a file"):
        write_splits(dataset, splits, tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_writing_training_maps_tells_how_far_it_is_and_holds_a_batch_at_a_time(
    dataset: PasDataset, tmp_path: Path
) -> None:
    told = []
    splits = make_splits(dataset, "lofo", [77])
    write_splits(dataset, splits, tmp_path / "split.h5", True, lambda *each: told.append(each))
    assert told == [(32, 45), (45, 45)]  # 5 transmitters at 9 carriers


def test_a_split_file_killed_in_the_middle_is_not_there_and_is_written_by_the_next_try(
    dataset: PasDataset, tmp_path: Path
) -> None:
    asked = dataset, make_splits(dataset, "lofo", [77]), tmp_path / "split.h5", True
    path = asked[2]
    killed(lambda: write_splits(*asked, lambda done, total: os.kill(os.getpid(), signal.SIGKILL)))
    assert not path.exists() and list(tmp_path.iterdir())
    assert write_splits(*asked)
    verify_sealed(path, SCHEMA)
    assert list(tmp_path.iterdir()) == [path]
