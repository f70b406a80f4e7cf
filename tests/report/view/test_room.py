"""The rays that `xfreqbench view` draws, against the geometry of the room, and the room in 3D, read again."""

from __future__ import annotations

import gzip
import json
import re
from base64 import b64decode
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.support.screened_room import ONE_LIT_TX, ONE_SHADOWED_TX, SCENE, store
from xfreqbench.data.dataset import PasDataset
from xfreqbench.report.view.figures import ray_colour
from xfreqbench.report.view.page import orbit_scene
from xfreqbench.report.view.plan import MAX_RAYS, RAY_RANGE_DB, Ray, ViewPlan, plan_view
from xfreqbench.report.view.write import room_model
from xfreqbench.scene.meshes import surface_meshes, write_mitsuba
from xfreqbench.scene.model import Surface

DEVIATION_RAD = 1e-9  # mirror points are exact to some roundings in float64


def turns_rad(ray: Ray) -> list[float]:
    """By how much a ray turns at each point it meets."""
    steps = np.diff(ray.points_m, axis=0)
    along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    pairs = pairwise(along)
    return [float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)) for a, b in pairs]


def reflections(rays: Sequence[Ray]) -> list[tuple[np.ndarray, np.ndarray, Surface]]:
    """Unit vectors into and out of each mirror point, with the surface that is said to be there."""
    surfaces = {surface.name: surface for surface in SCENE.surface}
    found = []
    for ray in rays:
        steps = np.diff(ray.points_m, axis=0)
        along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        for number, event in enumerate(ray.events):
            if event.startswith("reflected by "):
                surface = surfaces[event.removeprefix("reflected by ")]
                found.append((along[number], along[number + 1], surface))
    return found


def test_rays_run_from_the_transmitter_to_the_array_centre(view: ViewPlan) -> None:
    assert view.room.rays
    for ray in view.room.rays:
        np.testing.assert_array_equal(ray.points_m[0], view.room.tx_position_m[ONE_LIT_TX])
        np.testing.assert_array_equal(ray.points_m[-1], SCENE.receiver.position_m)
        length_m = np.linalg.norm(np.diff(ray.points_m, axis=0), axis=1).sum()
        assert ray.delay_s * 299_792_458 == pytest.approx(length_m, rel=1e-12)  # float64
        assert len(ray.points_m) == len(ray.events) + 2


def test_reflections_have_equal_angles_at_the_surface_they_are_said_to_be_at(view: ViewPlan) -> None:
    found = reflections(view.room.rays)
    assert {surface.name for *_, surface in found} >= {"floor", "ceiling", "screen, metal"}
    for towards, away, surface in found:
        normal = np.equal(surface.min_m, surface.max_m).astype(float)
        mirrored = towards - 2 * (towards @ normal) * normal
        assert np.linalg.norm(mirrored - away) < DEVIATION_RAD


def test_what_goes_through_a_surface_does_not_turn(dataset: PasDataset) -> None:
    wooden = replace(SCENE, surface=(Surface("pane", "glass", 0.008, (5.5, 0.0, 0.0), (5.5, 6.0, 2.8)),))
    path = store(wooden, dataset.path.parent / "pane.h5").path
    behind = plan_view(str(path), ONE_SHADOWED_TX).with_rays()
    (ray,) = behind.room.rays
    assert ray.label == "through pane"
    assert max(turns_rad(ray)) < DEVIATION_RAD


def test_rays_are_ordered_and_weak_ones_left_out(view: ViewPlan) -> None:
    levels = [ray.level_db for ray in view.room.rays]
    assert levels == sorted(levels, reverse=True)
    assert levels[0] == 0 and levels[-1] >= -RAY_RANGE_DB
    assert view.room.rays[0].label == "line of sight"
    assert 1 < len(levels) <= MAX_RAYS


