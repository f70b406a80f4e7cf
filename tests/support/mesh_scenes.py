"""Mesh files as people bring them, and scenes that refer to them: a room of 5 × 4 × 3 m with a table in it."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.model import Scene, parse_scene

ROOM = trimesh.creation.box(bounds=[[0, 0, 0], [5, 4, 3]])
TABLE = trimesh.creation.box(bounds=[[2, 1, 0.1], [3, 2, 0.7]])
PLACES = """
[receiver]
position_m = [1.0, 1.0, 1.5]
boresight = [0.0, 0.0, 1.0]
[transmitters]
min_m = [3.5, 3.0, 1.5]
max_m = [4.0, 3.0, 1.5]
step_m = [0.5, 0.5, 0.5]
clearance_m = 0.1
"""
WOOD = '<bsdf type="itu-radio-material" id="M"><string name="type" value="wood"/></bsdf>'


def write_meshes(folder: Path) -> None:
    """Table and room as PLY, OBJ and STL in `meshes`."""
    (folder / "meshes").mkdir(exist_ok=True)
    for kind in ("ply", "obj", "stl"):
        TABLE.export(folder / "meshes" / f"table.{kind}")
        ROOM.export(folder / "meshes" / f"room.{kind}")


def bounds_m(mesh: SurfaceMesh) -> np.ndarray:
    """The lowest and the highest corner of the box about a mesh, (2, 3)."""
    return np.array([mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)])


def shape(kind: str, inside: str = "", material: str = '<ref id="M" name="bsdf"/>', ident: str = "s") -> str:
    return f'<shape type="{kind}" id="mesh-{ident}">{material}{inside}</shape>'


def file_shape(filename: str, inside: str = "", material: str = '<ref id="M" name="bsdf"/>') -> str:
    kind = filename.rpartition(".")[2]
    return shape(kind, f'<string name="filename" value="{filename}"/>{inside}', material)


def to_world(*steps: str) -> str:
    return f'<transform name="to_world">{"".join(steps)}</transform>'


def scene_with(folder: Path, *elements: str, toml: str = "", places: str = PLACES) -> Scene:
    """A scene whose Mitsuba XML holds the elements."""
    (folder / "scene.xml").write_text(f'<scene version="3.0.0">{"".join(elements)}</scene>')
    return scene_of_file(folder, "scene.xml", toml, places)


def scene_of_file(folder: Path, name: str, toml: str = "", places: str = PLACES) -> Scene:
    top, _, tables = toml.partition("[[")
    return parse_scene(f'name = "test"\nscene = "{name}"\n{top}\n{"[[" if tables else ""}{tables}{places}', folder)


def obj_text(mesh: trimesh.Trimesh, name: str, material: str) -> str:
    """An OBJ of one mesh and material."""
    corners = "\n".join(f"v {x} {y} {z}" for x, y, z in mesh.vertices)
    faces = "\n".join("f " + " ".join(f"{index + 1}//1" for index in face) for face in mesh.faces)
    return f"o {name}\n{corners}\nvn 0 0 1\nusemtl {material}\n{faces}\n"


def ply_bytes(vertices_m: np.ndarray, faces: list[list[int]], binary: bool) -> bytes:
    """A PLY of faces of any number of corners."""
    head = f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\nelement vertex {len(vertices_m)}\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    if binary:
        rows = (bytes([len(face)]) + np.array(face, "<i4").tobytes() for face in faces)
        return head.encode() + vertices_m.astype("<f4").tobytes() + b"".join(rows)
    rows = (" ".join(map(str, [len(face), *face])).encode() for face in faces)
    points = (" ".join(map(str, vertex)).encode() for vertex in vertices_m)
    return head.encode() + b"\n".join([*points, *rows]) + b"\n"


def glb_content(nodes: list[dict[str, Any]], meshes: list[tuple[Any, Any, int, str]]) -> tuple[dict[str, Any], bytes]:
    """JSON and buffer of a GLB of meshes, each given by its vertices, its corner indices, its mode and its material."""
    binary, views, accessors, materials, told = b"", list[Any](), list[Any](), list[Any](), list[Any]()
    for vertices, corners, mode, material in meshes:
        for values, kind, form in (
            (np.asarray(vertices, "<f4"), 5126, "VEC3"),
            (np.asarray(corners, "<u4"), 5125, "SCALAR"),
        ):
            accessors.append({"bufferView": len(views), "componentType": kind, "count": len(values), "type": form})
            views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes})
            binary += values.tobytes()
        primitive = {"attributes": {"POSITION": len(accessors) - 2}, "indices": len(accessors) - 1, "mode": mode}
        if material:
            primitive["material"] = len(materials)
            materials.append({"name": material})
        told.append({"primitives": [primitive]})
    content = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes, "meshes": told,
        "materials": materials, "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(binary)}],
    }  # fmt: skip
    return content, binary


def packed_glb(content: Any, binary: bytes) -> bytes:
    text = json.dumps(content).encode("utf-8", "surrogatepass")
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def glb_bytes(
    nodes: list[dict[str, Any]], meshes: list[tuple[Any, Any, int, str]], header: dict[str, Any] | None = None
) -> bytes:
    """A GLB of meshes, as `glb_content` takes them; what `header` holds replaces parts of its JSON."""
    content, binary = glb_content(nodes, meshes)
    return packed_glb({**content, **(header or {})}, binary)
