"""Sound data sets, predictions and records, and strategies that spoil what is in them."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from fuzzing import cut_or_flipped, odd_array, spoilt_json, xfreqbench
from hypothesis import strategies as st
from stored_records import make_record
from synthetic import write_dataset

from xfreqbench.data import hdf5

Spoil = Callable[[Any], None]  # changes an open HDF5 file


@functools.cache
def sound_dataset() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return write_dataset(Path(folder) / "data.h5", 3, (1.0, 10.0), maps=True).path.read_bytes()


def spoilt_dataset(spoil: Spoil, is_sealed_again: bool) -> bytes:
    """A data set that some program has changed, with or without the hashes that tell of it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "data.h5"
        path.write_bytes(sound_dataset())
        with h5py.File(path, "r+", libver=("v110", "v110")) as file:
            spoil(file)
            if is_sealed_again:
                with contextlib.suppress(Exception):  # what has no hash has none
                    seal(file)
        if is_sealed_again:
            hdf5._append_trailer(path)
        return path.read_bytes()


def seal(file: Any) -> None:
    for name in hdf5._dataset_names(file):
        with contextlib.suppress(Exception):
            hdf5._set_texts(file[name], {"sha256": hdf5._digest_of(file[name])})
    hdf5._set_texts(file, {"data_sha256": hdf5._seal_of(file)})


@functools.cache
def attributes() -> dict[str, str]:
    with h5py.File(io.BytesIO(sound_dataset()), "r") as file:
        return hdf5.text_attributes(file)


@functools.cache
def tables() -> dict[str, np.ndarray]:
    with h5py.File(io.BytesIO(sound_dataset()), "r") as file:
        return {name: file[name][...] for name in file}


def with_attribute(name: str, value: Any) -> Spoil:
    def spoil(file: Any) -> None:
        file.attrs.pop(name, None)
        if value is not None:
            file.attrs[name] = value

    return spoil


def spoilt_attributes() -> st.SearchStrategy[Spoil]:
    is_json = ("_json", "maps")
    objects = {name: json.loads(text) for name, text in attributes().items() if name.endswith(is_json)}
    values = st.none() | st.sampled_from(
        [
            "",
            "null",
            "{",
            "[]",
            "nan",
            "-1",
            "1" * 5000,
            "[" * 5000,
            3,
            2.5,
            b"\xff\xfe",
            np.zeros(0),
            np.arange(4),
            h5py.Empty("f"),
            True,
            10**12,
            "1000000000000",
        ]
    )
    plain = st.tuples(st.sampled_from([*attributes(), "channels", "data_sha256"]), values)
    inside = st.sampled_from(sorted(objects)).flatmap(
        lambda name: spoilt_json(objects[name]).map(lambda value: (name, json.dumps(value)))
    )
    return (plain | inside | inside).map(lambda change: with_attribute(*change))


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


def spoilt_tables() -> st.SearchStrategy[Spoil]:
    names = st.sampled_from(sorted(tables()))
    kinds = st.sampled_from(["group", "texts", "records", "soft link", "external link", "endless", "long"])
    arrays = names.flatmap(lambda name: odd_array(tables()[name]).map(lambda array: with_table(name, array)))
    gone = names.map(lambda name: with_table(name, None))
    return arrays | arrays | gone | st.tuples(names, kinds).map(lambda change: as_other_thing(*change))


def sound_records() -> bytes:
    records = [make_record(), make_record("line-of-sight"), make_record(split="lofo-77GHz")]
    return b"".join(record.model_dump_json().encode() + b"\n" for record in records)


@functools.cache
def sound_predictions() -> bytes:
    """Predictions as somebody else would write them: the attributes copied from the split file, maps of ones."""
    with tempfile.TemporaryDirectory() as folder:
        data, split = Path(folder) / "data.h5", Path(folder) / "split.h5"
        data.write_bytes(sound_dataset())
        assert xfreqbench("split", "--data", data, "--targets", "10", "-o", split, "-q").code == 0
        with (
            h5py.File(split, "r") as known,
            h5py.File(Path(folder) / "maps.h5", "w", libver="latest") as file,
        ):
            group = file.create_group("lofo-10GHz")
            group.attrs.update(known["lofo-10GHz"].attrs)
            group.attrs["method"] = "mine"
            group["pas"] = np.ones((len(known["lofo-10GHz/test_row"]), 90, 360), "f4")
        return (Path(folder) / "maps.h5").read_bytes()


def spoilt_predictions() -> st.SearchStrategy[bytes]:
    with h5py.File(io.BytesIO(sound_predictions()), "r") as file:
        names, shape = list(file["lofo-10GHz"].attrs), file["lofo-10GHz/pas"].shape
    values = st.none() | st.sampled_from(
        ["", "x", -1, np.nan, np.inf, 10**12, b"\xff", np.zeros(3), h5py.Empty("f"), "|" * 200]
    )
    keys = st.sampled_from(
        [*names, "method", "seed", "fit_seconds", "parameters", "url", "hardware", "other"]
    )

    def changed(spoil: Spoil) -> bytes:
        buffer = io.BytesIO(sound_predictions())
        with h5py.File(buffer, "r+", libver="latest") as file:
            spoil(file["lofo-10GHz"])
        return buffer.getvalue()

    attribute = st.tuples(keys, values).map(lambda change: with_attribute(*change))
    table = odd_array(np.ones(shape, "f4")).map(lambda array: with_table("pas", array))
    other = st.sampled_from(["group", "texts", "records", "soft link", "external link", "endless"]).map(
        lambda kind: as_other_thing("pas", kind)
    )
    return (attribute | attribute | table | other).map(changed) | cut_or_flipped(sound_predictions()[:3000])
