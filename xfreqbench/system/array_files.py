"""Reads arrays of NumPy archives and MATLAB files, damaged ones and anybody's: as they were asked for, or not."""

from __future__ import annotations

import io
import math
import struct
import sys
import warnings
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from xfreqbench.errors import DataError
from xfreqbench.system.files import read_bytes, system_errors
from xfreqbench.system.machine import available_memory_mib
from xfreqbench.types import NDArray

MOST_COMPRESSED = 1032  # bytes that one byte on disk can stand for: the limit of deflate
_KINDS = {"real": "fiu", "text": "U"}
_MATLAB_5, _MATLAB_7_3, _MATRIX, _COMPRESSED = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file", 14, 15
_NUMBERS = {1: "<i1", 2: "<u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 9: "<f8", 12: "<i8", 13: "<u8"}
_NARROW = tuple(map(np.dtype, ("i1", "u1", "i2", "u2", "i4", "u4")))  # of whole numbers of any class
_OF_CLASS = ("<f8", "<f4", "<i1", "<u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8")
_CLASSES = {(number, 0): np.dtype(name) for number, name in enumerate(_OF_CLASS, start=6)}
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_arrays(
    path: Path, wanted: Mapping[str, str], advice: str, sizes: dict[str, int] | None = None, digest: Any = None
) -> dict[str, NDArray[Any]]:
    """Arrays of an `.npz` or a `.mat` file by name, for names with their kind and shape: `{"cfr": "<c8 T F M"}`.

    A kind is `real`, `text` or NumPy's name of a type, and then the array is in the order of C. An axis is a number or
    a name: axes of one name are as long as `sizes` says, or as the first of them, which is written there. `digest` is
    updated with the bytes of the file. Raises `DataError`, with `advice`, for any difference, and for files that are
    missing, damaged or hold objects, and `StorageError` if the system cannot read them into memory.
    """
    try:
        content = read_bytes(path)
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}. {advice}") from error
    if digest is not None:
        digest.update(content)
    arrays = unpacked(path, content, wanted, advice)
    sizes = {} if sizes is None else sizes
    for name, form in wanted.items():
        kind, *axes = form.split()
        array = arrays[name]
        is_own = array.dtype.str == kind and array.flags.c_contiguous
        if not is_own and (array.dtype.kind not in _KINDS.get(kind, "") or not array.dtype.isnative):
            raise DataError(f"{path} holds {name!r} as {array.dtype.str}, where {kind} is needed. {advice}")
        if len(axes) == array.ndim:
            named = zip(axes, array.shape, strict=True)
            axes = [axis if axis.isdigit() else str(sizes.setdefault(axis, length)) for axis, length in named]
        if axes != [str(length) for length in array.shape]:
            needed = " × ".join(axes) or "one value"
            raise DataError(f"{path} holds {name!r} in shape {array.shape}, where {needed} is needed. {advice}")
    return arrays


def unpacked(path: Path, content: bytes, names: Iterable[str] | None, advice: str) -> dict[str, NDArray[Any]]:
    """Arrays in the bytes of a file by name, all of them or those asked for, of any kind but objects.

    Raises `DataError` with the file's name and `advice`, and `StorageError` if memory does not hold them.
    """
    if content.startswith(_MATLAB_7_3):
        advice = "Save it again as version 7: save(FILE, VARIABLES, '-v7')."
        raise DataError(f"{path} is of MATLAB 7.3, which is HDF5 and not read here. {advice}")
    with system_errors(path):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # about what no program that we know writes
                return _of_matlab(content, names or ()) if path.suffix == ".mat" else _of_numpy(content, names)
        except MemoryError:
            raise
        except Exception as error:  # zipfile, zlib and NumPy raise of every kind for what they did not write
            raise DataError(f"{path} is damaged or lacks an array. {advice}") from error


def _require_memory(num_bytes: int) -> None:
    if num_bytes / 2**20 > available_memory_mib():
        raise MemoryError(num_bytes)


def _of_numpy(content: bytes, names: Iterable[str] | None) -> dict[str, NDArray[Any]]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        held = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
        members = {name: held[name] for name in (held if names is None else names)}
        if any(member.file_size > MOST_COMPRESSED * len(content) for member in members.values()):
            raise ValueError(members)
        _require_memory(2 * sum(member.file_size for member in members.values()))  # for each is copied once
        return {name: _of_member(archive.read(member)) for name, member in members.items()}  # to its end: sums hold


def _of_member(content: bytes) -> NDArray[Any]:
    """The array of an `.npy`, whose header must ask for all that follows; read short, no sum would be looked at."""
    file = io.BytesIO(content)
    shape, is_fortran, dtype = _HEADERS[npy.read_magic(file)](file)
    if dtype.hasobject or dtype.itemsize * math.prod(shape) != len(content) - file.tell():
        raise ValueError(shape)
    array = np.frombuffer(bytearray(memoryview(content)[file.tell() :]), dtype)
    return array.reshape(shape, order="F" if is_fortran else "C")


def _of_matlab(content: bytes, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Matrices of real numbers in a MATLAB 5 file, little-endian. SciPy's reader ends the process on damaged ones."""
    if not content.startswith(_MATLAB_5) or content[124:128] != b"\x00\x01IM":
        raise ValueError(content[:20])
    found, rest = {}, memoryview(content)[128:]
    while rest:
        kind, matrix, rest = _element(rest)
        if kind == _COMPRESSED:
            stream, most = zlib.decompressobj(), int(min(available_memory_mib() * 2**20, sys.maxsize))
            inflated = stream.decompress(matrix, most)
            if len(inflated) == most:
                raise MemoryError(most)
            kind, matrix, left = _element(memoryview(inflated))
            if left or not stream.eof or stream.unused_data:  # at its end it has compared the sum
                raise ValueError(kind)
        _, flags, parts = _element(matrix)
        _, lengths, parts = _element(parts)
        _, name, parts = _element(parts)
        if kind == _MATRIX and bytes(name).decode() in names:
            number, values, parts = _element(parts)
            of_class, stored = _CLASSES[struct.unpack("<II", flags)], np.dtype(_NUMBERS[number])
            if parts or (stored != of_class and stored not in _NARROW):  # or it has an imaginary part
                raise ValueError(number)
            shape = np.frombuffer(lengths, "<i4").tolist()
            array = np.frombuffer(values, stored)
            if math.prod(shape) != array.size or min(shape) < 0:
                raise ValueError(shape)
            _require_memory(array.size * of_class.itemsize)
            found[bytes(name).decode()] = array.astype(of_class).reshape(shape, order="F")
    return {name: found[name] for name in names}


def _element(content: memoryview) -> tuple[int, memoryview, memoryview]:
    """The first element's kind and content, and what follows it."""
    kind, size = struct.unpack_from("<II", content)
    if kind >> 16:  # up to four bytes stand in its head
        kind, size, start, end = kind & 0xFFFF, kind >> 16, 4, 8
    else:
        start, end = 8, 8 + size + (-size % 8 if kind != _COMPRESSED else 0)
    if len(content) < end or start + size > end:
        raise ValueError(size)
    return kind, content[start : start + size], content[end:]
