"""Mitsuba scenes as people write and export them: each is read as it is meant, or refused in words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.mesh_scenes import ROOM, TABLE, WOOD, bounds_m, file_shape, scene_with, shape, to_world, write_meshes
from xfreqbench.errors import SceneError, UnknownNameError
from xfreqbench.scene import imported
from xfreqbench.scene.materials import ConstantMaterial, complex_permittivity
from xfreqbench.scene.meshes import SurfaceMesh, surface_meshes
from xfreqbench.scene.mitsuba_xml import MAX_INCLUDES

TABLE_PLY = file_shape("meshes/table.ply")
NAMED = '<ref id="{0}" name="bsdf"/>'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_meshes(tmp_path)
    return tmp_path


def only_mesh(folder: Path, *elements: str, toml: str = "") -> SurfaceMesh:
    (mesh,) = surface_meshes(scene_with(folder, *elements, toml=toml))
    return mesh


def named(material: str, kind: str = "diffuse", inside: str = "") -> tuple[str, str]:
    bsdf = f'<bsdf type="{kind}" id="{material}">{inside}</bsdf>'
    return bsdf, file_shape("meshes/table.ply", material=NAMED.format(material))


@pytest.mark.parametrize("kind", ["ply", "obj", "stl"])
def test_a_mesh_of_every_format_has_the_triangles_of_the_others(folder: Path, kind: str) -> None:
    mesh = only_mesh(folder, WOOD, file_shape(f"meshes/table.{kind}"))
    corners = {tuple(np.sort(corner.round(6), axis=0).ravel()) for corner in mesh.corners_m}
    assert corners == {tuple(np.sort(corner.round(6), axis=0).ravel()) for corner in TABLE.triangles}
    assert (mesh.name, mesh.material) == ("s", "wood")


BALL = '<point name="center" x="1" y="-2" z="0"/><float name="radius" value="0.5"/>'
MOVES = {
    "none": [],
    "translate": ['<translate x="1" z="-2"/>'],
    "translate by value": ['<translate value="1, 2 3"/>'],
    "rotate": ['<rotate x="0.6" z="-0.8" angle="37"/>'],
    "scale": ['<scale x="2" y="0.5"/>'],
    "scale by one value": ['<scale value="0.3"/>'],
    "mirror": ['<scale x="-1"/>'],
    "matrix": ['<matrix value="0 -2 0 1  1 0 0 2  0 0 1 -3  0 0 0 1"/>'],
    "matrix of nine": ['<matrix value="0 -2 0 1 0 0 0.5 0 1"/>'],
    "lookat": ['<lookat origin="1, 2, 3" target="4 0 1" up="0 0 1"/>'],
    "turned, moved, turned": ['<rotate z="1" angle="90"/>', '<translate x="$far"/>', '<rotate x="1" angle="-20"/>'],
}  # fmt: skip
NO_SPHERES = ("scale", "matrix")  # Mitsuba's have one radius


@pytest.mark.sionna
def test_shapes_stand_where_mitsuba_puts_them(folder: Path) -> None:
    """Each form and file under each transform against Mitsuba's own reading of the same XML."""
    from xfreqbench.tracing.sionna.scene import mi

    forms = {
        "rectangle": shape("rectangle", "{0}", ident="{1}"),
        "cube": shape("cube", "{0}", ident="{1}"),
        "sphere": shape("sphere", BALL + "{0}", ident="{1}"),
        "obj": file_shape("meshes/table.obj", "{0}").replace("mesh-s", "mesh-{1}"),
        "ply": file_shape("meshes/room.ply", "{0}").replace("mesh-s", "mesh-{1}"),
    }  # fmt: skip
    shapes = [
        form.format(to_world(*steps), f"{kind} {name}")
        for kind, form in forms.items()
        for name, steps in MOVES.items()
        if kind != "sphere" or not any(word in name for word in NO_SPHERES)
    ]
    scene = scene_with(
        folder, '<default name="far" value="7"/><bsdf type="diffuse" id="mat-itu_wood"/>',
        *(shape.replace('"M"', '"mat-itu_wood"') for shape in shapes),
    )  # fmt: skip
    loaded = mi.load_file(str(folder / "scene.xml"), optimize=False)  # which would merge the shapes
    theirs = {shape.id().removeprefix("mesh-"): shape for shape in loaded.shapes()}
    ours = surface_meshes(scene)
    assert {mesh.name for mesh in ours} == set(theirs)
    for mesh in ours:
        box = theirs[mesh.name].bbox()
        # float32 in Mitsuba; 1,280 triangles need not have a corner where a sphere of .5 m is widest
        tolerance = 0.01 if mesh.name.startswith("sphere") else 1e-5
        np.testing.assert_allclose(bounds_m(mesh), [np.array(box.min), np.array(box.max)], atol=tolerance)
        known = mi.traverse(theirs[mesh.name])
        if "vertex_positions" in known:
            vertices = np.array(known["vertex_positions"]).reshape(-1, 3)
            distance_m = np.linalg.norm(vertices[:, None] - mesh.vertices_m[None], axis=2)
            assert max(distance_m.min(axis=0).max(), distance_m.min(axis=1).max()) < 1e-5


