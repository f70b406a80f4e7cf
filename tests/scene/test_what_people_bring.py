"""Scenes of Sionna RT, own materials from end to end, and hashes that later inputs have not changed."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.mesh_scenes import PLACES, WOOD, file_shape, scene_of_file, scene_with, write_meshes
from tests.support.plans import plan_generation
from xfreqbench.errors import SceneError, UnknownNameError
from xfreqbench.scene.materials import ConstantMaterial, Scattering
from xfreqbench.scene.meshes import meshes_sha256, surface_meshes, write_mitsuba
from xfreqbench.scene.model import load_scene, parse_scene
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import TraceSettings

# Of meshes and of the scene's JSON, before GLB, OBJ, transforms, own materials and rooms could be given.
SHIPPED = {
    "corridor": ("d469559e6b3ad9eb", "ee7cc39a1d0f3b64"),
    "empty": ("e3b0c44298fc1c14", "22432289376c81f8"),
    "lounge": ("3a9733bb3952b748", "371502a4ceee4812"),
    "office": ("8f59e2cc110cf6f6", "5f8a1436a4670e4f"),
    "office_cluttered": ("99711f43c4edcd6e", "5ab5b6b4a18a4f59"),
    "open_office": ("6aecc59ca96afe8d", "62c4beb56356ec8b"),
    "two_rooms": ("b42b44cd08745dec", "88149a990bd70de3"),
}
OWN = '[[material]]\nname = "foam"\nrelative_permittivity = 1.5\nconductivity_s_m = 0.002\n'
FOAM = """[[surface]]
name = "wall"
material = "foam"
thickness_m = 0.1
min_m = [0.0, 0.0, 0.0]
max_m = [0.0, 4.0, 3.0]
"""
PLAIN = TraceSettings(interactions=("specular", "refraction"))


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenes_have_the_hashes_that_they_always_had(name: str) -> None:
    scene = load_scene(name)
    found = meshes_sha256(surface_meshes(scene)), hashlib.sha256(scene.canonical_json.encode()).hexdigest()
    assert tuple(digest[:16] for digest in found) == SHIPPED[name]


def test_meshes_that_were_read_before_have_the_hash_of_then(tmp_path: Path) -> None:
    """Of a PLY and materials of both kinds, as an export of the first version's documents had them."""
    named = '<bsdf type="twosided" id="mat-itu_glass"><float name="thickness" value="0.008"/></bsdf>'
    write_meshes(tmp_path)
    pane = '<ref id="mat-itu_glass" name="bsdf"/>'
    shapes = file_shape("meshes/table.ply"), file_shape("meshes/room.ply", material=pane)
    meshes = surface_meshes(scene_with(tmp_path, WOOD, named, *shapes))
    assert [mesh.thickness_m for mesh in meshes] == [0.1, 0.008]
    assert meshes_sha256(meshes)[:16] == "1eba06249f5081c3"


def test_scenes_of_sionna_rt_are_named(tmp_path: Path) -> None:
    for name, num_triangles, material in (("floor_wall", 4, "brick"), ("box_two_screens", 16, "glass")):
        meshes = surface_meshes(scene_of_file(tmp_path, f"sionna:{name}"))
        assert sum(len(mesh.triangles) for mesh in meshes) == num_triangles
        assert material in {mesh.material for mesh in meshes}
    plan = plan_generation(scene_of_file(tmp_path, "sionna:box"), [2.4e9], replace(PLAIN, max_depth=2), maps=False)
    assert len(plan.tx_position_m) == 2  # a box is a room
    with pytest.raises(UnknownNameError, match=r"scene of Sionna RT 'floor_wal'\. Did you mean 'floor_wall'"):
        surface_meshes(scene_of_file(tmp_path, "sionna:floor_wal"))
    with pytest.raises(UnknownNameError, match="scene of Sionna RT"):
        surface_meshes(scene_of_file(tmp_path, "sionna:../scenes/box"))


