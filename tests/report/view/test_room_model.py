"""The model of a room, read again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from tests.support.screened_room import ONE_LIT_TX, SCENE, store
from xfreqbench.data.dataset import PasDataset
from xfreqbench.report.view.plan import ViewPlan, plan_view
from xfreqbench.report.view.write import room_model
from xfreqbench.scene.meshes import surface_meshes, write_mitsuba

ROUNDING_M = 1e-5  # of float32 metres in a room


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
    assert "scene.xml is missing or another" in other.missing and not other.room.meshes
