"""Footprints binned into pixel lists on the CPU (Numba); `footprints` holds the same in plain torch."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@njit(cache=True)
def footprint_rows(
    centre: FloatArray,
    conic: FloatArray,
    elevation_rad: FloatArray,
    first_azimuth_rad: float,
    num_azimuths: int,
    support: float,
) -> tuple[IntArray, IntArray]:
    """Where footprints meet rows: first column and number of columns, both (N, E).

    `centre` is (N, 2) azimuth and elevation, `conic` (N, 3) the inverse covariance's entries.
    """
    num_gaussians, num_rows = len(centre), len(elevation_rad)
    first = np.zeros((num_gaussians, num_rows), np.int64)
    count = np.zeros((num_gaussians, num_rows), np.int64)
    step_rad = 2 * math.pi / num_azimuths
    for i in range(num_gaussians):
        a, b, c = conic[i]
        offset = centre[i, 0] - first_azimuth_rad
        for row in range(num_rows):
            along = elevation_rad[row] - centre[i, 1]
            discriminant = (b * along) ** 2 - a * (c * along * along - support)
            if discriminant >= 0:
                reach = math.sqrt(discriminant)
                low = max((-b * along - reach) / a, -math.pi)
                high = min((-b * along + reach) / a, math.pi)
                begin = math.ceil((offset + low) / step_rad)
                first[i, row] = begin % num_azimuths
                count[i, row] = min(max(math.floor((offset + high) / step_rad) - begin + 1, 0), num_azimuths)
    return first, count


@njit(cache=True)
def fill_lists(
    first: IntArray, count: IntArray, num_rows: int, num_azimuths: int
) -> tuple[IntArray, IntArray]:
    """Start of every pixel's list, and the lists one behind the other, in the order of the Gaussians."""
    start = np.zeros(num_rows * num_azimuths + 1, np.int64)
    for i in range(len(first)):
        for row in range(num_rows):
            for nth in range(count[i, row]):
                start[row * num_azimuths + (first[i, row] + nth) % num_azimuths + 1] += 1
    for pixel in range(num_rows * num_azimuths):
        start[pixel + 1] += start[pixel]
    following = start[:-1].copy()
    gaussian = np.empty(start[-1], np.int64)
    for i in range(len(first)):
        for row in range(num_rows):
            for nth in range(count[i, row]):
                pixel = row * num_azimuths + (first[i, row] + nth) % num_azimuths
                gaussian[following[pixel]] = i
                following[pixel] += 1
    return start, gaussian
