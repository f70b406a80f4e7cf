"""Slabs of several layers: their coefficients, and what a wave meets of them in a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.plans import plan_generation
from tests.support.reference import slab_coefficients
from xfreqbench.errors import MaterialBandError, SceneError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import (
    PRESETS,
    ConstantMaterial,
    Layer,
    LayeredMaterial,
    SceneLayer,
    SceneMaterial,
    complex_permittivity,
)
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import ReceiverArray, Scene, Surface, parse_scene
from xfreqbench.tracing.absorption import slab_absorption, slab_response
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.solvers import make_tracer, resolve_solver
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

CARRIERS_HZ = (1e9, 24.25e9, 94e9)
COSINES = np.cos(np.radians([0.0, 10, 30, 45, 60, 75, 85, 89]))
LOSSLESS = [ConstantMaterial(f"eps {value}", value, 0.0) for value in (2.0, 6.5, 1.0, 3.3)]
STACKS = {
    "double glazing": PRESETS["double-glazing"].layers,
    "lining": (Layer("plasterboard", 0.0125), Layer("vacuum", 0.03), Layer("wood", 0.02), Layer("concrete", 0.03)),
    "lossless": tuple(Layer(material, 0.003 * (n + 1)) for n, material in enumerate(LOSSLESS)),
    "on metal": (Layer("glass", 0.006), Layer("metal", 0.001)),
}


def layered(layers: Sequence[Layer]) -> Slab:
    material = LayeredMaterial("stack", tuple(layers))
    return Slab(material, material.thickness_m)


def dense(slab: Slab, carrier_hz: float, cosine: float) -> list[complex]:
    """R_TE, R_TM, T_TE, T_TM by characteristic matrices of the fields along the faces (Born and Wolf, 1.6).

    P.2040 tells TM by the electric field across the ray, which makes the sign of its reflection the other.
    """
    wavenumber, reflected, passed = 2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S, [], []
    for polarization in ("TE", "TM"):
        admittance, matrix = (cosine if polarization == "TE" else 1 / cosine), np.eye(2, dtype=complex)
        for material, thickness_m in slab.layers:
            eta = complex_permittivity(material, carrier_hz)
            inner = np.sqrt(eta - (1 - cosine**2))
            own = inner if polarization == "TE" else eta / inner
            phase = wavenumber * thickness_m * inner
            matrix = matrix @ [[np.cos(phase), 1j * np.sin(phase) / own], [1j * own * np.sin(phase), np.cos(phase)]]
        electric, magnetic = matrix @ [1, admittance]
        whole = admittance * electric + magnetic
        reflected.append((admittance * electric - magnetic) / whole * (1 if polarization == "TE" else -1))
        passed.append(2 * admittance / whole)
    return [*reflected, *passed]


@pytest.mark.parametrize("carrier_hz", CARRIERS_HZ)
@pytest.mark.parametrize("name", STACKS)
def test_a_stack_reflects_and_passes_what_characteristic_matrices_say(name: str, carrier_hz: float) -> None:
    slab = layered(STACKS[name])
    found, behind = (slab_response(side, carrier_hz, COSINES) for side in (slab, slab.turned))
    np.testing.assert_allclose(behind[:, 2:], found[:, 2:], rtol=0, atol=1e-13)  # both ways alike
    if name != "on metal":  # whose matrices no number holds
        expected = [dense(slab, carrier_hz, cosine) for cosine in COSINES]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)  # phases of some hundred radians
    power = np.abs(found[:, :2]) ** 2 + np.abs(found[:, 2:]) ** 2
    if name == "lossless":
        np.testing.assert_allclose(power, 1, rtol=1e-12)
    else:
        assert (power < 1).all()


@pytest.mark.parametrize("carrier_hz", CARRIERS_HZ)
@pytest.mark.parametrize("material", ["glass", "concrete", "metal", "vacuum"])
def test_layers_of_one_material_are_one_slab(material: str, carrier_hz: float) -> None:
    whole = slab_response(Slab(material, 0.03), carrier_hz, COSINES)
    for parts_m in ([0.03], [0.01, 0.02], [0.002, 0.008, 0.02]):
        parts = layered([Layer(material, part_m) for part_m in parts_m])
        np.testing.assert_allclose(slab_response(parts, carrier_hz, COSINES), whole, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("material", "thickness_m"), [("glass", 0.01), ("concrete", 0.3), ("metal", 0.05)])
def test_a_slab_has_the_coefficients_of_p2040_from_grazing_to_normal(material: str, thickness_m: float) -> None:
    cosines = np.array([1e-4, 1e-2, 0.5, 1.0])
    for carrier_hz in (1e9, 2.4e9, 10e9, 24.25e9, 60e9, 94e9):
        eta = complex_permittivity(material, carrier_hz)
        expected = [slab_coefficients(eta, thickness_m, carrier_hz, cosine) for cosine in cosines]
        # of up to 600 rad in concrete; what is lost in metal does not come back
        found = slab_response(Slab(material, thickness_m), carrier_hz, cosines)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_slabs_without_loss_keep_the_energy_of_grazing_rays() -> None:
    power = np.abs(slab_response(Slab(LOSSLESS[1], 0.03), 24.25e9, np.geomspace(1e-6, 1, 50))) ** 2
    # 1 − R² of grazing rays keeps 1e-16 of 1e-6, and is divided by a number as small
    np.testing.assert_allclose(power[:, :2] + power[:, 2:], 1, rtol=0, atol=1e-9)


def test_grazing_and_opaque_stacks_have_finite_coefficients() -> None:
    for cosine in (0.0, 1e-12, 1e-7, 1e-3):
        for layers in STACKS.values():
            r_te, r_tm, t_te, t_tm = slab_response(layered(layers), 94e9, np.array([cosine]))[0]
            assert max(abs(r_te + 1), abs(r_tm + 1), abs(t_te), abs(t_tm)) < 0.02 + 50 * cosine
    thick = layered([Layer("concrete", 30.0), Layer("metal", 1.0), Layer("concrete", 30.0)])
    half_space = slab_response(Slab("concrete", 30.0), 94e9, COSINES)
    np.testing.assert_allclose(slab_response(thick, 94e9, COSINES), half_space, rtol=0, atol=1e-15)


SIDES: dict[str, dict[str, Any]] = {  # sheets whose front looks along an axis, or, in the last but one, against it
    "x": {"min_m": (0.0, -9.0, -9.0), "max_m": (0.0, 9.0, 9.0)},
    "y": {"min_m": (-9.0, 0.0, -9.0), "max_m": (9.0, 0.0, 9.0)},
    "z": {"min_m": (-9.0, -9.0, 0.0), "max_m": (9.0, 9.0, 0.0)},
    "polygon": {"vertices_m": ((-9.0, -9.0, 0.0), (9.0, -9.0, 0.0), (9.0, 9.0, 0.0), (-9.0, 9.0, 0.0))},
    "turned polygon": {"vertices_m": ((-9.0, 9.0, 0.0), (9.0, 9.0, 0.0), (9.0, -9.0, 0.0), (-9.0, -9.0, 0.0))},
    "box": {"min_m": (-9.0, -9.0, -9.0), "max_m": (9.0, 9.0, 0.0)},
}
LINED = SceneMaterial("lined", layers=(SceneLayer("wood", 0.02), SceneLayer("glass", 0.006)))


def scene_of(*surfaces: Surface, receiver_m: Sequence[float] = (0.0, 0.0, 2.0), polarization: str = "V") -> Scene:
    receiver = ReceiverArray(tuple(receiver_m), rows=1, cols=1, polarization=polarization)
    return Scene(name="test", receiver=receiver, surface=surfaces, material=(LINED,))


@pytest.mark.parametrize("name", SIDES)
def test_each_side_of_a_surface_reflects_as_it_is_made_and_both_let_through_the_same(name: str) -> None:
    sheet = Surface("sheet", "lined", **SIDES[name])
    along = np.eye(3)["xyz".index(name if len(name) == 1 else "z")]
    across = np.roll(along, 1)
    slab = layered([Layer("wood", 0.02), Layer("glass", 0.006)])
    sides = [(1, slab), (-1, slab.turned)] if name != "box" else [(1, slab)]
    if name == "turned polygon":
        sides = [(-1, slab), (1, slab.turned)]
    settings = TraceSettings(interactions=("specular",), max_depth=1, rays=2000)
    for sign, seen in sides:
        receiver_m, tx_m = sign * 2 * along + 0.3 * across, sign * 1.5 * along - across
        scene = scene_of(sheet, receiver_m=receiver_m, polarization="V" if along[0] else "H")
        paths = ImageTracer(scene, CARRIERS_HZ, settings).paths(tx_m)
        (row,) = np.flatnonzero(paths.interactions[:, 0] > 0)
        length_m = paths.delay_s[row] * SPEED_OF_LIGHT_M_S
        for carrier_hz, gain in zip(CARRIERS_HZ, paths.gain[:, row], strict=True):
            bare = gain * 4 * np.pi * length_m * carrier_hz / SPEED_OF_LIGHT_M_S
            expected = slab_response(seen, carrier_hz, np.array([3.5 / length_m]))[0, 0]  # fields are across: TE
            assert abs(bare) == pytest.approx(abs(expected), abs=1e-9), (name, sign, carrier_hz)
        through = replace(scene, receiver=replace(scene.receiver, position_m=tuple(-receiver_m)))
        passed = ImageTracer(through, CARRIERS_HZ, replace(settings, interactions=("refraction",))).paths(tx_m)
        if name != "box":
            back = replace(scene, receiver=replace(scene.receiver, position_m=tuple(tx_m)))
            reverse = ImageTracer(back, CARRIERS_HZ, replace(settings, interactions=("refraction",))).paths(-receiver_m)
            np.testing.assert_allclose(passed.gain, reverse.gain, rtol=1e-9)


@pytest.mark.parametrize("is_turned", [False, True])
def test_the_field_beside_the_rim_of_layers_is_continuous_at_either_side(is_turned: bool) -> None:
    """Where the shadow begins, and where each face ceases to reflect."""
    corners = ((0.0, -20.0, -20.0), (0.0, 20.0, -20.0), (0.0, 20.0, 1.0), (0.0, -20.0, 1.0))
    sheet = Surface("sheet", "lined", vertices_m=corners[::-1] if is_turned else corners)
    settings, savings = TraceSettings(max_depth=2, rays=2000), ImageSavings(diffraction_floor=0.0)
    for receiver_x, beyond_x in ((2.0, -3.0), (2.0, 3.0), (-2.0, -3.0)):
        at_z = 1.0 - 0.5 * 3.0 / 2.0  # as high as the rim seen from the receiver, directly or by the mirror
        tracer = ImageTracer(scene_of(sheet, receiver_m=(receiver_x, 0.0, 1.5)), CARRIERS_HZ[:2], settings, savings)
        low, high = tracer.channel(np.array([[beyond_x, 0.0, at_z - 1e-7], [beyond_x, 0.0, at_z + 1e-7]])).cfr[..., 0]
        assert (np.abs(high / low - 1) < 1e-3).all()


def test_reciprocity_holds_among_surfaces_of_layers() -> None:
    sheet = Surface("sheet", "lined", min_m=(1.0, -2.0, 0.0), max_m=(1.0, 0.5, 2.0))
    floor = Surface("floor", "lined", min_m=(-3.0, -3.0, 0.0), max_m=(5.0, 3.0, 0.0))
    here, there = (0.0, 0.0, 1.5), (2.0, 0.8, 1.1)
    settings = TraceSettings(max_depth=3, rays=2000)
    one, other = (
        ImageTracer(scene_of(sheet, floor, receiver_m=a), CARRIERS_HZ, settings).channel(np.array([b])).cfr
        for a, b in ((here, there), (there, here))
    )
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(one).max())


SCENE = """
name = "shed"
receiver = {position_m = [1, 1, 1]}
surface = [{name = "wall", material = "window", min_m = [0, 0, 0], max_m = [0, 2, 2]}]
[[material]]
name = "window"
layers = [{material = "glass", thickness_m = 0.004}, {material = "vacuum", thickness_m = 0.012}]
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('material = "window",', 'material = "glass",', "surface 'wall' of 'glass' needs a thickness_m"),
        ('material = "window",', 'material = "window", thickness_m = 0.02,', "'window' are 0.016 m thick"),
        ("layers =", 'itu = "glass"\nthickness_m = 1\nlayers =', "'window' has layers and itu and thickness_m"),
        ('"vacuum"', '"stud-wall"', "a layer of material 'window' is 'stud-wall', which has layers itself"),
        ('"vacuum"', '"vacum"', "material 'window': There is no .* Did you mean 'vacuum'"),
        ('material = "window",', 'material = "double-glasing",', "surface 'wall': There is no .* 'double-glazing'"),
        ('[{material = "glass"', "[] #", "layers: Tuple should have at least 1 item"),
        ("thickness_m = 0.012", "thickness_m = 0", r"layers\.1\.thickness_m: Input should be greater than 0"),
        ('name = "window"\nl', 'name = "stud-wall"\nthickness_m = 1 #', "leave thickness_m out"),
    ],
)
def test_layers_that_mean_nothing_are_refused_by_name(old: str, new: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        parse_scene(SCENE.replace(old, new))


def test_solver_image_alone_takes_layers_and_every_layer_has_its_band() -> None:
    scene = parse_scene(SCENE)
    geometry = Geometry(surface_meshes(scene))
    assert resolve_solver(geometry, TraceSettings()).solver == "image"
    with pytest.raises(SceneError, match="'window' has 2 layers, which only solver image traces"):
        make_tracer(scene, [2.4], TraceSettings(solver="sionna"))
    wall = replace(scene, surface=(replace(scene.surface[0], material="brick-wall"),))
    with pytest.raises(MaterialBandError, match="'brick' from 1 to 40 GHz"):
        plan_generation(wall, [94e9], tx_positions=np.array([[1.0, 1.5, 1.2]]))


def test_layers_absorb_what_neither_side_reflects() -> None:
    one, whole = layered([Layer("glass", 0.01), Layer("glass", 0.02)]), Slab("glass", 0.03)
    assert slab_absorption(one, 10e9) == pytest.approx(slab_absorption(whole, 10e9), rel=1e-9)
    sides = [Layer("metal", 0.001), Layer("concrete", 3.0)]  # nothing comes through either
    alone = [slab_absorption(Slab(*side), 10e9) for side in sides]
    for layers in (sides, sides[::-1]):
        assert slab_absorption(layered(layers), 10e9) == pytest.approx(np.mean(alone), rel=1e-9)
