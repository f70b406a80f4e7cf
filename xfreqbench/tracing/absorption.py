"""How much of the diffuse power in a room its surfaces take."""

from __future__ import annotations

import numpy as np

from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import MaterialPolicy, complex_permittivity
from xfreqbench.tracing.image.kernels.slabs import slab_coefficients
from xfreqbench.units import SPEED_OF_LIGHT_M_S

_NODES = 256  # of the quadrature: two for a fringe of 20 cm of glass at 94 GHz


def slab_absorption(slab: Slab, carrier_hz: float, policy: MaterialPolicy = "error") -> float:
    """The share of diffuse power, of both polarisations, that a slab does not reflect: it absorbs it or lets it pass.

    1 − ∫ (|r_TE|² + |r_TM|²)·μ dμ over the cosines μ of incidence from 0 to 1 (Kuttruff, Room Acoustics).
    """
    permittivity = complex_permittivity(slab.material, carrier_hz, policy)
    phase_thickness = 2 * np.pi * slab.thickness_m * carrier_hz / SPEED_OF_LIGHT_M_S
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    reflected = 0.0
    for cosine, weight in zip((1 + nodes) / 2, weights / 2, strict=True):
        r_te, r_tm, _, _ = slab_coefficients(cosine, permittivity, phase_thickness)
        reflected += weight * cosine * (abs(r_te) ** 2 + abs(r_tm) ** 2)
    return float(1 - reflected)


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
