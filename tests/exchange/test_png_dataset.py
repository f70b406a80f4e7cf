from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.support.png_folders import TRANSMITTERS, imported, levels, read, write_folder
from tests.support.synthetic import write_dataset
from xfreqbench.data.dataset import open_dataset, verify
from xfreqbench.errors import DataError, OutputExistsError, StorageError
from xfreqbench.exchange import png_dataset
from xfreqbench.exchange.png_dataset import import_png_folder


def test_samples_are_sorted_by_transmitter_and_carrier(tmp_path: Path) -> None:
    dataset = imported(write_folder(tmp_path / "small"), tmp_path / "data.h5")
    np.testing.assert_array_equal(dataset.tx_position_m, np.repeat(TRANSMITTERS, 2, axis=0))
    np.testing.assert_array_equal(dataset.carrier_hz, np.tile([2.4e9, 24.25e9], 2))
    for row, number in enumerate((3, 1, 4, 2)):  # the file's samples run over transmitters first
        expected = levels(number)[::-1] / np.float32(255)
        np.testing.assert_allclose(dataset.pas([row])[0], expected, atol=0.51 / 65280)  # packed
    verify(dataset.path)


def test_row_0_is_the_zenith_and_column_0_looks_to_minus_x(tmp_path: Path) -> None:
    dataset = imported(write_folder(tmp_path / "small"), tmp_path / "data.h5")
    brightest = np.unravel_index(dataset.pas([1])[0].argmax(), dataset.grid.shape)  # sample 1: row 1, column 10
    assert np.degrees(dataset.grid.elevation_rad[brightest[0]]) == pytest.approx(89)
    assert np.degrees(dataset.grid.azimuth_rad[brightest[1]]) == pytest.approx(-170)
    np.testing.assert_allclose(dataset.grid.directions[-1, 0], (0, 0, 1), atol=1e-9)
    np.testing.assert_allclose(dataset.grid.directions[0, 0], (-1, 0, 0), atol=1e-9)


def test_the_receiver_s_frame_is_the_world_and_its_array_stands_upright(tmp_path: Path) -> None:
    dataset = imported(write_folder(tmp_path / "small"), tmp_path / "data.h5")
    receiver = dataset.header.receiver
    assert receiver.position_m == (2.0, 1.0, -0.5)
    np.testing.assert_array_equal(receiver.rotation, np.eye(3))
    extent = np.ptp(dataset.beam.element_position_wavelengths, axis=0)
    np.testing.assert_array_equal(extent, (0, 1.5, 1.5))


def test_what_was_not_published_is_marked_so(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "small")
    Image.fromarray(np.zeros((91, 361), np.uint8)).save(folder / "spectrum" / "00003.png")
    dataset = imported(folder, tmp_path / "data.h5")
    np.testing.assert_array_equal(dataset.has_path, [False, True, True, True])
    np.testing.assert_array_equal(dataset.num_paths, [0, -1, -1, -1])
    assert dataset.line_of_sight.all()
    assert dataset.header.pas_kind == "amplitude"
    assert "not_published" in dataset.header.settings
    with pytest.raises(DataError, match="maps alone"):
        _ = dataset.cfr


def test_a_second_import_leaves_the_file_and_another_one_is_refused(tmp_path: Path) -> None:
    folder, path = write_folder(tmp_path / "small"), tmp_path / "data.h5"
    assert import_png_folder(read(folder), path)
    written = path.read_bytes()
    assert not import_png_folder(read(folder), path)
    Image.fromarray(levels(5)).save(folder / "spectrum" / "00002.png")
    with pytest.raises(OutputExistsError, match="another data set"):
        import_png_folder(read(folder), path)
    assert path.read_bytes() == written


@pytest.mark.parametrize("content", [b"not HDF5", None])
def test_a_file_of_somebody_else_s_is_not_overwritten(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "data.h5"
    if content is None:
        write_dataset(path)
    else:
        path.write_bytes(content)
    before = path.read_bytes()
    with pytest.raises(OutputExistsError):
        import_png_folder(read(write_folder(tmp_path / "small")), path)
    assert path.read_bytes() == before


def test_a_file_that_somebody_writes_during_the_import_stays(tmp_path: Path) -> None:
    path = tmp_path / "data.h5"
    with pytest.raises(OutputExistsError, match="in the meantime"):
        import_png_folder(read(write_folder(tmp_path / "small")), path, lambda done, total: path.write_text("theirs"))
    assert path.read_text() == "theirs"


def test_a_folder_whose_name_no_data_set_can_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"'caf\\udce9' is no UTF-8, and a data set cannot hold it"):
        import_png_folder(read(write_folder(tmp_path / "caf\udce9")), tmp_path / "data.h5")


def test_a_png_that_is_cut_short_leaves_no_file(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "small")
    path = folder / "spectrum" / "00004.png"
    path.write_bytes(path.read_bytes()[:80])
    with pytest.raises(DataError, match=r"00004\.png"):
        import_png_folder(read(folder), tmp_path / "data.h5")
    assert [entry.name for entry in tmp_path.iterdir()] == ["small"]


def test_a_map_that_is_nowhere_white_has_peak_1_and_its_own_peak_power(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "small")
    Image.fromarray(levels(3) // 2).save(folder / "spectrum" / "00003.png")
    dataset = imported(folder, tmp_path / "data.h5")
    assert dataset.pas([0]).max() == 1  # sample 3 comes first
    np.testing.assert_allclose(dataset.peak_power, [(127 / 255) ** 2, 1, 1, 1])  # amplitude, squared


def test_large_maps_are_imported_a_transmitter_at_a_time_with_the_same_outcome(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = read(write_folder(tmp_path / "small"))
    together, apart = tmp_path / "together.h5", tmp_path / "apart.h5"
    import_png_folder(source, together)
    monkeypatch.setattr(png_dataset, "_MAX_PIXELS", 1)
    done: list[int] = []
    import_png_folder(source, apart, lambda number, total: done.append(number))
    assert done == list(range(1, len(TRANSMITTERS) + 1))
    assert open_dataset(together).sha256 == open_dataset(apart).sha256
