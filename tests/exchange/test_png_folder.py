from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.support.png_folders import levels, read, write_folder
from xfreqbench.errors import DataError


def test_a_receiver_may_stand_in_any_spelling_of_yaml(tmp_path: Path) -> None:
    """As PyYAML writes a nested list by default, which publishers' builders do."""
    folder = write_folder(tmp_path / "small")
    known = read(folder).receiver
    (folder / "gateway_info.yml").write_text(
        "gateway1:\n  position:\n  - 2.0\n  - 1\n  - -0.5\n  orientation:\n  - 0.0\n  - 0.0\n  - 0.0\n  - 1.0\n"
    )
    assert read(folder).receiver == known


def test_names_of_names_of_names_are_not_written_out(tmp_path: Path) -> None:
    """A few lines of YAML that would be terabytes."""
    folder = write_folder(tmp_path / "small")
    lines = ["a0: &a0 [lol]", *(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 30))]
    text = "gateway1:\n  position: [*a29, *a29, *a29]\n  orientation: [0, 0, 0, 1]\n"
    (folder / "gateway_info.yml").write_text("\n".join([*lines, text]))
    with pytest.raises(DataError, match="'position' a list of 3 finite numbers"):
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
        (replace_line("tx_pos.csv", 1, "y,x,y"), r"tx_pos\.csv, line 1,.*not x,y,z nor numbers"),
        (replace_line("tx_pos.csv", 3, "1,2"), r"tx_pos\.csv, line 3,.*three finite numbers"),
        (replace_line("tx_pos.csv", 3, "1,nan,2"), r"tx_pos\.csv, line 3,.*three finite numbers"),
        (replace_line("freq.txt", 2, "often"), r"freq\.txt, line 2,.*GHz"),
        (replace_line("freq.txt", 2, "-1"), r"freq\.txt, line 2,.*above 0"),
        (drop_last_line, r"tx_pos\.csv has 4 samples and .*freq\.txt 3"),
        (replace_line("freq.txt", 3, "24.25"), r"tx_pos\.csv, line 4, repeats line 2.*24\.25 GHz"),
        (leave_the_last_sample_out, r"tx_pos\.csv, line 3: .*has no sample at 2\.4 GHz"),
        (replace_line("gateway_info.yml", 3, "  position: [2,1]"), r"gateway_info\.yml .*3 finite numbers"),
        (replace_line("gateway_info.yml", 4, "  orientation: [0, 0, 0, 0]"), r"gateway_info\.yml .*no length"),
        (replace_line("gateway_info.yml", 4, "  orientation: [0, nan, 0, 1]"), r"gateway_info\.yml .*4 finite"),
        (replace_line("gateway_info.yml", 3, "  position: [0, 1e9, 0]"), r"gateway_info\.yml .*position_m\.1"),
        (replace_line("freq.txt", 2, "nan"), r"freq\.txt, line 2,.*GHz"),
        (replace_line("freq.txt", 2, "1e12"), r"freq\.txt, line 2,.*GHz"),
        (write("train_index.txt", "00001\n00005"), r"train_index\.txt, line 2,.*numbered 1 to 4"),
        (write("test_index.txt", "00001\n\nfour"), r"test_index\.txt, line 2,.*numbered 1 to 4"),
        (rename("spectrum/00002.png", "spectrum/2.png"), r"no .*00002\.png.*2\.png is there"),
        (turn_two_receivers, r"describes 2 receivers"),
        (replace_line("gateway_info.yml", 1, "convention: {rows: [1]}"), r"no value for rows under .*Remove that line"),
        (replace_line("gateway_info.yml", 3, "  position: [2,1"), r"gateway_info\.yml is no YAML: .*line 4"),
        (replace_line("gateway_info.yml", 2, "gateway1: none"), r"gateway_info\.yml is no YAML: .*line 3"),
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
