from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from xfreqbench.examples.make_office_cluttered import clutter, write_glb, write_scene
from xfreqbench.examples.make_open_office import BENCHES_M, furniture
from xfreqbench.examples.what_clutter_adds import variants

from tests.support.fuzzing.common import xfreqbench
from xfreqbench.errors import PlacementError, SceneError, UnknownNameError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.materials import Scattering
from xfreqbench.scene.meshes import SurfaceMesh, meshes_sha256, surface_meshes, write_mitsuba
from xfreqbench.scene.model import Surface, load_scene, parse_scene
from xfreqbench.scene.overlaps import check_overlaps
from xfreqbench.scene.placement import check_receiver, check_transmitters, choose_transmitters, place_transmitters
from xfreqbench.scene.toml_files import shipped_scenes
from xfreqbench.scene.visibility import distance_to_surfaces, enclosing_mesh, sees
from xfreqbench.tracing.image.tracer import can_solve
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

BOX = """
name = "box"
[receiver]
position_m = [2.0, 2.0, 2.5]
[transmitters]
min_m = [0.0, 0.0, 0.5]
max_m = [4.0, 4.0, 1.5]
step_m = [0.5, 0.5, 0.5]
clearance_m = 0.2
[[surface]]
name = "cabinet"
material = "metal"
thickness_m = 0.01
min_m = [1.0, 1.0, 0.0]
max_m = [3.0, 3.0, 1.2]
[[surface]]
name = "floor"
material = "concrete"
thickness_m = 0.2
min_m = [0.0, 0.0, -0.1]
max_m = [4.0, 4.0, -0.1]
"""


BOX_SCENE = parse_scene(BOX)


@pytest.mark.parametrize("name", ["office", "open_office", "office_cluttered", "two_rooms", "corridor", "empty"])
def test_every_shipped_scene_has_a_free_receiver_and_usable_transmitters(name: str) -> None:
    scene = load_scene(name)
    meshes = surface_meshes(scene)
    check_receiver(scene, meshes, 1e9)
    placement = place_transmitters(scene, meshes)
    check_transmitters(scene, meshes, placement.tx_position_m, [1e9, 94e9])
    check_overlaps(Geometry(meshes))
    assert len(placement.tx_position_m) + sum(placement.rejected.values()) == len(scene.transmitters.lattice_m)
    assert name in shipped_scenes()


