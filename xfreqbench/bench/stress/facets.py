"""Facets of extreme shapes, sizes and numbers, against mirror images and slabs written out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.bench.stress.case import Area
from xfreqbench.bench.stress.channels import RECEIVER, free_space
from xfreqbench.bench.stress.geometry import fresnel_slab, largest_error, ray
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.model import PatchSize, ReceiverArray
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import ghz_to_hz

FACETS = Area("facets")
_CARRIERS_HZ = [ghz_to_hz(ghz) for ghz in (1.0, 24.25, 94.0)]
_RECEIVER = replace(RECEIVER, rows=1, cols=1, polarization="H")
_SETTINGS = TraceSettings(solver="image", rays=2000, max_depth=2)
_LIMIT = 2e-9  # the phase's 5e-10 rad, in the sum of two or three paths
Cut = tuple[Float[FloatArray, "V 2"], Int[IntArray, "K 3"]]


def _needles(num_triangles: int) -> Cut:
    """The unit square as a fan: its lower left corner, joined to points on the two sides that do not meet there."""
    at = np.linspace(0, 1, num_triangles // 2 + 1)
    upwards, back = np.stack([0 * at + 1, at], axis=1), np.stack([1 - at, 0 * at + 1], axis=1)
    corner = np.arange(1, num_triangles + 1)
    fan = np.stack([0 * corner, corner, corner + 1], axis=1)
    return np.vstack([[[0.0, 0.0]], upwards, back[1:]]), fan


def _checks(num_triangles: int) -> Cut:
    """The unit square as a grid of squares of two triangles each."""
    side = round(np.sqrt(num_triangles / 2))
    v, u = np.meshgrid(np.linspace(0, 1, side + 1), np.linspace(0, 1, side + 1), indexing="ij")
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1)
    square = first[:, None] + [0, 1, side + 2, side + 1]
    return np.stack([u, v], axis=-1).reshape(-1, 2), np.vstack([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])


def _channels(
    meshes: list[SurfaceMesh], receiver: ReceiverArray, tx_m: tuple[float, ...]
) -> Complex[NDArray[np.complex128], "F M"]:
    """Channel of one transmitter at three carriers, by the tracer that suits the number of facets."""
    tracer = ImageTracer(free_space(receiver), _CARRIERS_HZ, _SETTINGS, geometry=Geometry(meshes))
    return tracer.channel(np.array([tx_m])).cfr[0]


@FACETS.each(
    {
        "a floor of 2,000 needles, 0.5 mm by 1 m": (_needles, 2000),
        "a floor of 10,082 triangles": (_checks, 10_082),
    },
    limit=_LIMIT,
    unit="relative",
)
def _cut_floor(cut: Callable[[int], Cut], num_triangles: int) -> float:
    """A tilted floor that is cut into triangles reflects as a whole, wherever the cuts are."""
    place, triangles = cut(num_triangles)
    along, across = np.array([2.0, 0.0, 0.3]), np.array([0.0, 2.0, 0.0])
    vertices_m = np.array([-0.1, -0.7, 0.0]) + place @ np.stack([along, across])
    floor = SurfaceMesh("floor", "concrete", 0.2, vertices_m, triangles, least_patch=PatchSize())
    normal = np.cross(along, across) / np.linalg.norm(np.cross(along, across))
    here, tx_m = np.array(_RECEIVER.position_m), np.array([1.1, 0.0, 1.6])  # whose φ̂ are parallel
    image_m = here - 2 * (here - vertices_m[0]) @ normal * normal
    length_m, direct_m = float(np.linalg.norm(tx_m - image_m)), float(np.linalg.norm(tx_m - here))
    cosine = abs((tx_m - image_m) @ normal) / length_m
    expected = [
        -ray(direct_m, f) - fresnel_slab("concrete", 0.2, f, cosine)[0] * ray(length_m, f)
        for f in _CARRIERS_HZ
    ]
    return largest_error(_channels([floor], _RECEIVER, tuple(tx_m)), expected, direct_m)


@FACETS.each(
    {
        "1 mm of glass on the way, above a floor of 1 km": (False,),
        "1 mm of glass beside the way, above a floor of 1 km": (True,),
    },
    limit=_LIMIT,
    unit="relative",
)
def _large_and_small(is_beside: bool) -> float:
    """A pane of 1 mm² on the line of sight weakens it, and one 1 mm beside it does not; the floor reflects below."""
    square, two = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]), [[0, 1, 2], [0, 2, 3]]
    height_m = _RECEIVER.position_m[2]
    middle_m = np.array([1.5, 1e-3 * is_beside, height_m])
    floor_m = np.insert(1000 * square, 2, 0.0, axis=1)
    pane_m = middle_m + np.insert(1e-3 * square, 0, 0.0, axis=1)
    meshes = [
        SurfaceMesh("floor", "concrete", 0.2, floor_m, np.array(two), least_patch=PatchSize()),
        SurfaceMesh("pane", "glass", 0.005, pane_m, np.array(two), least_patch=PatchSize()),
    ]
    bounce_m = float(np.hypot(3, 2 * height_m))
    cosine = 2 * height_m / bounce_m
    expected = []
    for f in _CARRIERS_HZ:
        through = 1.0 if is_beside else fresnel_slab("glass", 0.005, f, 1.0)[2]
        expected.append(
            -through * ray(3.0, f) - fresnel_slab("concrete", 0.2, f, cosine)[0] * ray(bounce_m, f)
        )
    return largest_error(_channels(meshes, _RECEIVER, (3.0, 0.0, height_m)), expected, 3.0)
