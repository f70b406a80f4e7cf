"""The image method where geometry is at its edges, against mirror images and Fresnel slabs written out."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from xfreqbench.image_kernels import slab_coefficients
from xfreqbench.image_method import ImageSavings, ImageTracer
from xfreqbench.materials import complex_permittivity
from xfreqbench.paths import SPECULAR
from xfreqbench.scene import ReceiverArray, Surface
from xfreqbench.splatting.composite_kernels import use_threads
from xfreqbench.stress.case import Case
from xfreqbench.stress.channels import CARRIERS_GHZ, RECEIVER, free_space, friis, wave
from xfreqbench.stress.threads import needing_two_threads
from xfreqbench.tracing import TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S, ghz_to_hz

_CARRIERS_HZ = [ghz_to_hz(ghz) for ghz in (1.0, 24.25, 94.0)]
_ONE = replace(RECEIVER, rows=1, cols=1)
_HEIGHT_M = RECEIVER.position_m[2]
_SETTINGS = TraceSettings(solver="image", rays=2000, max_depth=1)
# the phase's 5e-10 rad, in the sum of two or three paths
_LIMIT = 2e-9
_ROUNDINGS = 1e-12  # of double precision, in sums of four paths
_POLARIZATIONS: tuple[Literal["V", "H"], ...] = ("V", "H")
_NEAR_THE_FLOOR = {  # the floor reflects between x = 1.2 and 1.8
    "sheets that end on a floor": tuple(
        Surface(f"sheet {x}", "glass", 0.005, (x, -2.0, 0.0), (x, 2.0, 1.0)) for x in (1.38, 1.62)
    ),
    "tiles that overlap": (
        Surface("small tile", "glass", 0.005, (1.0, -2.0, 0.6), (1.5, 2.0, 0.6)),
        Surface("large tile", "metal", 0.005, (0.0, -2.0, 0.6), (3.0, 2.0, 0.6)),
    ),
}


def _channel(
    surfaces: tuple[Surface, ...],
    receiver: ReceiverArray,
    tx_m: tuple[float, float, float],
    max_depth: int = 1,
) -> NDArray[np.complex128]:
    """(F, M) of one transmitter at three carriers."""
    scene = replace(free_space(receiver), surface=surfaces)
    tracer = ImageTracer(scene, _CARRIERS_HZ, replace(_SETTINGS, max_depth=max_depth))
    return tracer.channel(np.array([tx_m])).cfr[0]


def _slab(
    material: str, thickness_m: float, carrier_hz: float, cosine: float
) -> tuple[complex, complex, complex, complex]:
    """R_TE, R_TM, T_TE and T_TM of a slab: Recommendation ITU-R P.2040-3, Eqs. (37), (38), (43)–(45)."""
    eta = complex_permittivity(material, carrier_hz)
    root = np.sqrt(eta - (1 - cosine**2))
    through = np.exp(-2j * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S * thickness_m * root)
    te = (cosine - root) / (cosine + root)
    tm = (eta * cosine - root) / (eta * cosine + root)
    r_te, r_tm = (face * (1 - through**2) / (1 - (face * through) ** 2) for face in (te, tm))
    t_te, t_tm = ((1 - face**2) * through / (1 - (face * through) ** 2) for face in (te, tm))
    return complex(r_te), complex(r_tm), complex(t_te), complex(t_tm)


def _ray(length_m: float | np.longdouble, carrier_hz: float) -> complex:
    length = np.asarray(length_m, dtype=np.longdouble)
    return complex(friis(length, carrier_hz) * wave(length, carrier_hz))


def _off(found: NDArray[np.complex128], expected: list[complex], length_m: float) -> float:
    """Largest error of a channel a carrier, relative to a lone path of that length."""
    errors = [
        abs(row[0] - value) / abs(_ray(length_m, carrier_hz))
        for row, value, carrier_hz in zip(found, expected, _CARRIERS_HZ, strict=True)
    ]
    return float(max(errors))


def _grazing() -> float:
    """5 cm above a floor and 100 m away: cos θ is 1e-3, and R_TE next to −1. Horizontal antennas see TE alone."""
    floor = Surface("floor", "concrete", 0.2, (-50.0, -50.0, 0.0), (150.0, 50.0, 0.0))
    receiver = replace(_ONE, position_m=(0.0, 0.0, 0.05), polarization="H")
    found = _channel((floor,), receiver, (100.0, 0.0, 0.05))
    bounce_m = np.hypot(np.longdouble(100), np.longdouble(0.1))
    cosine = float(0.1 / bounce_m)
    expected = [
        -_ray(100.0, f) - _slab("concrete", 0.2, f, cosine)[0] * _ray(bounce_m, f)  # φ̂ turns with the ray
        for f in _CARRIERS_HZ
    ]
    return _off(found, expected, 100.0)


def _normal_incidence(material: str) -> float:
    """A wall 2 m behind the transmitter sends its wave straight back, past it."""
    wall = Surface("wall", material, 0.1, (5.0, -9.0, -9.0), (5.0, 9.0, 9.0))
    found = _channel((wall,), _ONE, (3.0, 0.0, _HEIGHT_M))
    expected = [_ray(3.0, f) + _slab(material, 0.1, f, 1.0)[0] * _ray(7.0, f) for f in _CARRIERS_HZ]
    return _off(found, expected, 3.0)


def _boresight(offset_m: float, polarization: Literal["V", "H"]) -> float:
    """Below the array, on its normal or beside it, however near.

    θ̂ is the same for a ray and its opposite, φ̂ the opposite.
    """
    found = _channel((), replace(_ONE, polarization=polarization), (offset_m, 0.0, 0.5))
    length_m = np.hypot(np.longdouble(offset_m), np.longdouble(_HEIGHT_M - 0.5))
    sign = 1 if polarization == "V" else -1
    return _off(found, [sign * _ray(length_m, f) for f in _CARRIERS_HZ], 1.5)


def _edge(material: str, receiver: ReceiverArray) -> float:
    """A ray exactly along a screen's edge passes by it or through it, and nothing between."""
    screen = Surface("screen", material, 0.02, (2.0, 0.0, -9.0), (2.0, 9.0, 9.0))
    found = _channel((screen,), receiver, (4.0, 0.0, _HEIGHT_M))
    free = [_ray(4.0, f) for f in _CARRIERS_HZ]
    behind = [_slab(material, 0.02, f, 1.0)[2] * ray for f, ray in zip(_CARRIERS_HZ, free, strict=True)]
    opaque = [0j] * len(free)
    return min(_off(found, expected, 4.0) for expected in (free, behind, opaque))