def test_a_sphere_is_1280_triangles_within_half_a_percent_of_its_radius(folder: Path) -> None:
    mesh = only_mesh(folder, WOOD, shape("sphere", '<float name="radius" value="2"/>'))
    assert len(mesh.triangles) == 1280
    height_m = np.linalg.norm(mesh.corners_m.mean(axis=1), axis=1)
    assert 0.99 * 2 < height_m.min() < height_m.max() < 2


def test_an_axis_of_any_length_is_turned_about(folder: Path) -> None:
    """Mitsuba itself distorts a shape that is turned about an axis of another length than one."""
    one, three = (
        only_mesh(folder, WOOD, shape("cube", to_world(f'<rotate x="{length}" angle="30"/>'))) for length in (1, 3)
    )
    np.testing.assert_allclose(three.vertices_m, one.vertices_m, atol=1e-12)


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ('<scale z="0"/>', "flattens"),
        ('<rotate angle="30"/>', "axis has no direction"),
        ('<rotate z="1"/>', "finite numbers"),
        ('<translate x="nan"/>', "finite numbers"),
        ('<scale x="1_0"/>', "'1_0'; give 1 finite numbers"),
        ('<translate x="$far"/>', "'\\$far'"),
        ('<translate value="1 2"/>', "1 or 3"),
        ('<matrix value="1 0 0"/>', "9 or 16"),
        ('<matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1"/>', "last row"),
        ('<lookat origin="0 0 0" target="0 0 1" up="0 0 1"/>', "no direction"),
        ('<shear x="1"/>', "step 'shear'"),
        ('<scale value="1e200"/><scale value="1e200"/>', "beyond every number"),
        ('<matrix value="1e155 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/>', "beyond every number"),
    ],
)
def test_a_transform_without_sense_is_refused(folder: Path, step: str, message: str) -> None:
    with pytest.raises(SceneError, match=f"shape 's' has a .*{message}"):
        only_mesh(folder, WOOD, shape("cube", to_world(step)))


def test_materials_are_known_by_the_names_that_exports_give_them(folder: Path) -> None:
    names = (
        "mat-itu_concrete",
        "itu_concrete",
        "mat-itu-concrete",
        "mat-itu_concrete.001",
        "itu_concrete.012",
        "concrete",
    )
    for name in names:
        mesh = only_mesh(folder, *named(name))
        assert (mesh.material, mesh.thickness_m) == ("concrete", 0.1)


def test_materials_in_other_materials_are_found(folder: Path) -> None:
    diffuse = '<bsdf type="diffuse"{0}><rgb name="reflectance" value="0.5 0.5 0.5"/></bsdf>'
    assert only_mesh(folder, *named("mat-itu_brick", "twosided", diffuse.format(""))).material == "brick"
    inner = diffuse.format(' id="mat-itu_glass"')
    assert only_mesh(folder, *named("mat-Pane", "twosided", inner)).material == "glass"
    radio = WOOD.replace(' id="M"', "").replace("</bsdf>", '<float name="thickness" value="0.02"/></bsdf>')
    mesh = only_mesh(folder, *named("mat-Door", "twosided", radio))
    assert (mesh.material, mesh.thickness_m) == ("wood", 0.02)
    inline = '<bsdf type="itu-radio-material" id="X"><string name="type" value="metal"/></bsdf>'
    assert only_mesh(folder, file_shape("meshes/table.ply", material=inline)).material == "metal"
    other = file_shape("meshes/table.ply", material=NAMED.format("other"))
    for refers in ('<alias id="M" as="other"/>', '<bsdf type="twosided" id="other"><ref id="M"/></bsdf>'):
        assert only_mesh(folder, WOOD, refers, other).material == "wood"
    ring = '<bsdf type="twosided" id="other"><ref id="b"/></bsdf><bsdf type="mask" id="b"><ref id="other"/></bsdf>'
    with pytest.raises(SceneError, match="'other' is not an ITU material"):
        only_mesh(folder, ring, other)


