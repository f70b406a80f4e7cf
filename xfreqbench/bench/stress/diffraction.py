"""Diffraction at extremes of geometry: on a boundary and beside it, along an edge, and where edges coincide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import wofz

from xfreqbench.bench.stress.case import Area
from xfreqbench.bench.stress.channels import HEIGHT_M, SINGLE, THREE_HZ, free_space
from xfreqbench.scene.materials import SceneMaterial
from xfreqbench.scene.model import ReceiverArray, Surface
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

DIFFRACTION = Area("diffraction")
_SETTINGS = TraceSettings(
    solver="image", interactions=("specular", "refraction", "diffraction"), rays=2000, max_depth=2
)
_BESIDE_M = (-1e-9, 1e-9)
_BESIDE_LIMIT = 1e-5  # a nanometre at 94 GHz turns the phase by 2e-6


def _channels(surfaces: tuple[Surface, ...], tx_m: Sequence[tuple[float, ...]]) -> NDArray[np.complex128]:
    """Channels at three carriers, all paths over edges among them, (T, F)."""
    scene = replace(free_space(SINGLE), surface=surfaces)
    tracer = ImageTracer(scene, THREE_HZ, _SETTINGS, ImageSavings(diffraction_floor=0.0))
    return tracer.channel(np.array(tx_m)).cfr[..., 0]


def _largest_step(channels: NDArray[np.complex128]) -> float:
    """Largest relative difference of the channels of several transmitters from those of the first."""
    return float((np.abs(channels[1:] - channels[0]) / np.abs(channels[0])).max())


@DIFFRACTION.cases_of(
    {
        f"transmitter on the boundary of {what}, {material}": (material, side)
        for material in ("metal", "glass")
        for what, side in (("a screen's shadow", 2.0), ("a screen's reflection", -2.0))
    },
    limit=_BESIDE_LIMIT,
    unit="relative",
)
def _boundary(material: str, side: float) -> float:
    """Channels on the line from the receiver, or its image, over an edge, and a nanometre above and below it."""
    screen = Surface("screen", material, 0.01, (1.0, -9.0, -9.0), (1.0, 9.0, HEIGHT_M - 0.5))
    tx_m = [(1.0 + side, 0.0, HEIGHT_M - 1.5 + beside) for beside in (0.0, *_BESIDE_M)]
    return _largest_step(_channels((screen,), tx_m))


@DIFFRACTION.case("transmitter on the line of an edge", limit=_BESIDE_LIMIT, unit="relative")
def _end_on() -> float:
    """Channels of a transmitter on the line of an edge and a nanometre beside it."""
    screen = Surface("screen", "metal", 0.01, (1.0, 0.5, 0.0), (1.0, 1.5, 1.0))
    return _largest_step(_channels((screen,), [(1.0 + beside, -1.0, 1.0) for beside in (0.0, *_BESIDE_M)]))


@DIFFRACTION.case("edges of two boxes that touch", limit=2e-9, unit="relative")
def _touching() -> float:
    """Channels around two metal boxes that touch, against one box of their size."""
    halves = tuple(Surface(f"half {y}", "metal", 0.01, (1.0, y, 0.0), (2.0, y + 1.0, 1.0)) for y in (-1.0, 0.0))
    whole = (Surface("whole", "metal", 0.01, (1.0, -1.0, 0.0), (2.0, 1.0, 1.0)),)
    tx_m = [(2.6, 0.3, 0.7), (2.6, -0.4, 0.2), (1.4, 1.7, 0.6)]
    found, expected = (_channels(surfaces, tx_m) for surfaces in (halves, whole))
    return float((np.abs(found - expected) / np.abs(expected)).max())


@DIFFRACTION.cases_of(
    {f"array astride a screen's {what}": (side,) for what, side in (("shadow", 1.5), ("reflection", -1.5))},
    limit=1e-4,  # a conductor of 1e9 S/m reflects all but 2e-5
    unit="relative",
)
def _astride(side: float) -> float:
    """Channels of eight elements in a row, of which a shadow's boundary, or a reflection's, has four on either side.

    They are Sommerfeld's, for spherical waves that meet the edge of a perfect conductor at right angles.
    """
    receiver = ReceiverArray(position_m=(3.0, 0.0, 2.0), rows=1, cols=8, boresight=(1.0, 0.0, 0.0))
    metal = SceneMaterial(name="conductor", relative_permittivity=1.0, conductivity_s_m=1e9)
    screen = Surface("screen", metal.name, 0.01, (0.0, 0.0, -900.0), (0.0, 900.0, 900.0))
    scene = replace(free_space(receiver), surface=(screen,), material=(metal,))
    tracer = ImageTracer(scene, THREE_HZ, _SETTINGS, ImageSavings(diffraction_floor=0.0))
    tx_m = np.array([-side, 0.0, 2.0])
    found, errors = tracer.channel(tx_m[None]).cfr[0], []
    for row, carrier_hz in zip(found, THREE_HZ, strict=True):
        element_m = receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz)
        expected = _beside_a_half_plane(tx_m, element_m, carrier_hz)
        errors.append((np.abs(row - expected) * 4 * np.pi * 4.5).max() * carrier_hz / SPEED_OF_LIGHT_M_S)
    return float(max(errors))


def _beside_a_half_plane(
    tx_m: NDArray[np.float64], element_m: NDArray[np.float64], carrier_hz: float
) -> NDArray[np.complex128]:
    """Channels of a transmitter to elements (M, 3) beside the perfect conductor x = 0, y > 0, E along z."""
    wavelength_m, near_m = SPEED_OF_LIGHT_M_S / carrier_hz, float(np.hypot(*tx_m[:2]))
    wavenumber, far_m = 2 * np.pi / wavelength_m, np.hypot(*element_m.T[:2])
    source_rad, angle_rad = (np.arctan2(-x, y) % (2 * np.pi) for x, y in (tx_m[:2], element_m.T[:2]))
    over_m, total = near_m + far_m, np.zeros(len(element_m), dtype=np.complex128)
    for sign, turn_rad in ((1, angle_rad - source_rad), (-1, angle_rad + source_rad)):
        straight_m = np.sqrt(near_m**2 + far_m**2 - 2 * near_m * far_m * np.cos(turn_rad))
        straight = np.exp(-1j * wavenumber * straight_m) / straight_m
        cosine = np.cos(turn_rad / 2)
        argument = np.sqrt(2 * wavenumber * near_m * far_m / over_m) * np.abs(cosine)
        over = np.exp(-1j * wavenumber * over_m) / over_m * wofz(1j * np.exp(0.25j * np.pi) * argument) / 2
        total += sign * np.where(cosine > 0, straight - over, over)
    return total * wavelength_m / (4 * np.pi)