def test_a_surface_may_be_of_a_material_of_the_scenes_own() -> None:
    scene = parse_scene(f'name = "test"\n{PLACES}{OWN}{FOAM}')
    (wall,) = surface_meshes(scene)
    assert wall.material == ConstantMaterial("foam", 1.5, 0.002)
    plan = plan_generation(scene, [1e9, 500e9], maps=False)  # no band ends there
    assert "the same at every carrier: foam (ε′ 1.5, σ 0.002 S/m)" in plan.summary
    changed = parse_scene(f'name = "test"\n{PLACES}{OWN.replace("0.002", "0.003")}{FOAM}')
    assert meshes_sha256(surface_meshes(scene)) != meshes_sha256(surface_meshes(changed))


@pytest.mark.sionna
def test_both_solvers_give_one_channel_with_an_own_material() -> None:
    scene = parse_scene(f'name = "test"\n{PLACES}{OWN}{FOAM}')
    tx_position_m, carriers_hz = np.array([[3.5, 3.0, 1.5]]), [1e9, 30e9]
    vacuum = parse_scene(f'name = "test"\n{PLACES}{OWN.replace("1.5", "1.0").replace("0.002", "0.0")}{FOAM}')
    settings = replace(PLAIN, max_depth=1, rays=10_000)
    image, sionna, nothing = (
        tracer_of(traced, carriers_hz, replace(settings, solver=solver)).channel(tx_position_m).cfr
        for traced, solver in ((scene, "image"), (scene, "sionna"), (vacuum, "image"))
    )
    assert np.abs(image - sionna).max() < 2e-3 * np.abs(image).max()  # Sionna's float32
    assert np.abs(image - nothing).max() > 0.01 * np.abs(image).max()


@pytest.mark.sionna
def test_a_slab_that_single_precision_cannot_hold_is_refused() -> None:
    thick = FOAM.replace("thickness_m = 0.1", "thickness_m = 1000.0")
    scene = parse_scene(f'name = "test"\n{PLACES}{OWN.replace("0.002", "1e9")}{thick}')
    tracer = tracer_of(scene, [94e9], replace(PLAIN, solver="sionna", max_depth=1, rays=10_000))
    with pytest.raises(SceneError, match=r"At 94 GHz Sionna RT gives 16 of 32 paths a field that is not a number"):
        tracer.channel(np.array([[3.5, 3.0, 1.5]]))