@pytest.mark.parametrize("name", shipped_scenes())
def test_the_toml_of_a_shipped_scene_is_that_scene_in_any_folder(name: str, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(xfreqbench("scenes", name, "--toml").stdout, "utf-8")
    mine, shipped = load_scene(str(tmp_path / "mine.toml")), load_scene(name)
    assert replace(mine, scene=shipped.scene, folder=shipped.folder) == shipped
    assert mine.scene is None or Path(mine.scene).is_file()


def test_the_office_has_about_1446_transmitters_in_light_and_in_shadow() -> None:
    scene = load_scene("office")
    meshes = surface_meshes(scene)
    placement = place_transmitters(scene, meshes)
    assert abs(len(placement.tx_position_m) - 1446) < 20
    lit = sees(meshes, placement.tx_position_m, np.array(scene.receiver.position_m))
    assert 0.1 < (~lit).mean() < 0.5


def test_the_cluttered_office_is_the_office_and_what_its_script_adds(tmp_path: Path) -> None:
    shipped, office = load_scene("office_cluttered"), load_scene("office")
    written = load_scene(str(write_scene(tmp_path)))
    assert written.canonical_json == shipped.canonical_json
    for field in ("surface", "receiver", "transmitters"):
        assert getattr(shipped, field) == getattr(office, field)
    meshes = surface_meshes(shipped)
    assert {mesh.name for mesh in meshes[len(office.surface) :]} == set().union(*clutter().values())
    require_same_meshes(surface_meshes(written), meshes)
    assert can_solve(Geometry(meshes), TraceSettings().by("image"))


def require_same_meshes(ours: list[SurfaceMesh], theirs: list[SurfaceMesh]) -> None:
    for one, other in zip(ours, theirs, strict=True):
        assert (one.name, one.slab) == (other.name, other.slab)
        np.testing.assert_allclose(one.corners_m, other.corners_m, atol=1e-5)


def test_the_furniture_of_the_open_office_is_what_its_script_makes(tmp_path: Path) -> None:
    shipped = load_scene("open_office")
    write_glb(tmp_path / "open_office" / "furniture.glb", furniture())
    meshes = surface_meshes(shipped)
    require_same_meshes(surface_meshes(replace(shipped, folder=tmp_path)), meshes)
    assert len(place_transmitters(shipped, meshes).tx_position_m) == 1440
    tops = [surface for surface in shipped.surface if surface.name.startswith("bench")]
    np.testing.assert_allclose([np.add(top.min_m, top.max_m)[:2] / 2 for top in tops], BENCHES_M)  # where desks are
    assert can_solve(Geometry(meshes), TraceSettings().by("image"))


def test_each_row_of_the_table_of_clutter_is_another_room(tmp_path: Path) -> None:
    rows = [(meshes_sha256(surface_meshes(scene)), settings) for _, scene, settings in variants(tmp_path)]
    assert len(set(rows)) == len(rows)
    full = meshes_sha256(surface_meshes(load_scene("office_cluttered")))
    assert [number for number, (sha256, _) in enumerate(rows) if sha256 == full] == [8]


def test_rejected_transmitters_are_counted_by_reason() -> None:
    placement = place_transmitters(BOX_SCENE, surface_meshes(BOX_SCENE))
    inside = 5 * 5 * 2 - 16 * 2  # lattice points with x and y of 1…3 at z 0.5 and 1.0, less those on a face
    assert placement.rejected["inside an object"] >= inside
    assert placement.rejected["within 0.2 m of the receiver"] == 0
    assert len(placement.tx_position_m) + sum(placement.rejected.values()) == 9 * 9 * 3


def test_the_chosen_transmitters_depend_on_the_seed_alone() -> None:
    placement = place_transmitters(BOX_SCENE, surface_meshes(BOX_SCENE))
    chosen = choose_transmitters(placement, 10, seed=3)
    np.testing.assert_array_equal(chosen, choose_transmitters(placement, 10, seed=3))
    assert not np.array_equal(chosen, choose_transmitters(placement, 10, seed=4))
    with pytest.raises(PlacementError, match="Ask for 1 to"):
        choose_transmitters(placement, 10_000, seed=3)


def test_a_receiver_inside_an_object_names_it() -> None:
    scene = parse_scene(BOX.replace("[2.0, 2.0, 2.5]", "[2.0, 2.0, 1.0]"))
    with pytest.raises(PlacementError, match=r"Receiver.*inside 'cabinet'"):
        check_receiver(scene, surface_meshes(scene), 1e9)


@pytest.mark.parametrize(
    ("tx_m", "words"),
    [
        ([[0.2, 0.2, 1.0], [2.0, 2.0, 0.5]], "Transmitter 1 is inside 'cabinet'"),
        ([[0.5, 0.5, -0.095]], r"Transmitter 0 is 5\.0 mm from a surface"),
        ([[np.nan, 0.5, 1.0]], "finite"),
        (np.zeros((0, 3)), "at least one"),
    ],
)
def test_a_transmitter_where_none_can_be_is_named(tx_m: list[list[float]], words: str) -> None:
    with pytest.raises(PlacementError, match=words):
        check_transmitters(BOX_SCENE, surface_meshes(BOX_SCENE), np.array(tx_m), [1e9])


@pytest.mark.parametrize("carrier_hz", [1e9, 94e9])
def test_a_transmitter_on_an_element_of_the_array_is_refused(carrier_hz: float) -> None:
    receiver, meshes = BOX_SCENE.receiver, surface_meshes(BOX_SCENE)
    for position_m in (receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz)[5], np.array(receiver.position_m)):
        with pytest.raises(PlacementError, match="mm from the receiver array"):
            check_transmitters(BOX_SCENE, meshes, position_m[None] + 0.002, [10e9, carrier_hz])


def test_grid_positions_within_the_widest_aperture_are_left_out() -> None:
    scene = parse_scene(BOX.replace("[2.0, 2.0, 2.5]", "[2.0, 2.3, 1.5]"))
    meshes = surface_meshes(scene)
    near = "within 0.2 m of the receiver"
    assert place_transmitters(scene, meshes).rejected[near] == 0
    assert place_transmitters(scene, meshes, 0.5e9).rejected[near] > 0


