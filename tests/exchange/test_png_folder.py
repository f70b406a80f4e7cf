from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.support.png_folders import TRANSMITTERS, imported, levels, read, write_folder
from xfreqbench.data.dataset import open_dataset, verify
from xfreqbench.errors import DataError, OutputExistsError, StorageError
from xfreqbench.exchange import png_dataset
from xfreqbench.exchange.png_dataset import import_png_folder
from xfreqbench.exchange.png_folder import MAX_PIXELS, read_levels, shape_of, write_levels


def test_a_receiver_may_stand_in_any_spelling_of_yaml(tmp_path: Path) -> None:
    """As PyYAML writes a nested list by default, which publishers' builders do."""
    folder = write_folder(tmp_path / "small")
    known = read(folder).receiver
    (folder / "gateway_info.yml").write_text(
        "gateway1:\n  position:\n  - 2.0\n  - 1\n  - -0.5\n  orientation:\n  - 0.0\n  - 0.0\n  - 0.0\n  - 1.0\n"
    )
    assert read(folder).receiver == known


def test_a_number_of_a_receiver_is_the_one_that_the_file_shows(tmp_path: Path) -> None:
    """YAML 1.1 takes 010 for 8."""
    folder = write_folder(tmp_path / "small")
    replace_line("gateway_info.yml", 3, "  position: [010, 005.50, +1e1]")(folder)
    assert read(folder).receiver.position_m == (10.0, 5.5, 10.0)


@pytest.mark.parametrize(
    ("names", "labels", "told"),
    [
        ("index,x,y,z", ("1", "2", "4", "3"), r"line 4, is of '4' by its column 'index'"),
        ("row,x,y,z", ("0", "2", "1", "3"), r"line 3, is of '2' by its column 'row'"),
        (",x,y,z", ("12", "40", "7", "8"), r"line 2, is of '12' by its column ''"),
        ("file,x,y,z", ("7.png", "12.png", "9.png", "30.png"), r"line 3, is of '12\.png' by its column 'file'"),
        ("", ("img_2.png", "img_1.png", "img_3.png", "img_4.png"), r"line 1, is of 'img_2\.png' by its column ''"),
        ("index,x,y,z", ("1", "2", "3", "4"), None),
        (",x,y,z", ("3", "14", "15", "92"), None),
        ("file,x,y,z", ("spectrum/2.png", "spectrum/4.png", "spectrum/5.png", "spectrum/7.png"), None),
        ("floor,x,y,z", ("1", "0", "1", "0"), None),
        ("rssi,x,y,z", ("-4", "-3", "-2", "-1"), None),
        ("height,x,y,z", ("1.3", "1.1", "1.2", "1.0"), None),
        ("room,x,y,z", ("kitchen", "hall", "bath", "hall 2"), None),
    ],
)
def test_a_column_that_says_which_map_a_line_belongs_to_is_in_order(
    tmp_path: Path, names: str, labels: tuple[str, ...], told: str | None
) -> None:
    folder = write_folder(tmp_path / "small")
    sound = read(folder)
    lines = (folder / "tx_pos.csv").read_text().splitlines()[1:]
    rows = [f"{label},{line}" for label, line in zip(labels, lines, strict=True)]
    (folder / "tx_pos.csv").write_text("\n".join([names, *rows] if names else rows))
    if told is None:
        np.testing.assert_array_equal(read(folder).tx_position_m, sound.tx_position_m)
    else:
        with pytest.raises(DataError, match=told):
            read(folder)


def test_names_of_names_of_names_are_not_written_out(tmp_path: Path) -> None:
    """A few lines of YAML that would be terabytes."""
    folder = write_folder(tmp_path / "small")
    lines = ["a0: &a0 [lol]", *(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 30))]
    text = "gateway1:\n  position: [*a29, *a29, *a29]\n  orientation: [0, 0, 0, 1]\n"
    (folder / "gateway_info.yml").write_text("\n".join([*lines, text]))
    with pytest.raises(DataError, match="a list of 3 finite numbers as 'position'"):
        read(folder)
    (folder / "gateway_info.yml").write_text("\n".join([*lines, "convention: {rows: *a29, first_row_deg: *a29}"]))
    with pytest.raises(DataError, match="no value for rows, first_row_deg"):
        read(folder)


