"""Hundreds of scenes that nobody should give, in every format: none ends in a traceback or costs a file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import strategies as st

from tests.support.fuzzing.common import (
    ODD_NUMBERS,
    ODD_WORDS,
    WORDS,
    check_clean,
    cut_or_flipped,
    fuzz,
    sentinel_folder,
    spoilt_json,
    untouched,
    xfreqbench,
)
from tests.support.fuzzing.scenes import (
    ASCII_PLY,
    EMPTY_SCENE,
    OBJ,
    REFERRING_SCENE,
    RICH_XML,
    SMALL_SCENE,
    XML,
    edited,
    edited_bytes,
    ply_files,
    toml_file,
)
from tests.support.mesh_scenes import glb_content, packed_glb
from tests.support.places import ROOT

pytestmark = pytest.mark.slow


def generates_nothing(changed: Mapping[str, bytes | None]) -> None:
    """A scene ends in a refusal of the scene, or in one of the output that is there already."""
    sound = {"odd.toml": REFERRING_SCENE, "room.xml": XML, "wall.ply": ASCII_PLY}
    with sentinel_folder() as folder:
        for name, content in ({name: text.encode() for name, text in sound.items()} | changed).items():
            if content is not None:
                (folder / name).write_bytes(content)
        with untouched(folder):
            outcome = xfreqbench("generate", folder / "odd.toml", "-o", folder / "taken.h5", "--freqs", "1,10", "-q")
        assert outcome.code != 0, outcome
        check_clean(outcome)


def texts() -> st.SearchStrategy[str]:
    """Any text, a sound key with an odd value, a small scene with a part spoilt, a shipped one with one edit."""
    keys = st.sampled_from(["name", "[receiver]\nposition_m", "[[surface]]\nname", "scene"])
    deep = ["1" * 5000, "[" * 3000, "[" * 3000 + "]" * 3000, "{a=" * 3000, "0x" + "f" * 6000]
    values = st.sampled_from([*deep, "1979-02-30", '"\\ud800"', '"\\u0000"', '"""']) | ODD_NUMBERS
    shipped = st.sampled_from([path.read_text() for path in sorted((ROOT / "scenes").glob("*.toml"))])
    spoilt = spoilt_json(SMALL_SCENE).map(toml_file)
    return st.text(max_size=60) | st.tuples(keys, values).map(" = ".join) | spoilt | spoilt | shipped.flatmap(edited)


def mitsuba() -> st.SearchStrategy[bytes]:
    encodings = st.sampled_from(["latin-1", "utf-16", "utf-7", "cp037", "no-such", "\0", ""])
    replaced = st.sampled_from([".", "/", "wall.obj", "wall.glb", "wall.stl", "no/such.ply", "wall.ply/x", "\x01"])
    strange = st.sampled_from([XML.replace("<string", "<b><string"), "<scene/>", "<a>" * 5000, XML + XML])
    parts = st.tuples(st.sampled_from(re.findall(r'"[^"]*"', XML)), WORDS | ODD_NUMBERS | ODD_WORDS)
    return (
        encodings.map(lambda encoding: XML.replace("utf-8", encoding).encode())
        | replaced.map(lambda name: XML.replace("wall.ply", name).encode())
        | parts.map(lambda change: XML.replace(change[0], f'"{change[1]}"').encode("utf-8", "replace"))
        | strange.map(str.encode)
        | edited_bytes(XML)
    )


def glb() -> st.SearchStrategy[bytes]:
    square_m = [[0, 0, 0], [4, 0, 0], [0, 4, 0], [4, 4, 0]]
    nodes: list[dict[str, Any]] = [{"children": [1], "rotation": [0, 0, 0, 1]}, {"mesh": 0, "name": "wall"}]
    content, binary = glb_content(nodes, [(square_m, [0, 1, 2, 2, 1, 3], 4, "itu_concrete")])
    files = spoilt_json(content).map(lambda spoilt: packed_glb(spoilt, binary))
    return files | files | cut_or_flipped(packed_glb(content, binary))


def naming(name: str, contents: st.SearchStrategy[bytes]) -> st.SearchStrategy[dict[str, bytes]]:
    """Scenes of which another file than `room.xml` is the mesh."""
    scene = toml_file({**EMPTY_SCENE, "scene": name, "up": None if name == "rich.xml" else "z"}).encode()
    return contents.map(lambda content: {"odd.toml": scene, name: content})


PLACES = WORDS | ODD_WORDS | st.sampled_from([".", "\0", "room.xml/x", "odd.toml", "wall.ply", "~", "\n"])
CHANGES = {  # by what is changed: the files, and how many are tried
    "text": (texts().map(lambda text: {"odd.toml": text.encode("utf-8", "surrogateescape")}), 100),
    "Mitsuba XML": (mitsuba().map(lambda xml: {"room.xml": xml}), 80),
    "place": (PLACES.map(lambda place: {"odd.toml": toml_file({**EMPTY_SCENE, "scene": place}).encode()}), 35),
    "PLY": (ply_files().map(lambda ply: {"wall.ply": ply}), 80),
    "Mitsuba XML of many parts": (naming("rich.xml", edited_bytes(RICH_XML)), 35),
    "GLB": (naming("odd.glb", glb()), 40),
    "OBJ": (naming("odd.obj", edited_bytes(OBJ)), 30),
}


@pytest.mark.parametrize("changed", CHANGES)
def test_no_scene_ends_in_a_traceback(changed: str) -> None:
    scenes, number = CHANGES[changed]
    fuzz(number, scenes, generates_nothing)
