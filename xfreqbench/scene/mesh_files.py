"""Triangles from mesh files: PLY, STL and OBJ, and the scenes that are one OBJ or GLB."""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from xfreqbench.errors import SceneError, StorageError
from xfreqbench.scene.glb import read_glb
from xfreqbench.scene.imported import ImportedShape, StatedMaterial, Triangles, bounded, slab_of
from xfreqbench.scene.materials import SceneMaterial
from xfreqbench.scene.polygons import triangulated
from xfreqbench.system.files import read_bytes, system_errors
from xfreqbench.types import FloatArray
from xfreqbench.units import parse_number

MeshKind = Literal["ply", "stl", "obj"]
_PLY_FACES = ("vertex_index", "vertex_indices")


def read_mesh(path: Path, kind: MeshKind) -> Triangles:
    """Triangles of a mesh file, as it states them; faces of more corners are split.

    Raises what reading raises: an `OSError` for a file that cannot be read, and others for what is in it.
    """
    import trimesh

    content = read_bytes(path)
    if kind == "obj":
        parts = [part.triangles for part in _obj_parts(content)]
        first = np.cumsum([0, *(len(part.vertices_m) for part in parts)])[:-1]
        triangles = [part.triangles + number for part, number in zip(parts, first, strict=True)]
        vertices_m = np.concatenate([np.zeros((0, 3)), *(part.vertices_m for part in parts)])
        return Triangles(vertices_m, np.concatenate([np.zeros((0, 3), np.int64), *triangles]))
    if kind == "ply":
        return _read_ply(content)
    return _loaded(trimesh.load_mesh(io.BytesIO(_whole_stl(content)), file_type="stl", process=False))


@contextmanager
def mesh_errors(source: str, path: Path) -> Iterator[None]:
    """Turn any error of reading a mesh file into a `SceneError`, or a `StorageError` of the system.

    `source` says in words which file it is.
    """
    try:
        with system_errors(path), np.errstate(all="ignore"):  # numbers that no float holds are refused later
            yield
    except StorageError:
        raise
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    except Exception as error:  # of a file that may hold anything
        fault = getattr(error, "strerror", None) or error
        if isinstance(error, KeyError):
            fault = f"it lacks {error}"
        elif isinstance(error, TypeError | AttributeError | IndexError):
            fault = f"its parts do not fit together, {error}"
        raise SceneError(f"{source} cannot be read: {fault}.") from error


def _loaded(mesh: Any) -> Triangles:
    found = Triangles.of(mesh)
    if any(array.shape[1:] != (3,) for array in found):
        raise ValueError("it is not a list of triangles")
    return found


