"""What slabs reflect and transmit, and how much of a room's diffuse power its surfaces absorb."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float

from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import MaterialPolicy, complex_permittivity
from xfreqbench.tracing.image.kernels.slabs import stack_coefficients
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S


def slab_response(
    slab: Slab, carrier_hz: float, cosine: Float[FloatArray, "C"], policy: MaterialPolicy = "error"
) -> Complex[NDArray[np.complex128], "C 4"]:
    """Reflection TE, TM and transmission TE, TM of a slab, for C cosines of the angle of incidence upon its front."""
    permittivity = np.array([complex_permittivity(layer.material, carrier_hz, policy) for layer in slab.layers])
    thickness_m = np.array([layer.thickness_m for layer in slab.layers])
    phase_thickness = 2 * np.pi * thickness_m * carrier_hz / SPEED_OF_LIGHT_M_S
    return np.array([stack_coefficients(c, permittivity, phase_thickness) for c in cosine.tolist()])


def slab_absorption(slab: Slab, carrier_hz: float, policy: MaterialPolicy = "error") -> float:
    """The share of diffuse power, of both polarisations, that a slab does not reflect: it absorbs it or lets it pass.

    1 − ∫ (|r_TE|² + |r_TM|²)·μ dμ over the cosines μ of incidence from 0 to 1 (Kuttruff, Room Acoustics). Of a slab
    whose two sides differ it is the mean of both.
    """
    # 256 nodes: two for a fringe of 20 cm of glass at 94 GHz
    nodes, weights = np.polynomial.legendre.leggauss(256)
    cosine = (1 + nodes) / 2
    sides = [np.abs(slab_response(side, carrier_hz, cosine, policy)[:, :2]) ** 2 for side in {slab, slab.turned}]
    return float(1 - weights / 2 * cosine @ np.mean(sides, axis=0).sum(axis=1))


def mean_absorption(geometry: Geometry, carrier_hz: float, policy: MaterialPolicy = "error") -> float:
    """The mean of `slab_absorption` over a scene's surfaces, each by its area; nan without surfaces."""
    areas_m2: dict[Slab, float] = {}
    for mesh in geometry.meshes:
        corners_m = mesh.corners_m
        sides = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
        areas_m2[mesh.slab] = areas_m2.get(mesh.slab, 0.0) + float(np.linalg.norm(sides, axis=1).sum() / 2)
    total_m2 = sum(areas_m2.values())
    absorbed = sum(area_m2 * slab_absorption(slab, carrier_hz, policy) for slab, area_m2 in areas_m2.items())
    return absorbed / total_m2 if total_m2 else float("nan")
