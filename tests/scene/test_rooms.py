"""Rooms that are closed meshes, objects in which nothing stands, and rooms that promise to be closed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.support import mesh_scenes
from tests.support.mesh_scenes import PLACES, WOOD, file_shape, scene_with, shape, to_world, write_meshes
from tests.support.plans import plan_generation
from xfreqbench.errors import PlacementError, SceneError, UnknownNameError
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Scene, parse_scene
from xfreqbench.scene.placement import are_outside, check_receiver, check_transmitters, place_transmitters
from xfreqbench.scene.rooms import check_closed, objects_of
from xfreqbench.tracing.tracer import TraceSettings


def box(name: str, low_m: list[float], high_m: list[float]) -> str:
    return f'[[surface]]\nname = "{name}"\nmaterial = "wood"\nthickness_m = 0.02\nmin_m = {low_m}\nmax_m = {high_m}\n'


ROOM = box("room", [0.0, 0.0, 0.0], [5.0, 4.0, 3.0])
CABINET = box("cabinet", [0.5, 0.5, 0.1], [1.5, 1.5, 2.0])  # about the receiver
ASIDE = box("aside", [2.0, 1.0, 0.1], [3.0, 2.0, 0.7])
SILL = box("sill", [4.9, 1.0, 0.8], [5.25, 2.0, 0.85])  # stands out of the room by a quarter of a metre
NEXT = box("next", [5.3, 0.0, 0.0], [9.0, 4.0, 3.0])


def scene_of(*surfaces: str, top: str = "") -> Scene:
    return parse_scene(f'name = "test"\n{top}\n{PLACES}{"".join(surfaces)}')


def check(scene: Scene) -> None:
    meshes = surface_meshes(scene)
    check_receiver(scene, meshes, 10e9)
    placed = place_transmitters(scene, meshes, 10e9)
    check_transmitters(scene, meshes, placed.tx_position_m, [10e9])


@pytest.mark.parametrize("others", [[], [ASIDE], [ASIDE, SILL]])
def test_a_closed_box_about_everything_is_a_room(others: list[str]) -> None:
    scene = scene_of(ROOM, *others)
    check(scene)
    assert "room" not in {mesh.name for mesh in objects_of(scene, surface_meshes(scene))}


@pytest.mark.parametrize("others", [[ROOM], [ASIDE], [ROOM, ASIDE]])
def test_a_cabinet_about_the_receiver_is_none(others: list[str]) -> None:
    with pytest.raises(PlacementError, match=r"Receiver.*inside 'cabinet'.*rooms = \['cabinet'\]"):
        check(scene_of(CABINET, *others))


def test_a_room_and_what_is_in_it_may_be_one_mesh(tmp_path: Path) -> None:
    joined = mesh_scenes.ROOM + mesh_scenes.TABLE + trimesh.creation.box(bounds=[[0.5, 0.5, 1.0], [1.5, 1.5, 2.0]])
    joined.export(tmp_path / "all.ply")
    scene = scene_with(tmp_path, WOOD, file_shape("all.ply"))
    meshes = surface_meshes(scene)
    assert len(objects_of(scene, meshes)) == 2
    with pytest.raises(PlacementError, match="Receiver array point 0 is inside 's'"):
        check_receiver(scene, meshes, 10e9)
    aside = replace(scene, receiver=replace(scene.receiver, position_m=(1.0, 3.0, 1.5)))
    check_receiver(aside, meshes, 10e9)
    with pytest.raises(PlacementError, match="Transmitter 0 is inside 's'"):
        check_transmitters(aside, meshes, np.array([[2.5, 1.5, 0.4]]), [10e9])


def test_the_space_between_walls_of_two_shells_is_free(tmp_path: Path) -> None:
    """A room with solid walls is an outer shell and an inner one turned inside out: inside, the air is free."""
    inner = mesh_scenes.ROOM.copy()
    inner.invert()
    (inner + trimesh.creation.box(bounds=[[-0.2] * 3, [5.2, 4.2, 3.2]])).export(tmp_path / "solid.ply")
    scene = scene_with(tmp_path, WOOD, file_shape("solid.ply"))
    check(scene)
    with pytest.raises(PlacementError, match="Transmitter 0 is inside 's'"):
        check_transmitters(scene, surface_meshes(scene), np.array([[-0.1, 2.0, 1.0]]), [10e9])


def test_rooms_side_by_side_are_named() -> None:
    with pytest.raises(PlacementError, match=r"rooms = \['room'\]"):
        check(scene_of(ROOM, NEXT))
    scene = scene_of(ROOM, NEXT, ASIDE, top='rooms = ["room", "next"]')
    check(scene)
    assert [mesh.name for mesh in objects_of(scene, surface_meshes(scene))] == ["aside"]
    with pytest.raises(UnknownNameError, match=r"mesh for a room 'rom'\. Did you mean 'room'"):
        check(scene_of(ROOM, NEXT, top='rooms = ["rom"]'))
    floor = box("floor", [0.0, 0.0, 0.0], [5.0, 4.0, 0.0])
    with pytest.raises(SceneError, match="'floor' as a room, but some of its edges"):
        check(scene_of(floor, top='rooms = ["floor"]'))


@pytest.mark.parametrize("kind", ["ply", "obj", "stl"])
def test_a_room_that_is_one_mesh_can_be_planned(tmp_path: Path, kind: str) -> None:
    """STL repeats the vertices of every triangle, and is closed nonetheless."""
    write_meshes(tmp_path)
    scene = scene_with(tmp_path, WOOD, file_shape(f"meshes/room.{kind}"), file_shape("meshes/table.ply"))
    plan = plan_generation(scene, [2.4e9, 60e9], maps=False)
    assert (len(plan.tx_position_m), plan.tracing.settings.solver) == (2, "image")
    assert plan.line_of_sight.all()


def test_a_hole_in_what_is_promised_closed_is_found() -> None:
    walls = [
        box("floor", [0.0, 0.0, 0.0], [5.0, 4.0, 0.0]), box("ceiling", [0.0, 0.0, 3.0], [5.0, 4.0, 3.0]),
        box("west", [0.0, 0.0, 0.0], [0.0, 4.0, 3.0]), box("east", [5.0, 0.0, 0.0], [5.0, 4.0, 3.0]),
        box("south", [0.0, 0.0, 0.0], [5.0, 0.0, 3.0]), box("north", [0.0, 4.0, 0.0], [5.0, 4.0, 3.0]),
    ]  # fmt: skip
    promise = "closed = true"
    for sound in (scene_of(*walls, top=promise), scene_of(ROOM, top=promise), scene_of(*walls[1:])):
        check_closed(sound, surface_meshes(sound))
    open_below = scene_of(*walls[1:], top=promise)
    with pytest.raises(PlacementError, match=r"closed = true, but [\d,]+ of 10,000 rays.*towards \["):
        plan_generation(open_below, [10e9])
    empty = scene_of(top=promise)
    with pytest.raises(PlacementError, match="10,000 of 10,000 rays"):
        check_closed(empty, surface_meshes(empty))


def room_of_file(folder: Path, scale: float = 1.0, toml: str = "") -> Scene:
    mesh_scenes.ROOM.copy().apply_scale(scale).export(folder / "room.ply")
    return scene_with(folder, WOOD, file_shape("room.ply"), toml=toml)


def test_who_stands_outside_of_everything_is_asked_about(tmp_path: Path) -> None:
    scene = room_of_file(tmp_path)
    meshes = surface_meshes(scene)
    for x, y, z in ((7.0, 1.0, 1.5), (1.0, -0.5, 1.5), (1.0, 1.0, -2.0), (1.0, 1.0, 2300.0)):
        astray = replace(scene, receiver=replace(scene.receiver, position_m=(x, y, z)))
        with pytest.raises(PlacementError, match=r"The receiver .*outside of all meshes, at .*5\.00 × 4\.00 × 3\.00 m"):
            check_receiver(astray, meshes, 10e9)
        check_receiver(replace(astray, outside=True), meshes, 10e9)
    far_m = (691000.25, 5334000.5, 1.5)
    with pytest.raises(PlacementError, match=r"at \(691000\.25, 5334000\.5, 1\.5\) m"):
        check_receiver(replace(scene, receiver=replace(scene.receiver, position_m=far_m)), meshes, 10e9)
    grid = replace(scene.transmitters, min_m=(7.0, 3.0, 1.5), max_m=(8.0, 3.0, 1.5))
    for asked, tx_m in ((replace(scene, transmitters=grid), None), (scene, grid.lattice_m)):
        with pytest.raises(PlacementError, match=r"Every transmitter .* outside of all meshes"):
            plan_generation(asked, [10e9], tx_positions=tx_m)
    some = plan_generation(scene, [10e9], tx_positions=np.array([[7.0, 3.0, 1.5], [4.0, 3.0, 1.5]]), maps=False)
    assert some.summary.endswith("; 1 transmitters are outside")


@pytest.mark.parametrize("scale", [1000.0, 100.0, -100.0])
def test_positions_in_another_unit_are_asked_about_in_every_scene(tmp_path: Path, scale: float) -> None:
    places_m = np.array([[1.2, 3.1, 1.5], [2.0, 3.3, 1.2]])
    ground = shape("rectangle", to_world('<scale x="5" y="4" z="1"/>'))
    for scene in (scene_of(ROOM), scene_of(box("floor", [0, 0, 0], [5, 4, 0])), scene_with(tmp_path, WOOD, ground)):
        meshes = surface_meshes(scene)
        check_transmitters(scene, meshes, np.vstack([scale * places_m, places_m]), [10e9])  # some are inside
        with pytest.raises(PlacementError, match=r"Every transmitter .*outside of all .* in metres, .*outside = true"):
            check_transmitters(scene, meshes, scale * places_m, [10e9])
        check_transmitters(replace(scene, outside=True), meshes, scale * places_m, [10e9])
    check_transmitters(scene_of(ROOM), surface_meshes(scene_of(ROOM)), places_m + 9, [10e9])  # beside the room
    check_transmitters(scene_of(), [], scale * places_m, [10e9])


def test_nothing_is_outside_of_a_single_wall_however_it_is_turned(tmp_path: Path) -> None:
    wall = '<transform name="to_world"><scale value="3"/><rotate x="1" angle="90"/><rotate {} angle="37"/></transform>'
    for axis in ('z="1"', 'x="1" y="0.3"'):
        scene = scene_with(tmp_path, WOOD, shape("rectangle", wall.format(axis)))
        assert not are_outside(surface_meshes(scene), np.array([[9.0, 9.0, 9.0], [0.0, 0.0, -9.0]])).any()


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1000.0), ("cm", 100.0), ("in", 1 / 0.0254)])
def test_a_room_in_another_unit_is_asked_about(tmp_path: Path, unit: str, scale: float) -> None:
    scene = room_of_file(tmp_path, scale)
    with pytest.raises(SceneError, match=rf"measures {5 * scale:,.2f} × .* its room is more than 60 m high"):
        plan_generation(scene, [10e9])
    check_receiver(replace(scene, unit="m"), surface_meshes(scene), 10e9)  # it was said
    told = room_of_file(tmp_path, scale, f'unit = "{unit}"')
    assert "meshes: 5.00 × 4.00 m, 3.00 m high; 94.00 of 94.00 m² mirror" in plan_generation(told, [10e9]).summary


def test_the_plan_names_panes_that_nothing_passes(tmp_path: Path) -> None:
    pane, door = (box(name, [2.5, 0.5, 0.5], [2.5 + thick, 2, 2]) for name, thick in (("pane", 0.006), ("door", 0.04)))
    settings = TraceSettings("sionna")
    told = plan_generation(scene_of(ROOM, pane), [10e9], settings).summary
    assert "\nthinner than 10 mm, so that in Sionna RT nothing passes both faces: pane; " in told
    turned = to_world('<scale x="0.003" y="0.5" z="0.5"/>', '<rotate z="1" y="1" angle="30"/>')
    shape_of = shape("cube", turned.replace("</transform>", '<translate x="2.5" y="2" z="1.5"/></transform>'))
    told = plan_generation(scene_with(tmp_path, WOOD, shape_of, toml="outside = true"), [10e9], settings).summary
    assert "nothing passes both faces: s; " in told
    assert "thinner" not in plan_generation(scene_of(ROOM, door), [10e9], settings).summary
    assert "thinner" not in plan_generation(scene_of(ROOM, pane), [10e9]).summary


@pytest.mark.parametrize(("apart_m", "told"), [(0.0, "0 mm"), (2e-5, "0.02 mm"), (8e-4, "0.8 mm"), (2e-3, "")])
def test_the_plan_names_objects_that_nearly_lie_in_one_plane(apart_m: float, told: str) -> None:
    wall, copy = box("wall", [2.5, 0.5, 0.5], [2.6, 2, 2]), box("copy", [2.6 + apart_m, 0.6, 0.6], [2.7, 1.9, 1.9])
    summary = plan_generation(scene_of(ROOM, wall, copy), [10e9]).summary
    assert f"\n'wall' and 'copy' are {told} apart at" in summary if told else "apart" not in summary


def test_the_plan_says_what_of_meshes_mirrors(tmp_path: Path) -> None:
    scene = room_of_file(tmp_path, toml="least_patch_area_m2 = 16")
    told = "40.00 of 94.00 m² mirror, the largest patch is 20.00 m²; 8 of 12 triangles do not"
    assert plan_generation(scene, [10e9], maps=False).summary.endswith(f"\nmeshes: 5.00 × 4.00 m, 3.00 m high; {told}")
