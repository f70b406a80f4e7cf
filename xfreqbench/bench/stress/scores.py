"""Metrics and statistics of constant, identical, zero and infinite values, against their closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np

from xfreqbench.bench.stress.case import Area
from xfreqbench.bench.stress.maps import beam, channels
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import (
    beam_loss,
    bootstrap_interval,
    power_error,
    psnr,
    quantiles,
    score_all,
    skill,
    ssim,
    ssim_wrapped,
)
from xfreqbench.types import Maps

SCORES = Area("scores")
_SSIM_C1 = 0.01**2  # of a data range of 1
_GRID = AngularGrid.hemisphere()
Score = Callable[[Maps, Maps, AngularGrid], Any]


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
    turned = [
        ssim_wrapped(np.roll(one, turn, 2), np.roll(other, turn, 2), _GRID) for turn in (1, 3, 90, 179, 359)
    ]
    return float(np.abs(np.array(turned) - still).max())


# 1 − 0.9 and 1 − 0.8 round to 2e-16 of 0.1
@SCORES.case("skill at trivial and perfect scores", limit=1e-14, unit="absolute")
def _skill() -> float:
    """Skill is 0 at the trivial score, 1 at a perfect one, and undefined where the trivial score is perfect."""
    assert math.isnan(skill(1.0, 1.0)), "skill where the trivial score is perfect"
    assert math.isnan(skill(0.5, 1.0)), "skill where the trivial score is perfect"
    found = [skill(0.9, 0.9), skill(1.0, 0.9), skill(1.0, 1 - 1e-15), skill(0.8, 0.9)]
    return float(np.abs(np.subtract(found, [0, 1, 1, -1])).max())


@SCORES.case("bootstrap of a constant and of infinity", limit=0, unit="absolute")
def _bootstrap() -> float:
    """For constant scores, infinite PSNR and a single transmitter, the interval is the value itself."""
    owner = np.arange(20) % 5
    constant = bootstrap_interval(np.full(20, 0.3), owner, lambda x: float(np.median(x)), 0)
    endless = bootstrap_interval(np.full(20, np.inf), owner, lambda x: float(np.median(x)), 0)
    alone = bootstrap_interval(np.arange(3.0), np.zeros(3, np.int64), lambda x: float(np.median(x)), 0)
    assert endless == (math.inf, math.inf), f"interval of infinite values is {endless}"
    return float(np.abs(np.subtract([*constant, *alone], [0.3, 0.3, 1.0, 1.0])).max())


@SCORES.case("quantiles beside infinite values", limit=0, unit="values")
def _quantiles() -> float:
    """Quantiles are values of the sample, so that infinite ones do not reach the lower quantiles."""
    values = np.array([np.inf, 1.0, 3.0, 2.0, np.inf])
    found = quantiles(values, [0.0, 0.2, 0.5, 0.6, 0.61, 1.0])
    expected = np.array([1.0, 1.0, 3.0, 3.0, np.inf, np.inf])
    return float((found != expected).sum())
