"""Sealed HDF5 files: written once and atomically, with a sha256 over every byte of data and header.

This is the only module that imports h5py. Metadata are in HDF5's checksummed format (1.10). Text has a fixed length,
because HDF5 keeps texts of variable length in a heap without checksums, where one flipped bit can send it into an
endless loop. A trailer behind HDF5's last byte holds the sha256 of all bytes before it. There are no time stamps, so
that equal content gives equal files.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from math import prod
from os import SEEK_END
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from xfreqbench.errors import DataError, StorageError, XFreqBenchError
from xfreqbench.maps.bartlett import RANGE_TOLERANCE
from xfreqbench.system.array_files import MOST_COMPRESSED
from xfreqbench.system.files import atomic_path, json_sha256, storage_errors, system_errors
from xfreqbench.system.remote import RemotePath
from xfreqbench.types import NDArray

_BLOCK_BYTES = 1 << 25
_CONVENTIONS = {"Conventions": "CF-1.11"}  # for other programs
_TRAILER = b"xfreqbench sha256 "
# Numbers from 0 to 1 are multiples of 1/65280: 65280 is 255 · 256, so that 8-bit levels are exact, and netCDF4 takes
# 65535 for a missing value.
_STEP = np.float32(1 / 65280)
PACKED = "<u2"


def packed(maps: NDArray[np.floating]) -> NDArray[np.uint16]:
    """Numbers from 0 to 1 as multiples of 1/65280, as files hold them, at most 7.7e-6 off; raises `DataError`."""
    low, high = (maps.min(), maps.max()) if maps.size else (0, 1)
    if not (low >= -RANGE_TOLERANCE and high <= 1 + RANGE_TOLERANCE):  # nan is not
        raise DataError(f"Maps are numbers from 0 to 1, but got {low:g} to {high:g}. Divide each by its maximum.")
    return np.rint(np.clip(maps, 0, 1) * np.float32(65280)).astype(PACKED)


def unpacked(stored: NDArray[np.uint16], out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
    """The numbers that `packed` has packed, written to `out` if it is given; a peak of 1 is exactly 1."""
    return np.multiply(stored, _STEP, out=out)


@dataclass(frozen=True)
class Variable:
    """One HDF5 dataset: name, type, shape, names of its axes, unit, description, and chunk if it is stored in chunks.

    Chunks may be `compressed`, by shuffling bytes and deflate. A variable whose only axis has its own name is the
    coordinate of that axis. A name may begin with a group, as in `lofo-77GHz/train_row`; the names of axes in the
    group then begin with it too. `flags` are the values that a variable may have, with the word for each, and
    `coordinates` the variables that say more of its rows; other programs read both, by the CF conventions. They also
    read `scale_factor`, and multiply the numbers of variables of type `PACKED` by it (see `packed`).
    """

    name: str
    dtype: str
    shape: tuple[int, ...]
    axes: tuple[str, ...]
    units: str
    long_name: str
    chunk: tuple[int, ...] | None = None
    compressed: bool = False
    flags: tuple[tuple[int, str], ...] = ()
    coordinates: tuple[str, ...] = ()

    @property
    def num_bytes(self) -> int:
        """Size of the data in bytes."""
        return prod(self.shape) * np.dtype(self.dtype).itemsize


class SealedWriter:
    """Fills the variables of a file row by row, and hashes what it writes."""

    def __init__(self, file: Any, path: Path, variables: Sequence[Variable]) -> None:
        self._file = file
        self._path = path
        self._variables = {variable.name: variable for variable in variables}
        self._num_rows = dict.fromkeys(self._variables, 0)
        for variable in variables:
            _create(file, variable)
        for variable in variables:
            for position, axis in enumerate(() if variable.axes == (variable.name,) else variable.axes):
                file[variable.name].dims[position].attach_scale(file[axis])
        self._digests = {name: _description_digest(file[name]) for name in self._variables}

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Write the next rows of a variable; raises `DataError` if they do not fit, and `StorageError`."""
        if name not in self._variables:
            raise DataError(f"By its header {self._path} has no {name!r}. Change the header, or leave that out.")
        variable, start = self._variables[name], self._num_rows[name]
        if variable.dtype == PACKED:
            rows = packed(rows)
        rows = np.ascontiguousarray(rows, dtype=variable.dtype)
        if rows.shape[1:] != variable.shape[1:] or start + len(rows) > variable.shape[0]:
            raise DataError(
                f"{name!r} has shape {variable.shape} and holds {start} rows; rows of shape {rows.shape} do not fit."
            )
        with storage_errors(self._path, variable.num_bytes):
            self._file[name][start : start + len(rows)] = rows
        self._digests[name].update(rows.data.cast("B") if rows.size else b"")
        self._num_rows[name] += len(rows)

    def seal(self) -> None:
        """Store the hashes; raises `DataError` if rows are missing."""
        for name, variable in self._variables.items():
            if self._num_rows[name] != variable.shape[0]:
                raise DataError(f"{name!r} got {self._num_rows[name]} of its {variable.shape[0]} rows.")
        for name, digest in self._digests.items():
            _set_texts(self._file[name], {"sha256": digest.hexdigest()})
        _set_texts(self._file, {"data_sha256": _seal_of(self._file)})


