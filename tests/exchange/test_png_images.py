"""What a single PNG of a map may be."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from xfreqbench.errors import DataError
from xfreqbench.exchange.png_folder import MAX_PIXELS, read_levels, shape_of, write_levels


@pytest.mark.parametrize("side", [1001, 12_000, 20_000])  # Pillow warns of the second, and refuses the third
def test_a_map_of_too_many_pixels_is_refused_before_it_takes_memory(tmp_path: Path, side: int) -> None:
    path = tmp_path / "00001.png"
    Image.new("L", (1, 1)).save(path)
    header = b"IHDR" + struct.pack(">II", side, side) + b"\x08\x00\x00\x00\x00"  # as of so many pixels
    content = path.read_bytes()
    path.write_bytes(content[:12] + header + struct.pack(">I", zlib.crc32(header)) + content[33:])
    for read in (shape_of, read_levels):
        with pytest.raises(DataError, match=f"00001\\.png has more than {MAX_PIXELS:,} pixels"):
            read(path)


def test_a_map_of_as_many_pixels_as_may_be_is_read(tmp_path: Path) -> None:
    path = tmp_path / "00001.png"
    Image.new("L", (1000, MAX_PIXELS // 1000)).save(path)
    assert shape_of(path) == read_levels(path).shape == (1000, 1000)


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
