"""Sound scenes of every format and strategies that spoil their text."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
from hypothesis import strategies as st

from tests.support.fuzzing.common import ODD_NUMBERS, ODD_WORDS, cut_or_flipped
from tests.support.mesh_scenes import ply_bytes

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
    "transmitters": {"min_m": [0.5, 0.5, 0.5], "max_m": [3.5, 3.5, 1.5], "step_m": [1.0, 1.0, 0.5], "clearance_m": 0.2},
    "surface": [
        {"name": name, "material": material, "thickness_m": thickness_m, "min_m": min_m, "max_m": max_m}
        for name, material, thickness_m, min_m, max_m in (
            ("floor", "concrete", 0.2, [0.0, 0.0, 0.0], [4.0, 4.0, 0.0]),
            ("cabinet", "metal", 0.01, [1.2, 1.2, 0.1], [1.8, 1.8, 1.2]),
        )
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


def edited_bytes(text: str) -> st.SearchStrategy[bytes]:
    return edited(text).map(lambda changed: changed.encode("utf-8", "surrogateescape"))


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
RICH_XML = """<scene version="3.0.0">
  <default name="far" value="2"/>
  <bsdf type="radio-material" id="foam">
    <float name="relative_permittivity" value="1.5"/> <float name="conductivity" value="0.1"/>
    <float name="scattering_coefficient" value="0.3"/> <string name="scattering_pattern" value="directive"/>
    <integer name="alpha_r" value="4"/>
  </bsdf>
  <bsdf type="twosided" id="two"><ref id="foam"/></bsdf>
  <alias id="two" as="alias"/>
  <include filename="room.xml"/>
  <shape type="cube" id="mesh-cube">
    <transform name="to_world">
      <scale value="0.2"/> <rotate z="1" angle="30"/> <translate x="$far"/>
      <matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/>
      <lookat origin="0 0 0" target="0 0 1" up="0 1 0"/>
    </transform>
    <ref id="alias" name="bsdf"/>
  </shape>
  <shape type="sphere" id="mesh-ball">
    <point name="center" x="1" y="1" z="1"/> <float name="radius" value="0.1"/>
    <bsdf type="diffuse" id="mat-itu_metal.001"/>
  </shape>
</scene>
"""
OBJ = """mtllib none.mtl
o wall
v 0 0 0
v 4 0 0
v 4 4 0
v 0 4 0
usemtl itu_concrete
f 1//1 2//1 3//1 4//1
g other
usemtl mat-itu_wood.001
f -4 -3 -2
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


def ply_files() -> st.SearchStrategy[bytes | None]:
    """A PLY file in other bytes or with other counts and types in its header; None for none."""
    texts = st.sampled_from(["vertex 4", "face 2", "float x", "uchar int vertex_indices", "ascii 1.0"])
    numbers = ["vertex 999999999999", "face 999999999", "face 0", "vertex 0", "vertex -1", "vertex 1e9"]
    others = [*numbers, "float", "list", "binary_little_endian 1.0", "double q"]
    headers = st.tuples(texts, st.sampled_from(others)).map(lambda change: ASCII_PLY.replace(*change).encode())
    edits, binary = edited_bytes(ASCII_PLY), ply_bytes(np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0]]), [[0, 1, 2]], True)
    return st.none() | headers | edits | edits | cut_or_flipped(binary) | st.binary(max_size=50)
