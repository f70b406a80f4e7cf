"""Phases and amplitudes of channels up to 100 m, and permittivities, against closed forms (phases in long double)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from xfreqbench.bench.stress.case import Area
from xfreqbench.errors import MaterialBandError
from xfreqbench.maps.bartlett import cfr_of_plane_waves
from xfreqbench.scene.array import planar_array, steering_vector
from xfreqbench.scene.materials import ITU_MATERIALS, Band, complex_permittivity
from xfreqbench.scene.model import ReceiverArray, Scene
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION, TraceSettings
from xfreqbench.types import NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, VACUUM_PERMITTIVITY_F_M, ghz_to_hz

PHASE, MATERIALS = Area("phase"), Area("materials")
CARRIERS_GHZ = (1.0, 2.4, 10.0, 24.25, 60.0, 94.0)
PI = 4 * np.arctan(np.longdouble(1))
LIGHT_M_S = np.longdouble(SPEED_OF_LIGHT_M_S)
RECEIVER = ReceiverArray(position_m=(0.0, 0.0, 2.0))
THREE_HZ = [ghz_to_hz(ghz) for ghz in (1.0, 24.25, 94.0)]
SINGLE = replace(RECEIVER, rows=1, cols=1)  # an array of one element
HEIGHT_M = RECEIVER.position_m[2]
SETTINGS = TraceSettings(interactions=WITHOUT_DIFFRACTION, solver="image", rays=1000)
_VACUUM_PERMEABILITY_H_M = 1.25663706212e-6  # CODATA 2018
_LENGTHS_M = np.geomspace(0.1, 100, 200)
# 100 m at 94 GHz are 31,000 turns: four roundings of 1.1e-16 each, times 2π, make 9e-11 rad
_PHASE_LIMIT = 1e-10


def free_space(receiver: ReceiverArray = RECEIVER) -> Scene:
    """A scene without surfaces."""
    return Scene(name="free space", receiver=receiver)


def wave(length_m: NDArray[np.longdouble], carrier_hz: float) -> NDArray[np.clongdouble]:
    """exp(−j2πfL/c) in extended precision, whole turns subtracted before the sine and cosine."""
    turns = np.longdouble(carrier_hz) * length_m / LIGHT_M_S
    angle = 2 * PI * (turns - np.floor(turns))
    return np.asarray(np.cos(angle) - 1j * np.sin(angle))


def friis(length_m: NDArray[np.longdouble], carrier_hz: float) -> NDArray[np.longdouble]:
    """Amplitude λ/4πL of a path in free space, in extended precision."""
    return np.asarray(LIGHT_M_S / np.longdouble(carrier_hz) / (4 * PI * length_m))


@PHASE.cases_of(
    {f"plane waves, 0.1 to 100 m at {ghz:g} GHz": (ghz,) for ghz in CARRIERS_GHZ}, limit=_PHASE_LIMIT, unit="rad"
)
def _plane_wave_phase(carrier_ghz: float) -> float:
    carrier_hz = ghz_to_hz(carrier_ghz)
    delay_s = _LENGTHS_M / SPEED_OF_LIGHT_M_S
    expected = wave(delay_s.astype(np.longdouble) * LIGHT_M_S, carrier_hz)
    gain, arrival = np.ones(1, complex), np.array([[0.6, 0.0, 0.8]])
    found = [cfr_of_plane_waves(gain, delay, arrival, np.zeros((1, 3)), carrier_hz)[0] for delay in delay_s[:, None]]
    return float(np.abs(np.array(found) / expected - 1).max())


def _horizontal_m() -> NDArray[np.float64]:
    """Positions of transmitters in the array's plane, where the antennas of both ends are parallel, (T, 3)."""
    height_m = np.full_like(_LENGTHS_M, HEIGHT_M)
    return np.stack([0.8 * _LENGTHS_M, 0.6 * _LENGTHS_M, height_m], axis=1)


def _traced(carrier_hz: float) -> tuple[NDArray[np.complex128], NDArray[np.longdouble]]:
    """Channels of the image method in free space, (T, M), and the exact distances to the elements in metres."""
    tx_m = _horizontal_m()
    cfr = ImageTracer(free_space(), [carrier_hz], SETTINGS).channel(tx_m).cfr[:, 0]
    element_m = RECEIVER.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz)
    gap_m = tx_m.astype(np.longdouble)[:, None] - element_m
    return cfr, np.sqrt((gap_m * gap_m).sum(axis=-1))


@PHASE.cases_of(
    {f"image method, 0.1 to 100 m at {ghz:g} GHz": (ghz,) for ghz in CARRIERS_GHZ},
    limit=5e-10,  # its polynomials of sine and cosine add 1e-10, and its distances a rounding of their square
    unit="rad",
)
def _image_phase(carrier_ghz: float) -> float:
    carrier_hz = ghz_to_hz(carrier_ghz)
    cfr, distance_m = _traced(carrier_hz)
    return float(np.abs(cfr / np.abs(cfr) / wave(distance_m, carrier_hz) - 1).max())


