"""Scores of predicted maps against true ones, map by map, and statistics of scores.

Maps (N, E, A) have N samples, E elevations and A azimuths, and values in [0, 1], the `data_range=1` of other libraries;
maps of another range, such as 0 to 255 or dB, are refused. Metrics in dB take maps of linear power. Every metric is
defined for constant, identical and zero maps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from inspect import unwrap
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.errors import ArgumentError
from xfreqbench.maps.bartlett import RANGE_TOLERANCE, PasKind, power_of
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.types import FloatArray, Maps, NDArray

METRICS_VERSION = "2"
SSIM_WINDOW = 7  # scikit-image's default, uniform
POWER_FLOOR_DB = -40.0
NUM_RESAMPLES = 1000

ScoreFunction = Callable[[Maps, Maps, AngularGrid], FloatArray]
SampleMaps = Float[Maps, "N E A"]  # of N samples
Scores = Float[FloatArray, "N"]


@dataclass(frozen=True)
class Metric:
    """A score of predicted maps: `score(predicted, truth, grid)` takes maps (N, E, A) and returns N values."""

    name: str
    unit: str
    higher_is_better: bool
    description: str
    score: ScoreFunction
    takes_power: bool = False  # maps of another kind are converted first


def _of_maps(score: ScoreFunction) -> ScoreFunction:
    """The score, which raises `ArgumentError` unless maps are (N, E, A), of one shape, on the grid and in [0, 1]."""

    @wraps(score)
    def checked_score(predicted: Maps, truth: Maps, grid: AngularGrid) -> FloatArray:
        return score(*_checked(score.__name__, predicted, truth, grid), grid)

    return checked_score


def _checked(name: str, predicted: Maps, truth: Maps, grid: AngularGrid) -> tuple[Maps, Maps]:
    """The maps as arrays; raises `ArgumentError`, in the name of a function, for what no metric compares."""
    predicted, truth = np.asarray(predicted), np.asarray(truth)
    if predicted.shape != truth.shape or truth.shape[1:] != grid.shape:
        raise ArgumentError(
            f"{name} compares maps of shape (N, {', '.join(map(str, grid.shape))}) on this grid, but predicted has "
            f"shape {predicted.shape} and truth {truth.shape}."
        )
    for which, maps in (("predicted", predicted), ("truth", truth)):
        if maps.dtype.kind not in "fiu":
            raise ArgumentError(
                f"{name} compares maps of real numbers, but those of {which} are {maps.dtype}. Give powers or "
                "amplitudes, as float32."
            )
        low, peaks = maps.min(initial=0), maps.max(axis=(1, 2), initial=0)
        small = maps[(peaks > 0) & (peaks < 1e-3)]
        is_tiny = np.ptp(small, axis=(1, 2)).any()
        if is_tiny or not (low >= -RANGE_TOLERANCE and (peaks <= 1 + RANGE_TOLERANCE).all()):
            high = small.max() if is_tiny else peaks.max()
            raise ArgumentError(
                f"{name} compares maps of values from 0 to 1 and peak 1, but those of {which} run from {low:g} to "
                f"{high:g}. Turn dB into power, and divide each map by its maximum."
            )
    return predicted, truth


@_of_maps
def ssim(predicted: SampleMaps, truth: SampleMaps, grid: AngularGrid) -> Scores:
    """Structural similarity, at most 1, as scikit-image computes it by default: 7×7 uniform window, range 1.

    Raises `ArgumentError` for maps that are smaller than the window.
    """
    return _ssims(predicted, truth)["ssim"]


@_of_maps
def ssim_wrapped(predicted: SampleMaps, truth: SampleMaps, grid: AngularGrid) -> Scores:
    """`ssim` with the azimuth periodic, which does not change when the scene is turned about the pole."""
    return _ssims(predicted, truth)["ssim_wrapped"]


def _ssims(predicted: SampleMaps, truth: SampleMaps) -> dict[str, Scores]:
    """`ssim_wrapped`, and `ssim`: the mean over those of its windows that do not cross the seam of the azimuth."""
    from skimage.metrics import structural_similarity

    compared: Any = structural_similarity
    if min(truth.shape[1:]) < SSIM_WINDOW:
        raise ArgumentError(
            f"SSIM compares windows of {SSIM_WINDOW} × {SSIM_WINDOW} directions, but the maps have "
            f"{' × '.join(map(str, truth.shape[1:]))}. Give maps on a finer grid."
        )
    margin = SSIM_WINDOW // 2
    inner, scores = slice(margin, -margin), np.empty((2, len(truth)))
    continued = (np.dstack([maps[..., -margin:], maps, maps[..., :margin]]) for maps in (predicted, truth))
    for nth, pair in enumerate(zip(*continued, strict=True)):
        of_windows = compared(*pair, win_size=SSIM_WINDOW, data_range=1.0, full=True)[1][inner, inner]
        scores[:, nth] = [of_all.mean(dtype=np.float64) for of_all in (of_windows[:, inner], of_windows)]
    return dict(zip(("ssim", "ssim_wrapped"), scores, strict=True))


@_of_maps
def psnr(predicted: SampleMaps, truth: SampleMaps, grid: AngularGrid) -> Scores:
    """Peak signal-to-noise ratio in dB with a peak of 1; infinite for identical maps."""
    error = predicted.astype(np.float64)
    error -= truth
    with np.errstate(divide="ignore"):
        return -10 * np.log10(np.square(error, out=error).mean(axis=(1, 2)))


@_of_maps
def power_error(predicted: SampleMaps, truth: SampleMaps, grid: AngularGrid) -> Scores:
    """Mean absolute error in dB over the directions where the truth is within 30 dB of its peak.

    Powers below −40 dB count as −40 dB.
    """
    strong = truth >= truth.max(axis=(1, 2), keepdims=True) * 1e-3
    ratio = _floored(predicted)
    ratio /= _floored(truth)
    error_bel = np.abs(np.log10(ratio, out=ratio), out=ratio)
    return 10 * np.einsum("nea,nea->n", error_bel, strong) / strong.sum(axis=(1, 2))


@_of_maps
def aoa_error(predicted: SampleMaps, truth: SampleMaps, grid: AngularGrid) -> Scores:
    """Great-circle angle in degrees between the directions of the two peaks.

    180 where the prediction is flat and has no peak, 0 where the truth is flat and any direction is right.
    """
    directions = grid.directions.reshape(-1, 3)
    there, here = directions[_peak(predicted)], directions[_peak(truth)]
    sine = np.linalg.norm(np.cross(there, here), axis=1)  # arccos loses half the digits near 0
    angle_deg = np.degrees(np.arctan2(sine, (there * here).sum(axis=1)))
    return np.where(_is_flat(truth), 0.0, np.where(_is_flat(predicted), 180.0, angle_deg))


@_of_maps
def beam_loss(predicted: SampleMaps, truth: SampleMaps, grid: AngularGrid) -> Scores:
    """Power in dB that steering at the predicted peak instead of the true one loses, at most 40.

    40 where the prediction is flat and has no peak to steer at, 0 where the truth is flat.
    """
    flat = truth.reshape(len(truth), -1)
    reached = np.take_along_axis(flat, _peak(predicted)[:, None], axis=1)[:, 0]
    loss_db = np.minimum(_decibel(flat.max(axis=1)) - _decibel(reached), -POWER_FLOOR_DB)
    return np.where(_is_flat(truth), 0.0, np.where(_is_flat(predicted), -POWER_FLOOR_DB, loss_db))


_POWER_ERROR = "mean absolute error where the truth is within 30 dB of its peak, predictions floored at −40 dB"
_BEAM_LOSS = "power lost by steering at the predicted peak, at most 40"
_ALL = (
    Metric("ssim", "", True, "structural similarity, 7×7 uniform window, data range 1", ssim),
    Metric("ssim_wrapped", "", True, "the same with the azimuth periodic", ssim_wrapped),
    Metric("psnr", "dB", True, "peak signal-to-noise ratio of each map, peak 1", psnr),
    Metric("power_error", "dB", False, _POWER_ERROR, power_error, takes_power=True),
    Metric("aoa_error", "°", False, "great-circle angle between predicted and true peak", aoa_error),
    Metric("beam_loss", "dB", False, _BEAM_LOSS, beam_loss, takes_power=True),
)
METRICS: dict[str, Metric] = {metric.name: metric for metric in _ALL}


def score_all(
    predicted: SampleMaps, truth: SampleMaps, grid: AngularGrid, kind: PasKind = "power"
) -> dict[str, Scores]:
    """Scores of N maps of one kind by every metric; metrics in dB are given the maps' power."""
    maps = power = _checked("score_all", predicted, truth, grid)
    if kind == "amplitude":
        power = _checked("score_all", power_of(maps[0], kind), power_of(maps[1], kind), grid)
    scores = _ssims(*maps)
    others = {name: metric for name, metric in METRICS.items() if name not in scores}
    scores |= {name: unwrap(of.score)(*(power if of.takes_power else maps), grid) for name, of in others.items()}
    return {name: scores[name] for name in METRICS}


