"""Scenes that are one GLB or OBJ: their materials by name, their axes, and what in them is refused."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from xfreqbench.examples.make_blender_room import PATH, room

from tests.support.mesh_scenes import (
    ROOM,
    TABLE,
    WOOD,
    bounds_m,
    file_shape,
    glb_bytes,
    glb_content,
    obj_text,
    packed_glb,
    ply_bytes,
    scene_of_file,
)
from xfreqbench.errors import SceneError
from xfreqbench.scene import imported
from xfreqbench.scene.facets import planar_facets
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import PRESETS
from xfreqbench.scene.mesh_files import read_mesh
from xfreqbench.scene.meshes import SurfaceMesh, surface_meshes

TRIANGLES, STRIP, FAN = 4, 5, 6
SQUARE_M = [[0, 0, 0], [1, 0, 0], [0, 0, -2], [1, 0, -2]]  # of glTF, where y is up: on the floor, 1 × 2 m


def meshes_of(folder: Path, name: str, content: bytes | str, toml: str = "") -> list[SurfaceMesh]:
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return surface_meshes(scene_of_file(folder, name, toml))


def test_the_room_from_blender_is_what_its_script_makes(tmp_path: Path) -> None:
    """Its planes are turned and scaled, its table hangs from an empty object, and none of it is aslant."""
    content = PATH.read_bytes()
    assert content == room() and len(content) < 60_000
    toml = '[[material]]\nname = "Oak"\nitu = "wood"\n[[material]]\nname = "Plastic.001"\nitu = "wood"\n'
    meshes = {mesh.name: mesh for mesh in meshes_of(tmp_path, "room.glb", content, toml)}
    whole_m = np.concatenate([mesh.vertices_m for mesh in meshes.values()])
    np.testing.assert_allclose([whole_m.min(0), whole_m.max(0)], [[0, 0, 0], [5, 4, 2.6]], atol=1e-6)
    assert meshes["Window"].material == "glass" and meshes["Cabinet"].material == "metal"
    np.testing.assert_allclose(bounds_m(meshes["Window"]), [[1.5, 4, 0.9], [3.5, 4, 2.1]], atol=1e-6)
    np.testing.assert_allclose(meshes["Table leg.002"].vertices_m.mean(0)[2], 0.36, atol=1e-6)
    area_m2 = trimesh.Trimesh(meshes["Wall with window"].vertices_m, meshes["Wall with window"].triangles).area
    assert area_m2 == pytest.approx(5 * 2.6 - 2 * 1.2)


def test_nodes_of_a_glb_stand_where_their_parents_put_them(tmp_path: Path) -> None:
    half = np.sqrt(0.5)
    nodes: list[dict[str, Any]] = [
        {"children": [1, 2], "translation": [10, 0, 0]},
        {"mesh": 0, "name": "list", "scale": [2, 1, 1], "rotation": [0, half, 0, half]},
        {"mesh": 1, "name": "strip", "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5, 0, 1]},
    ]
    flat = SQUARE_M, [0, 1, 2, 2, 1, 3], TRIANGLES, "Wood"
    strip = SQUARE_M, [0, 1, 2, 3], STRIP, "mat-itu_metal.002"
    listed, stripped = meshes_of(tmp_path, "nodes.glb", glb_bytes(nodes, [flat, strip]))
    assert [(mesh.name, mesh.material) for mesh in (listed, stripped)] == [("list", "wood"), ("strip", "metal")]
    # scaled to 2 × 2 m, turned by 90° about glTF's y, which is z here, and moved by 10 m
    np.testing.assert_allclose(bounds_m(listed), [[8, 0, 0], [10, 2, 0]], atol=1e-6)
    np.testing.assert_allclose(bounds_m(stripped), [[10, 0, 5], [11, 2, 5]], atol=1e-6)
    area_m2 = [trimesh.Trimesh(mesh.vertices_m, mesh.triangles).area for mesh in (listed, stripped)]
    np.testing.assert_allclose(area_m2, [4, 2])


def test_a_mirrored_node_keeps_its_fronts_outside(tmp_path: Path) -> None:
    square = SQUARE_M, [0, 1, 2, 2, 1, 3], TRIANGLES, "Wood"
    moved = {"scale": [1, 1, -1], "translation": [5, 0, 0]}
    nodes: list[dict[str, Any]] = [{"children": [1, 2]}, {"mesh": 0, "name": "a"}, {"mesh": 0, "name": "b", **moved}]
    meshes = meshes_of(tmp_path, "mirrored.glb", glb_bytes(nodes, [square]))
    corners_m = np.concatenate([mesh.corners_m for mesh in meshes])
    assert len(corners_m) == 4  # two squares of two triangles
    fronts = [np.cross(*np.diff(corners_m[n], axis=0)) for n in (0, 2)]
    np.testing.assert_allclose(fronts[1], fronts[0] * [1, -1, 1], atol=1e-6)  # glTF's z is -y here


def test_a_name_may_have_a_hash_in_it(tmp_path: Path) -> None:
    text = "# first\no a # second\nusemtl oak#1\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    (mesh,) = meshes_of(tmp_path, "hash.obj", text, '[[material]]\nname = "oak#1"\nitu = "wood"\n')
    assert mesh.name == "a"


def test_faces_may_be_of_parts_of_buildings_and_of_layers_of_the_scenes_own(tmp_path: Path) -> None:
    """Whatever thickness is stated for them elsewhere; the first layer is at the front of the faces."""
    layers = "{material = 'wood', thickness_m = 0.02}, {material = 'metal', thickness_m = 0.001}"
    own = f'[[material]]\nname = "lined"\nlayers = [{layers}]\n'
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\no a\nusemtl mat-double-glazing.001\nf 1 2 3\no b\nusemtl lined\nf 1 2 3\n"
    window, lined = meshes_of(tmp_path, "parts.obj", text, own)
    assert window.slab == Slab(PRESETS["double-glazing"], 0.024)
    assert lined.slab.layers == (("wood", 0.02), ("metal", 0.001))
    assert lined.thickness_m == pytest.approx(0.021)
    (facet,) = planar_facets([lined])
    assert facet.front[2] > 0


def test_objects_without_a_material_are_named_in_the_table(tmp_path: Path) -> None:
    content = glb_bytes([{"mesh": 0, "name": "Cube"}], [(SQUARE_M, [0, 1, 2], TRIANGLES, "")])
    (mesh,) = meshes_of(tmp_path, "cube.glb", content, '[[material]]\nname = "Cube"\nitu = "brick"\n')
    assert mesh.material == "brick"
    with pytest.raises(SceneError, match=r"without a material.*name = 'Cube'"):
        meshes_of(tmp_path, "cube.glb", content)


def square_glb(nodes: list[dict[str, Any]], change: dict[str, Any]) -> bytes:
    """A GLB of nodes of one triangle of `SQUARE_M`; `change` replaces parts of its JSON."""
    return glb_bytes(nodes, [(SQUARE_M, [0, 1, 2], TRIANGLES, "itu_wood")], change)


def test_without_a_scene_every_node_without_a_parent_counts(tmp_path: Path) -> None:
    content = square_glb([{"mesh": 0}, {"children": [0]}], {"scenes": []})
    assert len(meshes_of(tmp_path, "roots.glb", content)) == 1


def test_a_strip_and_a_fan_are_the_triangles_that_gltf_means(tmp_path: Path) -> None:
    ring = [[0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1]]
    for mode, vertices in ((STRIP, SQUARE_M), (FAN, ring)):
        (mesh,) = meshes_of(tmp_path, "strip.glb", glb_bytes([{"mesh": 0}], [(vertices, range(4), mode, "itu_wood")]))
        normals = np.cross(*np.moveaxis(np.diff(mesh.corners_m, axis=1), 1, 0))
        assert len(normals) == 2
        assert (normals[:, 2] > 0).all()  # both face upwards


def changed_square(extras: list[tuple[Any, str]], node: dict[str, Any], **change: Any) -> bytes:
    """A GLB of one triangle of `SQUARE_M`; `extras` are values and types of further accessors, from number 2 on."""
    content, binary = glb_content(
        [{"mesh": 0, "name": "cabinet", **node}], [(SQUARE_M, [0, 1, 2], TRIANGLES, "itu_wood")]
    )
    kinds = {"<f4": 5126, "<i2": 5122}
    for values, dtype in extras:
        array = np.asarray(values, dtype)
        view = {"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes}
        content["accessors"].append({"bufferView": len(content["bufferViews"]), "componentType": kinds[dtype],
                                     "count": len(array), "type": f"VEC{array.shape[1]}"})  # fmt: skip
        content["bufferViews"].append(view)
        binary += array.tobytes()
    content["buffers"] = [{"byteLength": len(binary)}]
    content["meshes"][0]["primitives"][0].update(change.pop("primitive", {}))
    content["meshes"][0].update(change.pop("mesh", {}))
    return packed_glb({**content, **change}, binary)


@pytest.mark.parametrize("required", [False, True])
def test_instances_of_a_glb_stand_at_their_places(tmp_path: Path, required: bool) -> None:
    """As Blender writes them, also with rotations as 16-bit integers and attributes of others."""
    half_turn = [[0, 0, 0, 32767], [0, 32767, 0, 0]]  # about glTF's y, which is z here
    extras = [([[5, 0, 0], [9, 0, 0]], "<f4"), (half_turn, "<i2"), ([[1, 1, 1], [2, 1, 1]], "<f4")]
    attributes = {"TRANSLATION": 2, "ROTATION": 3, "SCALE": 4, "_ID": 9}
    node = {"translation": [0, 1, 0], "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}}
    listed = {"extensionsRequired" if required else "extensionsUsed": ["EXT_mesh_gpu_instancing"]}
    meshes = meshes_of(tmp_path, "instances.glb", changed_square(extras, node, **listed))
    np.testing.assert_allclose(
        [bounds_m(mesh) for mesh in meshes], [[[5, 0, 1], [6, 2, 1]], [[7, -2, 1], [9, 0, 1]]], atol=1e-4
    )  # a rotation of 16 bits, over 2 m
    assert [mesh.name for mesh in meshes] == ["cabinet", "cabinet"]
    node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"_ID": 9}}}
    assert len(meshes_of(tmp_path, "instances.glb", changed_square([], node))) == 1


def test_blend_shapes_of_a_glb_are_applied_by_their_weights(tmp_path: Path) -> None:
    lift, sink = (np.tile([0, height_m, 0], (4, 1)) for height_m in (1, -8))
    extras = [(lift, "<f4"), (sink, "<f4")]
    primitive = {"targets": [{"POSITION": 2}, {"POSITION": 3}, {"NORMAL": 7}]}
    for node, mesh, height_m in (
        ({}, {}, 0),
        ({}, {"weights": [0.5, 0, 1]}, 0.5),
        ({"weights": [1, 0.25]}, {"weights": [9]}, -1),
    ):
        (read,) = meshes_of(tmp_path, "blend.glb", changed_square(extras, node, primitive=primitive, mesh=mesh))
        np.testing.assert_allclose(bounds_m(read)[:, 2], height_m)


def test_hidden_nodes_of_a_glb_are_left_out_with_their_children(tmp_path: Path) -> None:
    for visible, number in ((False, 1), (True, 3)):
        middle = {"extensions": {"KHR_node_visibility": {"visible": visible}}, "children": [2], "mesh": 0}
        content = square_glb([{"mesh": 0, "name": "seen", "children": [1]}, middle, {"mesh": 0}], {})
        meshes = meshes_of(tmp_path, "hidden.glb", content)
        assert (meshes[0].name, len(meshes)) == ("seen", number)


def test_instances_blend_shapes_and_hidden_nodes_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    places = {"TRANSLATION": 2, "SCALE": 3}
    extras = [([[5, 0, 0], [9, 0, 0]], "<f4"), ([[1, 1, 1]], "<f4")]
    blend = {"primitive": {"targets": [{"POSITION": 3}]}, "mesh": {"weights": [1]}}
    for extensions, change, told in (
        ({"EXT_mesh_gpu_instancing": {"attributes": places}}, {}, "different numbers of instances"),
        ({"KHR_node_visibility": {"visible": "false"}}, {}, "give true or false"),
        ({}, blend, "moves 1 of 4 vertices"),
    ):
        with pytest.raises(SceneError, match=told):
            meshes_of(tmp_path, "odd.glb", changed_square(extras, {"extensions": extensions}, **change))


def test_unknown_extensions_of_a_glb_are_refused_unless_they_are_about_looks_alone(tmp_path: Path) -> None:
    strange = {"extensions": {"ACME_bend": {}}}
    look = {"materials": [{"name": "itu_wood", "extensions": {"ACME_sheen": {}}}], "extensionsRequired": ["ACME_sheen"]}
    known = {"extensions": {"KHR_lights_punctual": {"light": 0}, "MOZ_hubs_components": {}}}
    compressed_too = {"extensions": {"KHR_draco_mesh_compression": {"bufferView": 7}}}
    assert meshes_of(tmp_path, "looks.glb", changed_square([], known, primitive=compressed_too, **look))
    for change in ({"node": strange}, {"mesh": strange}, {"primitive": strange}, {"extensionsRequired": ["ACME_bend"]}):
        with pytest.raises(SceneError, match="it uses ACME_bend, which cannot be read; export it without"):
            meshes_of(tmp_path, "bent.glb", changed_square([], change.pop("node", {}), **change))


ACCESSOR = {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}
VIEW = {"buffer": 0, "byteLength": 48}
EMPTY, DRACO = {"componentType": 5126, "count": 10**12, "type": "VEC3"}, "KHR_draco_mesh_compression"
INDEX = {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"extensionsRequired": [DRACO]}, "export it without compression"),
        ({"buffers": [{"uri": "../other.bin", "byteLength": 9}]}, "geometry is in another file"),
        ({"nodes": [{"mesh": 0, "skin": 0}]}, "skinned"),
        ({"nodes": [{"children": [0]}]}, "is in two places"),
        ({"nodes": [{"children": [1, 1]}, {"mesh": 0}]}, "is in two places"),
        ({"nodes": [{"mesh": 7}]}, "cannot be read"),
        ({"accessors": [ACCESSOR | {"count": 10**9}, INDEX]}, "cannot be read"),
        ({"accessors": [ACCESSOR | {"count": -1}, INDEX]}, "no sound size"),
        ({"accessors": [ACCESSOR | {"type": "VEC2"}, INDEX]}, "not a position"),
        ({"accessors": [EMPTY, INDEX]}, "sparse or empty"),
        ({"bufferViews": [VIEW | {"byteStride": 0}, VIEW]}, "sound size"),
        ({"bufferViews": [VIEW | {"byteOffset": 10**9}, VIEW]}, "cannot be read"),
        ({"accessors": [ACCESSOR | {"count": 2}, INDEX]}, "vertex 2 of 2"),
        ({"accessors": [ACCESSOR, INDEX | {"count": 2}]}, "a list of triangles has 2 corners"),
        ({"nodes": [{"mesh": 0, "matrix": [*np.eye(4).ravel()[:15], 2]}]}, r"the matrix of node None ends in \["),
        ({"accessors": [EMPTY, INDEX], "extensionsUsed": [DRACO]}, f"compressed by {DRACO}; export without"),
        ({"nodes": [{"mesh": 0, "scale": [1e308] * 3, "translation": [1e308] * 3}]}, "not finite, or beyond"),
        ({"materials": []}, "cannot be read"),
        ({"meshes": [{"primitives": [{"attributes": {}}]}]}, "it lacks 'POSITION'"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]}]}, "has no triangles"),
        ({"materials": [{"name": "Oak"}]}, r"node 'mesh 0': material 'Oak' is not an ITU material"),
    ],
)  # fmt: skip
def test_a_glb_that_is_not_sound_is_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        meshes_of(tmp_path, "spoilt.glb", square_glb([{"mesh": 0}], change))


def test_many_nodes_of_one_large_mesh_are_refused_before_they_fill_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(imported, "MAX_TRIANGLES", 99_999)
    monkeypatch.setattr(imported, "MAX_SHAPES", 1000)
    nodes: list[dict[str, Any]] = [{"mesh": 0, "children": list(range(1, 100))}, *({"mesh": 0} for _ in range(99))]
    with pytest.raises(SceneError, match="more than 99,999 triangles"):
        meshes_of(tmp_path, "many.glb", glb_bytes(nodes, [(np.zeros((1000, 3)), [0, 1, 2], TRIANGLES, "itu_wood")]))
    places = [(np.zeros((1001, 3)), "<f4")]
    node = {"extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 2}}}}
    with pytest.raises(SceneError, match="or 1,000 objects"):
        meshes_of(tmp_path, "many.glb", changed_square(places, node))


def test_a_glb_that_is_cut_or_nests_without_end_is_refused(tmp_path: Path) -> None:
    whole, text = square_glb([{"mesh": 0}], {}), b"[" * 100_000
    deep = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text
    for content in (*(whole[:length] for length in (0, 3, 11, 12, 19, 25, 200)), deep):
        with pytest.raises(SceneError, match="cannot be read"):
            meshes_of(tmp_path, "cut.glb", content)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no triangles"),
        ("v 0 0 0\n", "no triangles"),
        ("v 0 0\n", "line 1 is not a vertex"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 3\n", "line 3 is not a vertex, nor a face"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl itu_wood\nf 1 2 3\nf 1 2", "line 6 is not a vertex, nor a face of three"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nsurf 0 1 0 1 1 2 3\n", "line 4 is 'surf', which cannot be read"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "faces without a material"),
        ("usemtl itu_wood\nv 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no face of any area"),
        ("v 1e400 0 0\nv 1 0 0\nv 0 1 0\nusemtl itu_wood\nf 1 2 3\n", "line 1 is not a vertex"),
        ("v 1_0 0 0\n", "line 1 is not a vertex"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0_3\n", "line 4 is not a vertex, nor a face"),
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


STL = TABLE.export(file_type="stl_ascii")
SOLIDS = STL.replace("solid", "solid one", 1) + STL.replace("solid", "solid two", 1)


@pytest.mark.parametrize(
    "text",
    [
        STL.replace("solid", "solid facet normal", 1),
        STL.replace("solid", "solid vertex 1 2 3", 1),
        STL.replace("solid", "solid Normalwand", 1),
        STL.replace("solid", "\ufeffsolid", 1),
        STL.replace("\n", "\r"),
        STL.encode().replace(b"solid", "solid 门".encode("gbk"), 1),
        STL.upper(),
        STL.encode("utf-16"),
    ],
)
def test_an_stl_in_ascii_is_read_whatever_its_solid_is_named(
    tmp_path: Path, text: str | bytes, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "table.stl").write_bytes(text if isinstance(text, bytes) else text.encode())
    read = read_mesh(tmp_path / "table.stl", "stl")
    np.testing.assert_allclose(read.vertices_m[read.triangles], TABLE.triangles)
    assert not caplog.records  # nor does trimesh log a traceback


@pytest.mark.parametrize("content", [SOLIDS[:-8], SOLIDS[:-200], TABLE.export(file_type="stl")[:-7], b""])
def test_an_stl_that_is_cut_is_refused(tmp_path: Path, content: str | bytes) -> None:
    (tmp_path / "cut.stl").write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match="ends within a solid"):
        read_mesh(tmp_path / "cut.stl", "stl")


def test_names_of_materials_that_are_no_utf8_are_never_taken_for_each_other(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\no {0}\nusemtl {1}\nf 1 2 3\no {2}\nusemtl {3}\nf 1 3 2\n"
    for words, encoding in ((("门", "门", "窗", "窗"), "gbk"), (("a", "tür", "b", "tór"), "latin-1")):
        with pytest.raises(SceneError, match="is not UTF-8; save the file as UTF-8"):
            meshes_of(tmp_path, "door.obj", text.format(*words).encode(encoding))
    unnamed = text.replace("usemtl {1}\n", "").replace("usemtl {3}\n", "")
    with pytest.raises(SceneError, match="is not UTF-8"):
        meshes_of(tmp_path, "door.obj", unnamed.format("门", "", "窗").encode("gbk"))
    # of names that say nothing about materials, and comments, no letter ends a line with what is a backslash elsewhere
    japanese = "# 表\n" + text.format("表", "itu_wood", "机", "itu_glass")
    materials = [mesh.material for mesh in meshes_of(tmp_path, "door.obj", japanese.encode("shift-jis"))]
    assert materials == ["wood", "glass"]
    (tmp_path / "door.obj").write_bytes(text.format("门", "门", "窗", "窗").encode("gbk"))
    assert len(read_mesh(tmp_path / "door.obj", "obj").triangles) == 2  # of a Mitsuba XML, which says the material


def test_a_byte_order_mark_and_comments_in_any_language_are_passed_over(tmp_path: Path) -> None:
    text = "o a\nusemtl itu_wood\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    for encoding in ("utf-8-sig", "utf-16"):
        assert [mesh.name for mesh in meshes_of(tmp_path, "bom.obj", text.encode(encoding))] == ["a"]
    ply = ply_bytes(np.array([[0, 0, 0], [5, 0, 0], [5, 2, 0], [0, 2, 0]]), [[0, 1, 2, 3]], binary=True)
    for changed in (ply.replace(b"1.0\n", "1.0\ncomment 门\n".encode("gbk"), 1), b"\xef\xbb\xbf" + ply):
        (tmp_path / "door.ply").write_bytes(changed)
        assert trimesh.Trimesh(*read_mesh(tmp_path / "door.ply", "ply")).area == pytest.approx(10)


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


@pytest.mark.parametrize(
    ("suffix", "unit", "length_m"),
    [("obj", "m", 1), ("glb", "cm", 0.01), ("ply", "mm", 0.001), ("stl", "in", 0.0254), ("obj", "ft", 0.3048)],
)
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
    with pytest.raises(SceneError, match=rf"read with {read} upwards.* if {right} were up. Choose with up"):
        surface_meshes(scene)
    assert surface_meshes(replace(scene, up=read))  # it was said
    assert surface_meshes(scene_of_file(tmp_path, saved(tmp_path, suffix, mesh, Y_UP if suffix == "glb" else UPRIGHT)))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"room\.glb cannot be read: No such file"):
        surface_meshes(scene_of_file(tmp_path, "room.glb"))
