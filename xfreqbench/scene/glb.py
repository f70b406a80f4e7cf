"""Triangles of a GLB file (binary glTF 2.0), with the names of their nodes and materials; nothing else is read.

trimesh reads GLB too, but gives nodes of several materials random names, which the hash of a scene would hold, leaves
out triangle fans without a word, and opens images.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.scene.imported import ImportedShape, StatedMaterial, Triangles, slab_of
from xfreqbench.scene.materials import SceneMaterial
from xfreqbench.types import FloatArray, IntArray, NDArray

_INDEX_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
_FLOAT = 5126
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_WHAT = {1: "an index", 3: "a position", 4: "a rotation"}  # of accessors, by their number of columns
_INSTANCES, _VISIBILITY = "EXT_mesh_gpu_instancing", "KHR_node_visibility"
# say more about nodes and meshes, but move nothing; or have the meshes a second time, compressed
_HARMLESS = (
    *("KHR_audio", "KHR_collision", "KHR_interactivity", "KHR_node_hover", "KHR_node_select", "KHR_physics", "KHR_xmp"),
    *("EXT_mesh_features", "EXT_instance_features", "EXT_structural_metadata", "EXT_mesh_manifold", "CESIUM_primitive"),
    *("AGI_", "FB_", "GODOT_", "MOZ_", "MSFT_lod", "OMI_", "KHR_draco_mesh_compression", "EXT_meshopt_compression"),
)


def read_glb(content: bytes, materials: Mapping[str, SceneMaterial]) -> Iterator[ImportedShape]:
    """A shape for each node of the file's scene and each material of its mesh, in metres, with y upwards.

    `materials` is the scene's own table, by the names that the file uses. Raises `ValueError` for what is not a GLB, or
    holds geometry that is compressed, skinned, in another file or changed by an extension that is not read, and others
    where parts are missing. Hidden nodes are left out, instances and blend shapes are made.
    """
    header, binary = _chunks(content)
    _check_extensions(header)
    for node, matrix in _nodes(header):
        if "mesh" in node:
            yield from _primitives(header, binary, node, matrix, materials)


def _chunks(content: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON of a GLB and its binary buffer."""
    magic, version, length = struct.unpack_from("<4sII", content)
    if magic != b"glTF" or version != 2:
        raise ValueError("it is not binary glTF of version 2")
    if length > len(content):
        raise ValueError(f"it ends after {len(content):,} of {length:,} bytes")
    chunks: dict[bytes, bytes] = {}
    start = 12
    while start + 8 <= length:
        size, kind = struct.unpack_from("<I4s", content, start)
        chunks.setdefault(kind, content[start + 8 : start + 8 + size])
        start += 8 + size
    header = json.loads(chunks[b"JSON"].decode("utf-8"))
    if not isinstance(header, dict):
        raise ValueError("its JSON is not an object")
    return header, chunks.get(b"BIN\0", b"")


def _check_extensions(header: dict[str, Any]) -> None:
    """Raise `ValueError` for extensions that may change the geometry: those of its parts, and required ones."""
    looks, shapes = (
        {name for kind in kinds for part in header.get(kind, []) for name in part.get("extensions", {})}
        for kinds in (("materials", "textures", "images", "samplers"), ("nodes", "meshes", "accessors", "bufferViews"))
    )
    primitives = (primitive for mesh in header.get("meshes", []) for primitive in mesh.get("primitives", []))
    shapes = shapes.union(*(primitive.get("extensions", {}) for primitive in primitives))
    unknown = [name for name in header.get("extensionsRequired", []) if name in shapes or name not in looks]
    unknown += [name for name in sorted(shapes) if not name.startswith(_HARMLESS)]
    handled = "KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "EXT_lights_", _INSTANCES, _VISIBILITY
    refused = dict.fromkeys(name for name in unknown if not name.startswith(handled))
    if refused:
        raise ValueError(
            f"it uses {', '.join(refused)}, which cannot be read; export it without compression and without it"
        )


def _nodes(header: dict[str, Any]) -> Iterator[tuple[dict[str, Any], Float[FloatArray, "4 4"]]]:
    """Nodes of the file's scene that are not hidden, parents first, each with the matrix that takes it to the scene."""
    nodes, scenes = header.get("nodes", []), header.get("scenes", [])
    children = {child for node in nodes for child in node.get("children", [])}
    top = [index for index in range(len(nodes)) if index not in children]
    roots = scenes[header.get("scene", 0)].get("nodes", []) if scenes else top
    waiting = [(index, np.eye(4)) for index in reversed(roots)]
    met = set[int]()
    while waiting:
        index, above = waiting.pop()
        if index in met or index < 0:
            raise ValueError(f"node {index} is in two places of its tree")
        met.add(index)
        is_visible = nodes[index].get("extensions", {}).get(_VISIBILITY, {}).get("visible", True)
        if not isinstance(is_visible, bool):
            raise ValueError(f"node {index} is {is_visible!r} in {_VISIBILITY}; give true or false")
        if not is_visible:
            continue
        matrix = above @ _local_matrix(nodes[index])
        yield nodes[index], matrix
        waiting += [(child, matrix) for child in reversed(nodes[index].get("children", []))]


