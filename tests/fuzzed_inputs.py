"""Sound files of every kind, and strategies that spoil them for the fuzzing tests."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import trimesh
from fuzzing import (
    ODD_NUMBERS,
    ODD_WORDS,
    cut_or_flipped,
    odd_array,
    spoilt_json,
    xfreqbench,
)
from hypothesis import strategies as st
from PIL import Image
from synthetic import write_dataset
from test_records import make_record

from xfreqbench import hdf5

SMALL_SCENE: dict[str, Any] = {
    "name": "small",
    "description": "one wall and one box",
    "receiver": {
        "position_m": [2.0, 2.0, 2.5],
        "rows": 2,
        "cols": 2,
        "spacing_wavelengths": 0.5,
        "boresight": [0.0, 0.0, -1.0],
        "pattern": "iso",
        "polarization": "V",
    },
    "transmitters": {
        "min_m": [0.5, 0.5, 0.5],
        "max_m": [3.5, 3.5, 1.5],
        "step_m": [1.0, 1.0, 0.5],
        "clearance_m": 0.2,
    },
    "surface": [
        {
            "name": "floor",
            "material": "concrete",
            "thickness_m": 0.2,
            "min_m": [0.0, 0.0, 0.0],
            "max_m": [4.0, 4.0, 0.0],
        },
        {
            "name": "cabinet",
            "material": "metal",
            "thickness_m": 0.01,
            "min_m": [1.2, 1.2, 0.1],
            "max_m": [1.8, 1.8, 1.2],
        },
    ],
}


def toml(value: Any) -> str:
    """A value as TOML writes it; a table stands in one line, None is not there."""
    if isinstance(value, dict):
        pairs = (f"{toml(key)} = {toml(part)}" for key, part in value.items() if part is not None)
        return "{" + ", ".join(pairs) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(toml(part) for part in value if part is not None) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def toml_file(content: Any) -> str:
    if not isinstance(content, dict):
        return toml(content)
    return "\n".join(f"{toml(key)} = {toml(part)}" for key, part in content.items() if part is not None)


def edited(text: str) -> st.SearchStrategy[str]:
    """A text with one of its words replaced, one of its lines left out, or one of its bytes flipped."""
    words = [match.span() for match in re.finditer(r"-?[\w.]+", text)]
    word = st.tuples(st.sampled_from(words), ODD_NUMBERS | ODD_WORDS).map(
        lambda at: text[: at[0][0]] + at[1] + text[at[0][1] :]
    )
    lines = text.splitlines(keepends=True)
    line = st.integers(0, len(lines) - 1).map(lambda at: "".join(lines[:at] + lines[at + 1 :]))
    flipped = cut_or_flipped(text.encode()).map(lambda content: content.decode("utf-8", "surrogateescape"))
    return word | word | line | flipped


EMPTY_SCENE = {key: part for key, part in SMALL_SCENE.items() if key != "surface"}


REFERRING_SCENE = toml_file({"scene": "room.xml", **EMPTY_SCENE})


XML = """<?xml version="1.0" encoding="utf-8"?>
<scene version="2.1.0">
  <bsdf type="itu-radio-material" id="mat-wall">
    <string name="type" value="concrete"/>
    <float name="thickness" value="0.1"/>
  </bsdf>
  <shape type="ply" id="mesh-wall">
    <string name="filename" value="wall.ply"/>
    <ref id="mat-wall" name="bsdf"/>
  </shape>
</scene>
"""


ASCII_PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
4 0 0
0 4 0
4 4 0
3 0 1 2
3 1 3 2
"""


def binary_ply() -> bytes:
    content = trimesh.Trimesh([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]], process=False).export(
        file_type="ply"
    )
    assert isinstance(content, bytes)
    return content


GENERATE_OPTIONS = {
    "--freqs": [
        "",
        ",",
        "1,1",
        "1,,2",
        "paper",
        " paper",
        "1e300",
        "1e-300",
        "1e290",
        "0.0001",
        "450",
        "1_0",
        "1" * 5000,
        "1," * 3000 + "1",
        "-5",
        "nan",
        "2.4GHz",
    ],
    "--tx": ["0", "-1", "9" * 400, "1" * 5000, "1.5", "1e3", "٣", ""],
    "--tx-positions": [".", "/no/such", "x" * 400, "/proc/self/mem", ""],
    "--solver": ["Image", "", "auto "],
    "--interactions": ["", ",", "specular,specular", "all", "diffuse", "specular;refraction"],
    "--rays": ["0", "-1", "9" * 400, "1e6", ""],
    "--max-depth": ["-1", "9" * 400, "1.0", ""],
    "--seed": ["-1", "9" * 400, "1" * 5000, "1.0", ""],
    "--pas-kind": ["", "Power", "phase"],
    "--materials": ["", "ignore", "extrapolate"],
    "--maps": ["", "maybe"],
    "--output": [
        "",
        ".",
        "/",
        "x" * 400,
        "taken.h5/x.h5",
        "taken.h5",
        "/proc/x.h5",
        "notes.txt",
    ],
    "--no-such": [""],
}


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


