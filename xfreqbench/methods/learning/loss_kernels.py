"""Compiled kernels of SSIM, and of the loss of Eq. 12 with its slope: one pass over float32 maps, in one thread."""

from __future__ import annotations

import numpy as np
from numba import njit

from xfreqbench.maps.metrics import SSIM_WINDOW
from xfreqbench.system.kernels import entry
from xfreqbench.types import NDArray

F32 = NDArray[np.float32]
FAST = {"nsz", "arcp", "contract", "reassoc"}  # not nnan: a loss that is not finite has to show
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2  # for a data range of 1
_NUM_MEANS = 5  # of x, y, x², y² and xy over a window
_NUM_SLOPES = 3  # ∂SSIM/∂x = a + b x + c y within a window


def c2_of_view(window: int, stride: int) -> float:
    """C₂ for windows of a view; see `loss.ssim_of_each`."""
    return SSIM_C2 * max(1.0, (stride * window / SSIM_WINDOW) ** 2)


@entry(fastmath=FAST, error_model="numpy")
def ssim_and_l1(
    predicted: F32, truth: F32, window: int, c1: float, c2: float, ssim_weight: float, slope: F32
) -> tuple[float, float]:
    """Mean SSIM and mean |x − y| of maps x, y (B, E, A); writes the slope of (1 − w) L1 − w SSIM by x to `slope`."""
    num_maps, rows, columns = predicted.shape
    across = columns - window + 1
    num_windows = num_maps * (rows - window + 1) * across
    of_columns, means = (np.empty((_NUM_MEANS, columns), np.float32), np.empty((_NUM_MEANS, across), np.float32))
    of_windows, summed = (np.empty((_NUM_SLOPES, across), np.float32), np.empty((_NUM_SLOPES, columns), np.float32))
    of_ssim, of_l1 = np.float32(-ssim_weight / num_windows), np.float32((1 - ssim_weight) / predicted.size)
    ssim, l1 = 0.0, 0.0
    for nth in range(num_maps):
        x, y, of_map = predicted[nth], truth[nth], slope[nth]
        l1 += _l1_of_map(x, y, of_l1, of_map)
        for row in range(rows - window + 1):
            _means_of_windows(x, y, row, window, of_columns, means)
            ssim += _ssim_of_windows(means, window, np.float32(c1), np.float32(c2), of_windows)
            _add_slopes(x, y, row, window, of_ssim, of_windows, summed, of_map)
    return ssim / num_windows, l1 / predicted.size


def similarities(predicted: F32, truth: F32, window: int = SSIM_WINDOW, stride: int = 1) -> NDArray[np.float64]:
    """SSIM of each of n maps (n, E, A), contiguous, with the true ones: as `loss.ssim_of_each`, without its slope."""
    return _ssim_of_maps(predicted, truth, window, SSIM_C1, c2_of_view(window, stride))


@entry(fastmath=FAST, error_model="numpy")
def _ssim_of_maps(predicted: F32, truth: F32, window: int, c1: float, c2: float) -> NDArray[np.float64]:
    num_maps, rows, columns = predicted.shape
    down, across = rows - window + 1, columns - window + 1
    of_columns, means = (np.empty((_NUM_MEANS, columns), np.float32), np.empty((_NUM_MEANS, across), np.float32))
    slopes, ssim = np.empty((_NUM_SLOPES, across), np.float32), np.zeros(num_maps)
    for nth in range(num_maps):
        for row in range(down):
            _means_of_windows(predicted[nth], truth[nth], row, window, of_columns, means)
            ssim[nth] += _ssim_of_windows(means, window, np.float32(c1), np.float32(c2), slopes)
    return ssim / (down * across)


@njit(fastmath=FAST, error_model="numpy")
def _l1_of_map(x: F32, y: F32, weight: np.float32, slope: F32) -> float:
    """The sum of |x − y|; sets the slope to its weighted sign."""
    total = np.float32(0)
    for row in range(x.shape[0]):
        for column in range(x.shape[1]):
            difference = x[row, column] - y[row, column]
            total += abs(difference)
            slope[row, column] = weight * np.sign(difference)
    return float(total)


@njit(fastmath=FAST, error_model="numpy")
def _means_of_windows(x: F32, y: F32, row: int, window: int, of_columns: F32, means: F32) -> None:
    """The means over each window that begins in a row: sums over its rows first, then over its columns."""
    of_columns[:] = 0
    means[:] = 0
    share = np.float32(1 / window**2)
    for window_row in range(row, row + window):
        for column in range(x.shape[1]):
            here, there = x[window_row, column], y[window_row, column]
            of_columns[0, column] += share * here
            of_columns[1, column] += share * there
            of_columns[2, column] += share * here * here
            of_columns[3, column] += share * there * there
            of_columns[4, column] += share * here * there
    for kind in range(_NUM_MEANS):
        for shift in range(window):
            for first in range(means.shape[1]):
                means[kind, first] += of_columns[kind, first + shift]


@njit(fastmath=FAST, error_model="numpy")
def _ssim_of_windows(means: F32, window: int, c1: np.float32, c2: np.float32, slopes: F32) -> float:
    """The sum of SSIM over the windows of a row; writes a, b and c of each window to `slopes`."""
    one, two = np.float32(1), np.float32(2)
    unbiased, share = np.float32(window**2 / (window**2 - 1)), np.float32(1 / window**2)
    total = np.float32(0)
    for nth in range(means.shape[1]):
        mean_x, mean_y, xx, yy, xy = means[0, nth], means[1, nth], means[2, nth], means[3, nth], means[4, nth]
        by_means = one / (mean_x * mean_x + mean_y * mean_y + c1)
        luminance = (two * mean_x * mean_y + c1) * by_means
        by_spread = one / (unbiased * (xx - mean_x * mean_x + yy - mean_y * mean_y) + c2)
        structure = (two * unbiased * (xy - mean_x * mean_y) + c2) * by_spread
        total += luminance * structure
        of_moments = two * luminance * unbiased * share * by_spread
        of_mean = two * share * structure * (mean_y - mean_x * luminance) * by_means
        slopes[0, nth] = of_mean + of_moments * (structure * mean_x - mean_y)
        slopes[1, nth] = -of_moments * structure
        slopes[2, nth] = of_moments
    return float(total)


@njit(fastmath=FAST, error_model="numpy")
def _add_slopes(
    x: F32, y: F32, row: int, window: int, weight: np.float32, of_windows: F32, summed: F32, of_map: F32
) -> None:
    """Add the slopes of the windows that begin in a row to those of the values that they hold."""
    summed[:] = 0
    for kind in range(_NUM_SLOPES):
        for shift in range(window):
            for first in range(of_windows.shape[1]):
                summed[kind, first + shift] += of_windows[kind, first]
    for window_row in range(row, row + window):
        for column in range(x.shape[1]):
            by_value = summed[1, column] * x[window_row, column] + summed[2, column] * y[window_row, column]
            of_map[window_row, column] += weight * (summed[0, column] + by_value)
