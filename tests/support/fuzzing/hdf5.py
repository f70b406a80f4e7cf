"""Strategies that spoil what is in data sets, split files and predictions."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import json
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from hypothesis import strategies as st

from tests.support.fuzzing.common import odd_array, spoilt_json, torn
from tests.support.stored_records import make_record
from tests.support.synthetic import write_dataset
from xfreqbench.data import hdf5

Spoil = Callable[[Any], None]  # changes an open HDF5 file
KINDS = ("group", "texts", "records", "soft link", "external link", "endless", "long")  # of `as_other_thing`


@functools.cache
def sound_dataset() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return write_dataset(Path(folder) / "data.h5", 3, (1.0, 10.0), maps=True).path.read_bytes()


def sound_records() -> bytes:
    records = [make_record(), make_record("line-of-sight"), make_record(split="lofo-77GHz")]
    return b"".join(record.sealed_json() + b"\n" for record in records)


def hdf5_files(
    content: bytes, absent: Sequence[tuple[str, str]] = (("/", "channels"), ("/", "data_sha256"))
) -> st.SearchStrategy[bytes | Callable[[], bytes]]:
    """A sealed file in other bytes, or with an attribute or a dataset that some program changed and sealed again.

    The second is a function that makes it, for Hypothesis lets no library draw random numbers while it draws. `absent`
    are owners and names of further attributes.
    """
    changed = st.tuples(spoilt_attributes(content, absent) | spoilt_tables(content), st.booleans())
    spoilt = changed.map(lambda change: lambda: spoilt_file(content, *change))
    return spoilt | spoilt | torn(content) | st.binary(max_size=100)


def spoilt_file(content: bytes, spoil: Spoil, is_sealed_again: bool) -> bytes:
    """A sealed file that some program has changed, with or without the hashes that tell of it."""
    buffer = io.BytesIO(content)
    with h5py.File(buffer, "r+", libver=("v110", "v110")) as file:
        spoil(file)
        if is_sealed_again:
            with contextlib.suppress(Exception):  # what has no hash has none
                seal(file)
    spoilt = buffer.getvalue()
    trailer = hdf5._TRAILER + hashlib.sha256(spoilt).hexdigest().encode()
    return spoilt + trailer if is_sealed_again else spoilt


def seal(file: Any) -> None:
    for name in hdf5._dataset_names(file):
        with contextlib.suppress(Exception):
            hdf5._set_texts(file[name], {"sha256": hdf5._digest_of(file[name], [file[name][...]])})
    hdf5._set_texts(file, {"data_sha256": hdf5._seal_of(file)})


@functools.cache
def attributes(content: bytes) -> dict[tuple[str, str], str]:
    """The texts of the file and of its groups, by the owner's name and their own."""
    with h5py.File(io.BytesIO(content), "r") as file:
        owners = ["/", *(name for name in file if hdf5.is_group(file[name]))]
        return {(owner, name): text for owner in owners for name, text in hdf5.text_attributes(file[owner]).items()}


@functools.cache
def tables(content: bytes) -> dict[str, np.ndarray]:
    with h5py.File(io.BytesIO(content), "r") as file:
        return {name: file[name][...] for name in hdf5._dataset_names(file)}


def with_attribute(name: str, value: Any, owner: str = "/") -> Spoil:
    def spoil(file: Any) -> None:
        file[owner].attrs.pop(name, None)
        if value is not None:
            file[owner].attrs[name] = value

    return spoil


def spoilt_attributes(content: bytes, absent: Sequence[tuple[str, str]]) -> st.SearchStrategy[Spoil]:
    is_json = ("_json", "maps")
    known = attributes(content)
    objects = {place: json.loads(text) for place, text in known.items() if place[1].endswith(is_json)}
    texts = ["", "null", "{", "[]", "nan", "-1", "1" * 5000, "[" * 5000, "1000000000000", "|" * 200]
    others = [3, 2.5, -1, np.nan, np.inf, b"\xff\xfe", np.zeros(0), np.arange(4), h5py.Empty("f"), True, 10**12]
    values = st.none() | st.sampled_from([*texts, *others])
    plain = st.tuples(st.sampled_from([*known, *absent]), values)
    inside = st.sampled_from(sorted(objects)).flatmap(
        lambda place: spoilt_json(objects[place]).map(lambda value: (place, json.dumps(value)))
    )
    changes = plain | inside | inside if objects else plain
    return changes.map(lambda change: with_attribute(change[0][1], change[1], change[0][0]))


def with_table(name: str, array: np.ndarray | None) -> Spoil:
    def spoil(file: Any) -> None:
        kept = dict(file[name].attrs)
        del file[name]
        if array is not None:
            file[name] = array
            for key in kept.keys() & {"units", "long_name", "sha256"}:
                file[name].attrs[key] = kept[key]

    return spoil


def as_other_thing(name: str, kind: str) -> Spoil:
    def spoil(file: Any) -> None:
        del file[name]
        if kind == "group":
            file.create_group(name)
        elif kind == "texts":
            file[name] = ["a", "b"]
        elif kind == "records":
            file[name] = np.zeros(3, [("a", "f8"), ("b", "i4")])
        elif kind == "soft link":
            file[name] = h5py.SoftLink("/nowhere")
        elif kind == "external link":
            file[name] = h5py.ExternalLink("/etc/passwd", "/x")
        else:
            shape = (10**6, 10**6) if kind == "endless" else (10**10,)
            file.create_dataset(name, shape, "f8", chunks=tuple(min(1000, size) for size in shape))

    return spoil


def spoilt_tables(content: bytes) -> st.SearchStrategy[Spoil]:
    known = tables(content)
    names = st.sampled_from(sorted(known))
    arrays = names.flatmap(lambda name: odd_array(known[name]).map(lambda array: with_table(name, array)))
    gone = names.map(lambda name: with_table(name, None))
    return arrays | arrays | gone | st.tuples(names, st.sampled_from(KINDS)).map(lambda change: as_other_thing(*change))