def _border() -> float:
    """A reflection exactly at a floor's border is there or not."""
    floor = Surface("floor", "concrete", 0.2, (-9.0, -9.0, 0.0), (1.5, 9.0, 0.0))
    receiver = replace(_ONE, polarization="H")
    found = _channel((floor,), receiver, (3.0, 0.0, _HEIGHT_M))
    lone = [-_ray(3.0, f) for f in _CARRIERS_HZ]
    bounce_m = np.hypot(np.longdouble(3), np.longdouble(4))
    bounce = [-_slab("concrete", 0.2, f, float(4 / bounce_m))[0] * _ray(bounce_m, f) for f in _CARRIERS_HZ]
    both = [direct + reflected for direct, reflected in zip(lone, bounce, strict=True)]
    return min(_off(found, expected, 3.0) for expected in (lone, both))


def _unfolded() -> float:
    """Metres by which the paths between two plates are longer than their unfolded lines, 100 m apart."""
    plates = tuple(
        Surface(name, "metal", 0.01, (-20.0, -60.0, z), (120.0, 60.0, z))
        for name, z in (("low", 0.0), ("high", 4.0))
    )
    scene = replace(free_space(_ONE), surface=plates)
    tracer = ImageTracer(scene, [94e9], replace(_SETTINGS, max_depth=5, rays=200_000))
    paths = tracer.paths(np.array([100.0, 0.0, 1.0]))
    images_m = [8.0 * turn + side * 1.0 for turn in range(-3, 4) for side in (1, -1)]
    lengths_m = {float(np.hypot(np.longdouble(100), np.longdouble(z - _HEIGHT_M))) for z in images_m}
    nearest = [
        min(abs(delay * SPEED_OF_LIGHT_M_S - length) for length in lengths_m) for delay in paths.delay_s
    ]
    reflections = (paths.interactions == SPECULAR).sum(axis=1)
    assert sorted(reflections) == [0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5], (
        f"reflections a path: {sorted(reflections)}"
    )
    return float(max(nearest))


def _reciprocity() -> float:
    """Transmitter and receiver change places between a floor, a wall and a screen."""
    room = (
        Surface("floor", "concrete", 0.2, (-9.0, -9.0, 0.0), (9.0, 9.0, 0.0)),
        Surface("wall", "glass", 0.01, (-9.0, -4.0, 0.0), (9.0, -4.0, 3.0)),
        Surface("screen", "wood", 0.03, (1.5, -2.0, 0.0), (1.5, 3.0, 3.0)),
    )
    there, here = (3.1, 0.7, 1.1), (-0.3, -1.2, 2.2)
    forward, backward = (
        _channel(room, ReceiverArray(position_m=rx, rows=1, cols=1, polarization="V"), tx, max_depth=3)
        for rx, tx in ((here, there), (there, here))
    )
    return float((np.abs(forward - backward) / np.abs(forward)).max())


