"""Triangles from mesh files: PLY, STL and OBJ, and the scenes that are one OBJ or GLB."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh

from xfreqbench.errors import SceneError
from xfreqbench.scene.glb import read_glb
from xfreqbench.scene.imported import ImportedShape, StatedMaterial, Triangles, bounded, slab_of
from xfreqbench.scene.materials import SceneMaterial
from xfreqbench.system.files import read_bytes
from xfreqbench.types import FloatArray

MeshKind = Literal["ply", "stl", "obj"]
SCENE_SUFFIXES = (".glb", ".obj")  # of files that are a whole scene


def read_mesh(path: Path, kind: MeshKind) -> Triangles:
    """Triangles of a mesh file, as it states them; faces of more corners are split.

    Raises whatever the reading raises: an `OSError` for a file that cannot be read, and others for what is in it.
    """
    if kind == "obj":
        return _merged([part.triangles for part in _obj_parts(_text(path))])
    with np.errstate(all="ignore"):  # of numbers that no float holds, which are refused later
        content = io.BytesIO(read_bytes(path))  # not the path, beside which textures would be looked for
        loaded = trimesh.load_mesh(content, file_type=kind, process=False, skip_materials=True)
    vertices_m, triangles = np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64)
    if vertices_m.shape[1:] != (3,) or triangles.shape[1:] != (3,):
        raise ValueError("it is no list of triangles")
    return Triangles(vertices_m, triangles)


def _text(path: Path) -> str:
    """Text of an OBJ; what is no UTF-8, in comments and names, is replaced."""
    return read_bytes(path).decode("utf-8-sig", "replace")


def _merged(parts: Sequence[Triangles]) -> Triangles:
    first = np.cumsum([0, *(len(part.vertices_m) for part in parts)])[:-1]
    return Triangles(
        np.concatenate([np.zeros((0, 3)), *(part.vertices_m for part in parts)]),
        np.concatenate(
            [np.zeros((0, 3), np.int64), *(part.triangles + number for part, number in zip(parts, first, strict=True))]
        ),
    )


def read_scene(path: Path, materials: Mapping[str, SceneMaterial]) -> list[ImportedShape]:
    """Shapes of a GLB or OBJ, one for each object and material, as the file has them.

    `materials` is the scene's own table, by the names that the file uses. Raises `SceneError` for a file that cannot
    be read.
    """
    try:
        if path.suffix.lower() == ".obj":
            parts = _obj_parts(_text(path))
            read = iter([part.shape(materials) for part in parts])
        else:
            read = read_glb(read_bytes(path), materials)
        shapes = list(bounded(read, path))
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    except Exception as error:  # of a file that may hold anything
        fault = getattr(error, "strerror", None) or error
        if isinstance(error, KeyError):
            fault = f"it lacks {error}"
        elif isinstance(error, TypeError | AttributeError | IndexError):
            fault = f"its parts do not fit together, {error}"
        raise SceneError(f"The scene {path} cannot be read: {fault}.") from error
    if not shapes:
        raise SceneError(f"The scene {path} holds no triangles. Export it with its meshes.")
    return shapes


@dataclass
class _ObjPart:
    """Faces of one object and material of an OBJ, as corners into the vertices of the whole file."""

    name: str
    material: str
    vertices_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    corners: list[tuple[int, int, int]] = field(default_factory=list)

    @property
    def triangles(self) -> Triangles:
        used, triangles = np.unique(np.array(self.corners, np.int64).reshape(-1, 3), return_inverse=True)
        return Triangles(self.vertices_m[used], triangles.reshape(-1, 3).astype(np.int64))

    def shape(self, materials: Mapping[str, SceneMaterial]) -> ImportedShape:
        stated = StatedMaterial(self.material) if self.material else None
        source = f"object {self.name!r}"
        return ImportedShape(self.name, slab_of(stated, materials, source, self.name), self.triangles, source)


def _obj_parts(text: str) -> list[_ObjPart]:
    """Parts of a Wavefront OBJ, one for each object (`o`, or else `g`) and material (`usemtl`), in their order.

    A face of n corners is a fan of n − 2 triangles. Negative indices count back from the latest vertex. Library
    files, normals and textures are not read. Raises `ValueError` with the line.
    """
    parts: dict[tuple[str, str], _ObjPart] = {}
    vertices: list[tuple[float, float, float]] = []
    name, material = "unnamed", ""
    for number, line in _logical_lines(text):
        keyword, _, rest = line.partition(" ")
        try:
            if keyword == "v":
                x, y, z = map(float, rest.split()[:3])
                vertices.append((x, y, z))
            elif keyword == "f":
                part = parts.setdefault((name, material), _ObjPart(name, material))
                corners = [_obj_index(word, len(vertices)) for word in rest.split()]
                part.corners += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
        except ValueError as error:
            raise ValueError(f"line {number} is no vertex, or no face of the vertices before it") from error
        if keyword in ("o", "g"):
            name = rest.strip() or "unnamed"
        elif keyword == "usemtl":
            material = rest.strip()
    positions_m = np.array(vertices, np.float64).reshape(-1, 3)
    for part in parts.values():
        part.vertices_m = positions_m
    return list(parts.values())


def _logical_lines(text: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(re.sub(r"\\\r?\n", " ", text).splitlines(), start=1):
        words = re.sub(r"\s+", " ", line.partition("#")[0]).strip()
        if words:
            yield number, words


def _obj_index(word: str, num_vertices: int) -> int:
    index = int(word.partition("/")[0])
    counted = index - 1 if index > 0 else num_vertices + index
    if index == 0 or not 0 <= counted < num_vertices:
        raise ValueError("no such vertex")
    return counted