def test_a_byte_order_mark_is_no_part_of_a_line(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "small")
    known = read(folder)
    for name in ("tx_pos.csv", "freq.txt"):
        (folder / name).write_text((folder / name).read_text(), "utf-8-sig")
    np.testing.assert_array_equal(read(folder).tx_position_m, known.tx_position_m)
    np.testing.assert_array_equal(read(folder).carrier_hz, known.carrier_hz)


def replace_line(name: str, number: int, line: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        lines = (folder / name).read_text().splitlines()
        lines[number - 1] = line
        (folder / name).write_text("\n".join(lines))

    return change


def remove(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def write(name: str, text: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).write_text(text)

    return change


def rename(name: str, other: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).rename(folder / other)


def draw(name: str, image: np.ndarray) -> Callable[[Path], None]:
    return lambda folder: Image.fromarray(image).save(folder / "spectrum" / name)


def drop_last_line(folder: Path) -> None:
    lines = (folder / "freq.txt").read_text().splitlines()
    (folder / "freq.txt").write_text("\n".join(lines[:-1]))


def leave_the_last_sample_out(folder: Path) -> None:
    drop_last_line(folder)
    lines = (folder / "tx_pos.csv").read_text().splitlines()
    (folder / "tx_pos.csv").write_text("\n".join(lines[:-1]))
    remove("spectrum/00004.png")(folder)


def turn_two_receivers(folder: Path) -> None:
    text = (folder / "gateway_info.yml").read_text()
    (folder / "gateway_info.yml").write_text(text + text.replace("gateway1", "gateway2"))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (remove("tx_pos.csv"), r"tx_pos\.csv cannot be read"),
        (remove("freq.txt"), r"no .*freq\.txt.*--freq"),
        (remove("gateway_info.yml"), r"gateway_info\.yml cannot be read"),
        (remove("spectrum/00003.png"), r"no .*00003\.png"),
        (draw("00005.png", levels(1)), r"00005\.png belongs to no line of tx_pos\.csv"),
        (replace_line("tx_pos.csv", 1, "y,x,y"), r"tx_pos\.csv has the columns 'y, x, y', not one each"),
        (replace_line("tx_pos.csv", 3, "1,2"), r"tx_pos\.csv, line 3,.*three finite numbers"),
        (replace_line("tx_pos.csv", 3, "1,nan,2"), r"tx_pos\.csv, line 3,.*three finite numbers"),
        (replace_line("tx_pos.csv", 3, "1_0,1,2"), r"tx_pos\.csv, line 3, has '1_0' in column x"),
        (replace_line("freq.txt", 2, "often"), r"freq\.txt, line 2,.*GHz"),
        (replace_line("freq.txt", 2, "2_4"), r"freq\.txt, line 2, is '2_4'.*GHz"),
        (replace_line("freq.txt", 2, "-1"), r"freq\.txt, line 2,.*above 0"),
        (drop_last_line, r"tx_pos\.csv has 4 samples and .*freq\.txt 3"),
        (replace_line("freq.txt", 3, "24.25"), r"tx_pos\.csv, line 4, repeats line 2.*24\.25 GHz"),
        (leave_the_last_sample_out, r"tx_pos\.csv, line 3: .*has no sample at 2\.4 GHz"),
        (replace_line("gateway_info.yml", 3, "  position: [2,1]"), r"gateway_info\.yml .*3 finite numbers"),
        (replace_line("gateway_info.yml", 3, "  position: [1_0, 2, 3]"), r"gateway_info\.yml .*3 finite numbers"),
        (replace_line("gateway_info.yml", 3, "  position: [1:30, 2, 3]"), r"gateway_info\.yml .*3 finite numbers"),
        (replace_line("gateway_info.yml", 3, "  position: [yes, 2, 3]"), r"gateway_info\.yml .*3 finite numbers"),
        (replace_line("gateway_info.yml", 4, "  orientation: [0, 0, 0, 0]"), r"gateway_info\.yml .*length is not 1"),
        (replace_line("gateway_info.yml", 4, "  orientation: [0, nan, 0, 1]"), r"gateway_info\.yml .*4 finite"),
        (replace_line("gateway_info.yml", 3, "  position: [0, 1e9, 0]"), r"gateway_info\.yml .*position_m\.1"),
        (replace_line("freq.txt", 2, "nan"), r"freq\.txt, line 2,.*GHz"),
        (replace_line("freq.txt", 2, "1e12"), r"freq\.txt, line 2,.*GHz"),
        (write("train_index.txt", "00001\n00005"), r"train_index\.txt, line 2,.*numbered 1 to 4"),
        (write("test_index.txt", "00001\n\nfour"), r"test_index\.txt, line 2,.*numbered 1 to 4"),
        (rename("spectrum/00002.png", "spectrum/2.png"), r"no .*00002\.png.*2\.png is there"),
        (turn_two_receivers, r"describes 2 receivers"),
        (replace_line("gateway_info.yml", 1, "convention: {rows: [1]}"), r"no value for rows under .*Remove that line"),
        (replace_line("gateway_info.yml", 1, "convention: {rows: }"), r"no value for rows under .*Remove that line"),
        (replace_line("gateway_info.yml", 3, "  position: [2,1"), r"gateway_info\.yml is not YAML: .*line 4"),
        (replace_line("gateway_info.yml", 2, "gateway1: none"), r"gateway_info\.yml is not YAML: .*line 3"),
        (replace_line("gateway_info.yml", 3, "  place: [2,1,0]"), r"gateway_info\.yml describes 0 receivers"),
        (draw("00002.png", levels(1)[1:]), r"00002\.png has \(90, 361\).*\(91, 361\)"),
        (draw("00002.png", np.zeros((91, 361, 3), np.uint8)), r"00002\.png.*mode RGB"),
        (lambda folder: (folder / "spectrum" / "00002.png").write_text("no"), r"00002\.png cannot be read"),
    ],
)
def test_a_damaged_folder_is_refused_with_file_and_line(
    tmp_path: Path, damage: Callable[[Path], None], message: str
) -> None:
    folder = write_folder(tmp_path / "small")
    damage(folder)
    with pytest.raises(DataError, match=message):
        read(folder)


