"""Phases and amplitudes of channels up to 100 m, against closed forms in long double."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from xfreqbench.bench.stress.case import Area
from xfreqbench.maps.bartlett import cfr_of_plane_waves
from xfreqbench.scene.model import ReceiverArray, Scene
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION, TraceSettings
from xfreqbench.types import NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, ghz_to_hz

PHASE = Area("phase")
CARRIERS_GHZ = (1.0, 2.4, 10.0, 24.25, 60.0, 94.0)
PI = 4 * np.arctan(np.longdouble(1))
LIGHT_M_S = np.longdouble(SPEED_OF_LIGHT_M_S)
RECEIVER = ReceiverArray(position_m=(0.0, 0.0, 2.0))
THREE_HZ = [ghz_to_hz(ghz) for ghz in (1.0, 24.25, 94.0)]
SINGLE = replace(RECEIVER, rows=1, cols=1)  # an array of one element
HEIGHT_M = RECEIVER.position_m[2]
SETTINGS = TraceSettings(interactions=WITHOUT_DIFFRACTION, solver="image", rays=1000)
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
