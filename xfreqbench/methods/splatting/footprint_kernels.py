"""Compiled kernels that bin footprints into pixel lists on the CPU; `footprints` has the same in plain torch."""

from __future__ import annotations

import math

import numpy as np

from xfreqbench.system.kernels import entry
from xfreqbench.types import FloatArray, IntArray, NDArray

# one turn around the centre; the direction opposite belongs to its lower end alone, whatever the rounding
LOWEST_RAD, HIGHEST_RAD = -math.pi * (1 + 1e-12), math.pi * (1 - 1e-12)
_NUM_TURNS = 3  # in which a footprint around an azimuth in [0, 2π) may have columns in [0, 2π]


@entry(error_model="numpy")
def footprint_runs(
    centre: FloatArray, conic: FloatArray, elevation_rad: FloatArray, azimuth_rad: FloatArray, support: float
) -> tuple[IntArray, NDArray[np.uint32], FloatArray]:
    """The directions of all footprints as R runs along rows of the grid, those of one Gaussian after another.

    `centre` is (N, 2) azimuth and elevation, `conic` (N, 3) the inverse covariance's entries. Azimuths are evenly
    spaced over a turn at most. Returned are the numbers of runs and of directions before each Gaussian, (N+1, 2); each
    run's first direction and number of directions, (R, 2); azimuth and elevation of that from the centre, rad, (R, 2).
    """
    num_rows, num_azimuths = len(elevation_rad), len(azimuth_rad)
    before = np.zeros((len(centre) + 1, 2), np.int64)
    runs = np.empty((len(centre) * num_rows * _NUM_TURNS, 2), np.uint32)
    angles_rad = np.empty(runs.shape)
    step_rad = azimuth_rad[1] - azimuth_rad[0] if num_azimuths > 1 else 2 * math.pi
    run, pair = 0, 0
    for i in range(len(centre)):
        a, b, c = conic[i]
        offset = (centre[i, 0] - azimuth_rad[0]) % (2 * math.pi)
        for row in range(num_rows):
            along = elevation_rad[row] - centre[i, 1]
            discriminant = (b * along) ** 2 - a * (c * along * along - support)
            if discriminant >= 0:
                reach = math.sqrt(discriminant)
                low = offset + max((-b * along - reach) / a, LOWEST_RAD)
                high = offset + min((-b * along + reach) / a, HIGHEST_RAD)
                for turn in range(_NUM_TURNS):
                    shift = (turn - 1) * 2 * math.pi
                    if high + shift < 0 or low + shift > num_azimuths * step_rad:
                        continue
                    begin = max(math.ceil((low + shift) / step_rad), 0)
                    end = min(math.floor((high + shift) / step_rad), num_azimuths - 1)
                    if end >= begin:
                        runs[run, 0], runs[run, 1] = row * num_azimuths + begin, end - begin + 1
                        angles_rad[run, 0], angles_rad[run, 1] = begin * step_rad - offset - shift, along
                        run, pair = run + 1, pair + end - begin + 1
        before[i + 1, 0], before[i + 1, 1] = run, pair
    return before, runs[:run], angles_rad[:run]


@entry()
def fill_lists(before: IntArray, runs: NDArray[np.uint32], num_pixels: int) -> tuple[IntArray, IntArray]:
    """Start of each pixel's list, and all lists one after another, each in the order of the Gaussians."""
    start = np.zeros(num_pixels + 1, np.int64)
    for first, count in runs:
        start[first + 1 : first + count + 1] += 1
    start = start.cumsum()
    following = start[:-1].copy()
    gaussian = np.empty(start[-1], np.int64)
    for i in range(len(before) - 1):
        for run in range(before[i, 0], before[i + 1, 0]):
            for pixel in range(runs[run, 0], runs[run, 0] + runs[run, 1]):
                gaussian[following[pixel]] = i
                following[pixel] += 1
    return start, gaussian
