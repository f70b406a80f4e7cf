from __future__ import annotations

import json
import pickle
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from synthetic import append_all, channel, make_header, transmitters, write_dataset

from xfreqbench.angles import AngularGrid
from xfreqbench.dataset import PasDataset, PasWriter, open_dataset, verify
from xfreqbench.errors import DataError, StorageError
from xfreqbench.pas import BartlettBeam
from xfreqbench.predictions import read_predictions, write_predictions

FLOAT16_STEP = 2.0**-11  # half the spacing of float16 just below 1
TESTS = Path(__file__).parent


def test_stored_channels_and_maps_are_those_of_the_plane_waves(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5")
    expected = channel(transmitters(4)[2], 10e9)
    row = 2 * 3 + 1
    np.testing.assert_allclose(dataset.cfr[row], expected, rtol=1e-6)  # complex64
    beam = BartlettBeam(dataset.header.receiver.element_position_wavelengths, AngularGrid.hemisphere())
    maps, peak_power = beam.maps(expected[None])
    np.testing.assert_allclose(dataset.pas([row]), maps, atol=FLOAT16_STEP)
    assert dataset.peak_power[row] == pytest.approx(peak_power[0], rel=1e-5)


def test_rows_run_over_carriers_first(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5")
    assert len(dataset) == 12
    np.testing.assert_array_equal(dataset.tx_index, np.repeat(np.arange(4), 3))
    np.testing.assert_array_equal(dataset.carrier_hz, np.tile([1e9, 10e9, 37e9], 4))
    np.testing.assert_array_equal(dataset.tx_position_m, np.repeat(transmitters(4), 3, axis=0))
    np.testing.assert_array_equal(dataset.line_of_sight, np.repeat([True, False, True, False], 3))
    np.testing.assert_array_equal(dataset.num_paths, np.full(12, 3))


def test_a_file_without_maps_derives_the_maps_that_another_stores(tmp_path: Path) -> None:
    stored = write_dataset(tmp_path / "stored.h5")
    derived = write_dataset(tmp_path / "derived.h5", maps=False)
    np.testing.assert_allclose(derived.pas(), stored.pas(), atol=FLOAT16_STEP)
    assert derived.path.stat().st_size < stored.path.stat().st_size / 10


def test_the_grid_is_read_from_the_file(tmp_path: Path) -> None:
    grid = write_dataset(tmp_path / "data.h5").grid
    np.testing.assert_allclose(grid.directions, AngularGrid.hemisphere().directions, atol=1e-12)


def test_the_header_comes_back_as_it_was_written(tmp_path: Path) -> None:
    header, written = write_dataset(tmp_path / "data.h5").header, make_header()
    np.testing.assert_array_equal(header.carrier_hz, written.carrier_hz)
    assert header.attributes() == written.attributes()


def test_a_subset_of_a_subset_keeps_its_maps(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5")
    subset = dataset.subset([1, 5, 9]).subset([2, 0])
    np.testing.assert_array_equal(subset.rows, [9, 1])
    np.testing.assert_array_equal(subset.pas(), dataset.pas([9, 1]))
    np.testing.assert_array_equal(subset.carrier_hz, dataset.carrier_hz[[9, 1]])


def test_an_isolated_view_holds_no_channel_of_another_row(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5")
    view = dataset.subset([1, 5]).isolated()
    np.testing.assert_array_equal(view.cfr, dataset.cfr[[1, 5]])
    np.testing.assert_array_equal(view.peak_power, dataset.peak_power[[1, 5]])
    every = replace(view, rows=np.arange(len(dataset)))
    assert np.flatnonzero(np.abs(every.cfr).sum(axis=1)).tolist() == [1, 5]
    assert np.flatnonzero(every.peak_power).tolist() == [1, 5]


def write_maps_alone(path: Path) -> tuple[PasDataset, np.ndarray]:
    """Two transmitters × three carriers of random maps on a coarse grid, the one at (1, 2) of zeros."""
    header = replace(make_header(num_tx=2), channels=False)
    grid = AngularGrid.hemisphere(9, 36)
    maps = np.random.default_rng(4).random((2, 3, *grid.shape), dtype=np.float32)
    maps /= maps.max(axis=(2, 3), keepdims=True)
    maps[1, 2] = 0
    with PasWriter(path, header, grid) as writer:
        for tx in range(2):
            writer.append_maps(transmitters(2)[[tx]], np.array([True]), maps[[tx]])
    return open_dataset(path), maps.reshape(-1, *grid.shape)


def test_maps_that_came_without_channels_are_kept_on_their_grid(tmp_path: Path) -> None:
    dataset, maps = write_maps_alone(tmp_path / "data.h5")
    verify(dataset.path)
    np.testing.assert_allclose(dataset.pas(), maps, atol=FLOAT16_STEP)
    assert dataset.grid.shape == (9, 36)
    np.testing.assert_array_equal(np.flatnonzero(~dataset.has_path), [5])
    np.testing.assert_array_equal(dataset.num_paths, [-1, -1, -1, -1, -1, 0])
    assert not dataset.header.channels


def test_maps_that_came_without_channels_say_that_there_are_none(tmp_path: Path) -> None:
    dataset, _ = write_maps_alone(tmp_path / "data.h5")
    with pytest.raises(DataError, match="maps alone"):
        _ = dataset.subset([1]).cfr


def test_maps_that_came_without_channels_can_be_isolated_and_pickled(tmp_path: Path) -> None:
    dataset, maps = write_maps_alone(tmp_path / "data.h5")
    view = dataset.subset([1, 3]).isolated()
    np.testing.assert_allclose(view.pas(), maps[[1, 3]], atol=FLOAT16_STEP)
    assert np.flatnonzero(replace(view, rows=np.arange(6)).peak_power).tolist() == [1, 3]
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(view)).pas(), view.pas())


def test_the_hash_of_a_data_set_with_channels_is_what_it_was_before_there_were_others() -> None:
    attributes = make_header().attributes()
    assert "channels" not in attributes
    assert json.loads(replace(make_header(), channels=False).attributes()["channels"]) is False


def test_batches_cover_every_row_once(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5").subset(slice(0, 7))
    batches = list(dataset.batches(3))
    np.testing.assert_array_equal(np.concatenate([rows for rows, _ in batches]), np.arange(7))
    np.testing.assert_array_equal(np.concatenate([maps for _, maps in batches]), dataset.pas())


def test_a_data_set_pickles_as_path_and_rows(tmp_path: Path) -> None:
    subset = write_dataset(tmp_path / "data.h5").subset([3, 4])
    pickled = pickle.dumps(subset)
    assert len(pickled) < 1000
    np.testing.assert_array_equal(pickle.loads(pickled).pas(), subset.pas())


def test_a_pickle_of_a_file_that_changed_is_refused(tmp_path: Path) -> None:
    pickled = pickle.dumps(write_dataset(tmp_path / "data.h5"))
    write_dataset(tmp_path / "data.h5", num_tx=2)
    with pytest.raises(DataError, match="another data set"):
        pickle.loads(pickled)


def test_a_sample_without_any_path_is_flagged(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", silent=((1, 2),))
    np.testing.assert_array_equal(np.flatnonzero(~dataset.has_path), [5])
    assert not dataset.pas([5]).any()


def test_xarray_shows_names_coordinates_and_units(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "data.h5").path
    with xarray.open_dataset(path, engine="h5netcdf") as shown:
        assert shown.pas.dims == ("tx", "carrier_hz", "elevation_deg", "azimuth_deg")
        assert shown.cfr.dims == ("tx", "carrier_hz", "element")
        np.testing.assert_array_equal(shown.carrier_hz, [1e9, 10e9, 37e9])
        assert shown.carrier_hz.attrs["units"] == "Hz"
        assert shown.cfr.values.dtype == np.complex64
        peak = shown.pas.isel(tx=0, carrier_hz=0).sel(elevation_deg=slice(0, 89)).max()
        assert float(peak) == 1
        assert shown.frame_rotation.dims == ("axis", "receiver_axis")


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


def test_verify_accepts_what_was_written(tmp_path: Path) -> None:
    verify(write_dataset(tmp_path / "data.h5").path)


def _flip(path: Path, offset: int) -> None:
    with path.open("r+b") as file:
        file.seek(offset)
        byte = file.read(1)[0]
        file.seek(offset)
        file.write(bytes([byte ^ 1]))


def _data_offset(path: Path, name: str) -> int:
    with h5py.File(path) as file:
        dataset = file[name]
        return dataset.id.get_chunk_info(1).byte_offset if dataset.chunks else dataset.id.get_offset()


@pytest.mark.parametrize(
    "name", ["carrier_hz", "cfr", "complete", "elevation_deg", "line_of_sight", "pas", "tx_position_m"]
)
def test_verify_names_the_dataset_in_which_one_bit_flipped(tmp_path: Path, name: str) -> None:
    path = write_dataset(tmp_path / "data.h5", num_tx=2).path
    _flip(path, _data_offset(path, name))
    with pytest.raises(DataError, match=f"dataset '{name}'"):
        verify(path)


def test_verify_finds_a_flipped_bit_in_a_header_attribute(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "data.h5", num_tx=2).path
    content = path.read_bytes()
    for text in (b"inside an object", b"max_depth", b"synthetic", b"carrier frequency"):
        _flip(path, content.index(text))
        with pytest.raises(DataError, match="damaged"):
            verify(path)
        path.write_bytes(content)


def test_a_flipped_bit_anywhere_is_found(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "data.h5", num_tx=1, carriers_ghz=(1.0,), maps=False).path
    content = path.read_bytes()
    for offset in np.random.default_rng(1).choice(len(content), 300, replace=False):
        _flip(path, int(offset))
        with pytest.raises(DataError):
            verify(path)
        path.write_bytes(content)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_truncated_file_is_refused(tmp_path: Path, share: float) -> None:
    path = write_dataset(tmp_path / "data.h5", num_tx=2).path
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(DataError):
        open_dataset(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no file .*absent\.h5"):
        open_dataset(tmp_path / "absent.h5")


def test_a_file_of_another_schema_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.attrs["schema"] = "other/1"
    with pytest.raises(DataError, match="'other/1'"):
        open_dataset(tmp_path / "other.h5")


def test_missing_transmitters_leave_no_file(tmp_path: Path) -> None:
    header = make_header(num_tx=4)
    with pytest.raises(DataError, match="3 of its 4 rows"), PasWriter(tmp_path / "data.h5", header) as writer:
        append_all(writer, make_header(num_tx=3))
    assert list(tmp_path.iterdir()) == []


def test_too_many_transmitters_are_refused(tmp_path: Path) -> None:
    with (
        pytest.raises(DataError, match="do not fit"),
        PasWriter(tmp_path / "data.h5", make_header(num_tx=2)) as writer,
    ):
        append_all(writer, make_header(num_tx=3))


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
sys.path.insert(0, {tests!r})
from pathlib import Path
from synthetic import append_all, make_header
from xfreqbench.dataset import PasWriter
{prelude}
header = make_header()
with PasWriter(Path({path!r}), header) as writer:
    {before}
    append_all(writer, header)
"""


def _script(path: Path, prelude: str = "", before: str = "pass") -> list[str]:
    text = _WRITER.format(tests=str(TESTS), path=str(path), prelude=prelude, before=before)
    return [sys.executable, "-c", text]


def test_a_killed_writer_leaves_the_target_alone(tmp_path: Path) -> None:
    path = tmp_path / "data.h5"
    before = "append_all(writer, make_header(num_tx=2)); import os; os.kill(os.getpid(), 9)"
    killed = subprocess.run(_script(path, before=before), check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not path.exists()
    assert [file.suffix for file in tmp_path.iterdir()] == [".partial"]


def test_a_disk_that_fills_up_is_a_storage_error_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "data.h5"
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))"
    failed = subprocess.run(_script(path, prelude=limit), capture_output=True, text=True, check=False)
    assert failed.returncode == 1
    assert f"StorageError: {path}, which needs" in failed.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_room_is_refused_before_the_first_byte(tmp_path: Path) -> None:
    header = make_header(num_tx=10**9)
    with (
        pytest.raises(StorageError, match=r"data\.h5 needs [\d,]+ bytes"),
        PasWriter(tmp_path / "data.h5", header),
    ):
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


def _write_predictions(path: Path) -> np.ndarray:
    maps = np.random.default_rng(0).random((5, 90, 360), dtype=np.float32)
    batches = ((np.arange(start, min(start + 2, 5)), maps[start : start + 2]) for start in (0, 2, 4))
    write_predictions(path, batches, 5, (90, 360), dataset_sha256="d", split_sha256="s")
    return maps


def test_predictions_come_back_as_float16_keeps_them(tmp_path: Path) -> None:
    maps = _write_predictions(tmp_path / "predictions.h5")
    predictions = read_predictions(tmp_path / "predictions.h5")
    assert (predictions.dataset_sha256, predictions.split_sha256) == ("d", "s")
    stored = list(predictions.batches(3))
    np.testing.assert_array_equal(np.concatenate([rows for rows, _ in stored]), np.arange(5))
    np.testing.assert_array_equal(
        np.concatenate([batch for _, batch in stored]), maps.astype(np.float16).astype(np.float32)
    )


def test_damaged_predictions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "predictions.h5"
    _write_predictions(path)
    _flip(path, _data_offset(path, "pas"))
    with pytest.raises(DataError, match="dataset 'pas'"):
        read_predictions(path)