@contextmanager
def create_sealed(
    path: Path,
    variables: Sequence[Variable],
    attributes: Mapping[str, str | int],
    groups: Mapping[str, Mapping[str, str]] | None = None,
    prove: Callable[[Path], None] | None = None,
) -> Iterator[SealedWriter]:
    """Write a sealed file: a context manager. The complete file appears at `path` when the block ends.

    `groups` are the attributes of the groups that variables are in, by the group's name. `prove` is called with the
    sealed file before it gets its name; if it raises, the file is removed. Raises as `atomic_path` does.
    """
    num_bytes = sum(variable.num_bytes for variable in variables) + (1 << 20)  # more than any header needs
    with atomic_path(path, num_bytes) as temporary:
        with storage_errors(path, num_bytes):
            file = h5py.File(temporary, "w", libver=("v110", "v110"))
        try:
            with storage_errors(path, num_bytes):
                _set_texts(file, {**_CONVENTIONS, **attributes})
                for group, texts in (groups or {}).items():
                    _set_texts(file.create_group(group), texts)
                writer = SealedWriter(file, path, variables)
            yield writer
            with storage_errors(path, num_bytes):
                writer.seal()
                file.close()
                with temporary.open("r+b") as stored:
                    digest = hashlib.file_digest(stored, "sha256").hexdigest()
                    stored.write(_TRAILER + digest.encode())
            if prove:
                prove(temporary)
        finally:
            with suppress(OSError, RuntimeError):  # a full disk fails here once more
                file.close()


@contextmanager
def open_sealed(path: Path, schema: str) -> Iterator[Any]:
    """Open a file of a schema to read; raises `DataError` for one that is missing, damaged or of another schema.

    Everything that is read is checked: headers and data in chunks by the checksums of HDF5, other data by
    `read_array`. A file that another program opened to write is refused. Raises `StorageError` for one that another
    program holds open to write, or that may not be read.
    """
    with open_foreign(path, advice="Generate it again.") as file, _bytes_of(path) as stored:
        found = _text(file, "schema") if "schema" in file.attrs else "none"
        if found != schema:
            raise DataError(f"{path} has schema {found!r}, but schema {schema!r} is needed.")
        stored.seek(-len(_TRAILER) - 64, SEEK_END)
        if stored.read(len(_TRAILER)) != _TRAILER:  # HDF5 overwrites it in any file that it opens to write
            raise DataError(
                f"{path} does not end in its sha256: it was not written completely, or another program opened it "
                "to write and may have changed it. Generate it again."
            )
        yield file


def _bytes_of(path: Path) -> AbstractContextManager[Any]:
    """The bytes of a file, opened to read; those of a file on a server stay open, and what was read is kept."""
    return nullcontext(path.ranges()) if isinstance(path, RemotePath) else path.open("rb")