def test_paths_of_windows_are_understood(folder: Path) -> None:
    windows = file_shape("meshes/table.ply").replace("meshes/table", "meshes\\table")
    assert len(only_mesh(folder, WOOD, windows).triangles) == 12


def test_a_material_may_have_a_permittivity_and_conductivity_of_its_own(folder: Path) -> None:
    stated = (
        '<float name="relative_permittivity" value="4.5"/><float name="conductivity" value="0.02"/>'
        '<float name="thickness" value="0.05"/>'
    )
    mesh = only_mesh(folder, *named("foam", "radio-material", stated))
    assert mesh.material == ConstantMaterial("foam", 4.5, 0.02)
    assert mesh.thickness_m == 0.05
    low, high = (complex_permittivity(mesh.material, carrier_hz) for carrier_hz in (1e9, 300e9))
    assert low.real == high.real == 4.5
    assert low.imag == pytest.approx(300 * high.imag)  # σ/(2πf ε₀), with one σ
    for numbers, words in (
        ("", "has no relative_permittivity"),
        (stated.replace("4.5", "0.5"), r"relative_permittivity of material 'foam' is '0\.5'"),
        (stated.replace("4.5", "4_5"), r"relative_permittivity of material 'foam' is '4_5'\. Give a number from 1 to"),
        (stated.replace("0.02", "1e300"), r"conductivity of material 'foam' is '1e300'\. Give a number from 0 to 1e"),
        (stated + '<float name="scattering_coefficient" value="0_1"/>', "scattering_coefficient: Input should be"),
    ):
        with pytest.raises(SceneError, match=words):
            only_mesh(folder, *named("foam", "radio-material", numbers))


def test_the_scenes_own_table_comes_first(folder: Path) -> None:
    table = '[[material]]\nname = "mat-Wood.001"\nitu = "chipboard"\nthickness_m = 0.03\n'
    mesh = only_mesh(folder, *named("mat-Wood.001"), toml=table)
    assert (mesh.material, mesh.thickness_m) == ("chipboard", 0.03)
    everywhere = '[[material]]\nname = "wood"\nrelative_permittivity = 2.5\n'
    assert only_mesh(folder, WOOD, TABLE_PLY, toml=everywhere).material == ConstantMaterial("wood", 2.5, 0.0)


@pytest.mark.parametrize(
    ("kind", "inside", "message"),
    [
        ("itu-radio-material", '<float name="tickness" value="0.02"/>', "'itu_wood' .* 'tickness'.* mean 'thickness'"),
        ("itu-radio-material", '<float name="scattering_coeff" value="1"/>', "mean 'scattering_coefficient'"),
        ("itu-radio-material", '<string name="thickness" value="0.02"/>', r"<string>; give <float name='thickness'"),
        ("itu-radio-material", '<integer name="thickness" value="2"/>', r"<integer>; give <float"),
        ("itu-radio-material", '<float name="thickness" val="0.02"/>', r"<float>; give <float"),
        ("itu-radio-material", '<float name="thickness" value="1"/>' * 2, "thickness: it is given twice"),
        ("itu-radio-material", '<float name="conductivity" value="9"/>', "no property of a material of type 'itu-ra"),
        ("radio-material", '<float name="electrical_conductivity" value="9"/>', "Did you mean 'conductivity'"),
        ("radio-material", '<string name="type" value="wood"/>', "no property of a material of type 'radio-material'"),
        ("twosided", '<float name="Thicknes" value="9"/>', "Did you mean 'thickness'"),
        ("diffuse", '<float name="relative_permittivity" value="9"/>', "no property of a material of type 'diffuse'"),
        ("diffuse", '<bsdf type="mask"><float name="permittivity" value="9"/></bsdf>', "called 'permittivity'"),
        ("RadioMaterial", '<float name="relative_permittivity" value="9"/>', "Did you mean 'radio-material'"),
        ("itu", '<string name="name" value="concrete"/>', "called 'itu'"),
        ("diffuse", '<string name="type" value="wod"/>', "Did you mean 'wood'"),
    ],
)  # fmt: skip
def test_properties_that_would_be_passed_over_are_refused(folder: Path, kind: str, inside: str, message: str) -> None:
    """Though the material's name would say what it is."""
    stated = '<string name="type" value="wood"/>' if kind == "itu-radio-material" else ""
    stated += '<float name="relative_permittivity" value="2"/>' if kind == "radio-material" else ""
    bsdf, table = named("itu_wood", kind, stated + inside)
    with pytest.raises((SceneError, UnknownNameError), match=message):
        only_mesh(folder, bsdf, table)