def test_two_materials_in_one_place_are_refused() -> None:
    def with_posters(*starts_m: float) -> Geometry:
        posters = (Surface(f"poster {x}", "wood", 0.01, (x, 1.0, -0.1), (x + 0.5, 2.0, -0.1)) for x in starts_m)
        return Geometry(surface_meshes(replace(BOX_SCENE, surface=(*BOX_SCENE.surface, *posters))))

    overlaps = [r"'floor' [^;]* and 'poster \d.0' [^;]* overlap in one plane, at [^;]* m"] * 2
    with pytest.raises(SceneError, match=f"^{'; '.join(overlaps)}: a ray could meet either"):
        check_overlaps(with_posters(1.0, 3.0))
    check_overlaps(with_posters(4.0))


def sheet(name: str, slab: str, low: float, high: float, x_m: float = 0.0, parts: int = 1) -> SurfaceMesh:
    """A square of corners (x, low, low) and (x, high, high), of so many by so many parts."""
    side = np.linspace(low, high, parts + 1)
    vertices_m = np.stack([np.full((parts + 1) ** 2, x_m), *np.stack(np.meshgrid(side, side), -1).reshape(-1, 2).T], 1)
    first = (np.arange(parts)[:, None] * (parts + 1) + np.arange(parts)).reshape(-1, 1)
    triangles = np.concatenate([first + np.array(half) for half in ([0, 1, parts + 2], [0, parts + 2, parts + 1])])
    return SurfaceMesh(name, slab, 0.1, vertices_m, triangles)


@pytest.mark.parametrize("turn_deg", [0.0, 33.0])
@pytest.mark.parametrize("parts", [1, 7])
def test_a_pane_on_a_wall_is_found_among_any_number_of_triangles(turn_deg: float, parts: int) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1).apply_translation([2.5, 1.5, 2.8])
    lamp = SurfaceMesh("lamp", "glass", 0.1, np.array(ball.vertices), np.array(ball.faces, np.int64))
    turn = trimesh.transformations.rotation_matrix(np.radians(turn_deg), [0.3, 0.5, 0.8], [40, 2, 0])
    place = partial(trimesh.transformations.transform_points, matrix=turn)
    wall, pane = sheet("wall", "concrete", 0, 3, parts=parts), sheet("pane", "glass", 1, 2)
    near, beside = sheet("near", "glass", 1, 2, x_m=0.001), sheet("beside", "glass", 3, 4)
    for meshes in ((wall, pane, lamp), (lamp, pane, wall), (pane, beside, wall, near)):
        placed = [replace(mesh, vertices_m=place(mesh.vertices_m)) for mesh in meshes]
        with pytest.raises(SceneError, match=r"'(wall|pane)' .* and '(wall|pane)' .* overlap in one plane, at \("):
            check_overlaps(Geometry(placed))
        check_overlaps(Geometry([mesh for mesh in placed if mesh.name != "pane"]))
        same = [replace(mesh, material="concrete") if mesh.name == "pane" else mesh for mesh in placed]
        check_overlaps(Geometry(same))


def test_surfaces_that_scatter_otherwise_are_refused_where_they_overlap() -> None:
    floor = surface_meshes(BOX_SCENE)[-1]
    check_overlaps(Geometry([floor, replace(floor, name="again")]))
    check_overlaps(Geometry([replace(floor, triangles=floor.triangles[:1])]))  # nor does a triangle with itself
    rough = replace(floor, name="rough", scattering=Scattering(0.3))
    with pytest.raises(SceneError, match=r"'floor' .* and 'rough' .* overlap in one plane"):
        check_overlaps(Geometry([floor, rough]))


def test_an_array_on_both_sides_of_a_wall_is_refused() -> None:
    scene = load_scene("flat")
    scene, meshes = replace(scene, receiver=scene.receivers[3], other_receivers=()), surface_meshes(scene)
    check_receiver(scene, meshes, 10e9)
    with pytest.raises(PlacementError, match="'4': at 1 GHz a surface is between"):
        check_receiver(scene, meshes, 1e9)


def test_an_array_too_wide_for_its_place_is_refused_at_the_low_carrier_only() -> None:
    scene = parse_scene(BOX.replace("[2.0, 2.0, 2.5]", "[0.7, 2.0, 1.0]"))
    meshes = surface_meshes(scene)
    check_receiver(scene, meshes, 94e9)
    with pytest.raises(PlacementError, match=r"at 0\.5 GHz"):
        check_receiver(scene, meshes, 0.5e9)


