"""Bartlett maps of channels without a path, with one path, of any amplitude, in both precisions; and scores of maps."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import product
from typing import Any, get_args

import numpy as np

from xfreqbench.bench.stress.case import Area
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import (
    aoa_error,
    beam_loss,
    power_error,
    psnr,
    quantiles,
    score_all,
    skill,
    ssim,
    ssim_wrapped,
)
from xfreqbench.scene.array import planar_array
from xfreqbench.types import Maps, NDArray

MAPS = Area("maps")
# a beam is 16 products of float32, its power twice that, of a peak of 1: 16 · 2 · 6e-8, and the peak's
_SINGLE = 5e-6
ComplexArray = NDArray[np.complexfloating[Any, Any]]
ELEMENTS = planar_array(4, 4, 0.5)
SCORES = Area("scores")
_SSIM_C1 = 0.01**2  # of a data range of 1
_GRID = AngularGrid.hemisphere()
Score = Callable[[Maps, Maps, AngularGrid], Any]


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


def _flat(value: float) -> Maps:
    return np.full((1, *_GRID.shape), value, np.float32)


def _spot(*others: float) -> Maps:
    """A map with peak 1 and as many lower directions as are given, zero elsewhere."""
    spot = _flat(0)
    spot[0, 30, 40] = 1
    spot[0, 60, 200 : 200 + len(others)] = others
    return spot


def _random() -> Maps:
    return beam().maps(channels())[0]


def _error(score: Score, predicted: Maps, truth: Maps, expected: float) -> float:
    """Difference between a score and its expected value; 0 where both are the same infinity."""
    found = float(score(predicted, truth, _GRID)[0])
    return 0.0 if found == expected else abs(found - expected)


# scikit-image keeps float32 and takes running sums: some roundings of 6e-8
@SCORES.case("SSIM of constant maps", limit=2e-5, unit="absolute")
def _ssim_of_constants() -> float:
    """Without structure SSIM is (2ab + C₁)/(a² + b² + C₁), wrapped or not."""
    pairs = [(0.2, 0.7), (0.0, 1.0), (1.0, 0.0), (1.0, 1e-3), (0.5, 0.5)]
    return max(
        _error(score, _flat(a), _flat(b), (2 * a * b + _SSIM_C1) / (a * a + b * b + _SSIM_C1))
        for a, b in pairs
        for score in (ssim, ssim_wrapped)
    )


@SCORES.case("SSIM of identical maps is 1", limit=1e-6, unit="absolute")
def _ssim_of_identical() -> float:
    same = [_flat(0), _flat(1), _flat(1e-40), _spot(), _random()]
    return max(_error(score, one, one, 1.0) for one in same for score in (ssim, ssim_wrapped))


@SCORES.case("PSNR of constant maps", limit=1e-9, unit="dB")
def _psnr_of_constants() -> float:
    pairs = [(0.2, 0.7), (0.0, 1.0), (1.0, 0.0), (0.0, 1e-10)]
    return max(
        _error(psnr, _flat(a), _flat(b), -20 * math.log10(abs(np.float32(a) - np.float64(np.float32(b)))))
        for a, b in pairs
    )


@SCORES.case("PSNR of identical maps is infinite", limit=0, unit="dB")
def _psnr_of_identical() -> float:
    return max(_error(psnr, one, one, math.inf) for one in (_flat(0), _flat(1), _random()))


# 0.1 is a float32: 2e-8 of it is 1e-7 dB
@SCORES.case("power error of zero, full and lone maps", limit=1e-6, unit="dB")
def _power_error() -> float:
    """Predictions are clipped at −40 dB; only directions less than 30 dB below the true peak count in the mean."""
    return max(
        _error(power_error, _flat(0), _flat(1), 40.0),
        _error(power_error, _flat(0), _spot(), 40.0),
        _error(power_error, _flat(1), _spot(0.1, 9e-4), 5.0),
        _error(power_error, _flat(0), _flat(0), 0.0),
        _error(power_error, _flat(1), _flat(0), 40.0),
        _error(power_error, _spot(), _spot(), 0.0),
    )


@SCORES.case("beam loss of flat and misplaced maps", limit=1e-6, unit="dB")
def _beam_loss() -> float:
    elsewhere = np.roll(_spot(), 60, axis=2)
    return max(
        _error(beam_loss, _flat(0), _spot(), 40.0),
        _error(beam_loss, _flat(1), _spot(), 40.0),
        _error(beam_loss, _spot(), _flat(1), 0.0),
        _error(beam_loss, elsewhere, _spot(), 40.0),
        _error(beam_loss, np.roll(_spot(), (30, 160), axis=(1, 2)), _spot(0.01), 20.0),
    )


@SCORES.case("no score of any pair of maps is nan", limit=0, unit="scores")
def _undefined() -> float:
    """Number of scores that are nan, over all pairs of maps that are zero, full, or hold one direction."""
    maps = [_flat(0), _flat(1), _flat(0.5), _flat(1e-40), _spot(), _spot(1.0), _random()[:1]]
    scores = [score_all(one, other, _GRID) for one, other in product(maps, maps)]
    return float(sum(np.isnan(values).sum() for score in scores for values in score.values()))


# running sums start in another column
@SCORES.case("wrapped SSIM of a turned scene", limit=1e-5, unit="absolute")
def _wrapped() -> float:
    """Largest change of the wrapped SSIM when both maps are turned about the pole, also by one column."""
    one, other = _random()[:4], _random()[4:]
    still = ssim_wrapped(one, other, _GRID)
    turned = [ssim_wrapped(np.roll(one, turn, 2), np.roll(other, turn, 2), _GRID) for turn in (1, 3, 90, 179, 359)]
    return float(np.abs(np.array(turned) - still).max())


# 1 − 0.9 and 1 − 0.8 round to 2e-16 of 0.1
@SCORES.case("skill at trivial and perfect scores", limit=1e-14, unit="absolute")
def _skill() -> float:
    """Skill is 0 at the trivial score, 1 at a perfect one, and undefined where the trivial score is perfect."""
    assert math.isnan(skill(1.0, 1.0)), "skill where the trivial score is perfect"
    assert math.isnan(skill(0.5, 1.0)), "skill where the trivial score is perfect"
    found = [skill(0.9, 0.9), skill(1.0, 0.9), skill(1.0, 1 - 1e-15), skill(0.8, 0.9)]
    return float(np.abs(np.subtract(found, [0, 1, 1, -1])).max())


@SCORES.case("quantiles beside infinite values", limit=0, unit="values")
def _quantiles() -> float:
    """Quantiles are values of the sample, so that infinite ones do not reach the lower quantiles."""
    values = np.array([np.inf, 1.0, 3.0, 2.0, np.inf])
    found = quantiles(values, [0.0, 0.2, 0.5, 0.6, 0.61, 1.0])
    expected = np.array([1.0, 1.0, 3.0, 3.0, np.inf, np.inf])
    return float((found != expected).sum())
