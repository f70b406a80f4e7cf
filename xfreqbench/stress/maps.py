"""Maps of channels without paths, with one, of any amplitude, and in either precision."""

from __future__ import annotations

from functools import cache, partial
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from xfreqbench.angles import AngularGrid
from xfreqbench.array import planar_array
from xfreqbench.metrics import aoa_error
from xfreqbench.pas import BartlettBeam, PasKind
from xfreqbench.stress.case import Case

_SINGLE = 5e-6  # a beam is 16 products of float32, its power twice that, of a peak of 1: 16 · 2 · 6e-8, and the peak's
ComplexArray = NDArray[np.complexfloating[Any, Any]]
ELEMENTS = planar_array(4, 4, 0.5)


@cache
def beam() -> BartlettBeam:
    """Of a 4×4 array on the house grid."""
    return BartlettBeam(ELEMENTS, AngularGrid.hemisphere())


@cache
def channels() -> NDArray[np.complex128]:
    """Eight channels of 16 elements, of amplitude about 1."""
    rng = np.random.default_rng(0)
    return np.asarray(rng.normal(size=(8, 16)) + 1j * rng.normal(size=(8, 16)))


def power_map(cfr: ComplexArray) -> NDArray[np.float64]:
    """|Σ_n h_n exp(−j2π r_n·d)|², its maximum 1, in double precision: the definition, direction by direction."""
    scaled = cfr.astype(np.complex128) / np.abs(cfr).max()  # of one channel (M,), no denormal number
    phase = 2 * np.pi * np.einsum("eac,mc->eam", beam().grid.directions, ELEMENTS)
    power = np.abs((np.exp(-1j * phase) * scaled).sum(axis=-1)) ** 2
    return np.asarray(power / power.max())


def _against_double(kind: type[np.complexfloating[Any, Any]], amplitude: float) -> float:
    cfr = (amplitude * channels()).astype(kind)
    maps = beam().maps(cfr)[0]
    return max(float(np.abs(m - power_map(row)).max()) for m, row in zip(maps, cfr, strict=True))


def _denormal(kind: type[np.complexfloating[Any, Any]], amplitude: float) -> float:
    """The rounded channel lifted by a power of two, which is exact, has the same map."""
    cfr = (amplitude * channels()).astype(kind)
    lift = np.float64(2.0**500) if kind is np.complex128 else np.float64(2.0**100)
    lifted = cfr.astype(np.complex128) * lift
    return float(np.abs(beam().maps(cfr)[0] - beam().maps(lifted)[0]).max())


def _peak_power(amplitude: float) -> float:
    wave = np.exp(2j * np.pi * beam().grid.directions[30:31, 40] @ ELEMENTS.T).astype(np.complex128)
    peak = beam().maps(amplitude * wave)[1]
    return float(abs(peak[0] / amplitude**2 - 1))


def _without_path() -> float:
    """Zero map and zero peak, in all kinds and both precisions."""
    silent: list[ComplexArray] = [np.zeros((1, 16), np.complex64), np.zeros((1, 16), np.complex128)]
    both = [beam().maps(cfr, kind) for cfr in silent for kind in get_args(PasKind)]
    return max(float(max(np.abs(maps).max(), np.abs(peak).max())) for maps, peak in both)


def _lone_peak() -> float:
    """Greatest angle between a lone wave's peak and its direction, from 5° to 80° of elevation."""
    rng = np.random.default_rng(1)
    row, column = rng.integers(5, 81, 300), rng.integers(0, 360, 300)
    arrival = beam().grid.directions[row, column]
    maps = beam().maps(np.exp(2j * np.pi * arrival @ ELEMENTS.T))[0]
    found = beam().grid.directions.reshape(-1, 3)[maps.reshape(300, -1).argmax(axis=1)]
    return float(np.degrees(2 * np.arcsin(np.linalg.norm(found - arrival, axis=1) / 2)).max())


def _peak_of_one() -> float:
    """Of every kind, of channels of very different amplitude in one batch."""
    cfr = channels() * np.geomspace(1e-20, 1e20, 8)[:, None]
    peaks = [beam().maps(cfr, kind)[0].max(axis=(1, 2)) for kind in get_args(PasKind)]
    return float(np.abs(np.array(peaks) - 1).max())


def _two_equal_peaks() -> float:
    """The first of two equal peaks, row by row, counts: the AoA of either map is its own first peak."""
    truth, first, second = np.zeros((3, 1, *beam().grid.shape), np.float32)
    truth[0, 30, 40] = truth[0, 30, 130] = first[0, 30, 40] = second[0, 30, 130] = 1
    expected = [0.0, 0.0, np.degrees(np.arccos(np.sin(np.pi / 6) ** 2))]  # at 30°, azimuths 90° apart
    found = [aoa_error(predicted, truth, beam().grid)[0] for predicted in (truth, first, second)]
    return float(np.abs(np.subtract(found, expected)).max())


def _phase_only(element: int) -> float:
    """An element without a field adds nothing; the others have modulus 1 whatever their amplitude."""
    cfr = channels()[:1] * np.geomspace(1e-30, 1, 16)
    cfr[0, element] = 0
    unit = np.where(cfr == 0, 0, np.exp(1j * np.angle(cfr)))
    return float(np.abs(beam().maps(cfr, "phase-only")[0][0] - power_map(unit[0])).max())


def _common_phase() -> float:
    """A phase common to all elements is no power."""
    return float(np.abs(beam().maps(channels())[0] - beam().maps(channels() * np.exp(2.3j))[0]).max())


CASES = (
    Case("channels without a path give zero maps, peak 0", "maps", 0, "absolute", _without_path),
    # neighbours of the grid lie 40 times further below the peak than float32 rounds; the angle rounds to 1e-14
    Case("a lone wave peaks at its direction", "maps", 1e-6, "deg", _lone_peak),
    Case("every map has peak 1, amplitudes 1e-20 to 1e20", "maps", 0, "absolute", _peak_of_one),
    Case("of two equal peaks the first counts", "maps", 1e-9, "deg", _two_equal_peaks),
    Case(
        "maps of complex128 channels against double",
        "maps",
        _SINGLE,
        "absolute",
        partial(_against_double, np.complex128, 1.0),
    ),
    Case(
        "maps of complex64 channels against double",
        "maps",
        _SINGLE,
        "absolute",
        partial(_against_double, np.complex64, 1.0),
    ),
    Case(
        "maps of complex64 channels of 1e-30",
        "maps",
        _SINGLE,
        "absolute",
        partial(_against_double, np.complex64, 1e-30),
    ),
    Case(
        "maps of complex64 channels of 1e30",
        "maps",
        _SINGLE,
        "absolute",
        partial(_against_double, np.complex64, 1e30),
    ),
    Case(
        "maps of denormal complex64 channels, 1e-42",
        "maps",
        _SINGLE,
        "absolute",
        partial(_denormal, np.complex64, 1e-42),
    ),
    Case(
        "maps of denormal complex128 channels, 1e-310",
        "maps",
        _SINGLE,
        "absolute",
        partial(_denormal, np.complex128, 1e-310),
    ),
    # float32 sum of 16 equal numbers, squared
    Case("peak power of a channel of 1e-30", "maps", 1e-6, "relative", partial(_peak_power, 1e-30)),
    Case("peak power of a channel of 1e30", "maps", 1e-6, "relative", partial(_peak_power, 1e30)),
    Case("phase-only map with one silent element", "maps", _SINGLE, "absolute", partial(_phase_only, 5)),
    Case("a common phase leaves the map", "maps", _SINGLE, "absolute", _common_phase),
)
