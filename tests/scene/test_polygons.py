"""Polygons: faces of mesh files, and surfaces of scenes in any plane."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydantic import TypeAdapter

from tests.support.mesh_scenes import ply_bytes, scene_of_file
from xfreqbench.errors import PlacementError, SceneError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.imported import Triangles
from xfreqbench.scene.mesh_files import read_mesh
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import ReceiverArray, Scene, Surface, TransmitterGrid, parse_scene
from xfreqbench.scene.overlaps import check_overlaps
from xfreqbench.scene.placement import place_transmitters
from xfreqbench.scene.rooms import check_closed

DOORWAY = [(-2, 0), (-0.5, 0), (-0.5, 2), (0.5, 2), (0.5, 0), (2, 0), (2, 3), (-2, 3)]
FLAT_FACES = {  # corners in turn, and the area that they enclose
    "a doorway": (DOORWAY, 10.0),
    "an L": ([(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)], 6.0),
    "a dart": ([(0, 0), (2, 1), (0, 2), (1, 1)], 1.0),
    "two windows, by slits": (
        [(0, 0), (6, 0), (6, 3), (5, 2), (5, 1), (4, 1), (4, 2), (5, 2), (6, 3), (0, 3), (0, 1), (1, 1), (1, 2), (2, 2),
         (2, 1), (1, 1), (0, 1)], 16.0,
    ),
    "corners on straight sides": (
        [(0, 0), (1, 0), (2, 0), (4, 0), (4, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2)], 7.0,
    ),
}  # fmt: skip


def placed(corners: list[tuple[float, float]], turn_deg: float) -> np.ndarray:
    """Corners (n, 3) of a flat face, upright for 0°, rounded as files round them."""
    turn = trimesh.transformations.rotation_matrix(np.radians(turn_deg), [0.3, 0.5, 0.8], [1, 2, 0])
    upright = np.insert(np.array(corners, np.float64), 0, 0, axis=1)
    return np.asarray(trimesh.transformations.transform_points(upright, turn).round(6))


def area_m2(triangles: Triangles) -> float:
    return float(trimesh.Trimesh(*triangles, process=False).area)


@pytest.mark.parametrize("name", FLAT_FACES)
def test_a_concave_face_covers_what_it_encloses(tmp_path: Path, name: str) -> None:
    """From whichever corner it is listed, whichever way round and however it stands."""
    corners, true_m2 = FLAT_FACES[name]
    for turn_deg in (0, 90, 180, 222):
        vertices_m = placed(corners, turn_deg)
        for start in range(-len(corners), len(corners)):
            face = np.roll(np.arange(len(corners)), start)[:: 1 if start < 0 else -1].tolist()
            lines = "".join(f"v {x} {y} {z}\n" for x, y, z in vertices_m)
            (tmp_path / "face.obj").write_text(f"{lines}f {' '.join(str(index + 1) for index in face)}\n")
            read = read_mesh(tmp_path / "face.obj", "obj")
            assert area_m2(read) == pytest.approx(true_m2, rel=1e-5)
            normals = np.cross(*np.moveaxis(np.diff(read.vertices_m[read.triangles], axis=1), 1, 0))
            assert (normals @ normals.sum(axis=0) > -1e-3).all()  # all on one side, but for rounding


def test_faces_of_a_ply_may_have_any_number_of_corners(tmp_path: Path) -> None:
    """In binary too, where the rows of 4, 3 and 5 corners are together as long as three of 4."""
    vertices_m = np.concatenate([placed(DOORWAY, 30), [[9, 0, 0], [9, 1, 0], [9, 1, 1], [9, 0, 1]]])
    polygons = [[8, 9, 10, 11], [8, 9, 10], [0, 1, 2, 6, 7], list(range(8))]
    for binary in (False, True):
        for faces, true_m2 in ((polygons[:3], 1 + 0.5 + 5.75), (polygons, 1 + 0.5 + 5.75 + 10), (polygons[3:], 10)):
            (tmp_path / "mixed.ply").write_bytes(ply_bytes(vertices_m, faces, binary))
            assert area_m2(read_mesh(tmp_path / "mixed.ply", "ply")) == pytest.approx(true_m2, rel=1e-5)
    rows = ply_bytes(vertices_m, [[0, 1, 2], [2, 3, 4], [4, 5, 6]], binary=False).splitlines(keepends=True)
    whole = b"".join(rows)
    for content, told in (
        (ply_bytes(vertices_m, polygons, binary=True)[:-1], "smaller"),
        (b"".join(rows[:-1]), "ends within its faces"),
        (whole[:-3], "ends within its faces"),
        (whole + rows[-1], "longer than its header"),
        (whole.replace(b"_ind", b"_x"), "no list"),
    ):
        (tmp_path / "odd.ply").write_bytes(content)
        with pytest.raises(ValueError, match=told):
            read_mesh(tmp_path / "odd.ply", "ply")


def test_a_flat_face_that_crosses_itself_is_refused_and_a_bent_one_is_a_fan(tmp_path: Path) -> None:
    text = "usemtl itu_wood\nv 0 0 0\nv 2 2 {0}\nv 2 0 0\nv 0 2 -{0}\nf 1 2 3 4\n"
    (tmp_path / "bow.obj").write_text(text.format(0))
    with pytest.raises(SceneError, match=r"face with a corner at \(0, 0, 0\) crosses itself; export the mesh as tri"):
        surface_meshes(scene_of_file(tmp_path, "bow.obj"))
    window = [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0], [1, 1], [3, 1], [3, 2], [1, 2], [1, 1]]  # turned as the wall is
    (tmp_path / "window.ply").write_bytes(ply_bytes(placed(window, 0), [list(range(10))], binary=True))
    with pytest.raises(ValueError, match="crosses itself"):
        read_mesh(tmp_path / "window.ply", "ply")
    (tmp_path / "bent.obj").write_text(text.format("1.5"))
    (bent,) = surface_meshes(scene_of_file(tmp_path, "bent.obj"))
    assert len(bent.triangles) == 2


def polygon(vertices_m: np.ndarray, name: str = "gable") -> Surface:
    return Surface(name, "wood", 0.02, vertices_m=tuple(map(tuple, vertices_m.tolist())))


def scene_of(*surfaces: Surface) -> Scene:
    grid = TransmitterGrid(min_m=(0.5, 0.5, 0.5), max_m=(3.5, 0.5, 2.5), step_m=(0.5, 1.0, 0.5))
    receiver = ReceiverArray(position_m=(2.0, 1.0, 1.0))
    return Scene(name="roof", receiver=receiver, transmitters=grid, surface=surfaces, closed=True)


@pytest.mark.parametrize("name", FLAT_FACES)
def test_a_polygon_of_a_scene_covers_what_it_encloses(name: str) -> None:
    """In its own plane, though corners are rounded to millimetres, and with the first corner once more at the end."""
    corners, true_m2 = FLAT_FACES[name]
    for turn_deg in (0, 90, 222):
        given_m = placed(corners, turn_deg).round(3)
        (mesh,) = surface_meshes(scene_of(polygon(np.concatenate([given_m, given_m[:1]]))))
        assert area_m2(Triangles(mesh.vertices_m, mesh.triangles)) == pytest.approx(true_m2, rel=2e-3)
        normals = np.cross(*np.moveaxis(np.diff(mesh.corners_m, axis=1), 1, 0))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        np.testing.assert_allclose(normals @ normals[0], 1, rtol=1e-12)
        if turn_deg == 0:
            np.testing.assert_array_equal(mesh.vertices_m[:-1], given_m)


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ("vertices_m = [[0, 0, 0], [1, 0, 0]]", r"surface\.0\.vertices_m: Tuple should have at least 3 items"),
        ("vertices_m = [[0, 0, 0], [1, 1, 1], [2, 2, 2]]", "polygon of surface 'gable' has no area"),
        ("vertices_m = [[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]]", "polygon of surface 'gable' crosses itself"),
        ("vertices_m = [[0, 0, 0], [3, 3, 0], [3, 0, 0], [0, 1, 0]]", "polygon of surface 'gable' crosses itself"),
        (  # a strip that ends upon its own beginning, nowhere turned round
            "vertices_m = [[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0], [0, 0.5, 0], [3, -0.5, 0], [3, 0.2, 0], "
            "[1, 0.7, 0], [1, 8, 0], [8, 8, 0], [8, 1, 0], [0, 1, 0]]",
            "polygon of surface 'gable' crosses itself",
        ),
        (
            "vertices_m = [[0, 0, 0], [1, 0, 0], [1, 1, 0.01], [0, 1, 0]]",
            r"corner is 2\.5 mm off its plane, and at most 1 mm",
        ),
        ("min_m = [0, 0, 0]", "surface 'gable' needs either min_m and max_m, or vertices_m, and not both"),
        ("", "surface 'gable' needs either min_m and max_m, or vertices_m, and not both"),
        (
            "min_m = [0, 0, 0]\nmax_m = [1, 1, 0]\nvertices_m = [[0, 0, 0], [1, 0, 0], [1, 1, 0]]",
            "surface 'gable' needs either min_m and max_m, or vertices_m, and not both",
        ),
    ],
)
def test_a_polygon_that_means_nothing_is_refused_by_name(stated: str, message: str) -> None:
    head = 'name = "x"\nreceiver = {position_m = [1, 1, 1]}\n[[surface]]\nname = "gable"\nmaterial = "wood"\n'
    with pytest.raises(SceneError, match=message):
        parse_scene(f"{head}thickness_m = 0.02\n{stated}")


def tent() -> list[Surface]:
    """A closed room of 4 × 2 m below a pitched roof, 3 m at its ridge."""
    ring = np.array([[0, 0, 0], [4, 0, 0], [4, 0, 1], [2, 0, 3], [0, 0, 1]], np.float64)
    far = ring + np.array([0, 2, 0])
    sides = [np.array([ring[i], far[i], far[i - 1], ring[i - 1]]) for i in range(5)]
    return [polygon(corners_m, f"part {n}") for n, corners_m in enumerate([ring, far, *sides])]


def test_polygons_close_a_room_keep_transmitters_off_and_may_not_overlap() -> None:
    scene = scene_of(*tent())
    meshes = surface_meshes(scene)
    check_closed(scene, meshes)
    check_overlaps(Geometry(meshes))
    tx_m = place_transmitters(scene, meshes).tx_position_m
    roof_m = (3 - np.abs(tx_m[:, 0] - 2) - tx_m[:, 2]) / np.sqrt(2)
    assert len(tx_m) == 29  # of 35, the rest on the roof
    assert (np.abs(roof_m) > scene.transmitters.clearance_m).all()
    with pytest.raises(PlacementError, match="meet nothing"):
        check_closed(scene, meshes[1:])
    window = Surface("window", "glass", 0.01, vertices_m=((0.2, 0.5, 1.2), (1.0, 0.5, 2.0), (1.0, 1.5, 2.0)))
    with pytest.raises(SceneError, match=r"'part 6' \(wood\) and 'window' \(glass\) overlap"):
        check_overlaps(Geometry(surface_meshes(scene_of(*tent(), window))))


def test_a_box_is_stored_as_before_and_a_polygon_as_it_was_given() -> None:
    box = Surface("box", "wood", 0.02, (0.0, 0.0, 0.0), (1.0, 1.0, 0.0))
    given = scene_of(box, tent()[0])
    stored = json.loads(given.canonical_json)["surface"]
    assert list(stored[0]) == ["name", "material", "thickness_m", "min_m", "max_m"]
    assert list(stored[1]) == ["name", "material", "thickness_m", "vertices_m"]
    assert TypeAdapter(Scene).validate_json(given.canonical_json) == given
