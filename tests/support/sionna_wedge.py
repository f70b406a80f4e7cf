"""The wedge of Sionna RT 2.2.0, `RadioMaterial._diffraction_matrix`, written out in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import wofz

from xfreqbench.tracing.image.edges import Edge
from xfreqbench.tracing.image.kernels.slabs import slab_coefficients

Vector = NDArray[np.float64]


def unit(vector: Vector) -> Vector:
    return vector / np.linalg.norm(vector)


def rotator(k: Vector, current: Vector, target: Vector) -> Vector:
    cosine, sine = current @ target, k @ np.cross(current, target)
    return np.array([[cosine, sine], [-sine, cosine]])


def sionna_wedge(
    edge: Edge,
    incoming: Vector,
    outgoing: Vector,
    distances_m: tuple[float, float],
    wavelength_m: float,
    slab: tuple[complex, float],
) -> NDArray[np.complex128]:
    """Matrix (3, 3) that Sionna RT applies to the field at an edge; faces are ordered for the incoming wave.

    `distances_m` are those before and after the edge, `slab` is a permittivity and a thickness over the wavelength
    in radians.
    """
    n0, e = edge.normal, edge.along
    nn = np.sin(edge.angle_rad) * edge.tangent - np.cos(edge.angle_rad) * edge.normal
    if incoming @ n0 > 0:
        n0, nn, e = nn, n0, -e
    n, k, sine = edge.angle_rad / np.pi, 2 * np.pi / wavelength_m, np.linalg.norm(np.cross(incoming, e))
    t0 = np.cross(n0, e)
    source = np.arctan2(-incoming @ n0, -incoming @ t0) % (2 * np.pi)
    phi = np.arctan2(outgoing @ n0, outgoing @ t0) % (2 * np.pi)
    root = np.sqrt(2 * k * distances_m[0] * distances_m[1] / sum(distances_m)) * sine

    def term(turn: float) -> complex:
        off = turn / (2 * n) - np.pi * np.round(turn / (2 * n * np.pi))
        y = root * abs(np.sin(n * off))
        transition = np.sqrt(np.pi) * np.exp(0.25j * np.pi) * y * wofz(1j * np.exp(0.25j * np.pi) * y)
        factor = -np.exp(-0.25j * np.pi) / (2 * n * np.sqrt(2 * np.pi * k) * sine)
        return complex(factor / np.tan(off) * transition)

    apart, together = phi - source, phi + source
    d1, d2, d3, d4 = (term(np.pi + turn) for turn in (apart, -apart, together, -together))
    phi_in = unit(np.cross(incoming, e))
    faces = []
    for normal in (n0, nn):
        reflected = incoming - 2 * (incoming @ normal) * normal
        s = unit(np.cross(incoming, normal))
        te, tm, _, _ = slab_coefficients(abs(incoming @ normal), *slab)
        back = rotator(reflected, s, -unit(np.cross(reflected, e)))
        faces.append(back @ np.diag([te, tm]) @ rotator(incoming, phi_in, s))
    if edge.angle_rad > np.pi + source:
        faces[1] = -np.eye(2)
    matrix = faces[0] * (d1 - d4) + faces[1] * (d2 - d3)
    phi_out = -unit(np.cross(outgoing, e))
    return np.stack([phi_out, np.cross(outgoing, phi_out)]).T @ matrix @ np.stack([phi_in, np.cross(incoming, phi_in)])
