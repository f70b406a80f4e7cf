from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from tests.support.mesh_scenes import ply_bytes
from tests.support.sionna_scenes import GRID, RECEIVER, scene_of
from xfreqbench.errors import SceneError
from xfreqbench.scene.facets import group_by_plane, planar_facets
from xfreqbench.scene.meshes import SurfaceMesh, meshes_sha256, shape_ids, surface_meshes, write_mitsuba
from xfreqbench.scene.model import Scene, Surface

CONCRETE = '<bsdf type="itu-radio-material" id="mat-a"><string name="type" value="concrete"/>{}</bsdf>'
SHAPE = '<shape type="ply"{}><string name="filename" value="{}.ply"/><ref id="mat-a" name="bsdf"/></shape>'
WALL = Surface("wall", "wood", 0.1, (0.0, -4.0, -3.0), (0.0, 6.0, 6.0))
SQUARE_M = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def imported(folder: Path, *elements: str, surface: tuple[Surface, ...] = ()) -> Scene:
    (folder / "scene.xml").write_text(f"<scene version='2.1.0'>{''.join(elements)}</scene>")
    trimesh.Trimesh(SQUARE_M, SQUARE, process=False).export(folder / "square.ply")
    return Scene(name="test", receiver=RECEIVER, transmitters=GRID, surface=surface, scene="scene.xml", folder=folder)


def mesh_of(vertices_m: np.ndarray, triangles: np.ndarray) -> SurfaceMesh:
    return SurfaceMesh("mesh", "wood", 0.1, vertices_m, triangles.astype(np.int64))


@pytest.mark.parametrize("thickness", ["abc", "nan", "inf", "-1", "0", ""])
def test_a_slab_without_a_positive_thickness_is_refused_by_name(tmp_path: Path, thickness: str) -> None:
    bsdf = CONCRETE.format(f'<float name="thickness" value="{thickness}"/>')
    with pytest.raises(SceneError, match=r"scene\.xml: the thickness of material 'mat-a' is"):
        surface_meshes(imported(tmp_path, bsdf, SHAPE.format("", "square")))


def test_a_material_that_no_shape_refers_to_may_be_anything(tmp_path: Path) -> None:
    unused = '<bsdf type="diffuse" id="red"/>'
    (mesh,) = surface_meshes(imported(tmp_path, unused, CONCRETE.format(""), SHAPE.format(' id="mesh-a"', "square")))
    assert (mesh.name, mesh.material, mesh.thickness_m) == ("a", "concrete", 0.1)
    used = unused.replace("red", "mat-a")
    with pytest.raises(SceneError, match="not an ITU material"):
        surface_meshes(imported(tmp_path, used, SHAPE.format("", "square")))


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([], "no face of any area"),
        ([[0, 1, 1]], "no face of any area"),
        ([[0, 1, 9]], "cannot be read"),
        ([[0, 1, 2], [0, 1, 3]], "not finite"),
        (None, r"points\.ply of shape 'a'"),  # a point cloud
    ],
)
def test_a_mesh_without_faces_does_not_vanish_silently(
    tmp_path: Path, faces: list[list[int]] | None, message: str
) -> None:
    last = np.nan if message == "not finite" else 0
    content = ply_bytes(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, last]]), faces or [], binary=False)
    if faces is None:
        content = re.sub(rb"element face 0\n.*\n", b"", content)
    (tmp_path / "points.ply").write_bytes(content)
    with pytest.raises(SceneError, match=message):
        surface_meshes(imported(tmp_path, CONCRETE.format(""), SHAPE.format(' id="mesh-a"', "points")))