RUN_OPTIONS = {
    "--data": ["", ".", "x" * 400, "taken.h5", "/etc/passwd", "/root/../no/such", "notes.txt/x"],
    "--results": ["notes.txt", "x" * 400, "notes.txt/x", "/proc/no"],
    "--method": [
        "",
        ",",
        "nearest,",
        "nerf",
        "os:path",
        "os:",
        ":",
        "a.b:c",
        "..:x",
        "x" * 400,
        "json:dumps",
    ],
    "--protocol": ["", "Lofo", "sparse", "all"],
    "--targets": ["", ",", "all,1", "1e300", "nan", "3", "1,1", "-1"],
    "--seed": ["", ",", "-1", "0,,1", "1.5", "9" * 5000, "9" * 40, "²", "٣", "1e3"],
    "--budget": [
        "",
        "0s",
        "5",
        "-1s",
        "1e3s",
        "9" * 400 + "s",
        "9" * 5000 + "steps",
        "9" * 400 + "steps",
        "٣s",
        "5 m",
    ],
    "--device": ["", "gpu", "tpu"],
    "--set": [
        "",
        "=",
        "x",
        "x=",
        "hidden=128",
        "num_nearest",
        "num_nearest=",
        "num_nearest=nan",
        "=1",
        "num_nearest=" + "[" * 5000,
        "num_nearest=1" + "0" * 5000,
        "num_nearest={}",
        "num_nearest=0",
        "num_nearest=-1",
    ],
    "--executor": ["", "0", "-1", "dask://", "dask://x:1:2", "dask://localhost", "x", "9" * 5000, "http://x"],
}


def option_texts(
    options: dict[str, list[str]], free: st.SearchStrategy[str]
) -> st.SearchStrategy[dict[str, str]]:
    option = st.sampled_from(sorted(options)).flatmap(
        lambda name: st.tuples(st.just(name), st.sampled_from(options[name]) | free)
    )
    return st.lists(option, min_size=1, max_size=2).map(dict)


@functools.cache
def png() -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.arange(91 * 361, dtype=np.uint32).reshape(91, 361).astype(np.uint8)).save(
        buffer, "png"
    )
    return buffer.getvalue()


PNG_FOLDER = {
    "tx_pos.csv": b"x,y,z\n1.0,2.0,3.0\n-1.0,0.0,0.5\n",
    "freq.txt": b"24.25\n24.25\n",
    "gateway_info.yml": b"gateway1:\n  position: [2,1,-0.5]\n  orientation:  [ 0.0, 0.0, 0.0,  1.0]\n",
}


def png_folders() -> st.SearchStrategy[tuple[dict[str, bytes | None], list[str]]]:
    """Files that differ from those of a sound folder, and options of the command."""
    texts = st.sampled_from(sorted(PNG_FOLDER)).flatmap(
        lambda name: st.tuples(st.just(name), spoilt_text(PNG_FOLDER[name]) | st.none())
    )
    images = st.tuples(
        st.sampled_from(["spectrum/00001.png", "spectrum/00002.png", "spectrum/00003.png"]),
        cut_or_flipped(png())
        | cut_or_flipped(png()[:60]).map(lambda head: head + png()[60:])
        | odd_images()
        | st.none(),
    )
    options = st.sampled_from(
        [
            [],
            [],
            [],
            ["--convention", "mine"],
            ["--set", "plane=zz"],
            ["--set", "x"],
            ["--set", "rows="],
            ["--set", "=1"],
            ["--freq", "nan"],
            ["--freq", "-1"],
            ["--freq", "1e300"],
            ["--freq", "x"],
            ["--freq", "5"],
        ]
    )
    return st.tuples(st.lists(texts | images, min_size=1, max_size=2).map(dict), options)


def spoilt_text(text: bytes) -> st.SearchStrategy[bytes]:
    return edited(text.decode()).map(lambda changed: changed.encode("utf-8", "surrogateescape"))


def odd_images() -> st.SearchStrategy[bytes]:
    def image(mode: str, size: tuple[int, int]) -> bytes:
        buffer = io.BytesIO()
        Image.new(mode, size).save(buffer, "png")
        return buffer.getvalue()

    modes, sides = st.sampled_from(["1", "L", "LA", "P", "RGB", "I;16"]), st.sampled_from([1, 2, 91, 361])
    bomb = png()[:16] + (60000).to_bytes(4, "big") * 2 + png()[24:]
    return st.builds(image, modes, st.tuples(sides, sides)) | st.sampled_from([b"", b"GIF89a", bomb])


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