def test_looks_of_materials_may_have_any_properties(folder: Path) -> None:
    """As Mitsuba's own plugins have them, and exports of Blender and scenes of Sionna RT."""
    numbers = ["roughness", "alpha_u", "int_ior", "flatness", "thin_film_thickness", "specular"]
    looks = "".join(f'<float name="{name}" value="0.5"/>' for name in numbers) + (
        '<rgb name="base_color" value="0.8 0.8 0.8"/><string name="distribution" value="ggx"/>'
        '<texture type="bitmap" name="opacity"><string name="filename" value="none.png"/></texture>'
    )
    inside = f'<bsdf type="principled" id="inner">{looks}</bsdf><float name="thickness" value="0.03"/>'
    mesh = only_mesh(folder, *named("mat-itu_wood", "twosided", inside))
    assert (mesh.material, mesh.thickness_m) == ("wood", 0.03)
    colour = '<rgb name="color" value="1 0 0"/><string name="type" value="metal"/>'
    assert only_mesh(folder, *named("m", "itu-radio-material", colour)).material == "metal"


def test_what_one_file_includes_is_as_if_it_stood_there(folder: Path) -> None:
    (folder / "parts").mkdir()
    (folder / "parts" / "materials.xml").write_text(f'<scene>{WOOD}<default name="z" value="2"/></scene>')
    included = '<include filename="parts/materials.xml"/>'
    mesh = only_mesh(folder, included, shape("cube", to_world('<translate z="$z"/>')))
    assert mesh.material == "wood"
    np.testing.assert_allclose(bounds_m(mesh), [[-1, -1, 1], [1, 1, 3]])
    (folder / "again.xml").write_text(f"<scene>{WOOD}{TABLE_PLY}</scene>")
    assert len(surface_meshes(scene_with(folder, WOOD, '<include filename="again.xml"/>', TABLE_PLY))) == 2


@pytest.mark.parametrize(
    ("filename", "message"),
    [
        ("../elsewhere.xml", "outside of the scene's folder"),
        ("/etc/hostname", "outside of the scene's folder"),
        ("link.xml", "outside of the scene's folder"),
        ("scene.xml", f"more than {MAX_INCLUDES} files, or itself"),
        ("absent.xml", "cannot be read: No such file"),
        ("pipe.xml", "cannot be read: it is a pipe or a device"),
        ("", "cannot be read: Is a directory"),
    ],
)
def test_what_may_not_be_included_is_refused(folder: Path, filename: str, message: str) -> None:
    import os

    (folder.parent / "elsewhere.xml").write_text("<scene/>")
    (folder / "link.xml").symlink_to(folder.parent / "elsewhere.xml")
    os.mkfifo(folder / "pipe.xml")
    with pytest.raises(SceneError, match=message):
        only_mesh(folder, WOOD, f'<include filename="{filename}"/>', TABLE_PLY)


def test_files_that_include_each_other_twice_over_end_soon(folder: Path) -> None:
    (folder / "40.xml").write_text("<scene/>")
    for number in range(40):
        twice = f'<include filename="{number + 1}.xml"/>' * 2
        (folder / f"{number}.xml").write_text(f"<scene>{twice}</scene>")
    with pytest.raises(SceneError, match=f"more than {MAX_INCLUDES} files"):
        only_mesh(folder, '<include filename="0.xml"/>')