@contextmanager
def read_errors(path: Path, what: str = "the file", advice: str = "Generate it again.") -> Iterator[None]:
    """Turn any exception that h5py raises for damaged bytes into a `DataError` that names `what` was read.

    Errors of locks, and those of `system_errors`, become a `StorageError`.
    """
    try:
        with system_errors(path):
            try:
                yield
            except OSError as error:
                # a killed program leaves a mark in the file, and HDF5 uses these words for it
                if isinstance(error, BlockingIOError) or "already open for write" in str(error):
                    raise StorageError(
                        f"{path} is in use: another program has opened it to write. Close it there and try "
                        "again; if that program was killed, run: h5clear -s FILE"
                    ) from error
                bytearray(_BLOCK_BYTES)  # HDF5 does not say that it found no memory, but this does
                raise
    except XFreqBenchError:
        raise
    except Exception as error:
        place = f"{path} is damaged, cut short or not HDF5"
        if isinstance(path, RemotePath):  # servers fail in ways of their own
            place, advice = str(path), f"Try again, or download it: xfreqbench.fetch({str(path)!r})"
        elif not isinstance(error, OSError | RuntimeError | LookupError | ValueError | TypeError | AttributeError):
            raise
        fault = getattr(error, "strerror", None) or error
        raise DataError(f"{place}: {what} cannot be read ({fault}). {advice}") from error


@contextmanager
def open_foreign(
    path: Path,
    what: str = "the file",
    advice: str = "Write it again with h5py, h5write of MATLAB, or another HDF5 library.",
) -> Iterator[Any]:
    """Open an HDF5 file of any origin, to read `what` of it; raises as `read_errors`, and if it is missing."""
    with read_errors(path, what, advice):
        source = path.ranges() if isinstance(path, RemotePath) else path
        if source is path and path.is_dir():
            raise DataError(f"{path} is a folder. Give one of its files, with a name in .h5.")
        if source is path and not path.is_file():
            raise DataError(f"There is no file {path}. Generate it first, or correct the path.")
        with h5py.File(source, "r") as file:
            yield file


def is_group(item: Any) -> bool:
    """Whether an item of a file is a group, rather than a dataset."""
    return isinstance(item, h5py.Group)


def foreign_item(group: Any, name: str) -> Any:
    """A group or a dataset that a group holds itself; None for anything else, and for chunks far larger than the data.

    Reading a link, or a dataset whose values are elsewhere, would read any file that it names.
    """
    item = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
    if not isinstance(item, h5py.Dataset):
        return item if is_group(item) else None
    is_here = not (item.shape is None or item.is_virtual or item.external)
    return item if is_here and prod(item.chunks or ()) * item.dtype.itemsize <= max(item.nbytes, _BLOCK_BYTES) else None


def read_array(file: Any, name: str) -> NDArray[Any]:
    """All values of a dataset, compared with its sha256; raises `ValueError` if they differ or it is missing."""
    stored = _dataset(file, name)
    values: NDArray[Any] = stored[...]
    if _digest_of(stored, [values]) != _text(stored, "sha256"):
        raise ValueError(f"dataset {name!r} differs from its sha256")
    return values


def require_layout(file: Any, variables: Sequence[Variable]) -> None:
    """Raise `ValueError` naming the first variable that is missing, or has another type or shape in the file."""
    for variable in variables:
        stored = _dataset(file, variable.name)
        if (stored.dtype, stored.shape) != (np.dtype(variable.dtype), variable.shape):
            raise ValueError(
                f"dataset {variable.name!r} is {stored.dtype} of shape {stored.shape}, but the header asks for "
                f"{variable.dtype} of shape {variable.shape}"
            )


def _dataset(file: Any, name: str) -> Any:
    """A dataset that fits into the file: a few damaged bytes may claim terabytes, which must not be allocated."""
    stored = file.get(name)
    if not isinstance(stored, h5py.Dataset):
        raise ValueError(f"it has no dataset {name!r}")
    if stored.nbytes > MOST_COMPRESSED * stored.id.get_storage_size():
        raise ValueError(f"dataset {name!r} claims {stored.nbytes:,} bytes, more than the file can hold")
    return stored


def sealed_sha256(file: Any) -> str:
    """The stored hash over all data and the header."""
    return _text(file, "data_sha256")


def values_sha256(file: Any) -> str:
    """A hash over the stored hashes of all data: names, types, shapes, units and values, but no header."""
    return json_sha256({name: _text(file[name], "sha256") for name in _dataset_names(file)})


def text_attributes(file: Any) -> dict[str, str]:
    """The attributes of a file or group as texts, without the hash over all data and the conventions."""
    return {name: _text(file, name) for name in file.attrs if name not in ("data_sha256", *_CONVENTIONS)}


