"""Scenes that are one GLB or OBJ: their materials by name, their axes, and what in them is refused."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from tests.support.mesh_scenes import PLACES, ROOM, TABLE, WOOD, file_shape, glb_bytes, obj_text, scene_of_file
from xfreqbench.errors import SceneError
from xfreqbench.report.drawing.glb import write_glb
from xfreqbench.scene import imported
from xfreqbench.scene.meshes import SurfaceMesh, meshes_sha256, surface_meshes

TRIANGLES, STRIP, FAN = 4, 5, 6
SQUARE_M = [[0, 0, 0], [1, 0, 0], [0, 0, -2], [1, 0, -2]]  # of glTF, where y is up: on the floor, 1 × 2 m
TWO_MATERIALS = (
    '[[material]]\nname = "shell"\nitu = "concrete"\nthickness_m = 0.2\n'
    '[[material]]\nname = "top"\nrelative_permittivity = 3.0\nconductivity_s_m = 0.1\n'
)


def meshes_of(folder: Path, name: str, content: bytes | str, toml: str = "") -> list[SurfaceMesh]:
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return surface_meshes(scene_of_file(folder, name, toml))


def bounds_m(mesh: SurfaceMesh) -> np.ndarray:
    return np.array([mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)])


def two_materials(y_up: bool) -> str:
    turn = trimesh.transformations.rotation_matrix(-np.pi / 2 if y_up else 0, [1, 0, 0])
    room, table = (mesh.copy().apply_transform(turn) for mesh in (ROOM, TABLE))
    return "mtllib none.mtl\n" + obj_text(room, "room", "shell") + obj_text(table, "table", "top", first=9)


def test_an_obj_has_z_upwards_unless_the_scene_says_y(tmp_path: Path) -> None:
    for toml, y_up in ((TWO_MATERIALS, False), ('up = "y"\n' + TWO_MATERIALS, True)):
        room, table = meshes_of(tmp_path, "room.obj", two_materials(y_up), toml)
        np.testing.assert_allclose(bounds_m(room), ROOM.bounds, atol=1e-12)
        np.testing.assert_allclose(bounds_m(table), TABLE.bounds, atol=1e-12)
        assert (room.name, room.material, room.thickness_m) == ("room", "concrete", 0.2)
        assert (str(table.material), table.thickness_m) == ("top", 0.1)


def test_a_glb_has_y_upwards_unless_the_scene_says_z(tmp_path: Path) -> None:
    mesh = SurfaceMesh("table", "wood", 0.1, np.array(TABLE.vertices), np.array(TABLE.faces, np.int64))
    write_glb([mesh], {}, {}, tmp_path / "ours.glb")  # as our own views are written
    exported = trimesh.Scene()
    exported.add_geometry(ROOM.copy(), node_name="room")
    (tmp_path / "upright.glb").write_bytes(exported.export(file_type="glb"))
    named = '[[material]]\nname = "material 0"\nitu = "wood"\n'
    (table,) = surface_meshes(scene_of_file(tmp_path, "ours.glb", named))
    np.testing.assert_allclose(bounds_m(table), TABLE.bounds, atol=1e-6)  # float32
    with pytest.raises(SceneError, match="without a material"):
        surface_meshes(scene_of_file(tmp_path, "upright.glb", 'up = "z"\n'))


def test_a_room_that_lies_on_its_side_is_noticed(tmp_path: Path) -> None:
    """The receiver would stand outside of it, and inside if the other axis were up."""
    lying = two_materials(y_up=True)
    with pytest.raises(SceneError, match=r"read with z upwards.* inside if y were up.* up = 'y'"):
        meshes_of(tmp_path, "room.obj", lying, TWO_MATERIALS)
    assert len(meshes_of(tmp_path, "room.obj", lying, 'up = "z"\n' + TWO_MATERIALS)) == 2  # it was said
    corners = np.arange(len(ROOM.vertices))[ROOM.faces.ravel()]
    content = glb_bytes([{"mesh": 0}], [(ROOM.vertices, corners, TRIANGLES, "itu_wood")])
    with pytest.raises(SceneError, match=r"read with y upwards.* inside if z were up"):
        meshes_of(tmp_path, "room.glb", content)


def test_nodes_of_a_glb_stand_where_their_parents_put_them(tmp_path: Path) -> None:
    half = np.sqrt(0.5)
    nodes: list[dict[str, Any]] = [
        {"children": [1, 2], "translation": [10, 0, 0]},
        {"mesh": 0, "name": "list", "scale": [2, 1, 1], "rotation": [0, half, 0, half]},
        {"mesh": 1, "name": "strip", "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5, 0, 1]},
    ]
    flat, strip = (
        (SQUARE_M, [0, 1, 2, 2, 1, 3], TRIANGLES, "itu_wood"),
        (SQUARE_M, [0, 1, 2, 3], STRIP, "mat-itu_metal.002"),
    )
    listed, stripped = meshes_of(tmp_path, "nodes.glb", glb_bytes(nodes, [flat, strip]))
    assert [(mesh.name, mesh.material) for mesh in (listed, stripped)] == [("list", "wood"), ("strip", "metal")]
    # scaled to 2 × 2 m, turned by 90° about glTF's y, which is z here, and moved by 10 m
    np.testing.assert_allclose(bounds_m(listed), [[8, 0, 0], [10, 2, 0]], atol=1e-6)
    np.testing.assert_allclose(bounds_m(stripped), [[10, 0, 5], [11, 2, 5]], atol=1e-6)
    area_m2 = [trimesh.Trimesh(mesh.vertices_m, mesh.triangles).area for mesh in (listed, stripped)]
    np.testing.assert_allclose(area_m2, [4, 2])


def test_objects_without_a_material_are_named_in_the_table(tmp_path: Path) -> None:
    content = glb_bytes([{"mesh": 0, "name": "Cube"}], [(SQUARE_M, [0, 1, 2], TRIANGLES, "")])
    (mesh,) = meshes_of(tmp_path, "cube.glb", content, '[[material]]\nname = "Cube"\nitu = "brick"\n')
    assert mesh.material == "brick"
    with pytest.raises(SceneError, match=r"without a material.*name = 'Cube'"):
        meshes_of(tmp_path, "cube.glb", content)


def test_without_a_scene_every_node_without_a_parent_counts(tmp_path: Path) -> None:
    nodes: list[dict[str, Any]] = [{"mesh": 0}, {"children": [0]}]
    content = glb_bytes(nodes, [(SQUARE_M, [0, 1, 2], TRIANGLES, "itu_wood")], {"scenes": []})
    assert len(meshes_of(tmp_path, "roots.glb", content)) == 1


def test_a_strip_and_a_fan_are_the_triangles_that_gltf_means(tmp_path: Path) -> None:
    ring = [[0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1]]
    for mode, vertices in ((STRIP, SQUARE_M), (FAN, ring)):
        (mesh,) = meshes_of(tmp_path, "strip.glb", glb_bytes([{"mesh": 0}], [(vertices, range(4), mode, "itu_wood")]))
        normals = np.cross(*np.moveaxis(np.diff(mesh.corners_m, axis=1), 1, 0))
        assert len(normals) == 2
        assert (normals[:, 2] > 0).all()  # both face upwards


def test_the_same_glb_has_the_same_hash_each_time(tmp_path: Path) -> None:
    content = glb_bytes([{"mesh": 0, "name": "a"}], [(SQUARE_M, [0, 1, 2], TRIANGLES, "itu_wood")])
    first, second = (meshes_sha256(meshes_of(tmp_path, "same.glb", content)) for _ in range(2))
    assert first == second


def spoilt_glb(change: dict[str, Any]) -> bytes:
    return glb_bytes([{"mesh": 0}], [(SQUARE_M, [0, 1, 2], TRIANGLES, "itu_wood")], change)


ACCESSOR = {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}
VIEW = {"buffer": 0, "byteLength": 48}
INDEX = {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "export it without compression"),
        ({"buffers": [{"uri": "../other.bin", "byteLength": 9}]}, "geometry is in another file"),
        ({"nodes": [{"mesh": 0, "skin": 0}]}, "skinned"),
        ({"nodes": [{"children": [0]}]}, "stands in two places"),
        ({"nodes": [{"children": [1, 1]}, {"mesh": 0}]}, "stands in two places"),
        ({"nodes": [{"mesh": 7}]}, "cannot be read"),
        ({"accessors": [ACCESSOR | {"count": 10**9}, INDEX]}, "cannot be read"),
        ({"accessors": [ACCESSOR | {"count": -1}, INDEX]}, "no sound size"),
        ({"accessors": [ACCESSOR | {"type": "VEC2"}, INDEX]}, "no position"),
        ({"accessors": [{"componentType": 5126, "count": 10**12, "type": "VEC3"}, INDEX]}, "sparse or empty"),
        ({"bufferViews": [VIEW | {"byteStride": 0}, VIEW]}, "sound size"),
        ({"bufferViews": [VIEW | {"byteOffset": 10**9}, VIEW]}, "cannot be read"),
        ({"accessors": [ACCESSOR | {"count": 2}, INDEX]}, "vertex 2 of 2"),
        ({"materials": []}, "cannot be read"),
        ({"meshes": [{"primitives": [{"attributes": {}}]}]}, "it lacks 'POSITION'"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]}]}, "holds no triangles"),
        ({"materials": [{"name": "Wood"}]}, r"node 'mesh 0': material 'Wood' is no ITU material"),
    ],
)  # fmt: skip
def test_a_glb_that_is_not_sound_is_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        meshes_of(tmp_path, "spoilt.glb", spoilt_glb(change))


def test_many_nodes_of_one_large_mesh_are_refused_before_they_fill_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(imported, "MAX_TRIANGLES", 99_999)
    vertices = np.zeros((1000, 3))
    nodes: list[dict[str, Any]] = [{"mesh": 0, "children": list(range(1, 100))}, *({"mesh": 0} for _ in range(99))]
    with pytest.raises(SceneError, match="more than 99,999 triangles"):
        meshes_of(tmp_path, "many.glb", glb_bytes(nodes, [(vertices, [0, 1, 2], TRIANGLES, "itu_wood")]))


@pytest.mark.parametrize("length", [0, 3, 11, 12, 19, 25, 200])
def test_a_glb_that_is_cut_is_refused(tmp_path: Path, length: int) -> None:
    with pytest.raises(SceneError, match="cannot be read"):
        meshes_of(tmp_path, "cut.glb", spoilt_glb({})[:length])


def test_json_that_nests_without_end_is_refused(tmp_path: Path) -> None:
    text = b"[" * 100_000
    body = struct.pack("<I4s", len(text), b"JSON") + text
    with pytest.raises(SceneError, match="cannot be read"):
        meshes_of(tmp_path, "deep.glb", struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    assert json.loads("[]") == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no triangles"),
        ("v 0 0 0\n", "no triangles"),
        ("v 0 0\n", "line 1 is no vertex"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 3\n", "line 3 is no vertex, or no face"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "faces without a material"),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nusemtl itu_wood\nf 1 2 3\n", "no face of any area|not finite"),
        ("usemtl itu_wood\nv 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no face of any area"),
        ("v 1e400 0 0\nv 1 0 0\nv 0 1 0\nusemtl itu_wood\nf 1 2 3\n", "no face of any area|not finite"),
    ],
)
def test_an_obj_that_is_not_sound_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        meshes_of(tmp_path, "odd.obj", text)


def test_faces_of_an_obj_may_have_many_corners_and_count_backwards(tmp_path: Path) -> None:
    text = (
        "\ufeff# from Windows\r\no slab\r\nv 0 0 0\r\nv 1 0 0 1.0\r\nv 1 1 0\r\nv 0 1 0\r\nvt 0 0\r\n"
        "usemtl itu_wood\r\nf -4/1 -3/1 \\\r\n -2/1 -1/1\r\nv 9 9 9\r\ng other\r\nf 1 2 3\r\n"
    )
    slab, other = meshes_of(tmp_path, "slab.obj", text)
    assert (slab.name, other.name) == ("slab", "other")
    assert trimesh.Trimesh(slab.vertices_m, slab.triangles).area == pytest.approx(1)
    assert trimesh.Trimesh(other.vertices_m, other.triangles).area == pytest.approx(0.5)


FORMATS = ["obj", "glb", "ply", "stl"]  # the last two within a Mitsuba XML
HALL = trimesh.creation.box(bounds=[[-10, -10, 0], [10, 10, 8]])
UPRIGHT, Y_UP = np.eye(3), np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def saved(folder: Path, suffix: str, mesh: trimesh.Trimesh, turn: np.ndarray) -> str:
    """Name of a scene's file with a mesh, its vertices multiplied by a matrix."""
    turned, name = trimesh.Trimesh(mesh.vertices @ turn.T, mesh.faces, process=False), f"room.{suffix}"
    if suffix == "obj":
        (folder / name).write_text(obj_text(turned, "room", "itu_wood"))
    elif suffix == "glb":
        content = glb_bytes([{"mesh": 0}], [(turned.vertices, turned.faces.ravel(), TRIANGLES, "itu_wood")])
        (folder / name).write_bytes(content)
    else:
        turned.export(folder / name)
        (folder / "room.xml").write_text(f'<scene version="3.0.0">{WOOD}{file_shape(name)}</scene>')
        return "room.xml"
    return name


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize(("unit", "length_m"), [("m", 1), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254), ("ft", 0.3048)])
def test_a_file_may_have_either_axis_upwards_and_any_unit(
    tmp_path: Path, suffix: str, unit: str, length_m: float
) -> None:
    for up, turn in (("y", Y_UP), ("z", UPRIGHT)):
        name = saved(tmp_path, suffix, ROOM, turn / length_m)
        (room,) = surface_meshes(scene_of_file(tmp_path, name, f'up = "{up}"\nunit = "{unit}"\n'))
        np.testing.assert_allclose(bounds_m(room), ROOM.bounds, atol=1e-5)  # float32


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("mesh", [ROOM, HALL])  # the hall is about the receiver, however it lies
def test_a_room_of_any_format_that_lies_on_its_side_is_noticed(
    tmp_path: Path, suffix: str, mesh: trimesh.Trimesh
) -> None:
    turn, read, right = (UPRIGHT, "y", "z") if suffix == "glb" else (Y_UP, "z", "y")
    scene = scene_of_file(tmp_path, saved(tmp_path, suffix, mesh, turn))
    with pytest.raises(SceneError, match=rf"read with {read} upwards.* if {right} were up. Say which is right"):
        surface_meshes(scene)
    assert surface_meshes(replace(scene, up=read))  # it was said
    assert surface_meshes(scene_of_file(tmp_path, saved(tmp_path, suffix, mesh, Y_UP if suffix == "glb" else UPRIGHT)))


@pytest.mark.parametrize("name", ["room.glb", "room.obj"])
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(SceneError, match=rf"{name} cannot be read: No such file"):
        surface_meshes(scene_of_file(tmp_path, name, places=PLACES))
