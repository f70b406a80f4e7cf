"""Bartlett maps of channels of any amplitude, in both precisions."""

from __future__ import annotations

from functools import cache
from typing import Any, get_args

import numpy as np

from xfreqbench.bench.stress.case import Area
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.array import planar_array
from xfreqbench.types import NDArray

MAPS = Area("maps")
# a beam is 16 products of float32, its power twice that, of a peak of 1: 16 · 2 · 6e-8, and the peak's
_SINGLE = 5e-6
ComplexArray = NDArray[np.complexfloating[Any, Any]]
ELEMENTS = planar_array(4, 4, 0.5)


@cache
def beam() -> BartlettBeam:
    """Beams of a 4×4 array towards the directions of the hemisphere."""
    return BartlettBeam(ELEMENTS, AngularGrid.hemisphere())


@cache
def channels() -> NDArray[np.complex128]:
    """Eight random channels of 16 elements with amplitudes about 1, (8, 16)."""
    rng = np.random.default_rng(0)
    return np.asarray(rng.normal(size=(8, 16)) + 1j * rng.normal(size=(8, 16)))


def power_map(cfr: ComplexArray) -> NDArray[np.float64]:
    """Power |Σ_n h_n exp(−j2π r_n·d)|² of one channel (M,) by its definition, scaled to a maximum of 1, (E, A)."""
    scaled = cfr.astype(np.complex128) / np.abs(cfr).max()  # no denormal number
    phase = 2 * np.pi * np.einsum("eac,mc->eam", beam().grid.directions, ELEMENTS)
    power = np.abs((np.exp(-1j * phase) * scaled).sum(axis=-1)) ** 2
    return np.asarray(power / power.max())


@MAPS.case("every map has peak 1, amplitudes 1e-20 to 1e20", limit=0, unit="absolute")
def _peak_of_one() -> float:
    """Error of the peak in every kind, for channels of very different amplitudes in one batch."""
    cfr = channels() * np.geomspace(1e-20, 1e20, 8)[:, None]
    peaks = [beam().maps(cfr, kind)[0].max(axis=(1, 2)) for kind in get_args(PasKind)]
    return float(np.abs(np.array(peaks) - 1).max())


@MAPS.cases_of(
    {
        "maps of complex128 channels against double": (np.complex128, 1.0),
        "maps of complex64 channels against double": (np.complex64, 1.0),
        "maps of complex64 channels of 1e-30": (np.complex64, 1e-30),
        "maps of complex64 channels of 1e30": (np.complex64, 1e30),
    },
    limit=_SINGLE,
    unit="absolute",
)
def _against_double(kind: type[np.complexfloating[Any, Any]], amplitude: float) -> float:
    """Largest difference between maps of rounded channels and the definition in double precision."""
    cfr = (amplitude * channels()).astype(kind)
    maps = beam().maps(cfr)[0]
    return max(float(np.abs(m - power_map(row)).max()) for m, row in zip(maps, cfr, strict=True))


@MAPS.case("phase-only map with one silent element", 5, limit=_SINGLE, unit="absolute")
def _phase_only(element: int) -> float:
    """An element without a field adds nothing; the others count with modulus 1 whatever their amplitude."""
    cfr = channels()[:1] * np.geomspace(1e-30, 1, 16)
    cfr[0, element] = 0
    unit = np.where(cfr == 0, 0, np.exp(1j * np.angle(cfr)))
    return float(np.abs(beam().maps(cfr, "phase-only")[0][0] - power_map(unit[0])).max())