def test_a_shadowed_transmitter_has_no_line_of_sight(dataset: PasDataset) -> None:
    shadowed = plan_view(str(dataset.path), ONE_SHADOWED_TX)
    assert shadowed.room.in_sight is not None and not shadowed.room.in_sight[ONE_SHADOWED_TX]
    rays = shadowed.with_rays().room.rays
    assert rays and all(ray.label != "line of sight" for ray in rays)


def test_the_strongest_ray_depends_on_the_carrier_asked_for(dataset: PasDataset) -> None:
    low, high = (plan_view(str(dataset.path), ONE_LIT_TX, carrier).with_rays() for carrier in (2.4, 77.0))
    assert (low.carrier_hz, high.carrier_hz) == (2.4e9, 77e9)
    assert [ray.level_db for ray in low.room.rays] != [ray.level_db for ray in high.room.rays]


ROUNDING_M = 1e-5  # of float32 metres in a room
ROUNDED_M = 0.0005  # half a millimetre


def world(model: trimesh.Scene, node: str) -> trimesh.Trimesh:
    """A node's shape as it stands in the world: glTF's y is up, ours is z."""
    transform, name = model.graph[node]
    shape = model.geometry[name].copy().apply_transform(transform)
    shape.vertices = shape.vertices[:, [0, 2, 1]] * [1, -1, 1]
    return shape


def test_the_model_holds_every_surface_group_ray_and_the_receiver(folder: Path, view: ViewPlan) -> None:
    model = trimesh.load_scene(folder / "scene.glb")
    nodes = set(model.graph.nodes_geometry)
    assert {f"surface {surface.name}" for surface in SCENE.surface} <= nodes
    assert {"transmitters in sight", "transmitters in shadow", "transmitter 0", "boresight"} <= nodes
    assert {"receiver", "array elements at 2.4 GHz", "ray 1: 0.0 dB, line of sight"} <= nodes
    assert sum(node.startswith("ray ") for node in nodes) == len(view.room.rays)


def test_the_model_is_in_the_places_of_the_scene(folder: Path, dataset: PasDataset) -> None:
    model = trimesh.load_scene(folder / "scene.glb")
    floor = world(model, "surface floor")
    np.testing.assert_allclose(floor.bounds, [[0, 0, 0], [8, 6, 0]], atol=ROUNDING_M)
    position_m, lit = dataset.tables["tx_position_m"], dataset.tables["line_of_sight"].astype(bool)
    for node, members in {"transmitters in sight": lit, "transmitters in shadow": ~lit}.items():
        markers = world(model, node).vertices.reshape(-1, 6, 3)
        np.testing.assert_allclose(markers.mean(axis=1), position_m[members], atol=ROUNDING_M)
    ahead_m = world(model, "boresight").bounds.mean(axis=0) - SCENE.receiver.position_m
    assert ahead_m[2] < -0.2 and abs(ahead_m[:2]).max() < ROUNDING_M  # it looks down


def test_a_ray_of_the_model_touches_both_its_ends(folder: Path, view: ViewPlan) -> None:
    model = trimesh.load_scene(folder / "scene.glb")
    for number, ray in enumerate(view.room.rays, start=1):
        (node,) = [node for node in model.graph.nodes_geometry if node.startswith(f"ray {number}: ")]
        vertices_m = world(model, node).vertices
        for point_m in ray.points_m:
            nearest_m = np.linalg.norm(vertices_m - point_m, axis=1).min()
            assert nearest_m < 0.008 + ROUNDING_M  # the tube's radius


def test_thousands_of_transmitters_stay_one_light_mesh(view: ViewPlan, tmp_path: Path) -> None:
    many = np.random.default_rng(0).uniform(0, 5, size=(5000, 3))
    room = replace(view.room, tx_position_m=many, in_sight=None, tx=0, rays=[])
    room_model(room).write(tmp_path / "many.glb")
    model = trimesh.load_scene(tmp_path / "many.glb")
    assert len(model.geometry["transmitters"].vertices) == 6 * 5000
    assert (tmp_path / "many.glb").stat().st_size < 2_000_000