@PHASE.case("image method, Friis over 100 m, six carriers", limit=1e-9, unit="relative")
def _image_amplitude() -> float:
    errors = []
    for carrier_ghz in CARRIERS_GHZ:
        cfr, distance_m = _traced(ghz_to_hz(carrier_ghz))
        errors.append(np.abs(np.abs(cfr) / friis(distance_m, ghz_to_hz(carrier_ghz)) - 1).max())
    return float(max(errors))


@PHASE.case("two carriers 1 Hz apart over 100 m", limit=_PHASE_LIMIT, unit="rad")
def _one_hertz_apart() -> float:
    carriers, length_m = [24.25e9, 24.25e9 + 1], 100.0
    tracer = ImageTracer(free_space(SINGLE), carriers, SETTINGS)
    low, high = tracer.channel(np.array([[length_m, 0.0, 2.0]])).cfr[0, :, 0]
    return float(abs(np.angle(high / low) + 2 * np.pi * length_m / SPEED_OF_LIGHT_M_S))


@PHASE.case(
    "steering vectors of 64×64 elements at 94 GHz",
    limit=1e-13,  # the corners lie 22 wavelengths from the centre: 140 rad times five roundings
    unit="rad",
)
def _steering() -> float:
    """Error of steering vectors of unit modulus, for 50 arrivals."""
    element_m = planar_array(64, 64, 0.5) * SPEED_OF_LIGHT_M_S / 94e9
    directions = np.random.default_rng(0).normal(size=(50, 3))
    arrival = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    path_m = (arrival.astype(np.longdouble)[:, None] * element_m).sum(axis=-1)
    return float(np.abs(steering_vector(element_m, arrival, 94e9) / wave(-path_m, 94e9) - 1).max())


Side = Literal["lower", "upper"]


def _edges(side: Side, outward_hz: float) -> Iterator[tuple[str, Band, float]]:
    """Material, band and carrier of every tabulated band; the carrier lies `outward_hz` outside one edge of the band.

    Carriers that another band of the same material contains are left out.
    """
    for name, bands in ITU_MATERIALS.items():
        for band in bands:
            low, high = round(band.low_ghz * 1e9), round(band.high_ghz * 1e9)
            carrier_hz = low - outward_hz if side == "lower" else high + outward_hz
            if not any(other.contains(carrier_hz) for other in bands if other != band):
                yield name, band, carrier_hz


@MATERIALS.cases_of(
    {f"P.2040 at the {side} edge of every band": (side,) for side in get_args(Side)},
    limit=1e-9,  # the constants of CODATA agree to 1e-10
    unit="relative",
)
def _permittivity_at_edges(side: Side) -> float:
    """Error of η = ε' − jσ/(2πfε₀), ε₀ = 1/(μ₀c²), at the edges of all bands and 1 Hz inside them."""
    vacuum_f_m = 1 / (_VACUUM_PERMEABILITY_H_M * SPEED_OF_LIGHT_M_S**2)
    errors = []
    for name, band, carrier_hz in [*_edges(side, 0.0), *_edges(side, -1.0)]:
        carrier_ghz = carrier_hz / 1e9
        conductivity_s_m = band.c * carrier_ghz**band.d
        imaginary = conductivity_s_m / (2 * np.pi * carrier_hz * vacuum_f_m)
        expected = band.a * carrier_ghz**band.b - 1j * imaginary
        errors.append(abs(complex_permittivity(name, carrier_hz) / expected - 1))
    return max(errors)


@MATERIALS.case("P.2040 refuses 1 Hz outside every band", limit=0, unit="materials")
def _accepted_outside() -> float:
    """Number of bands that are accepted 1 Hz outside their edges, gaps between bands included."""
    accepted = 0
    for name, _, carrier_hz in [*_edges("lower", 1.0), *_edges("upper", 1.0)]:
        try:
            complex_permittivity(name, carrier_hz)
            accepted += 1
        except MaterialBandError:
            continue
    return float(accepted)


@MATERIALS.case(
    "extrapolation starts where a band ends",
    limit=1e-8,  # 1 Hz is 1e-6 of 1 MHz, where a twentieth of wood's permittivity goes as f^0.07
    unit="relative",
)
def _extrapolated_jump() -> float:
    """Difference between the extrapolation 1 Hz outside a band and the band's power law at its edge."""
    jumps = []
    for side in get_args(Side):
        for name, band, carrier_hz in _edges(side, 1.0):
            inside_hz = (band.low_ghz if side == "lower" else band.high_ghz) * 1e9
            conductivity_s_m = band.c * (inside_hz / 1e9) ** band.d
            loss = conductivity_s_m / (2 * np.pi * inside_hz * VACUUM_PERMITTIVITY_F_M)
            edge = band.a * (inside_hz / 1e9) ** band.b - 1j * loss
            jumps.append(abs(complex_permittivity(name, carrier_hz, "extrapolate") / edge - 1))
    return max(jumps)