def verify_sealed(path: Path, schema: str) -> None:
    """Hash every byte of a file, and raise `DataError` naming the first damaged part."""
    with open_sealed(path, schema) as file:
        if _is_whole(path):
            return
        for name in _dataset_names(file):
            with read_errors(path, f"dataset {name!r}"):
                stored = _dataset(file, name)
                step = max(1, _BLOCK_BYTES // max(1, prod(stored.shape[1:]) * stored.dtype.itemsize))
                blocks = (stored[start : start + step] for start in range(0, stored.shape[0], step))
                if _digest_of(stored, blocks) != _text(stored, "sha256"):
                    raise DataError(f"{path} is damaged: dataset {name!r} differs from its sha256.")
    raise DataError(f"{path} is damaged: its bytes differ from the sha256 at its end. Generate it again.")


def _is_whole(path: Path) -> bool:
    """Whether the trailer of a file has the hash of all bytes before it."""
    digest = hashlib.sha256()
    with _bytes_of(path) as file:
        file.seek(-len(_TRAILER) - 64, SEEK_END)
        left = file.tell()
        file.seek(0)
        while left > 0 and (block := file.read(min(left, _BLOCK_BYTES))):
            digest.update(block)
            left -= len(block)
        return file.read(len(_TRAILER) + 64) == _TRAILER + digest.hexdigest().encode()


def _set_texts(owner: Any, texts: Mapping[str, str | int]) -> None:
    """Store attributes; a number is stored as one, and read as its digits by `_text`."""
    for name, text in texts.items():
        if isinstance(text, int):
            owner.attrs.create(name, text, dtype="<i8")
            continue
        content = text.encode()
        owner.attrs.create(name, content, dtype=h5py.string_dtype("utf-8", max(1, len(content))))


def _text(owner: Any, name: str) -> str:
    value = owner.attrs[name]
    text = value.decode() if isinstance(value, bytes) else str(value)
    text.encode()  # `ValueError` for bytes that are not UTF-8, which h5py accepts
    return text


def _create(file: Any, variable: Variable) -> None:
    filters = {"compression": "gzip", "shuffle": True} if variable.compressed else {}
    dataset = file.create_dataset(
        variable.name,
        shape=variable.shape,
        dtype=variable.dtype,
        chunks=variable.chunk,
        fletcher32=variable.chunk is not None,
        track_times=False,
        **filters,
    )
    _set_texts(dataset, {"units": variable.units, "long_name": variable.long_name})
    if variable.dtype == PACKED:
        dataset.attrs.create("scale_factor", _STEP)
    if variable.flags:
        values, words = zip(*variable.flags, strict=True)
        dataset.attrs.create("flag_values", np.array(values, variable.dtype))
        _set_texts(dataset, {"flag_meanings": " ".join(words)})
    if variable.coordinates:
        _set_texts(dataset, {"coordinates": " ".join(variable.coordinates)})
    if variable.axes == (variable.name,):
        dataset.make_scale(variable.name.rpartition("/")[2])


def _description_digest(dataset: Any) -> Any:
    """A sha256 of name, type, shape, unit and description of a dataset; its values are to be added."""
    meaning = [_text(dataset, "units"), _text(dataset, "long_name")]
    description = [dataset.name, dataset.dtype.str, dataset.shape, *meaning]
    return hashlib.sha256(json.dumps(description).encode())


def _digest_of(dataset: Any, blocks: Iterable[NDArray[Any]]) -> str:
    """The sha256 of a dataset with these values, one block of rows after the other."""
    digest = _description_digest(dataset)
    for block in blocks:
        digest.update(np.ascontiguousarray(block).data.cast("B") if block.size else b"")
    return digest.hexdigest()


def _seal_of(file: Any) -> str:
    """A sha256 over the hashes of all datasets in sorted order, the header and the attributes of the groups."""
    hashes = {name: _text(file[name], "sha256") for name in _dataset_names(file)}
    groups = {name: text_attributes(file[name]) for name in file if is_group(file[name])}
    # references describe the data and do not change them, so they are not hashed
    header = {name: text for name, text in text_attributes(file).items() if name != "references"}
    return json_sha256([hashes, header, *([groups] if groups else [])])


def _dataset_names(file: Any) -> list[str]:
    """Names of all datasets, sorted; the name of one in a group begins with the group's."""
    names: list[str] = []
    file.visit(names.append)
    return sorted(name for name in names if not is_group(file[name]))
