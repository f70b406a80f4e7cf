"""Thousands of scenes, positions and options that nobody should give: none ends in a traceback or costs a file."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import lzma
import re
from typing import Any

import pytest
from hypothesis import strategies as st

from tests.support.fuzzing.common import (
    NUM_INPUTS,
    ODD_NUMBERS,
    ODD_WORDS,
    WORDS,
    cut_or_flipped,
    fuzz,
    refused,
    sentinel_folder,
    spoilt_json,
)
from tests.support.fuzzing.options import GENERATE_OPTIONS
from tests.support.fuzzing.scenes import (
    ASCII_PLY,
    EMPTY_SCENE,
    OBJ,
    REFERRING_SCENE,
    RICH_XML,
    SMALL_SCENE,
    XML,
    edited,
    ply_files,
    toml_file,
)
from tests.support.mesh_scenes import glb_content, packed_glb
from tests.support.places import ROOT

SCENES = ROOT / "scenes"
pytestmark = pytest.mark.slow


def generates_nothing(scene: str, *options: str) -> None:
    """A scene's text ends in a refusal of the scene, or in one of the output that is there already."""
    with sentinel_folder() as folder:
        path = folder / "odd.toml"
        path.write_bytes(scene.encode("utf-8", "surrogateescape"))
        refused(folder, "generate", path, "-o", folder / "taken.h5", "--freqs", "1,10", "-q", *options)


def test_no_text_as_a_scene_ends_in_a_traceback() -> None:
    texts = st.text(max_size=60) | st.tuples(
        st.sampled_from(["name", "[receiver]\nposition_m", "[[surface]]\nname", "scene"]),
        st.sampled_from(
            [
                "1" * 5000,
                "[" * 3000,
                "[" * 3000 + "]" * 3000,
                "{a=" * 3000,
                "1979-02-30",
                '"\\ud800"',
                '"\\u0000"',
                '"""',
                "0x" + "f" * 6000,
            ]
        )
        | ODD_NUMBERS,
    ).map(" = ".join)
    fuzz(NUM_INPUTS["random scene text"], texts, generates_nothing)


def test_no_spoilt_part_of_a_scene_ends_in_a_traceback() -> None:
    scenes = spoilt_json(SMALL_SCENE).map(toml_file)
    fuzz(NUM_INPUTS["a small scene with one part spoilt"], scenes, generates_nothing)


def test_no_edit_of_a_shipped_scene_ends_in_a_traceback() -> None:
    texts = st.sampled_from([path.read_text() for path in sorted(SCENES.glob("*.toml"))])
    fuzz(NUM_INPUTS["a shipped scene with one edit"], texts.flatmap(edited), generates_nothing)


def refused_room(xml: bytes, ply: bytes | None, scene: str = REFERRING_SCENE) -> None:
    with sentinel_folder() as folder:
        (folder / "odd.toml").write_text(scene)
        (folder / "room.xml").write_bytes(xml)
        if ply is not None:
            (folder / "wall.ply").write_bytes(ply)
        refused(folder, "generate", folder / "odd.toml", "-o", folder / "taken.h5", "--freqs", "1,10", "-q")


def test_no_mitsuba_scene_ends_in_a_traceback() -> None:
    encodings = st.sampled_from(["latin-1", "utf-16", "utf-7", "cp037", "no-such", "\0", ""])
    replaced = st.sampled_from([".", "/", "wall.obj", "wall.glb", "wall.stl", "no/such.ply", "wall.ply/x", "\x01"])
    parts = re.findall(r'"[^"]*"', XML)
    strange = (
        encodings.map(lambda encoding: XML.replace("utf-8", encoding).encode())
        | replaced.map(lambda name: XML.replace("wall.ply", name).encode())
        | st.tuples(st.sampled_from(parts), WORDS | ODD_NUMBERS | ODD_WORDS).map(
            lambda change: XML.replace(change[0], f'"{change[1]}"').encode("utf-8", "replace")
        )
        | st.sampled_from([XML.replace("<string", "<b><string"), "<scene/>", "<a>" * 5000, XML + XML]).map(str.encode)
        | edited(XML).map(lambda text: text.encode("utf-8", "surrogateescape"))
    )
    fuzz(NUM_INPUTS["a Mitsuba XML with one edit"], strange, lambda xml: refused_room(xml, ASCII_PLY.encode()))


def test_no_place_of_a_mitsuba_scene_ends_in_a_traceback() -> None:
    places = WORDS | ODD_WORDS | st.sampled_from([".", "\0", "room.xml/x", "odd.toml", "wall.ply", "~", "\n"])
    scenes = places.map(lambda place: toml_file({**EMPTY_SCENE, "scene": place}))
    fuzz(
        NUM_INPUTS["the place of a Mitsuba XML"],
        scenes,
        lambda scene: refused_room(XML.encode(), ASCII_PLY.encode(), scene),
    )