def _in_utf8(content: bytes) -> bytes:
    """A text without a byte order mark, and one in UTF-16, which is known by its mark, in UTF-8."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16").encode()
    return content.removeprefix(codecs.BOM_UTF8)


def _in_ascii(text: bytes) -> bytes:
    """A text whose other letters are question marks, so that trimesh asks no further library what they are."""
    return text if text.isascii() else text.decode("ascii", "replace").encode("ascii", "replace")


def _whole_stl(content: bytes) -> bytes:
    """An STL as trimesh understands it: in ASCII without words of the format in names of solids, on which it stumbles.

    Raises `ValueError` if it is cut, which trimesh does not report.
    """
    if len(content) == 84 + 50 * int.from_bytes(content[80:84], "little"):  # a binary one
        return content
    text = _in_ascii(_in_utf8(content))
    text = re.sub(rb"\r\n?", b"\n", text) if b"\r" in text else text
    if not _is_whole(text.lower(), with_normals=True):
        text = re.sub(rb"(?mi)^(\s*(?:end)?solid).*$", rb"\1", text)
        if not _is_whole(text.lower()):
            raise ValueError("it is not an STL, or ends within a solid; export it again")
    return text


def _is_whole(words: bytes, with_normals: bool = False) -> bool:
    """Whether the words of an STL in ASCII are in the numbers that belong together."""
    ends, facets = words.count(b"endsolid"), words.count(b"endfacet")
    counts = [words.count(word) for word in (b"solid", b"facet", b"vertex", b"normal")[: 3 + with_normals]]
    return ends > 0 and counts == [2 * ends, 2 * facets, 3 * facets, facets][: 3 + with_normals]


def _read_ply(content: bytes) -> Triangles:
    """Triangles of a PLY, read by trimesh except for concave faces, and for faces of several sizes in binary."""
    import trimesh

    header, end, body = content.partition(b"end_header")
    content = _in_ascii(header) + end + body
    if b"element face" in header and not any(name.encode() in header for name in _PLY_FACES):
        raise ValueError("its faces have no list vertex_indices; export it again")
    counts = [words[2] for words in map(bytes.split, header.splitlines()) if words[:1] == [b"element"]]
    if b"ascii" in header and sum(map(bool, map(bytes.strip, body.splitlines()))) > sum(map(int, counts)):
        raise ValueError("it is longer than its header says")
    try:  # from memory: no texture is searched
        mesh = trimesh.load_mesh(io.BytesIO(content), file_type="ply", process=False, skip_materials=True)
        raw = mesh.metadata.get("_ply_raw", {})  # none where there are no faces
        rows = raw.get("face", {}).get("data")
        names = list(rows if isinstance(rows, dict) else getattr(rows, "dtype", np.dtype([])).names or ())
        corners: Any = next((rows[name] for name in names if name in _PLY_FACES or len(names) == 1), np.zeros((0, 3)))
        if corners.dtype.names:  # binary, each row read as if it were as long as the first
            sizes, corners = corners["f0"], corners["f1"]
            if (sizes != sizes[0]).any():
                raise ValueError("unexpected length")
        elif len(corners) < raw.get("face", {}).get("length", 0) or min(map(len, corners[-1:]), default=3) < 3:
            raise ValueError("it ends within its faces; export it again")
    except ValueError as error:
        if "unexpected length" not in str(error):  # as trimesh says of one that is cut, or of faces of several sizes
            raise
        faces, vertices_m = _binary_polygons(content)
        return Triangles(vertices_m, triangulated(vertices_m, faces)[0])
    if corners.shape[1:] != (3,):
        columns = [np.asarray(raw["vertex"]["data"][axis], np.float64).reshape(-1) for axis in "xyz"]
        vertices_m = np.stack(columns, axis=1)
        triangles, are_fans = triangulated(vertices_m, [face.tolist() for face in corners])
        if not are_fans:
            return Triangles(vertices_m, triangles)
    return _loaded(mesh)


def _binary_polygons(content: bytes) -> tuple[list[list[int]], Float[FloatArray, "V 3"]]:
    """Faces and vertices of a binary PLY whose faces differ in size; raises `ValueError` if it is cut."""
    header, _, body = content.partition(b"end_header")
    start = body.index(b"\n") + 1
    order: Literal["<", ">"] = ">" if b"binary_big_endian" in header else "<"
    types = {"char": "i1", "short": "i2", "int": "i4", "uchar": "u1", "ushort": "u2", "uint": "u4", "float": "f4"}
    elements = list[tuple[str, int, list[tuple[Any, ...]]]]()
    for words in map(str.split, header.decode("ascii", "replace").splitlines()):
        if words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            kinds = [np.dtype(types.get(word, word)).newbyteorder(order) for word in words[1:-1] if word != "list"]
            elements[-1][2].append((words[-1], *kinds))
    faces, vertices_m = list[list[int]](), np.zeros((0, 3))
    for name, count, properties in elements:
        if all(len(kinds) == 1 for _, *kinds in properties):
            rows = np.frombuffer(body, np.dtype(properties), count, start)
            start += rows.nbytes
            if name == "vertex":
                vertices_m = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)
            continue
        for _ in range(count):
            for label, *kinds in properties:
                number = 1
                if len(kinds) == 2:
                    number = int(np.frombuffer(body, kinds[0], 1, start)[0])
                    start += kinds[0].itemsize
                values = np.frombuffer(body, kinds[-1], number, start)
                start += values.nbytes
                if name == "face" and label in _PLY_FACES:
                    faces.append(values.tolist())
    if start != len(body):
        raise ValueError("it is longer than its header says")
    return faces, vertices_m


def read_scene(path: Path, materials: Mapping[str, SceneMaterial]) -> list[ImportedShape]:
    """Shapes of a GLB or OBJ, one for each object and material, as the file has them.

    `materials` is the scene's own table, by the names that the file uses. Raises `SceneError` for a file that cannot
    be read.
    """
    with mesh_errors(f"The scene {path}", path):
        content, is_obj = read_bytes(path), path.suffix.lower() == ".obj"
        read = (p.shape(materials) for p in _obj_parts(content)) if is_obj else read_glb(content, materials)
        shapes = list(bounded(read, path))
    if not shapes:
        raise SceneError(f"The scene {path} has no triangles. Export it with its meshes.")
    return shapes


@dataclass
class _ObjPart:
    """Faces of one object and material of an OBJ, as corners into the vertices of the whole file."""

    name: str
    material: str
    vertices_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    faces: list[list[int]] = field(default_factory=list)

    @property
    def triangles(self) -> Triangles:
        used, triangles = np.unique(triangulated(self.vertices_m, self.faces)[0], return_inverse=True)
        return Triangles(self.vertices_m[used], triangles.reshape(-1, 3).astype(np.int64))

    def shape(self, materials: Mapping[str, SceneMaterial]) -> ImportedShape:
        """The part in the scene; raises `ValueError` if the name of its material is not UTF-8."""
        name, material = (
            word.encode(errors="surrogateescape").decode(errors="replace") for word in (self.name, self.material)
        )
        if material != self.material or (not material and name != self.name):
            raise ValueError(
                f"the name {material or name!r} of a material is not UTF-8; save the file as UTF-8, as with "
                "iconv -f GBK -t UTF-8, or give names in ASCII"
            )
        source = f"object {name!r}"
        slab = slab_of(StatedMaterial(material) if material else None, materials, source, name)
        return ImportedShape(name, slab, self.triangles, source)


def _obj_parts(content: bytes) -> list[_ObjPart]:
    """Parts of a Wavefront OBJ, one for each object (`o`, otherwise `g`) and material (`usemtl`), in their order.

    Negative indices count back from the latest vertex. Library files, normals and textures are not read. Raises
    `ValueError` with the line. Names that are not UTF-8 have surrogates, so that none is taken for another.
    """
    parts: dict[tuple[str, str], _ObjPart] = {}
    vertices: list[tuple[float, float, float]] = []
    name, material = "unnamed", ""
    for number, line in _logical_lines(_in_utf8(content).decode("utf-8", "surrogateescape")):
        keyword, _, rest = line.partition(" ")
        # free-form surfaces, an old word for faces, and other files
        if keyword in ("surf", "fo", "call"):
            raise ValueError(f"line {number} is {keyword!r}, which cannot be read; export meshes as faces (f)")
        try:
            if keyword == "v":
                x, y, z = (parse_number(word) for word in rest.split()[:3])
                vertices.append((x, y, z))
            elif keyword == "f":
                part = parts.get((name, material)) or parts.setdefault((name, material), _ObjPart(name, material))
                numbers = [parse_number(word.partition("/")[0], int) for word in rest.split()]
                corners = [index - 1 if index > 0 else len(vertices) + index for index in numbers]
                if len(corners) < 3 or not 0 <= min(corners) <= max(corners) < len(vertices):  # 0 is none either
                    raise ValueError("it is cut, or there is no such vertex")
                part.faces.append(corners)
        except ValueError as error:
            raise ValueError(
                f"line {number} is not a vertex, nor a face of three or more vertices before it"
            ) from error
        if keyword in ("o", "g"):
            name = rest.strip() or "unnamed"
        elif keyword == "usemtl":
            material = rest.strip()
    positions_m = np.array(vertices, np.float64).reshape(-1, 3)
    for part in parts.values():
        part.vertices_m = positions_m
    return list(parts.values())


def _logical_lines(text: str) -> Iterator[tuple[int, str]]:
    joined = re.sub(r"(?<![\udc80-\udcff])\\\r?\n", " ", text)  # letters of Shift JIS and GBK may end in a backslash
    for number, line in enumerate(joined.splitlines(), start=1):
        words = re.sub(r"\s+", " ", re.sub(r"(^|\s)#.*", "", line)).strip()  # names may have a # in them
        if words:
            yield number, words
