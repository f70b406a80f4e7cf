from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.support.furnished_room import SHELL, furnished_room
from tests.support.mesh_scenes import PLACES
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import meshes_sha256, surface_meshes
from xfreqbench.scene.model import PatchSize, parse_scene
from xfreqbench.scene.patches import Patches

SHED = f'name = "shed"\nscene = "room.xml"\nmirrors = "patches"\nleast_patch_area_m2 = 0.2\n{PLACES}'
DULL = '{name = "a", material = "wood", thickness_m = 0.01, min_m = [0, 0, 0], max_m = [1, 0, 1], mirrors = false}'


def patches_of(mesh: trimesh.Trimesh) -> Patches:
    return Patches(np.asarray(mesh.vertices[mesh.faces]))


def ring(inner_m: float, outer_m: float, sections: int = 400) -> trimesh.Trimesh:
    """A flat ring."""
    angle = np.linspace(0, 2 * np.pi, sections, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(sections)], axis=1)
    a, b = np.arange(sections), (np.arange(sections) + 1) % sections
    faces = np.vstack([np.stack([a, b, a + sections], 1), np.stack([b, b + sections, a + sections], 1)])
    return trimesh.Trimesh(np.vstack([inner_m * circle, outer_m * circle]), faces, process=False)


@pytest.mark.parametrize("middle_m", [(0.0, 0.0, 0.0), (691608.3, 5334762.7, 519.1)])  # the second is in UTM
def test_a_box_is_six_patches_and_a_squares_width_is_its_side(middle_m: tuple[float, float, float]) -> None:
    patches = patches_of(trimesh.creation.box(extents=[2.0, 2.0, 0.5]).apply_translation(middle_m))
    np.testing.assert_allclose(np.sort(patches.area_m2), [1, 1, 1, 1, 4, 4])
    square = patches.area_m2 > 2
    np.testing.assert_allclose(patches.width_m[square], 2.0)
    np.testing.assert_allclose(patches.width_m[~square], 4 * 1.0 / 5.0)  # 4·area / perimeter of 2 × 0.5


def test_a_rings_width_is_twice_that_of_its_band() -> None:
    (width_m,) = patches_of(ring(0.48, 0.5)).width_m
    assert width_m == pytest.approx(2 * 0.02, rel=1e-3)  # of 400 straight pieces


def test_triangles_need_not_share_vertices_and_are_rounded_to_float32() -> None:
    soup_m = np.add(ring(0.2, 0.5).triangles, [7.3, 5.1, 0.7])  # each triangle with corners of its own
    soup_m = soup_m.astype(np.float32).astype(np.float64) + np.random.default_rng(0).uniform(-1e-6, 1e-6, (1, 1, 3))
    assert len(Patches(soup_m).area_m2) == 1


def test_a_fan_of_needles_is_one_patch() -> None:
    """Of triangles a hundredth of a millimetre wide, whose normals float32 leaves wrong by a tenth."""
    x = np.linspace(0, 0.05, 5001)
    tip, base = np.array([[0.02, 1.0, 2.0]]), np.stack([x, np.zeros(5001), np.full(5001, 1.0)], axis=1)
    corner = np.arange(5000)
    fan = np.vstack([tip, base]).astype(np.float32).astype(np.float64)
    faces = np.stack([np.zeros(5000, np.int64), corner + 1, corner + 2], axis=1)
    patches = Patches(fan[faces])
    assert len(patches.area_m2) == 1
    assert patches.area_m2[0] == pytest.approx(0.05 * np.sqrt(2) / 2, rel=1e-5)


def test_a_triangle_that_is_given_twice_counts_once() -> None:
    box = trimesh.creation.box(extents=[1.0, 1.0, 1.0])
    twice = trimesh.Trimesh(box.vertices, np.vstack([box.faces, box.faces[:, ::-1]]), process=False)
    np.testing.assert_allclose(patches_of(twice).area_m2, 1.0)
    np.testing.assert_allclose(patches_of(twice).width_m, 1.0)


def test_a_curved_surface_is_no_patch_however_fine_it_is() -> None:
    assert patches_of(trimesh.creation.icosphere(subdivisions=4)).area_m2.max() < 0.01
    x, y = np.meshgrid(np.linspace(0, 2, 201), np.linspace(0, 0.5, 2), indexing="ij")
    bent = np.stack([x, y, 2e-3 * x**2], axis=-1).reshape(-1, 3)  # neighbours tilt by 4e-5, as little as is parallel
    a = 2 * np.arange(200)
    faces = np.vstack([np.stack([a, a + 1, a + 2], 1), np.stack([a + 1, a + 3, a + 2], 1)])
    assert patches_of(trimesh.Trimesh(bent, faces, process=False)).area_m2.max() < 0.5


def test_surfaces_mirror_and_of_meshes_only_large_patches(tmp_path: Path) -> None:
    room = furnished_room(tmp_path)
    geometry = Geometry(surface_meshes(room))
    mirrors = np.split(geometry.mirrors, np.cumsum([len(mesh.triangles) for mesh in geometry.meshes])[:-1])
    told = {mesh.name: int(own.sum()) for mesh, own in zip(geometry.meshes, mirrors, strict=True)}
    assert told == {**{wall.name: 2 for wall in SHELL}, "cushion": 0, "table": 4, "screen": 4, "foot": 0}
    assert geometry.num_mirrors == 2 * len(SHELL) + 4
    assert Geometry(surface_meshes(replace(room, mirrors="facets"))).mirrors.all()
    wider = replace(room, least_patch_width_m=0.9)
    assert Geometry(surface_meshes(wider)).num_mirrors == 2 * len(SHELL) + 2


def test_a_surface_may_say_that_it_does_not_mirror(tmp_path: Path) -> None:
    room = replace(furnished_room(tmp_path), scene=None)
    first, *others = room.surface
    dull = replace(room, surface=(replace(first, mirrors=False), *others))
    geometry = Geometry(surface_meshes(dull))
    assert not geometry.mirrors[geometry.mesh_of_triangle == 0].any()
    assert geometry.mirrors[geometry.mesh_of_triangle > 0].all()
    assert geometry.num_mirrors == Geometry(surface_meshes(room)).num_mirrors - 2
    assert parse_scene(f"surface = [{DULL}]\n{SHED}").surface[0].mirrors is False


def test_scenes_of_surfaces_say_nothing_of_patches(tmp_path: Path) -> None:
    room = furnished_room(tmp_path)
    bare = replace(room, scene=None)
    assert "patch" not in bare.canonical_json
    assert "mirrors" not in bare.canonical_json
    assert bare.mirror_settings == {}
    assert room.mirror_settings == {
        "mirrors": "patches",
        "least_patch_area_m2": PatchSize().area_m2,
        "least_patch_width_m": PatchSize().width_m,
    }
    assert replace(room, mirrors="facets").mirror_settings == {"mirrors": "facets"}
    facets = replace(room, mirrors="facets")
    assert meshes_sha256(surface_meshes(facets)) == meshes_sha256(surface_meshes(room))


def test_the_scene_file_states_the_least_patch() -> None:
    assert parse_scene(SHED).least_patch == (0.2, PatchSize().width_m)
