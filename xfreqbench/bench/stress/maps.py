"""Bartlett maps of channels without a path, with one path, of any amplitude, and in both precisions."""

from __future__ import annotations

from functools import cache
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from xfreqbench.bench.stress.case import Area
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import aoa_error
from xfreqbench.scene.array import planar_array

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


@MAPS.case("channels without a path give zero maps, peak 0", limit=0, unit="absolute")
def _without_path() -> float:
    """Largest value of maps and peaks, in all kinds and both precisions."""
    silent: list[ComplexArray] = [np.zeros((1, 16), np.complex64), np.zeros((1, 16), np.complex128)]
    both = [beam().maps(cfr, kind) for cfr in silent for kind in get_args(PasKind)]
    return max(float(max(np.abs(maps).max(), np.abs(peak).max())) for maps, peak in both)


@MAPS.case(
    "a lone wave peaks at its direction",
    limit=1e-6,  # neighbours of the grid are lower by 40 roundings of float32; the angle rounds to 1e-14
    unit="deg",
)
def _lone_peak() -> float:
    """Largest angle between the peak of a lone plane wave and its direction, from 5° to 80° of elevation."""
    rng = np.random.default_rng(1)
    row, column = rng.integers(5, 81, 300), rng.integers(0, 360, 300)
    arrival = beam().grid.directions[row, column]
    maps = beam().maps(np.exp(2j * np.pi * arrival @ ELEMENTS.T))[0]
    found = beam().grid.directions.reshape(-1, 3)[maps.reshape(300, -1).argmax(axis=1)]
    return float(np.degrees(2 * np.arcsin(np.linalg.norm(found - arrival, axis=1) / 2)).max())


@MAPS.case("every map has peak 1, amplitudes 1e-20 to 1e20", limit=0, unit="absolute")
def _peak_of_one() -> float:
    """Error of the peak in every kind, for channels of very different amplitudes in one batch."""
    cfr = channels() * np.geomspace(1e-20, 1e20, 8)[:, None]
    peaks = [beam().maps(cfr, kind)[0].max(axis=(1, 2)) for kind in get_args(PasKind)]
    return float(np.abs(np.array(peaks) - 1).max())


@MAPS.case("of two equal peaks the first counts", limit=1e-9, unit="deg")
def _two_equal_peaks() -> float:
    """The angle of arrival of a map with two equal peaks is that of the first one, row by row."""
    truth, first, second = np.zeros((3, 1, *beam().grid.shape), np.float32)
    truth[0, 30, 40] = truth[0, 30, 130] = first[0, 30, 40] = second[0, 30, 130] = 1
    expected = [0.0, 0.0, np.degrees(np.arccos(np.sin(np.pi / 6) ** 2))]  # at 30°, azimuths 90° apart
    found = [aoa_error(predicted, truth, beam().grid)[0] for predicted in (truth, first, second)]
    return float(np.abs(np.subtract(found, expected)).max())


@MAPS.each(
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


@MAPS.each(
    {
        "maps of denormal complex64 channels, 1e-42": (np.complex64, 1e-42),
        "maps of denormal complex128 channels, 1e-310": (np.complex128, 1e-310),
    },
    limit=_SINGLE,
    unit="absolute",
)
def _denormal(kind: type[np.complexfloating[Any, Any]], amplitude: float) -> float:
    """The rounded channel multiplied by a power of two, which is exact, has the same map."""
    cfr = (amplitude * channels()).astype(kind)
    lift = np.float64(2.0**500) if kind is np.complex128 else np.float64(2.0**100)
    lifted = cfr.astype(np.complex128) * lift
    return float(np.abs(beam().maps(cfr)[0] - beam().maps(lifted)[0]).max())


@MAPS.each(
    {"peak power of a channel of 1e-30": (1e-30,), "peak power of a channel of 1e30": (1e30,)},
    limit=1e-6,  # float32 sum of 16 equal numbers, squared
    unit="relative",
)
def _peak_power(amplitude: float) -> float:
    """Relative error of the peak power of a plane wave from one direction of the grid."""
    wave = np.exp(2j * np.pi * beam().grid.directions[30:31, 40] @ ELEMENTS.T).astype(np.complex128)
    peak = beam().maps(amplitude * wave)[1]
    return float(abs(peak[0] / amplitude**2 - 1))


@MAPS.case("phase-only map with one silent element", 5, limit=_SINGLE, unit="absolute")
def _phase_only(element: int) -> float:
    """An element without a field adds nothing; the others count with modulus 1 whatever their amplitude."""
    cfr = channels()[:1] * np.geomspace(1e-30, 1, 16)
    cfr[0, element] = 0
    unit = np.where(cfr == 0, 0, np.exp(1j * np.angle(cfr)))
    return float(np.abs(beam().maps(cfr, "phase-only")[0][0] - power_map(unit[0])).max())


@MAPS.case("a common phase leaves the map", limit=_SINGLE, unit="absolute")
def _common_phase() -> float:
    """A phase that all elements share does not change the map."""
    return float(np.abs(beam().maps(channels())[0] - beam().maps(channels() * np.exp(2.3j))[0]).max())