@pytest.mark.parametrize("side", [1001, 12_000, 20_000])  # Pillow warns of the second, and refuses the third
def test_a_map_of_too_many_pixels_is_refused_before_it_takes_memory(tmp_path: Path, side: int) -> None:
    path = tmp_path / "00001.png"
    Image.new("L", (1, 1)).save(path)
    header = b"IHDR" + struct.pack(">II", side, side) + b"\x08\x00\x00\x00\x00"  # as of so many pixels
    content = path.read_bytes()
    path.write_bytes(content[:12] + header + struct.pack(">I", zlib.crc32(header)) + content[33:])
    for read_one in (shape_of, read_levels):
        with pytest.raises(DataError, match=f"00001\\.png has more than {MAX_PIXELS:,} pixels"):
            read_one(path)
    Image.new("L", (1000, MAX_PIXELS // 1000)).save(path)  # as many as may be
    assert shape_of(path) == read_levels(path).shape == (1000, 1000)


def test_a_file_larger_than_any_map_or_receiver_is_not_read(tmp_path: Path) -> None:
    """Each of a million empty chunks of a PNG takes time, and so does each word of a YAML file."""
    folder = write_folder(tmp_path / "small")
    path = folder / "spectrum" / "00001.png"
    content, chunk = path.read_bytes(), struct.pack(">I4sI", 0, b"teSt", zlib.crc32(b"teSt"))
    path.write_bytes(content[:33] + chunk * 333_334 + content[33:])
    with pytest.raises(
        DataError, match=r"00001\.png cannot be read as a PNG \(it has 4,[\d,]+ bytes, and at most 4,000,000 are"
    ):
        read(folder)
    path.write_bytes(content)
    write("gateway_info.yml", "a: [" + "1, " * 40_000 + "]\n")(folder)
    with pytest.raises(
        DataError, match=r"gateway_info\.yml cannot be read: it has 120,006 bytes, and at most 100,000 are"
    ):
        read(folder)


def test_a_flipped_bit_of_a_pixel_is_found(tmp_path: Path) -> None:
    path = tmp_path / "map.png"
    levels = np.random.default_rng(0).integers(0, 256, (9, 36)).astype(np.uint8)
    write_levels(path, levels)
    np.testing.assert_array_equal(read_levels(path), levels)
    whole = path.read_bytes()
    first, last = whole.index(b"IDAT") + 4, whole.index(b"IEND") - 8  # the file's sum of them follows
    for place in range(first, last):
        content = bytearray(whole)
        content[place] ^= 1 << place % 8
        path.write_bytes(content)
        with pytest.raises(DataError, match="cannot be read as a PNG"):
            read_levels(path)


def test_samples_are_sorted_by_transmitter_and_carrier(tmp_path: Path) -> None:
    dataset = imported(write_folder(tmp_path / "small"), tmp_path / "data.h5")
    np.testing.assert_array_equal(dataset.tx_position_m, np.repeat(TRANSMITTERS, 2, axis=0))
    np.testing.assert_array_equal(dataset.carrier_hz, np.tile([2.4e9, 24.25e9], 2))
    for row, number in enumerate((3, 1, 4, 2)):  # the file's samples run over transmitters first
        expected = levels(number)[::-1] / np.float32(255)
        np.testing.assert_allclose(dataset.pas([row])[0], expected, atol=0.51 / 65280)  # packed
    verify(dataset.path)
    receiver = dataset.header.receiver  # its frame is the world, and its array stands upright
    assert receiver.position_m == (2.0, 1.0, -0.5)
    np.testing.assert_array_equal(receiver.rotation, np.eye(3))
    np.testing.assert_array_equal(np.ptp(dataset.beam.element_position_wavelengths, axis=0), (0, 1.5, 1.5))


def test_what_was_not_published_is_marked_so(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "small")
    Image.fromarray(np.zeros((91, 361), np.uint8)).save(folder / "spectrum" / "00003.png")
    dataset = imported(folder, tmp_path / "data.h5")
    np.testing.assert_array_equal(dataset.has_path, [False, True, True, True])
    np.testing.assert_array_equal(dataset.tables["num_paths"].flat[dataset.rows], [0, -1, -1, -1])
    assert dataset.tables["line_of_sight"][dataset.tx_index].all()
    assert dataset.header.pas_kind == "amplitude"
    assert "not_published" in dataset.header.settings
    with pytest.raises(DataError, match="maps, but no channels"):
        _ = dataset.cfr


def test_a_second_import_leaves_the_file_and_another_one_is_refused(tmp_path: Path) -> None:
    folder, path = write_folder(tmp_path / "small"), tmp_path / "data.h5"
    assert import_png_folder(read(folder), path)
    written = path.read_bytes()
    assert not import_png_folder(read(folder), path)
    Image.fromarray(levels(5)).save(folder / "spectrum" / "00002.png")
    for content, told in ((written, "another data set"), (b"not HDF5", "not a data set that can be read")):
        path.write_bytes(content)
        with pytest.raises(OutputExistsError, match=told):
            import_png_folder(read(folder), path)
        assert path.read_bytes() == content


def test_a_folder_whose_name_no_data_set_can_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"'caf\\udce9' is not UTF-8, and a data set cannot hold it"):
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
    np.testing.assert_allclose(
        dataset.tables["peak_power"].flat[dataset.rows], [(127 / 255) ** 2, 1, 1, 1]
    )  # amplitude, squared


def test_large_maps_are_imported_a_transmitter_at_a_time_with_the_same_outcome(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = read(write_folder(tmp_path / "small"))
    together, apart = tmp_path / "together.h5", tmp_path / "apart.h5"
    import_png_folder(source, together)
    monkeypatch.setattr(png_dataset, "_BATCH", 1)
    done: list[int] = []
    import_png_folder(source, apart, lambda number, total: done.append(number))
    assert done == list(range(1, len(TRANSMITTERS) + 1))
    assert open_dataset(together).sha256 == open_dataset(apart).sha256