@pytest.mark.sionna
def test_a_triangle_of_no_area_changes_nothing(tmp_path: Path) -> None:
    from xfreqbench.tracing.sionna.chains import planes_of

    collinear = [[0, 1, 1], [2, 2, 2]]
    trimesh.Trimesh(SQUARE_M, [SQUARE[0], *collinear, SQUARE[1]], process=False).export(tmp_path / "bad.ply")
    bad, good = (
        surface_meshes(imported(tmp_path, CONCRETE.format(""), SHAPE.format(' id="mesh-a"', ply)))
        for ply in ("bad", "square")
    )
    assert meshes_sha256(bad) == meshes_sha256(good)
    planes = planes_of(bad)
    assert np.isfinite(planes.normal).all()
    assert planes.index.tolist() == [0, 0]


def test_a_corner_within_a_side_makes_no_facet_without_area() -> None:
    corners_m = np.array([[0, 0, 0], [0.7, 0, 0], [2, 0, 0], [2, 1, 0], [0.3, 1.7, 0]])
    fan = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    whole = planar_facets([mesh_of(corners_m, fan[1:])])
    for turn in Rotation.random(20, rng=1):
        facets = planar_facets([mesh_of(turn.apply(corners_m), fan)])
        assert len(facets) == len(whole)
        for facet, expected in zip(facets, whole, strict=True):
            np.testing.assert_allclose(facet.corners_m, turn.apply(expected.corners_m), atol=1e-12)


def test_meshes_of_one_name_have_different_ids() -> None:
    (wall,) = surface_meshes(scene_of(WALL))
    names = ["wall", "floor", "wall", "wall", "wall-00002"]
    ids = shape_ids([replace(wall, name=name) for name in names])
    assert ids[:3] == ["mesh-wall", "mesh-floor", "mesh-wall-00002"]
    assert len(set(ids)) == len(names)


@pytest.mark.sionna
def test_meshes_of_one_name_are_all_loaded_by_sionna(tmp_path: Path) -> None:
    from xfreqbench.tracing.sionna.scene import RadioScene

    shapes = [SHAPE.format(ident, "square") for ident in ("", "", ' id="mesh-wall"')]
    meshes = surface_meshes(imported(tmp_path, CONCRETE.format(""), *shapes, surface=(WALL,)))
    assert [mesh.name for mesh in meshes] == ["wall", "unnamed", "unnamed", "wall"]
    pointer = RadioScene(meshes).shape_pointer
    assert len(set(pointer.tolist())) == 4
    again = surface_meshes(
        replace(imported(tmp_path), scene=str(write_mitsuba(meshes, tmp_path / "b")), folder=tmp_path)
    )
    assert [len(mesh.triangles) for mesh in again] == [2, 2, 2, 2]


def test_planes_are_grouped_alike_wherever_they_stand() -> None:
    """Single-precision vertices move a plane by 1e-6 m and turn it by 1e-6 rad: less than the tolerance."""
    rng = np.random.default_rng(0)
    tiles_m = np.concatenate([SQUARE_M + np.array([i, j, 0]) for i in range(6) for j in range(6)])
    triangles = np.concatenate([SQUARE + 4 * tile for tile in range(36)])
    for _ in range(20):
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        floor, ceiling = (
            mesh_of(((tiles_m + np.array([0, 0, height_m])) @ rotation.T).astype(np.float32).astype(float), triangles)
            for height_m in (0.0, 1e-3)
        )
        facets = planar_facets([floor, ceiling])
        planes, plane = group_by_plane(facets)
        assert len(planes) == 2
        np.testing.assert_array_equal(plane == plane[0], [facet.surface == 0 for facet in facets])


def test_a_plane_has_no_side_that_a_grouping_could_split() -> None:
    """Facets whose normals' first sizeable component lies about the threshold have normals of both signs."""
    u = np.array([0.0, 1.0, 0.0])
    meshes = []
    for tilt in (0.1 - 1e-9, 0.1 + 1e-9):
        v = np.array([np.sqrt(1 - tilt**2), 0.0, tilt])
        corners_m = np.array([0 * u, u, u + v, v])
        meshes.append(mesh_of(corners_m, SQUARE))
    planes, plane = group_by_plane(planar_facets(meshes))
    assert (len(planes), plane.tolist()) == (1, [0, 0])
