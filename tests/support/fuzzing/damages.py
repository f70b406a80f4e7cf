"""Damages to each kind of file: bytes, and parts of the structure replaced, with hashes that hold or do not."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import lzma
import struct
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from hypothesis import strategies as st
from safetensors.numpy import load, save

from tests.support.fuzzing.common import JSON_VALUES, ODD_NUMBERS, WORDS, cut_or_flipped, odd_array, spoilt_json, torn
from tests.support.fuzzing.hdf5 import hdf5_files
from tests.support.fuzzing.png import PNG_FOLDER, png_folders, receivers
from tests.support.fuzzing.scenes import edited, ply_files, toml_file
from tests.support.fuzzing.sound_files import DATA, FINGERPRINT, MAPS, RECORDS, ROOM, SPLIT, sound_files
from xfreqbench.runs.sealed import SEAL, content_sha256
from xfreqbench.system.array_files import unpacked

Content = bytes | Callable[[], bytes] | None  # or what makes it; None where the file is gone
Damage = dict[str, Content]  # of the files that differ from the sound ones


def in_place_of(path: str, contents: st.SearchStrategy[Any]) -> st.SearchStrategy[Damage]:
    return contents.map(lambda content: {path: content})


def sealed_json(content: Any, is_sealed_again: bool = True) -> bytes:
    """A record or checkpoint as JSON, with the hash that it has or the one that it should have."""
    if isinstance(content, dict) and is_sealed_again and SEAL in content:
        bare = {name: value for name, value in content.items() if name != SEAL}
        content = {**bare, SEAL: content_sha256(bare)}
    return json.dumps(content).encode()


def _stored_predictions() -> st.SearchStrategy[Damage]:
    paths = [path for path in sound_files() if path.startswith("results/predictions/")]
    return st.one_of([in_place_of(path, hdf5_files(sound_files()[path]) | st.none()) for path in paths])


def _records() -> st.SearchStrategy[Damage]:
    content = sound_files()[RECORDS]
    lines = [json.loads(line) for line in content.splitlines()]
    number = st.integers(0, len(lines) - 1)
    findings = spoilt_json(lines[-1]["findings"]).map(lambda part: (1, {**lines[-1], "findings": part}))
    spoilt = number.flatmap(lambda at: spoilt_json(lines[at]).map(lambda line: (at, line))) | findings

    def joined(change: tuple[int, Any], is_sealed_again: bool) -> bytes:
        changed = [*lines[: change[0]], change[1], *lines[change[0] + 1 :]]
        return b"".join(sealed_json(line, is_sealed_again) + b"\n" for line in changed)

    sealed = st.builds(joined, spoilt, st.sampled_from([True, True, True, False]))
    endings = [b"{", b"x", b"\xff", b"[" * 5000, b"\n\n", b"{}\n", b"[" * 5000 + b"\n"]
    ended = st.sampled_from(endings).map(lambda end: content + end)
    line_ends = [content.replace(b"\n", end) for end in (b"\r\n", b"\r", b"\n\n", b"")]
    marked = [b"\xef\xbb\xbf" + content, content.decode().encode("utf-16"), content[:-1] + b"\0" * 9]
    moved = st.sampled_from([*line_ends, *marked, content[:-1], content * 2])
    bytes_ = cut_or_flipped(content) | st.binary(max_size=80)
    return in_place_of(RECORDS, sealed | sealed | sealed | bytes_ | ended | moved)


def _maps() -> st.SearchStrategy[Damage]:
    content = sound_files()[MAPS]
    spoilt = st.builds(sealed_json, spoilt_json(json.loads(content)), st.sampled_from([True, True, True, False]))
    return in_place_of(MAPS, spoilt | cut_or_flipped(content) | st.binary(max_size=80))


def _checkpoints() -> st.SearchStrategy[Damage]:
    state_path = next(path for path in sound_files() if path.endswith("checkpoint.json"))
    state = json.loads(sound_files()[state_path])
    method = state_path.replace("checkpoint.json", "method/")

    def with_hashes(name: str, content: bytes) -> Damage:
        sha256 = {**state["sha256"], name: hashlib.sha256(content).hexdigest()}
        return {state_path: sealed_json({**state, "sha256": sha256}), method + name: content}

    def of_method(name: str, contents: st.SearchStrategy[bytes]) -> st.SearchStrategy[Damage]:
        kept = contents.map(lambda content: {method + name: content})
        told = contents.map(lambda content: with_hashes(name, content))
        return told | told | told | kept

    saved = sound_files()[method + "state.json"]
    tensors = sound_files()[method + "state.safetensors"]
    spoilt_state = st.builds(sealed_json, spoilt_json(state), st.sampled_from([True, True, False]))
    torn_state = cut_or_flipped(sound_files()[state_path])
    spoilt_saved = spoilt_json(json.loads(saved)).map(json.dumps).map(str.encode)
    gone = st.sampled_from([state_path, method + "state.json", method + "state.safetensors"])
    return (
        in_place_of(state_path, spoilt_state | torn_state)
        | of_method("state.json", spoilt_saved | spoilt_saved | cut_or_flipped(saved))
        | of_method("state.safetensors", _spoilt_tensors(tensors) | torn(tensors))
        | gone.map(lambda path: {path: None})
        | st.just(with_hashes("more", b"1"))
    )


def _spoilt_tensors(content: bytes) -> st.SearchStrategy[bytes]:
    """Tensors of which one is gone, is of another type or shape, or holds numbers that mean nothing."""
    known = load(content)
    names = st.sampled_from(sorted(known))
    plain = "fiub"  # kinds of numbers that the format knows, of which it takes no other byte order
    arrays = names.flatmap(
        lambda name: (
            odd_array(known[name])
            .filter(lambda array: array.dtype.kind in plain and array.dtype.isnative)
            .map(lambda array: {**known, name: array})
        )
    )
    gone = names.map(lambda name: {key: array for key, array in known.items() if key != name})
    return (arrays | arrays | gone).map(save)


def _table(sound: bytes) -> st.SearchStrategy[bytes]:
    """A table with cells, lines and columns as they should not be; one of numbers that mean nothing; or other bytes."""
    known = [line.split(",") for line in sound.decode().splitlines()]
    heads = st.sampled_from([known[:1], []])
    cells = st.sampled_from(_ODD_CELLS) | ODD_NUMBERS | st.floats().map(str) | WORDS
    rows = st.lists(st.lists(cells, max_size=5), max_size=4)
    texts = st.builds(lambda head, rows: "\n".join(map(",".join, head + rows)).encode(), heads, rows)
    odd = st.lists(st.tuples(st.integers(0, len(known) - 1), st.integers(0, len(known[0])), cells), max_size=3)
    lines = st.lists(st.sampled_from(range(len(known))), max_size=len(known)) | st.just([*range(len(known))])
    columns = st.lists(st.integers(0, len(known[0]) - 1), max_size=6) | st.just([*range(len(known[0]))])
    spoilt = st.builds(partial(_spoilt_table, known), odd, lines, columns, st.sampled_from(_WRITTEN))
    return texts | spoilt | spoilt | st.binary(max_size=60) | cut_or_flipped(sound)


def _spoilt_table(
    known: list[list[str]], odd: list[tuple[int, int, str]], lines: list[int], columns: list[int], written: Callable
) -> bytes:
    """Some lines and columns of a table, odd cells in place of others or behind the last, written in some way."""
    rows = [[known[line][column] for column in columns] for line in lines]
    for line, column, cell in odd:
        for row in rows[line : line + 1]:
            row[column : column + 1] = [cell]
    return written(rows).encode("utf-8", "surrogateescape")


def _joined(separator: str, end: str = "\n", point: str = ".") -> Callable[[list[list[str]]], str]:
    return lambda rows: end.join(separator.join(row).replace(".", point) for row in rows)


def _positions() -> st.SearchStrategy[Damage]:
    """The table as it is, or packed and cut, in every file of positions."""
    contents = _table(b"x,y,z,sample\n1.0,1.0,1.0,1\n0.5,0.5,1.5,2\n").flatmap(
        lambda text: st.sampled_from([text, text, gzip.compress(text, mtime=0)[:-4], lzma.compress(text)[:-4]])
    )
    return contents.map(lambda content: dict.fromkeys(("tx.csv", "tx.csv.gz", "tx.xz"), content))


def _scenes() -> st.SearchStrategy[Damage]:
    text = sound_files()["room.toml"].decode()
    spoilt = spoilt_json(ROOM).map(toml_file) | edited(text) | JSON_VALUES.map(toml_file)
    return in_place_of("room.toml", spoilt.map(lambda toml: toml.encode("utf-8", "surrogateescape")))


def _scenarios(root: str, write: Callable[..., bytes]) -> st.SearchStrategy[Damage]:
    """Parameters spoilt, arrays of other types, shapes or numbers, or other bytes, of the scenario at one carrier."""
    files = {path: content for path, content in sound_files().items() if path.startswith(root)}
    parameters = next(path for path in files if path.endswith("params.json"))
    folder = parameters.removesuffix("params.json")
    arrays = [path for path in files if path.startswith(folder) and "_t000" in path]

    def spoilt_array(path: str) -> st.SearchStrategy[Damage]:
        key = path.removeprefix(folder).partition("_t000")[0]
        (array,) = unpacked(Path(path), files[path], [key], "").values()
        return in_place_of(path, odd_array(array).map(lambda array: lambda: write(**{key: array})))

    told = spoilt_json(json.loads(files[parameters])).map(json.dumps).map(str.encode)
    bytes_ = st.sampled_from([parameters, *arrays]).flatmap(
        lambda path: in_place_of(path, cut_or_flipped(files[path]) | st.none())
    )
    spoilt = st.one_of([spoilt_array(path) for path in arrays])
    return spoilt | spoilt | in_place_of(parameters, told) | bytes_ | _bombs(root, write)


def _collections() -> st.SearchStrategy[Damage]:
    """What describes the rooms spoilt, with names of files that lead elsewhere, or a room of other bytes."""
    told = json.loads(sound_files()["rooms/collection.json"])
    names = st.sampled_from(["../data/room.toml.h5", "/etc/passwd", "one.h5/x.h5", "x" * 300 + "/one.h5"])
    elsewhere = names.map(lambda name: {**told, "rooms": [{**told["rooms"][0], "file": name}]})
    described = (spoilt_json(told) | elsewhere).map(json.dumps).map(str.encode)
    bytes_ = cut_or_flipped(sound_files()["rooms/collection.json"]) | st.none()
    room = in_place_of("rooms/one.h5", torn(sound_files()["rooms/one.h5"]) | st.none())
    return in_place_of("rooms/collection.json", described | described | bytes_) | room


def _bombs(root: str, write: Callable[..., bytes]) -> st.SearchStrategy[Damage]:
    """Arrays that take a thousand times as much memory as the file, and sizes that no file has."""
    path = next(path for path in sound_files() if path.startswith(root) and "/power_t000" in path)
    numbers = [0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF]
    number = st.sampled_from([struct.pack("<I", size) for size in numbers])
    content = sound_files()[path]
    sizes = st.builds(
        lambda at, size: content[:at] + size + content[at + 4 :], st.integers(0, len(content) - 4), number
    )
    zeros = st.sampled_from([10**7, 10**8]).map(lambda size: lambda: write(power=np.zeros((1, size), "u1")))
    return in_place_of(path, sizes | sizes | zeros)


def _fingerprints() -> st.SearchStrategy[Damage]:
    """One of its arrays of another type, shape or numbers, or gone; or other bytes."""
    content = sound_files()[FINGERPRINT]
    known = unpacked(Path(FINGERPRINT), content, None, "")
    names = st.sampled_from(sorted(known))
    odd = names.flatmap(
        lambda name: (odd_array(known[name]) if known[name].dtype.kind != "U" else JSON_VALUES.map(json.dumps)).map(
            lambda value: _npz(**{**known, name: value})
        )
    )
    gone = names.map(lambda name: _npz(**{key: array for key, array in known.items() if key != name}))
    return in_place_of(FINGERPRINT, odd | odd | gone | cut_or_flipped(content))


def _npz(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def _mat(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, arrays, do_compression=True)
    return buffer.getvalue()


_ODD_CELLS = [
    *("1_0", "010", "1:30", "0x10", "1,5", '"1,5"', '"', "#", "NA", "-999", "100", "٣", "−1", "1 000", "x", "x_mm")
]
_WRITTEN = [
    *(_joined(","), _joined(";"), _joined("\t"), _joined("  "), _joined("|"), _joined(",", "\r\n"), _joined(",", "\r")),
    *(_joined(",", point=","), _joined(";", point=","), lambda rows: "\ufeff# " + _joined(", ")(rows)),
]
_DECLARED = [(SPLIT, name) for name in ("seed", "fit_seconds", "parameters", "url", "hardware", "other")]
_DAMAGES: dict[str, Callable[[], st.SearchStrategy[Damage]]] = {
    "data set": lambda: in_place_of(DATA, hdf5_files(sound_files()[DATA])),
    "stored predictions": _stored_predictions,
    "checkpoint": _checkpoints,
    "records": _records,
    "maps to show": _maps,
    "collection": _collections,
    "split file": lambda: in_place_of("split.h5", hdf5_files(sound_files()["split.h5"])),
    "predictions made elsewhere": lambda: in_place_of("theirs.h5", hdf5_files(sound_files()["theirs.h5"], _DECLARED)),
    "PNG folder": png_folders,
    "receiver of a PNG folder": lambda: in_place_of("maps/gateway_info.yml", receivers()),
    "table of a PNG folder": lambda: in_place_of("maps/tx_pos.csv", _table(PNG_FOLDER["tx_pos.csv"])),
    "DeepMIMO scenario": partial(_scenarios, "scenarios/", _npz),
    "DeepMIMO scenario of MATLAB": partial(_scenarios, "mats/", _mat),
    "fingerprint": _fingerprints,
    "positions": _positions,
    "measurement": lambda: in_place_of("measured.csv", _table(sound_files()["measured.csv"])),
    "scene": _scenes,
    "mesh": lambda: in_place_of("wall.ply", ply_files()),
}


@cache
def damages(kind: str) -> st.SearchStrategy[Damage]:
    """Damages to the files of a kind."""
    return _DAMAGES[kind]()