def _slabs() -> float:
    """Compiled coefficients against the written-out ones, from grazing to normal, from glass to metal."""
    errors = []
    for material, thickness_m in (("glass", 0.01), ("concrete", 0.3), ("metal", 0.05), ("vacuum", 0.1)):
        for carrier_hz in [ghz_to_hz(ghz) for ghz in CARRIERS_GHZ]:
            phase_thickness = 2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S * thickness_m
            for cosine in (1e-4, 1e-2, 0.5, 1.0):
                eta = complex_permittivity(material, carrier_hz)
                found = slab_coefficients(cosine, eta, phase_thickness)
                expected = _slab(material, thickness_m, carrier_hz, cosine)
                errors.append(np.abs(np.subtract(found, expected)).max())
    return float(max(errors))


def _energy() -> float:
    """|R|² + |T|² of a slab without loss, at all angles."""
    errors = []
    for cosine in np.geomspace(1e-6, 1, 50):
        r_te, r_tm, t_te, t_tm = slab_coefficients(float(cosine), 6.31 + 0j, 37.0)
        errors += [abs(abs(r_te) ** 2 + abs(t_te) ** 2 - 1), abs(abs(r_tm) ** 2 + abs(t_tm) ** 2 - 1)]
    return max(errors)


def _threads() -> float:
    """Difference between channels computed by one thread and by two."""
    floor = Surface("floor", "concrete", 0.2, (-9.0, -9.0, 0.0), (9.0, 9.0, 0.0))
    scene = replace(free_space(), surface=(floor,))
    tracer = ImageTracer(scene, _CARRIERS_HZ, _SETTINGS)
    tx_m = np.random.default_rng(0).uniform(0.5, 3.0, size=(9, 3)) * (1, 1, 0.5)
    before = use_threads(1)
    try:
        one = tracer.channel(tx_m).cfr
        use_threads(2)
        two = tracer.channel(tx_m).cfr
    finally:
        use_threads(before)
    return float(np.abs(one - two).max())


def _by_corners(surfaces: tuple[Surface, ...]) -> float:
    """Channels where four corners decide for the elements between them, against every element traced by itself.

    A transmitter at 40 heights, so that what stands near its floor is met within 1 cm of the reflection by some
    elements and by others beyond.
    """
    floor = Surface("floor", "concrete", 0.2, (-9.0, -9.0, 0.0), (9.0, 9.0, 0.0))
    scene = replace(free_space(), surface=(floor, *surfaces))
    settings = replace(_SETTINGS, max_depth=4)
    tx_m = np.array([(3.0, 0.1, height_m) for height_m in np.linspace(1.5, 2.5, 40)])
    shared, single = (
        ImageTracer(
            scene, _CARRIERS_HZ, settings, ImageSavings(share_visibility=share, field_nodes_per_axis=4)
        )
        .channel(tx_m)
        .cfr
        for share in (True, False)
    )
    return float((np.abs(shared - single).max(axis=(1, 2)) / np.abs(single).max(axis=(1, 2))).max())


CASES = (
    Case("reflection at grazing incidence, 100 m", "geometry", _LIMIT, "relative", _grazing),
    Case(
        "reflection at normal incidence, concrete",
        "geometry",
        _LIMIT,
        "relative",
        partial(_normal_incidence, "concrete"),
    ),
    Case(
        "reflection at normal incidence, metal",
        "geometry",
        _LIMIT,
        "relative",
        partial(_normal_incidence, "metal"),
    ),
    *(
        Case(
            f"transmitter {where} the array's normal, {polarization}",
            "geometry",
            _LIMIT,
            "relative",
            partial(_boresight, offset_m, polarization),
        )
        for where, offset_m in (("on", 0.0), ("1 µm off", 1e-6), ("1 mm off", 1e-3))
        for polarization in _POLARIZATIONS
    ),
    Case(
        "ray along the edge of a wooden screen", "geometry", _LIMIT, "relative", partial(_edge, "wood", _ONE)
    ),
    Case(
        "ray along the edge of a metal screen", "geometry", _LIMIT, "relative", partial(_edge, "metal", _ONE)
    ),
    Case("reflection at the border of a floor", "geometry", _LIMIT, "relative", _border),
    # some roundings of 100 m
    Case("lengths of unfolded paths over 100 m, in metres", "geometry", 1e-12, "m", _unfolded),
    Case("transmitter and receiver change places", "geometry", _LIMIT, "relative", _reciprocity),
    # the phase in the slab is up to 3000 rad in metal, but nothing of it comes back; 600 rad in concrete
    Case("slab coefficients, grazing to normal", "geometry", 1e-12, "absolute", _slabs),
    # 1 − R² of grazing rays keeps 1e-16 of 1e-6, and is divided by a number as small
    Case("slabs without loss keep the energy", "geometry", 1e-9, "relative", _energy),
    *(
        Case(
            f"visibility by corners against every element, {name}",
            "geometry",
            _ROUNDINGS,
            "relative",
            partial(_by_corners, surfaces),
        )
        for name, surfaces in _NEAR_THE_FLOOR.items()
    ),
    Case("channels of one thread and of two", "geometry", 0, "absolute", needing_two_threads(_threads)),
)