def test_a_scene_with_faults_lists_them_all_with_their_places() -> None:
    broken = BOX.replace('name = "floor"', 'nmae = "floor"').replace("step_m = [0.5", "step_m = [-0.5")
    with pytest.raises(SceneError) as caught:
        parse_scene(broken)
    assert "surface.1.nmae" in str(caught.value)
    assert "transmitters.step_m.0" in str(caught.value)


def test_of_very_many_faults_some_are_named_and_keys_of_very_many_parts_are_not_read() -> None:
    with pytest.raises(SceneError) as told:
        parse_scene(BOX + "[[surface]]\nnme = 1\n" * 1000)
    assert len(str(told.value).splitlines()) == 22
    assert str(told.value).endswith("\n  and 2980 more")
    for text in ("a." * 10_001 + "b = 1\n" + BOX, BOX + "c = {" + "a." * 10_001 + "b = 1}\n"):
        with pytest.raises(SceneError, match="more than 10,000 points"):
            parse_scene(text)
    scene = parse_scene(BOX)
    assert scene.materials is scene.materials  # of which each surface asks


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("max_m = [3.0, 3.0, 1.2]", "max_m = [3.0, 0.5, 1.2]", "must exceed min_m"),
        ('name = "floor"', 'name = "cabinet"', "two surfaces are named 'cabinet'"),
        ("position_m = [2.0, 2.0, 2.5]", "position_m = [2.0, inf, 2.5]", "finite"),
        ("[receiver]", "[receiver", "not TOML"),
        (
            'name = "box"',
            'name = "box"\nunit = "mm"',
            "'unit' is for the meshes of a file, but the scene names no file",
        ),
        ('name = "box"', 'name = "box"\nup = "y"', "'up' is for the meshes of a file"),
    ],
)
def test_scenes_that_mean_nothing_are_refused(old: str, new: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        parse_scene(BOX.replace(old, new))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_byte_order_mark_is_no_part_of_a_scene(tmp_path: Path, encoding: str) -> None:
    text = BOX.replace('"box"', '"büro"')
    (tmp_path / "box.toml").write_bytes(text.replace("\n", "\r\n").encode(encoding))
    assert load_scene(tmp_path / "box.toml") == parse_scene(text, tmp_path)
    (tmp_path / "box.toml").write_bytes(text.encode("latin-1"))
    with pytest.raises(SceneError, match=r"box\.toml is not text in UTF-8 .* Save it in that encoding"):
        load_scene(tmp_path / "box.toml")


def test_unknown_scenes_and_materials_name_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'office'"):
        load_scene("offcie")
    (tmp_path / "box.toml").write_text(BOX.replace('"concrete"', '"conrete"', 1), encoding="utf-8")
    with pytest.raises(SceneError, match=r"box\.toml: (.|\n)*surface 'floor': .* Did you mean 'concrete'"):
        load_scene(tmp_path / "box.toml")
    with pytest.raises(SceneError, match="cannot be read"):
        load_scene("no/such/place.toml")


@pytest.mark.parametrize(
    ("table", "key", "nearest"),
    [
        ("[receiver]", "row = 8", "receiver.row: There is no key 'row'. Did you mean 'rows'? Choose one of: antenna_"),
        ("[transmitters]", "step = 0.5", "transmitters.step: There is no key 'step'. Did you mean 'step_m'?"),
        (
            "[[surface]]",
            "thickness = 1",
            "surface.0.thickness: There is no key 'thickness'. Did you mean 'thickness_m'?",
        ),
        ("[receiver]", "polarisation = 'H'", "Did you mean 'polarization'?"),
        ('name = "box"', "recievers = 1", "recievers: There is no key 'recievers'. Did you mean 'receiver'?"),
        ("[receiver]", "[[receiver]]\nname = 'one'\nboresite = 1", "Did you mean 'boresight'?"),
        (
            "[receiver]",
            "[[receiver]]\nposition_m = [1, 1, 1]\nname = 'one'\n[[receiver]]\nrow = 1",
            "receiver.1.row: There",
        ),
        (
            'name = "box"',
            "[[material]]\nname = 'a'\n[[material.layers]]\nmaterials = 'b'\n",
            "Did you mean 'material'?",
        ),
    ],
)
def test_an_unknown_key_of_a_table_names_the_nearest_and_all(table: str, key: str, nearest: str) -> None:
    content = key if key.startswith("[[rec") else f"{table}\n{key}"
    with pytest.raises(SceneError, match=re.escape(nearest)):
        parse_scene(BOX.replace(table, content, 1))


def test_a_users_mitsuba_scene_gives_the_same_meshes(tmp_path: Path) -> None:
    meshes = surface_meshes(BOX_SCENE)
    write_mitsuba(meshes, tmp_path)
    imported = parse_scene(BOX[: BOX.index("[[surface]]")].replace('"box"', '"box"\nscene = "scene.xml"'), tmp_path)
    again = surface_meshes(imported)
    assert [(m.name, m.material, m.thickness_m) for m in again] == [(m.name, m.material, m.thickness_m) for m in meshes]
    for mesh, original in zip(again, meshes, strict=True):
        np.testing.assert_allclose(mesh.corners_m, original.corners_m, atol=1e-6)  # PLY holds float32


def test_a_cabinet_encloses_whichever_way_its_faces_are_turned_and_however_often_they_are_given() -> None:
    whole = surface_meshes(BOX_SCENE)[0]
    turned = whole.triangles[:, ::-1]
    points = np.array([[2.0, 2.0, 0.6], [1.1, 1.2, 1.1], [2.9, 1.1, 0.1], [2.0, 2.0, 1.3], [0.9, 2.0, 0.6]])
    for flipped in ([0], [0, 1, 2, 3], range(6), range(0, 12, 2), range(12)):
        faces = np.where(np.isin(np.arange(12), flipped)[:, None], turned, whole.triangles)
        for triangles in (faces, np.vstack([faces, turned]), np.vstack([faces, faces[:5]])):
            mesh = replace(whole, triangles=triangles)
            assert enclosing_mesh([mesh], points).tolist() == [0, 0, 0, -1, -1], (flipped, len(triangles))
    assert enclosing_mesh([replace(whole, triangles=whole.triangles[1:])], points).tolist() == [-1] * 5
    flap_m = np.vstack([whole.vertices_m, [[1, 1, 0.5], [3, 1, 0.5], [3, 4, 0.5]]])  # which stands out of it
    shelved = replace(whole, vertices_m=flap_m, triangles=np.vstack([whole.triangles, [[8, 9, 10]]]))
    assert enclosing_mesh([shelved], points).tolist() == [0, 0, 0, -1, -1]
    both_m = np.vstack([whole.vertices_m, 0.9 * whole.vertices_m + [0.2, 0.2, 0.06]])  # a hollow one of thick walls
    hollow = replace(whole, vertices_m=both_m, triangles=np.vstack([turned[:1], whole.triangles[1:], 8 + turned]))
    assert enclosing_mesh([hollow], points).tolist() == [-1, 0, 0, -1, -1]


def test_geometry_queries_agree_with_closed_forms() -> None:
    cabinet, floor = surface_meshes(BOX_SCENE)
    points = np.random.default_rng(0).uniform(-1, 5, (2000, 3))
    low, high = np.array([1, 1, 0.0]), np.array([3, 3, 1.2])
    inside = ((points > low) & (points < high)).all(axis=1)
    np.testing.assert_array_equal(enclosing_mesh([floor, cabinet], points) == 1, inside)
    outside_m = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=1)
    np.testing.assert_allclose(distance_to_surfaces([cabinet], points)[~inside], outside_m[~inside], atol=1e-9)
    end = np.array([2.0, 2.0, -1.0])
    at_floor = points + ((-0.1 - points[:, 2]) / (end[2] - points[:, 2]))[:, None] * (end - points)
    blocked = (points[:, 2] > -0.1) & ((at_floor[:, :2] > 0) & (at_floor[:, :2] < 4)).all(axis=1)
    np.testing.assert_array_equal(sees([floor], points, end), ~blocked)


def test_the_digest_follows_geometry_and_material() -> None:
    changed = (BOX, BOX.replace("0.2\n", "0.3\n"), BOX.replace('"concrete"', '"glass"'))
    assert len({meshes_sha256(surface_meshes(parse_scene(text))) for text in changed}) == 3