@pytest.mark.sionna
def test_sionna_is_given_own_materials_as_they_are(tmp_path: Path) -> None:
    from xfreqbench.tracing.sionna.scene import RadioScene

    meshes = surface_meshes(parse_scene(f'name = "test"\n{PLACES}{OWN}{FOAM}'))
    loaded = RadioScene(meshes)
    loaded.set_carrier(60e9)
    (material,) = loaded.sionna.radio_materials.values()
    np.testing.assert_allclose([material.relative_permittivity[0], material.conductivity[0]], [1.5, 0.002], rtol=1e-6)
    again = surface_meshes(scene_of_file(tmp_path, str(write_mitsuba(meshes, tmp_path))))
    assert str(again[0].material) == "mat-own-0"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('name = "foam"', "no ITU-R P.2040 material 'foam'"),
        ('name = "foam"\nitu = "fom"', "no ITU-R P.2040 material 'fom'"),
        ('name = "foam"\nconductivity_s_m = 1.0', "give its relative_permittivity too"),
        ('name = "foam"\nitu = "wood"\nrelative_permittivity = 2.0', "give one of them"),
        ('name = "foam"\nrelative_permittivity = 0.5', "greater than or equal to 1"),
        ('name = "foam"\nrelative_permittivity = nan', "material.0.relative_permittivity"),
        ('name = "foam"\nitu = "wood"\n[[material]]\nname = "foam"\nitu = "wood"', "two materials are named 'foam'"),
    ],
)
def test_a_table_of_materials_without_sense_is_refused(table: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        parse_scene(f'name = "test"\n{PLACES}[[material]]\n{table}\n')


def rough_wood(**fields: object) -> str:
    told = ", ".join(f"{name} = {value!r}" for name, value in fields.items())
    return f'[[material]]\nname = "wood"\nscattering = {{{told}}}\n'


def test_scattering_is_read_from_the_table_and_from_xml(tmp_path: Path) -> None:
    write_meshes(tmp_path)
    table = file_shape("meshes/table.ply")
    stated = '<float name="scattering_coefficient" value="0.3"/><float name="xpd_coefficient" value="0.1"/></bsdf>'
    lobe = '<string name="scattering_pattern" value="directive"/><integer name="alpha_r" value="4"/></bsdf>'
    smooth, flat, rough, directive, own = (
        surface_meshes(scene_with(tmp_path, bsdf, table, toml=toml))
        for bsdf, toml in (
            (WOOD, ""),
            (WOOD.replace("</bsdf>", stated.replace("0.3", "0")), ""),
            (WOOD.replace("</bsdf>", stated), ""),
            (WOOD.replace("</bsdf>", stated).replace("</bsdf>", lobe), ""),
            (WOOD.replace("</bsdf>", stated), rough_wood(coefficient=0.5)),
        )
    )
    assert meshes_sha256(flat) == meshes_sha256(smooth)
    assert len({meshes_sha256(meshes) for meshes in (smooth, rough, directive, own)}) == 4
    assert rough[0].scattering == Scattering(0.3, xpd_coefficient=0.1)
    assert directive[0].scattering == Scattering(0.3, xpd_coefficient=0.1, pattern="directive", alpha_r=4)
    assert own[0].scattering == Scattering(0.5)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"coefficient": 1.5}, "less than or equal to 1"),
        ({"coefficient": 0.3, "pattern": "shiny"}, "'lambertian', 'directive' or 'backscattering'"),
        ({"coefficient": 0.3, "pattern": "directive"}, "'directive' has alpha_r, but none is stated"),
        ({"coefficient": 0.3, "alpha_r": 4}, "'lambertian' has no numbers, but alpha_r is stated"),
        ({"pattern": "lambertian"}, "material.0.scattering.coefficient: Field required"),
        ({"coefficient": 0.3, "pattern": "directive", "alpha_r": 0}, "greater than or equal to 1"),
    ],
)
def test_scattering_without_sense_is_refused(tmp_path: Path, fields: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        parse_scene(f'name = "test"\n{PLACES}{rough_wood(**fields)}')
    write_meshes(tmp_path)
    names = {"coefficient": "scattering_coefficient", "pattern": "scattering_pattern"}
    tags = {"pattern": "string", "alpha_r": "integer"}
    told = "".join(
        f'<{tags.get(key, "float")} name="{names.get(key, key)}" value="{value}"/>' for key, value in fields.items()
    )
    if "coefficient" in fields:
        with pytest.raises(SceneError, match=r"scene\.xml: material 'M', "):
            surface_meshes(
                scene_with(tmp_path, WOOD.replace("</bsdf>", f"{told}</bsdf>"), file_shape("meshes/table.ply"))
            )


def test_a_plan_tells_how_a_scene_scatters() -> None:
    table = rough_wood(coefficient=0.3, pattern="directive", alpha_r=4)
    scene = parse_scene(f'name = "test"\n{PLACES}{table}{FOAM.replace("foam", "wood")}')
    without = plan_generation(scene, [1e9], maps=False)
    assert without.tracing.settings.solver == "image"
    assert "scattering: wood (S 0.3, directive), but the interaction diffuse is not traced" in without.summary
    settings = TraceSettings(interactions=("specular", "diffuse"), rays=1000)
    traced = plan_generation(scene, [1e9], settings, maps=False)
    assert "scattering: wood (S 0.3, directive)\n" in traced.summary + "\n"
    told = {"material": "wood", "coefficient": 0.3, "xpd_coefficient": 0.0, "pattern": "directive", "alpha_r": 4}
    assert traced.header.settings["scattering"] == [told]
    smooth = parse_scene(f'name = "test"\n{PLACES}{FOAM.replace("foam", "wood")}')
    assert "scattering" not in plan_generation(smooth, [1e9], maps=False).header.settings
    with pytest.raises(SceneError, match="no material of the scene scatters"):
        plan_generation(smooth, [1e9], settings, maps=False)