def skill(score: float, best_trivial: float) -> float:
    """How far a score is from the best trivial one (0) to a perfect one (1): 1 − (1 − score)/(1 − best_trivial).

    Both scores are at most 1. Negative where the score is below the trivial one; nan where that is perfect.
    """
    return 1 - (1 - score) / (1 - best_trivial) if best_trivial != 1 else float("nan")


def quantiles(values: Float[FloatArray, "N"], levels: list[float]) -> Float[FloatArray, "L"]:
    """Quantiles of N values, each of them one of the values: interpolating with an infinite PSNR would give nan."""
    return np.quantile(values, levels, method="inverted_cdf")


def _floored(power: NDArray[np.floating]) -> FloatArray:
    copied = power.astype(np.float64)
    return np.maximum(copied, 10 ** (POWER_FLOOR_DB / 10), out=copied)


def _decibel(power: NDArray[np.floating]) -> FloatArray:
    return 10 * np.log10(_floored(power))


def _peak(maps: Float[Maps, "N E A"]) -> Int[NDArray[np.int64], "N"]:
    return maps.reshape(len(maps), -1).argmax(axis=1)


def _is_flat(maps: Float[Maps, "N E A"]) -> NDArray[np.bool_]:
    return np.ptp(maps, axis=(1, 2)) == 0
