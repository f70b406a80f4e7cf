"""Archives of NumPy and files of MATLAB are read as they were written, or refused: no damage gives other numbers."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse

from xfreqbench.errors import DataError, StorageError
from xfreqbench.system import array_files
from xfreqbench.system.array_files import read_arrays

TABLE = np.array([[0.5, np.nan, -2e-9], [7.0, 1e30, 0.1]])
FORM = {"power": "real U L"}


def npz(compressed: bool = True, **arrays: Any) -> bytes:
    buffer = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(buffer, **(arrays or {"power": TABLE}))
    return buffer.getvalue()


def mat(compressed: bool = True, **arrays: Any) -> bytes:
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, arrays or {"power": TABLE}, do_compression=compressed)
    return buffer.getvalue()


def read(folder: Path, name: str, content: bytes) -> np.ndarray:
    (folder / name).write_bytes(content)
    return read_arrays(folder / name, FORM, "Fetch it again.")["power"]


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize(("name", "write"), [("a.npz", npz), ("a.mat", mat)])
@pytest.mark.parametrize("dtype", ["<f8", "<f4", "<i8", "u1"])
def test_what_was_written_is_read(tmp_path: Path, name: str, write: Callable[..., bytes], dtype: str, compressed: bool):
    for table in (np.arange(6).reshape(2, 3), np.arange(6).reshape(3, 2).T, np.zeros((2, 0)), np.ones((1, 1)) * 200):
        content = write(compressed, power=table.astype(dtype), other=np.array(["a"]))
        found = read(tmp_path, name, content)
        np.testing.assert_array_equal(found, table.astype(dtype), strict=True)


@pytest.mark.parametrize(
    ("name", "content", "num_checked"),
    [
        ("a.npz", npz(), None),
        ("a.npz", npz(compressed=False), None),
        ("a.mat", mat(), None),
        ("a.mat", mat(compressed=False), 192),  # the numbers themselves have no sum there
    ],
)
def test_a_flipped_bit_or_a_cut_changes_no_number(
    tmp_path: Path, name: str, content: bytes, num_checked: int | None
) -> None:
    num_refused = 0
    for place in range(len(content)):
        flipped = bytearray(content)
        flipped[place] ^= 1 << place % 8
        for spoilt in [content[:place], *([bytes(flipped)] if place < (num_checked or len(content)) else [])]:
            try:
                np.testing.assert_array_equal(read(tmp_path, name, spoilt), TABLE, strict=True)
            except DataError as error:
                num_refused += 1
                assert str(error).endswith("Fetch it again.")
    assert num_refused > len(content)  # all cuts, and most flips


def with_header(old: bytes, new: bytes) -> bytes:
    """An archive whose sums hold, with another header of its array."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(npz())) as known, zipfile.ZipFile(buffer, "w") as archive:
        member = known.read("power.npy")
        assert old in member
        archive.writestr("power.npy", member.replace(old, new))
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.npz", with_header(b"(2, 3)", b"(2, 1)"), "is damaged"),  # read short, no sum is compared
        ("a.npz", with_header(b"(2, 3)", b"(2, 9)"), "is damaged"),
        ("a.npz", with_header(b"(2, 3)", b"(-2,-3)"), "is damaged"),
        ("a.npz", with_header(b"(2, 3)", b"(3, 2)"), "shape"),
        ("a.npz", with_header(b"<f8", b"<f4"), "is damaged"),
        ("a.npz", with_header(b"<f8", b"<c8"), "<c8, where real is needed"),
        ("a.npz", with_header(b"<f8", b">f8"), ">f8, where real is needed"),  # next to 0, each of them
        ("a.npz", with_header(b"{", b"["), "is damaged"),
        ("a.npz", npz().replace(struct.pack("<I", TABLE.nbytes + 128), b"\xff\xff\xff\x7f"), "is damaged"),  # a size
        ("a.npz", npz(power=np.array([[object()]])), "is damaged"),
        ("a.npz", npz(power=TABLE > 0), "b1, where real is needed"),
        ("a.npz", npz(power=TABLE[0]), r"shape \(3,\)"),
        ("a.npz", npz(other=TABLE), "lacks an array"),
        ("a.npz", mat(), "is damaged"),
        ("a.mat", npz(), "is damaged"),
        ("a.mat", mat(power=TABLE + 1j), "is damaged"),
        ("a.mat", mat(power="text"), "is damaged"),
        ("a.mat", mat(power=scipy.sparse.csc_array(TABLE)), "is damaged"),
        ("a.mat", mat(other=TABLE), "lacks an array"),
        ("a.mat", mat(compressed=False).replace(b"MATLAB 5.0", b"MATLAB 7.3"), r"of MATLAB 7\.3, .*HDF5.*'-v7'"),
    ],
)
def test_another_kind_shape_or_size_is_refused(tmp_path: Path, name: str, content: bytes, told: str) -> None:
    sizes = {"U": 2}
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=told):
        read_arrays(tmp_path / name, FORM, "", sizes)


@pytest.mark.parametrize(("name", "write"), [("a.npz", npz), ("a.mat", mat)])
def test_what_no_memory_holds_is_not_called_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, write: Callable[..., bytes]
) -> None:
    zeros = np.zeros((1000, 1000))  # 8 MB, which take some kilobytes
    content = write(power=zeros)
    monkeypatch.setattr(array_files, "available_memory_mib", lambda: 7)
    with pytest.raises(StorageError, match=f"{name} cannot be read: there is not enough memory"):
        read(tmp_path, name, content)


def test_an_own_array_has_the_very_type_and_order_that_were_stored(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    for table in (TABLE.astype(">f8"), TABLE.astype("<f4"), np.asfortranarray(TABLE)):
        path.write_bytes(npz(power=table))
        with pytest.raises(DataError, match="where <f8 is needed"):
            read_arrays(path, {"power": "<f8 U L"}, "")
    with pytest.raises(DataError, match=r"cannot be read: No such file or directory\. Fetch"):
        read_arrays(tmp_path / "none.npz", FORM, "Fetch it.")
