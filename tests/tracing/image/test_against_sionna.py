"""Diffracted paths against the public forward solver of Sionna RT, and where that breaks a law.

Sionna RT 2.2.0 gives the terms of reflection the wrong sign (`sionna_wedge` writes it out), takes faces for opaque,
and is not reciprocal. So places are compared with the public ones, gains after exchange of the coefficients.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.reference import antenna_field
from tests.support.sionna_scenes import ONE_ELEMENT, scene_of
from tests.support.sionna_wedge import sionna_wedge
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.materials import complex_permittivity
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Scene, Surface
from xfreqbench.tracing.image.edges import find_edges
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.paths import DIFFRACTION, Paths
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

pytestmark = pytest.mark.sionna

METAL_BOX = Surface("metal box", "metal", 0.002, (1.0, 1.0, 0.0), (2.0, 2.2, 1.3))
WOODEN_BOX = Surface("wooden box", "wood", 0.02, (3.1, 2.0, 0.1), (4.0, 3.0, 1.0))
PANE = Surface("pane", "glass", 0.008, (2.5, -1.0, 0.5), (2.5, 1.8, 1.9))
CARRIER_HZ = 3e9


def public_paths(scene: Scene, tx_m: NDArray[np.float64], max_depth: int) -> Any:
    from xfreqbench.tracing.sionna.plain import loaded
    from xfreqbench.tracing.sionna.scene import mi, rt

    sionna_scene = loaded(scene, CARRIER_HZ)
    sionna_scene.add(rt.Transmitter(name="transmitter", position=mi.Point3f(*map(float, tx_m))))
    asked = {"diffraction": True, "edge_diffraction": True, "synthetic_array": False, "seed": 1}
    return rt.PathSolver()(sionna_scene, max_depth=max_depth, samples_per_src=100_000, **asked)


def our_paths(scene: Scene, tx_m: NDArray[np.float64], max_depth: int) -> Paths:
    settings = TraceSettings(interactions=("specular", "refraction", "diffraction"), max_depth=max_depth)
    savings = ImageSavings(diffraction_planes=3, diffraction_floor=0.0)
    return ImageTracer(scene, [CARRIER_HZ], replace(settings, rays=50_000), savings).paths(tx_m)


def told(public: Any, depth: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Interactions (P, D), vertices (P, D, 3) and gains (P,) of a public solve for one receiver."""
    codes = public.interactions.numpy().reshape(depth, -1).T
    vertices_m = public.vertices.numpy().reshape(depth, -1, 3).transpose(1, 0, 2)
    return codes, vertices_m, (public.a[0].numpy() + 1j * public.a[1].numpy()).reshape(-1)


def test_every_diffracted_path_of_the_public_solver_is_found_at_its_place() -> None:
    scene, depth = scene_of(METAL_BOX, WOODEN_BOX, PANE, receiver=ONE_ELEMENT), 3
    num_compared = 0
    for tx_m in np.array([[3.3, 1.1, 0.6], [0.4, 2.9, 1.7]]):
        codes, vertices_m, _ = told(public_paths(scene, tx_m, depth), depth)
        ours = our_paths(scene, tx_m, depth)
        for code, points_m in zip(codes, vertices_m, strict=True):
            if DIFFRACTION not in code:
                continue
            points_m = np.where(code[:, None] > 0, points_m, np.nan)
            apart_m = np.abs(ours.vertices_m - points_m).max(axis=(1, 2), initial=0, where=code[None, :, None] > 0)
            alike = (ours.interactions == code).all(axis=1)
            assert apart_m[alike].min(initial=np.inf) < 1e-3, (code, points_m)
            num_compared += 1
    assert num_compared > 15


def test_gains_differ_from_the_public_ones_by_sionnas_coefficients_alone() -> None:
    """With its coefficients in place of ours, on our points, distances and angles, its gains come out."""
    num_compared, apart = 0, []
    for surface in (METAL_BOX, WOODEN_BOX):
        scene = scene_of(surface, receiver=ONE_ELEMENT)
        edges = find_edges(Geometry(surface_meshes(scene)).facets, np.zeros((0, 3, 3)), np.zeros(0, np.int64))
        wavelength_m = SPEED_OF_LIGHT_M_S / CARRIER_HZ
        slab = (complex_permittivity(surface.material, CARRIER_HZ), 2 * np.pi * surface.thickness_m / wavelength_m)
        for tx_m in np.array([[3.3, 1.1, 0.6], [0.4, 2.9, 1.7], [4.4, 2.6, 0.3]]):
            codes, vertices_m, gains = told(public_paths(scene, tx_m, 1), 1)
            ours = our_paths(scene, tx_m, 1)
            for code, point_m, gain in zip(codes[:, 0], vertices_m[:, 0], gains, strict=True):
                if code != DIFFRACTION:
                    continue
                row = np.nanargmin(
                    np.linalg.norm(ours.vertices_m[:, 0] - point_m, axis=1)
                    + np.where(ours.interactions[:, 0] == DIFFRACTION, 0, 9)
                )
                point_m = ours.vertices_m[row, 0]
                (edge,) = [e for e in edges if np.linalg.norm(np.cross(point_m - e.start_m, e.along)) < 1e-9]
                before, after = point_m - tx_m, np.asarray(scene.receiver.position_m) - point_m
                s = float(np.linalg.norm(before)), float(np.linalg.norm(after))
                matrix = sionna_wedge(edge, before / s[0], after / s[1], s, wavelength_m, slab)
                sent, heard = (antenna_field(way, "iso", "V") for way in (before / s[0], -after / s[1]))
                theirs = heard @ matrix @ sent
                theirs *= wavelength_m / (4 * np.pi * np.sqrt(s[0] * s[1] * sum(s)))
                straight = wavelength_m / (4 * np.pi * sum(s))
                # single precision, and their Fresnel integral of 1e-5 or so where the four terms cancel
                assert abs(theirs - gain) < 1e-3 * abs(gain) + 2e-5 * straight
                apart.append(abs(ours.gain[0, row] - gain) / abs(gain))
                num_compared += 1
    assert num_compared >= 6
    assert max(apart) > 0.1  # they break a law: see below


def test_sionnas_field_jumps_where_a_face_ceases_to_reflect_and_ours_does_not() -> None:
    receiver = replace(ONE_ELEMENT, position_m=(1.5, 1.6, 2.3), polarization="H")
    scene = scene_of(METAL_BOX, receiver=receiver)
    beside_m = np.array([[2.498, 1.61, 2.3], [2.502, 1.61, 2.3]])  # the top ends half-way, at x = 2
    theirs = [public_paths(scene, tx_m, 1).cir(normalize_delays=False, out_type="numpy")[0].sum() for tx_m in beside_m]
    settings = TraceSettings(interactions=("specular", "diffraction"), max_depth=1, rays=5000)
    ours = ImageTracer(scene, [CARRIER_HZ], settings).channel(beside_m).cfr[:, 0, 0]
    jumps_db = [20 * np.log10(abs(field[1] / field[0])) for field in (theirs, ours)]
    assert abs(jumps_db[0]) > 3
    assert abs(jumps_db[1]) < 0.3  # over 4 mm of a wave of 10 cm
