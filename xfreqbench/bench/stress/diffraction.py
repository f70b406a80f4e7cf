"""Diffraction at extremes of geometry: on a boundary and beside it, along an edge, and where edges coincide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from xfreqbench.bench.stress.case import Area
from xfreqbench.bench.stress.channels import RECEIVER, free_space
from xfreqbench.scene.model import Surface
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.units import ghz_to_hz

DIFFRACTION = Area("diffraction")
_CARRIERS_HZ = [ghz_to_hz(ghz) for ghz in (1.0, 24.25, 94.0)]
_ONE = replace(RECEIVER, rows=1, cols=1)
_HEIGHT_M = RECEIVER.position_m[2]
_SETTINGS = TraceSettings(
    solver="image", interactions=("specular", "refraction", "diffraction"), rays=2000, max_depth=2
)
_BESIDE_M = (-1e-9, 1e-9)
_BESIDE_LIMIT = 1e-5  # a nanometre at 94 GHz turns the phase by 2e-6


def _channels(surfaces: tuple[Surface, ...], tx_m: Sequence[tuple[float, ...]]) -> NDArray[np.complex128]:
    """Channels at three carriers, all paths over edges among them, (T, F)."""
    scene = replace(free_space(_ONE), surface=surfaces)
    tracer = ImageTracer(scene, _CARRIERS_HZ, _SETTINGS, ImageSavings(diffraction_floor=0.0))
    return tracer.channel(np.array(tx_m)).cfr[..., 0]


def _largest_step(channels: NDArray[np.complex128]) -> float:
    """Largest relative difference of the channels of several transmitters from those of the first."""
    return float((np.abs(channels[1:] - channels[0]) / np.abs(channels[0])).max())


@DIFFRACTION.each(
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
    screen = Surface("screen", material, 0.01, (1.0, -9.0, -9.0), (1.0, 9.0, _HEIGHT_M - 0.5))
    tx_m = [(1.0 + side, 0.0, _HEIGHT_M - 1.5 + beside) for beside in (0.0, *_BESIDE_M)]
    return _largest_step(_channels((screen,), tx_m))


@DIFFRACTION.case("transmitter on the line of an edge", limit=_BESIDE_LIMIT, unit="relative")
def _end_on() -> float:
    """Channels of a transmitter on the line of an edge and a nanometre beside it."""
    screen = Surface("screen", "metal", 0.01, (1.0, 0.5, 0.0), (1.0, 1.5, 1.0))
    return _largest_step(_channels((screen,), [(1.0 + beside, -1.0, 1.0) for beside in (0.0, *_BESIDE_M)]))


@DIFFRACTION.case("edges of two boxes that touch", limit=2e-9, unit="relative")
def _touching() -> float:
    """Channels around two metal boxes that touch, against one box of their size."""
    halves = tuple(
        Surface(f"half {y}", "metal", 0.01, (1.0, y, 0.0), (2.0, y + 1.0, 1.0)) for y in (-1.0, 0.0)
    )
    whole = (Surface("whole", "metal", 0.01, (1.0, -1.0, 0.0), (2.0, 1.0, 1.0)),)
    tx_m = [(2.6, 0.3, 0.7), (2.6, -0.4, 0.2), (1.4, 1.7, 0.6)]
    found, expected = (_channels(surfaces, tx_m) for surfaces in (halves, whole))
    return float((np.abs(found - expected) / np.abs(expected)).max())