def _local_matrix(node: dict[str, Any]) -> Float[FloatArray, "4 4"]:
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    if "matrix" in node:
        given: Float[FloatArray, "4 4"] = np.array(node["matrix"], np.float64).reshape(4, 4).T
        if not np.allclose(given[3], matrix[3], atol=1e-6):
            raise ValueError(f"the matrix of node {node.get('name')!r} ends in {given[3]}, but 0, 0, 0, 1 is needed")
        return given
    turn = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
    matrix[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), np.float64)
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def _instances(header: dict[str, Any], binary: bytes, node: dict[str, Any]) -> Iterator[Float[FloatArray, "4 4"]]:
    """Matrices that take the mesh of a node to each of its instances, or the one that leaves it where it is."""
    plain = {_FLOAT: "<f4"}
    kinds = {"TRANSLATION": (plain, 3), "ROTATION": (plain | {5120: "<i1", 5122: "<i2"}, 4), "SCALE": (plain, 3)}
    stated = node.get("extensions", {}).get(_INSTANCES, {}).get("attributes", {})
    given = {name: index for name, index in stated.items() if name in kinds}
    if not given:
        yield np.eye(4)
        return
    values = [_accessor(header, binary, index, *kinds[name]).astype(np.float64) for name, index in given.items()]
    if len(set(map(len, values))) > 1:
        raise ValueError(f"{_INSTANCES} of node {node.get('name')!r} has attributes of different numbers of instances")
    for place in zip(*values, strict=True):
        yield _local_matrix({name.lower(): value for name, value in zip(given, place, strict=True)})


def _primitives(
    header: dict[str, Any],
    binary: bytes,
    node: dict[str, Any],
    matrix: Float[FloatArray, "4 4"],
    materials: Mapping[str, SceneMaterial],
) -> Iterator[ImportedShape]:
    """A shape for each primitive of a node; points and lines are passed over."""
    mesh = header["meshes"][node["mesh"]]
    name = str(node.get("name") or mesh.get("name") or f"mesh {node['mesh']}")
    if "skin" in node:
        raise ValueError(f"node {name!r} is skinned; apply the armature before the export")
    for primitive in mesh["primitives"]:
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            continue
        position_m = _accessor(header, binary, primitive["attributes"]["POSITION"], {_FLOAT: "<f4"}, 3)
        position_m = position_m.astype(np.float64)
        weights = node.get("weights", mesh.get("weights", []))
        for target, weight in zip(primitive.get("targets", []), weights, strict=False):
            if weight and "POSITION" in target:
                shift_m = _accessor(header, binary, target["POSITION"], {_FLOAT: "<f4"}, 3)
                if len(shift_m) != len(position_m):
                    raise ValueError(f"a blend shape of {name!r} moves {len(shift_m)} of {len(position_m)} vertices")
                position_m = position_m + weight * shift_m
        if "indices" in primitive:
            corners = _accessor(header, binary, primitive["indices"], _INDEX_TYPES, 1)[:, 0].astype(np.int64)
        else:
            corners = np.arange(len(position_m))
        if corners.max(initial=0) >= len(position_m):
            raise ValueError(f"node {name!r} has a face with vertex {corners.max()} of {len(position_m)}")
        stated = None
        if "material" in primitive:
            number = primitive["material"]
            stated = StatedMaterial(str(header["materials"][number].get("name") or f"material {number}"))
        where = f"node {name!r}"
        slab, triangles = slab_of(stated, materials, where, name), _triangles(corners, mode)
        for instance in _instances(header, binary, node):
            whole = matrix @ instance
            vertices_m = position_m @ whole[:3, :3].T + whole[:3, 3]
            front = triangles[:, ::-1] if np.linalg.det(whole[:3, :3]) < 0 else triangles  # a mirror turns them round
            yield ImportedShape(name, slab, Triangles(vertices_m, front), where)


def _accessor(header: dict[str, Any], binary: bytes, index: int, types: dict[int, str], columns: int) -> NDArray[Any]:
    """Values (N, columns) of an accessor into the file's own buffer, at most as many as the buffer holds."""
    accessor = header["accessors"][index]
    if "sparse" in accessor or "bufferView" not in accessor:
        named = {*header.get("extensionsUsed", ()), *header.get("extensionsRequired", ())}
        compressions = sorted(name for name in named if "compression" in name)
        fault = f"compressed by {', '.join(compressions)}" if compressions else "sparse or empty"
        raise ValueError(f"accessor {index} is {fault}; export without compression and sparse accessors")
    view = header["bufferViews"][accessor["bufferView"]]
    if view.get("buffer", 0) != 0 or "uri" in header["buffers"][0]:
        raise ValueError("its geometry is in another file; export it as one .glb")
    if accessor["componentType"] not in types or accessor["type"] != {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[columns]:
        raise ValueError(f"accessor {index} is not {_WHAT[columns]} of glTF 2.0")
    dtype = np.dtype(types[accessor["componentType"]])
    stride = view.get("byteStride", columns * dtype.itemsize)
    offset = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    if min(stride - columns * dtype.itemsize, offset, accessor["count"] - 1) < 0:
        raise ValueError(f"accessor {index} has no sound size")
    shape, strides = (accessor["count"], columns), (stride, dtype.itemsize)
    return np.ndarray(shape, dtype, binary, offset, strides)  # raises where the buffer is too small


def _triangles(corners: Int[IntArray, "n"], mode: int) -> Int[IntArray, "K 3"]:
    """Corners of a list, strip or fan of triangles; every second one of a strip is turned round."""
    if mode == _TRIANGLES:
        if len(corners) % 3:
            raise ValueError(f"a list of triangles has {len(corners)} corners, which is not a multiple of 3")
        return corners.reshape(-1, 3)
    if mode == _FAN:
        return np.stack([np.full(max(0, len(corners) - 2), corners[0]), corners[1:-1], corners[2:]], axis=1)
    strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    strip[1::2] = strip[1::2, ::-1]
    return strip
