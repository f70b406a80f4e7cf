"""The image method at extremes of geometry, against mirror images and Fresnel slabs written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.bench.stress.case import Area
from xfreqbench.bench.stress.channels import HEIGHT_M, SINGLE, THREE_HZ, free_space, friis, wave
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.materials import complex_permittivity
from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.model import PatchSize, ReceiverArray, Surface
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION, TraceSettings
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

GEOMETRY = Area("geometry")
_SETTINGS = TraceSettings(interactions=WITHOUT_DIFFRACTION, solver="image", rays=2000, max_depth=1)
_LIMIT = 2e-9  # the phase's 5e-10 rad, in the sum of two or three paths
_HORIZONTAL = replace(SINGLE, polarization="H")


def _channel(
    surfaces: tuple[Surface, ...], receiver: ReceiverArray, tx_m: tuple[float, float, float]
) -> NDArray[np.complex128]:
    """Channel of one transmitter at three carriers, (F, M)."""
    scene = replace(free_space(receiver), surface=surfaces)
    return ImageTracer(scene, THREE_HZ, _SETTINGS).channel(np.array([tx_m])).cfr[0]


def fresnel_slab(
    material: str, thickness_m: float, carrier_hz: float, cosine: float
) -> tuple[complex, complex, complex, complex]:
    """Coefficients R_TE, R_TM, T_TE and T_TM of a slab: Recommendation ITU-R P.2040-3, Eqs. (37), (38), (43)–(45)."""
    eta = complex_permittivity(material, carrier_hz)
    root = np.sqrt(eta - (1 - cosine**2))
    through = np.exp(-2j * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S * thickness_m * root)
    te = (cosine - root) / (cosine + root)
    tm = (eta * cosine - root) / (eta * cosine + root)
    r_te, r_tm = (face * (1 - through**2) / (1 - (face * through) ** 2) for face in (te, tm))
    t_te, t_tm = ((1 - face**2) * through / (1 - (face * through) ** 2) for face in (te, tm))
    return complex(r_te), complex(r_tm), complex(t_te), complex(t_tm)


def ray(length_m: float | np.longdouble, carrier_hz: float) -> complex:
    """Channel λ/4πL·exp(−j2πL/λ) of a lone path of length L."""
    length = np.asarray(length_m, dtype=np.longdouble)
    return complex(friis(length, carrier_hz) * wave(length, carrier_hz))


def largest_error(found: NDArray[np.complex128], expected: list[complex], length_m: float) -> float:
    """Largest error over the carriers of a channel, relative to the amplitude of a lone path of that length."""
    errors = [
        abs(row[0] - value) / abs(ray(length_m, carrier_hz))
        for row, value, carrier_hz in zip(found, expected, THREE_HZ, strict=True)
    ]
    return float(max(errors))


@GEOMETRY.case("reflection at grazing incidence, 100 m", limit=_LIMIT, unit="relative")
def _grazing() -> float:
    """Both ends 5 cm above a floor and 100 m apart: cos θ is 1e-3, and R_TE is nearly −1.

    Horizontal antennas see TE alone.
    """
    floor = Surface("floor", "concrete", 0.2, (-50.0, -50.0, 0.0), (150.0, 50.0, 0.0))
    receiver = replace(_HORIZONTAL, position_m=(0.0, 0.0, 0.05))
    found = _channel((floor,), receiver, (100.0, 0.0, 0.05))
    bounce_m = np.hypot(np.longdouble(100), np.longdouble(0.1))
    cosine = float(0.1 / bounce_m)
    expected = [
        -ray(100.0, f) - fresnel_slab("concrete", 0.2, f, cosine)[0] * ray(bounce_m, f)  # φ̂ turns with the ray
        for f in THREE_HZ
    ]
    return largest_error(found, expected, 100.0)


@GEOMETRY.cases_of(
    {"ray along the edge of a wooden screen": ("wood",), "ray along the edge of a metal screen": ("metal",)},
    limit=_LIMIT,
    unit="relative",
)
def _edge(material: str) -> float:
    """A ray exactly along the edge of a screen passes by it, through it or not at all, with nothing in between."""
    screen = Surface("screen", material, 0.02, (2.0, 0.0, -9.0), (2.0, 9.0, 9.0))
    found = _channel((screen,), SINGLE, (4.0, 0.0, HEIGHT_M))
    free = [ray(4.0, f) for f in THREE_HZ]
    behind = [fresnel_slab(material, 0.02, f, 1.0)[2] * alone for f, alone in zip(THREE_HZ, free, strict=True)]
    opaque = [0j] * len(free)
    return min(largest_error(found, expected, 4.0) for expected in (free, behind, opaque))


@GEOMETRY.case("reflection at the border of a floor", limit=_LIMIT, unit="relative")
def _border() -> float:
    """A reflection exactly at the border of a floor is either there or not."""
    floor = Surface("floor", "concrete", 0.2, (-9.0, -9.0, 0.0), (1.5, 9.0, 0.0))
    found = _channel((floor,), _HORIZONTAL, (3.0, 0.0, HEIGHT_M))
    lone = [-ray(3.0, f) for f in THREE_HZ]
    bounce_m = np.hypot(np.longdouble(3), np.longdouble(4))
    bounce = [-fresnel_slab("concrete", 0.2, f, float(4 / bounce_m))[0] * ray(bounce_m, f) for f in THREE_HZ]
    both = [direct + reflected for direct, reflected in zip(lone, bounce, strict=True)]
    return min(largest_error(found, expected, 3.0) for expected in (lone, both))


def _needles(num_triangles: int) -> tuple[Float[FloatArray, "V 2"], Int[IntArray, "K 3"]]:
    """The unit square as a fan: its lower left corner, joined to points on the two sides that do not meet there."""
    at = np.linspace(0, 1, num_triangles // 2 + 1)
    upwards, back = np.stack([0 * at + 1, at], axis=1), np.stack([1 - at, 0 * at + 1], axis=1)
    corner = np.arange(1, num_triangles + 1)
    fan = np.stack([0 * corner, corner, corner + 1], axis=1)
    return np.vstack([[[0.0, 0.0]], upwards, back[1:]]), fan


@GEOMETRY.case("a floor of 2,000 needles, 0.5 mm by 1 m", limit=_LIMIT, unit="relative")
def _cut_floor() -> float:
    """A tilted floor that is cut into triangles reflects as a whole, wherever the cuts are."""
    place, triangles = _needles(2000)
    along, across = np.array([2.0, 0.0, 0.3]), np.array([0.0, 2.0, 0.0])
    vertices_m = np.array([-0.1, -0.7, 0.0]) + place @ np.stack([along, across])
    floor = SurfaceMesh("floor", "concrete", 0.2, vertices_m, triangles, least_patch=PatchSize())
    normal = np.cross(along, across) / np.linalg.norm(np.cross(along, across))
    here, tx_m = np.array(_HORIZONTAL.position_m), np.array([1.1, 0.0, 1.6])  # whose φ̂ are parallel
    image_m = here - 2 * (here - vertices_m[0]) @ normal * normal
    length_m, direct_m = float(np.linalg.norm(tx_m - image_m)), float(np.linalg.norm(tx_m - here))
    cosine = abs((tx_m - image_m) @ normal) / length_m
    expected = [-ray(direct_m, f) - fresnel_slab("concrete", 0.2, f, cosine)[0] * ray(length_m, f) for f in THREE_HZ]
    settings = replace(_SETTINGS, max_depth=2)
    tracer = ImageTracer(free_space(_HORIZONTAL), THREE_HZ, settings, geometry=Geometry([floor]))
    return largest_error(tracer.channel(tx_m[None]).cfr[0], expected, direct_m)