def test_defaults_that_double_at_every_step_are_refused(folder: Path) -> None:
    bomb = '<default name="a" value="1234567890"/>' + "".join(
        f'<default name="{name}" value="${before}${before}"/>'
        for before, name in zip("abcdefghijklmnopqrstuvw", "bcdefghijklmnopqrstuvwx", strict=True)
    )
    used = '<integer name="n" value="$x"/>' * 1000
    mesh = only_mesh(folder, bomb, WOOD, f'<integrator type="path">{used}</integrator>', TABLE_PLY)
    assert mesh.material == "wood"  # defaults are taken as they stand, so that nothing doubles
    long = '<default name="a" value="' + "1" * 100_000 + '"/>'
    with pytest.raises(SceneError, match="more than 1,000,000 characters"):
        only_mesh(folder, long, WOOD, f'<integrator type="path">{used.replace("$x", "$a")}</integrator>', TABLE_PLY)


@pytest.mark.parametrize(
    ("elements", "message"),
    [
        ([WOOD], "has no <shape>"),
        ([WOOD, shape("cylinder")], "world coordinates"),
        ([WOOD, shape("instance")], "is a 'instance'"),
        ([WOOD, file_shape("meshes/table.ply", material="")], "refers to no material"),
        ([WOOD, file_shape("meshes/absent.obj")], r"absent\.obj of shape 's' cannot be read: No such file"),
        ([WOOD, file_shape("meshes/table.ply").replace('type="ply"', 'type="obj"')], "no face of any area"),
        ([WOOD, shape("sphere", '<float name="radius" value="-1"/>')], "radius -1"),
        ([WOOD, WOOD.replace("wood", "metal"), TABLE_PLY], "two materials have the id 'M'"),
        (["<shape type='merge'><include filename='a.xml'/></shape>"], "directly below <scene>"),
        ([WOOD, shape("sphere", '<integer name="radius" value="3"/>')], "give it once, as <float name='radius'"),
        ([WOOD, shape("sphere", '<vector name="center" x="3"/>')], "as <point name='center'"),
        ([WOOD, shape("sphere", '<point name="center" X="3"/>')], "a <point> with 'X'; give x, y and z"),
        ([WOOD, shape("cube", to_world('<translate dx="3"/>'))], "a <translate> with 'dx'; give x, y and z"),
        ([WOOD, shape("ply")], "names no file"),
        ([WOOD, shape("cube", '<transform name="to_uv"/>')], "named 'to_world'"),
        ([WOOD, WOOD.replace('"M"', '"N"').replace("wood", "glass"),
          file_shape("meshes/table.ply", NAMED.format("N"))], "has 2 materials; leave one"),
        ([WOOD.replace("</bsdf>", WOOD.replace('"M"', '"N"').replace("wood", "glass") + "</bsdf>"), TABLE_PLY],
         "holds several others"),
        (["<bsdf type='mask' id='M'><bsdf type='diffuse' id='itu_wood'/><bsdf id='itu_glass'/></bsdf>",
          TABLE_PLY], "holds several others"),
        (named("mat-Oak.001"), r"\[\[material\]\] name = 'mat-Oak.001'"),
    ],
)  # fmt: skip
def test_what_would_not_be_traced_as_it_is_meant_is_refused(folder: Path, elements: list[str], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        surface_meshes(scene_with(folder, *elements))


@pytest.mark.parametrize("inside", ['<float name="Radius" value="3"/>', '<float name="diameter" value="3"/>'])
def test_unknown_properties_of_shapes_are_refused(folder: Path, inside: str) -> None:
    with pytest.raises(UnknownNameError, match="property of a sphere"):
        only_mesh(folder, WOOD, shape("sphere", inside))
    flipped = only_mesh(
        folder, WOOD, shape("sphere", '<boolean name="flip_normals" value="true"/><emitter type="area"/>')
    )
    np.testing.assert_array_equal(flipped.triangles[:, ::-1], only_mesh(folder, WOOD, shape("sphere", "")).triangles)


def test_shapes_that_are_merged_are_read_one_by_one(folder: Path) -> None:
    merged = f'<shape type="merge">{TABLE_PLY}{file_shape("meshes/room.obj")}</shape>'
    table, room = surface_meshes(scene_with(folder, WOOD, merged))
    np.testing.assert_allclose(bounds_m(table), TABLE.bounds)
    np.testing.assert_allclose(bounds_m(room), ROOM.bounds)


def test_more_triangles_than_a_solver_can_trace_are_refused_before_they_are_built(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(imported, "MAX_TRIANGLES", 100 * 1280)
    with pytest.raises(SceneError, match="more than 128,000 triangles"):
        surface_meshes(scene_with(folder, WOOD, shape("sphere") * 101))
    assert len(surface_meshes(scene_with(folder, WOOD, shape("sphere") * 100))) == 100