def test_no_ply_file_ends_in_a_traceback() -> None:
    fuzz(NUM_INPUTS["a PLY file with one edit"], ply_files(), lambda ply: refused_room(XML.encode(), ply))


def refused_scene(name: str, content: bytes) -> None:
    with sentinel_folder() as folder:
        scene = folder / "odd.toml"
        scene.write_text(toml_file({**EMPTY_SCENE, "scene": name, "up": None if name == "rich.xml" else "z"}))
        (folder / name).write_bytes(content)
        (folder / "room.xml").write_text(XML)
        (folder / "wall.ply").write_text(ASCII_PLY)
        refused(folder, "generate", scene, "-o", folder / "taken.h5", "--freqs", "1,10", "-q")


def test_no_mitsuba_scene_of_many_parts_ends_in_a_traceback() -> None:
    texts = edited(RICH_XML).map(lambda text: text.encode("utf-8", "surrogateescape"))
    fuzz(NUM_INPUTS["a Mitsuba XML of many parts"], texts, lambda xml: refused_scene("rich.xml", xml))


def test_no_glb_ends_in_a_traceback() -> None:
    square_m = [[0, 0, 0], [4, 0, 0], [0, 4, 0], [4, 4, 0]]
    nodes: list[dict[str, Any]] = [{"children": [1], "rotation": [0, 0, 0, 1]}, {"mesh": 0, "name": "wall"}]
    content, binary = glb_content(nodes, [(square_m, [0, 1, 2, 2, 1, 3], 4, "itu_concrete")])
    files = spoilt_json(content).map(lambda spoilt: packed_glb(spoilt, binary))
    torn = cut_or_flipped(packed_glb(content, binary))
    fuzz(NUM_INPUTS["a GLB with one part spoilt"], files | files | torn, lambda glb: refused_scene("odd.glb", glb))


def test_no_obj_ends_in_a_traceback() -> None:
    texts = edited(OBJ).map(lambda text: text.encode("utf-8", "surrogateescape"))
    fuzz(NUM_INPUTS["an OBJ with one edit"], texts, lambda obj: refused_scene("odd.obj", obj))


def positions_refused(content: bytes, name: str = "tx.csv") -> None:
    with sentinel_folder() as folder:
        (folder / "small.toml").write_text(toml_file(SMALL_SCENE))
        (folder / name).write_bytes(content)
        words = ["generate", folder / "small.toml", "--tx-positions", folder / name, "-q", "--freqs", "1,10"]
        refused(folder, *words, "-o", folder / "taken.h5")


def test_no_file_of_positions_ends_in_a_traceback() -> None:
    numbers = st.lists(st.lists(ODD_NUMBERS | st.floats().map(str) | WORDS, max_size=4).map(",".join), max_size=4)
    torn = cut_or_flipped(b"x,y,z\n1.0,1.0,1.0\n0.5,0.5,1.5\n")
    texts = numbers.map("\n".join).map(str.encode) | st.binary(max_size=60) | torn
    names = st.sampled_from(["tx.csv", "tx.csv", "tx.csv.gz", "tx.bz2", "tx.xz", "tx.npy"])
    packed = st.tuples(names, texts).flatmap(
        lambda file: st.sampled_from(
            [file[1], gzip.compress(file[1], mtime=0)[:-4], bz2.compress(file[1])[:-4], lzma.compress(file[1])[:-4]]
        ).map(lambda content: (content, file[0]))
    )
    fuzz(NUM_INPUTS["positions of transmitters"], packed, lambda file: positions_refused(*file))


def options_refused(options: dict[str, str]) -> None:
    """`taken.h5` is asked for unless an option says otherwise, so that nothing is ever traced."""
    with sentinel_folder() as folder, contextlib.chdir(folder):
        (folder / "small.toml").write_text(toml_file(SMALL_SCENE))
        given = {"--output": "taken.h5", "--freqs": "1,10", **options}
        words = [f"{name}={text}" for name, text in given.items()]
        refused(folder, "generate", "small.toml", "-q", *words)


def test_no_option_text_of_generate_ends_in_a_traceback() -> None:
    option = st.sampled_from(sorted(GENERATE_OPTIONS)).flatmap(
        lambda name: st.tuples(
            st.just(name),
            st.sampled_from(GENERATE_OPTIONS[name]) | (WORDS | ODD_NUMBERS if name != "--output" else st.nothing()),
        )
    )
    options = st.lists(option, min_size=1, max_size=3).map(dict)
    fuzz(NUM_INPUTS["option texts of generate"], options, options_refused)
