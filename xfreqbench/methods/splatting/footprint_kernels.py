"""Compiled kernels that bin footprints into pixel lists on the CPU; `footprints` has the same in plain torch."""

from __future__ import annotations

import math

import numpy as np

from xfreqbench.system.kernels import entry
from xfreqbench.types import FloatArray, IntArray

# one turn around the centre; the direction opposite belongs to its lower end alone, whatever the rounding
LOWEST_RAD, HIGHEST_RAD = -math.pi * (1 + 1e-12), math.pi * (1 - 1e-12)


_NUM_TURNS = 3  # in which a footprint around an azimuth in [0, 2π) may have columns in [0, 2π]


@entry()
def footprint_spans(
    centre: FloatArray, conic: FloatArray, elevation_rad: FloatArray, azimuth_rad: FloatArray, support: float
) -> tuple[IntArray, IntArray]:
    """Where footprints meet rows: first column and number of columns in each turn, both (N, E, turns).

    `centre` is (N, 2) azimuth and elevation, `conic` (N, 3) the inverse covariance's entries. Azimuths are
    evenly spaced over a turn at most.
    """
    num_rows, num_azimuths = len(elevation_rad), len(azimuth_rad)
    first = np.zeros((len(centre), num_rows, _NUM_TURNS), np.int64)
    count = np.zeros((len(centre), num_rows, _NUM_TURNS), np.int64)
    step_rad = azimuth_rad[1] - azimuth_rad[0] if num_azimuths > 1 else 2 * math.pi
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
                    begin = max(math.ceil((low + shift) / step_rad), 0)
                    end = min(math.floor((high + shift) / step_rad), num_azimuths - 1)
                    first[i, row, turn] = begin
                    count[i, row, turn] = max(end - begin + 1, 0)
    return first, count


@entry()
def fill_lists(first: IntArray, count: IntArray, num_azimuths: int) -> tuple[IntArray, IntArray]:
    """Start of each pixel's list, and all lists one after another, each in the order of the Gaussians."""
    num_gaussians, num_rows, num_turns = first.shape
    start = np.zeros(num_rows * num_azimuths + 1, np.int64)
    for i in range(num_gaussians):
        for row in range(num_rows):
            for turn in range(num_turns):
                pixel = row * num_azimuths + first[i, row, turn]
                for nth in range(count[i, row, turn]):
                    start[pixel + nth + 1] += 1
    for pixel in range(len(start) - 1):
        start[pixel + 1] += start[pixel]
    following = start[:-1].copy()
    gaussian = np.empty(start[-1], np.int64)
    for i in range(num_gaussians):
        for row in range(num_rows):
            for turn in range(num_turns):
                pixel = row * num_azimuths + first[i, row, turn]
                for nth in range(count[i, row, turn]):
                    gaussian[following[pixel + nth]] = i
                    following[pixel + nth] += 1
    return start, gaussian