def test_a_group_without_a_member_is_no_node(view: ViewPlan, tmp_path: Path) -> None:
    lit = np.ones(len(view.room.tx_position_m), dtype=bool)
    room_model(replace(view.room, in_sight=lit)).write(tmp_path / "lit.glb")
    nodes = set(trimesh.load_scene(tmp_path / "lit.glb").graph.nodes_geometry)
    assert "transmitters in sight" in nodes and "transmitters in shadow" not in nodes


def test_meshes_beside_the_data_are_drawn_and_others_are_not(tmp_path: Path) -> None:
    write_mitsuba(surface_meshes(SCENE), tmp_path)
    meshed = replace(SCENE, surface=(), scene="scene.xml", folder=tmp_path)
    path = store(meshed, tmp_path / "meshed.h5").path
    shown = plan_view(str(path), ONE_LIT_TX)
    assert not shown.missing and len(shown.room.meshes) == len(SCENE.surface)
    assert shown.with_rays().room.rays
    write_mitsuba(surface_meshes(replace(SCENE, surface=SCENE.surface[:2])), tmp_path)
    other = plan_view(str(path), ONE_LIT_TX)
    assert "scene.xml is missing or was changed" in other.missing and not other.room.meshes


def metres(points: list[int]) -> np.ndarray:
    return np.cumsum(np.reshape(points, (-1, 3)), axis=0) / 1000


def test_the_page_holds_the_room_that_is_drawn(folder: Path, view: ViewPlan) -> None:
    html = (folder / "index.html").read_text("utf-8")
    found = re.search('<script type="application/gzip" id="orbit-scene">(.*?)</script>', html, re.DOTALL)
    assert found and json.loads(gzip.decompress(b64decode(found.group(1)))) == orbit_scene(view.room)
    assert html.index("Permission is hereby granted") < html.index("THREE={}")  # the licence, above the library


def test_surfaces_of_a_material_are_one_mesh_and_fill_their_surfaces(view: ViewPlan) -> None:
    surfaces = orbit_scene(view.room)["surfaces"]
    assert len(surfaces) == len({surface.material for surface in SCENE.surface}) == 3
    area_m2 = 0.0
    for surface in surfaces:
        corners = metres(surface["points"])[np.cumsum(surface["triangles"]).reshape(-1, 3)]
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area_m2 += float(np.linalg.norm(sides, axis=1).sum() / 2)
    np.testing.assert_allclose(area_m2, 2 * 8 * 6 + 6 * 2.8 + 3 * 2.3)


def test_rays_run_from_the_transmitter_to_the_receiver_the_weakest_first(view: ViewPlan) -> None:
    backwards = replace(view.room, rays=view.room.rays[::-1])
    drawn = orbit_scene(backwards)
    assert drawn == orbit_scene(view.room)
    assert len(drawn["rays"]) == len(view.room.rays)
    for shown, ray in zip(drawn["rays"], sorted(view.room.rays, key=lambda ray: ray.level_db), strict=True):
        assert shown["colour"] == "#{:02x}{:02x}{:02x}".format(*ray_colour(ray.level_db))
        np.testing.assert_allclose(metres(shown["points"]), ray.points_m, atol=ROUNDED_M)
        assert shown["points"][:3] == drawn["transmitter"]
        np.testing.assert_array_equal(metres(shown["points"])[-1:], metres(drawn["receiver"]))


def test_a_room_of_which_nothing_but_places_is_known_is_drawn(view: ViewPlan) -> None:
    drawn = orbit_scene(replace(view.room, meshes=[], rays=[], in_sight=None))
    assert drawn["surfaces"] == drawn["rays"] == []
    np.testing.assert_allclose(metres(drawn["groups"][0]["points"]), view.room.tx_position_m, atol=ROUNDED_M)
