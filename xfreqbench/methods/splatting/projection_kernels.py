"""Compiled kernels of Eqs. 5, 8 and 9 on the CPU: footprints of Gaussians, and their gradients, computed in float64.

`projection` has the same in plain torch. What a kernel calls is not cached by itself: code from the cache is called
instead of becoming part of the kernel, and rounds otherwise.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from xfreqbench.system.kernels import entry
from xfreqbench.types import FloatArray

POLE_DISTANCE = math.sin(math.radians(1.0))
MIN_VARIANCE = math.radians(0.5) ** 2  # rad²: a footprint's deviation is at least half a step of the grid
MIN_RANGE_M = 1e-2  # a Gaussian at the receiver has no direction
LEAST_DECORRELATION = 1e-6  # sixteen roundings of float32; the ellipse is a thousand times as long as wide
OFF_AXIS_M = 1e-6  # points closer to the pole's axis are moved off it, so that they have an azimuth
_LEAST_LENGTH = 1e-12  # of a quaternion, as `torch.nn.functional.normalize` has it


@njit(error_model="numpy")
def _off_axis(x: float, y: float) -> float:
    """x, moved off the pole's axis."""
    return x + 2 * OFF_AXIS_M if abs(x) + abs(y) < OFF_AXIS_M else x


@njit(error_model="numpy")
def _write_axes(gaussian: FloatArray, unit: FloatArray, axes: FloatArray) -> float:
    """Write the quaternion of length 1 to `unit` and the columns of R S (Eq. 5) to `axes`; return its length."""
    length = 0.0
    for k in range(4):
        length += float(gaussian[3 + k]) ** 2
    length = max(math.sqrt(length), _LEAST_LENGTH)
    for k in range(4):
        unit[k] = gaussian[3 + k] / length
    w, x, y, z = unit[0], unit[1], unit[2], unit[3]
    axes[0, 0], axes[0, 1], axes[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    axes[1, 0], axes[1, 1], axes[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    axes[2, 0], axes[2, 1], axes[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    for k in range(3):
        size_m = math.exp(gaussian[7 + k])
        for i in range(3):
            axes[i, k] *= size_m
    return length


@njit(error_model="numpy")
def _write_jacobian(x: float, y: float, z: float, jacobian: FloatArray) -> tuple[float, float, float, float]:
    """Write Eq. 9's J, rad/m, to `jacobian`; return distance from the axis, range, and what stands for them in J."""
    horizontal = math.hypot(x, y)
    range_m = math.hypot(horizontal, z)
    counted = max(range_m, MIN_RANGE_M)
    reach = max(horizontal, POLE_DISTANCE * counted)
    cosine, sine = x / horizontal, y / horizontal
    jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = -sine / reach, cosine / reach, 0.0
    square = counted * counted
    jacobian[1, 0], jacobian[1, 1], jacobian[1, 2] = -z * cosine / square, -z * sine / square, horizontal / square
    return horizontal, range_m, counted, reach


@njit(error_model="numpy")
def _write_sides(jacobian: FloatArray, axes: FloatArray, sides: FloatArray) -> tuple[float, float, float, float]:
    """Write J R S to `sides`; return a, b, c of the footprint's covariance, and the most that |b| may be."""
    a, b, c = MIN_VARIANCE, 0.0, MIN_VARIANCE
    for k in range(3):
        for row in range(2):
            sides[row, k] = 0.0
            for i in range(3):
                sides[row, k] += jacobian[row, i] * axes[i, k]
        a += sides[0, k] * sides[0, k]
        b += sides[0, k] * sides[1, k]
        c += sides[1, k] * sides[1, k]
    return a, b, c, math.sqrt(a * c) * (1 - LEAST_DECORRELATION)


@entry(error_model="numpy")
def project(gaussians: FloatArray, footprint: FloatArray, range_m: FloatArray) -> None:
    """Write azimuth, elevation and a, b, c of the covariance to `footprint` (N, 5), and ranges (N,).

    `gaussians` (N, 10) are positions, quaternions and log-scales.
    """
    unit, axes, jacobian, sides = np.empty(4), np.empty((3, 3)), np.empty((2, 3)), np.empty((2, 3))
    for n in range(len(gaussians)):
        y, z = float(gaussians[n, 1]), float(gaussians[n, 2])
        x = _off_axis(float(gaussians[n, 0]), y)
        _write_axes(gaussians[n], unit, axes)
        horizontal, range_m[n], _, _ = _write_jacobian(x, y, z, jacobian)
        a, b, c, most = _write_sides(jacobian, axes, sides)
        footprint[n, 0], footprint[n, 1] = math.atan2(y, x), math.atan2(z, horizontal)
        footprint[n, 2], footprint[n, 3], footprint[n, 4] = a, min(max(b, -most), most), c


@entry(error_model="numpy")
def project_backward(gaussians: FloatArray, slope: FloatArray, gradient: FloatArray) -> None:
    """Write gradients by `gaussians` (N, 10), from those by the footprint, `slope` (N, 5)."""
    unit, axes, jacobian, sides = np.empty(4), np.empty((3, 3)), np.empty((2, 3)), np.empty((2, 3))
    of_turn, of_jacobian, of_unit = np.empty((3, 3)), np.empty((2, 3)), np.empty(4)
    for n in range(len(gaussians)):
        y, z = float(gaussians[n, 1]), float(gaussians[n, 2])
        x = _off_axis(float(gaussians[n, 0]), y)
        length = _write_axes(gaussians[n], unit, axes)
        horizontal, range_m, counted, reach = _write_jacobian(x, y, z, jacobian)
        a, b, c, most = _write_sides(jacobian, axes, sides)
        of_a, of_b, of_c = float(slope[n, 2]), float(slope[n, 3]), float(slope[n, 4])
        if abs(b) > most:  # the covariance has ±most in place of b
            of_most = of_b if b > 0 else -of_b
            of_a, of_b, of_c = of_a + of_most * most / (2 * a), 0.0, of_c + of_most * most / (2 * c)
        of_jacobian[:] = 0
        for k in range(3):
            of_first = 2 * of_a * sides[0, k] + of_b * sides[1, k]
            of_second = 2 * of_c * sides[1, k] + of_b * sides[0, k]
            size_m, of_size = math.exp(gaussians[n, 7 + k]), 0.0
            for i in range(3):
                of_axis = of_first * jacobian[0, i] + of_second * jacobian[1, i]
                of_jacobian[0, i] += of_first * axes[i, k]
                of_jacobian[1, i] += of_second * axes[i, k]
                of_size += of_axis * axes[i, k]
                of_turn[i, k] = of_axis * size_m
            gradient[n, 7 + k] = of_size
        _write_slope_of_rotation(unit, of_turn, of_unit)
        along = 0.0
        for k in range(4):
            along += unit[k] * of_unit[k]
        for k in range(4):
            gradient[n, 3 + k] = (of_unit[k] - unit[k] * along) / length
        cosine, sine, square = x / horizontal, y / horizontal, counted * counted
        of_reach, of_counted = 0.0, 0.0
        for i in range(3):
            of_reach -= of_jacobian[0, i] * jacobian[0, i] / reach
            of_counted -= 2 * of_jacobian[1, i] * jacobian[1, i] / counted
        of_elevation = float(slope[n, 1]) / (range_m * range_m)
        of_z = of_elevation * horizontal - (cosine * of_jacobian[1, 0] + sine * of_jacobian[1, 1]) / square
        of_cosine = of_jacobian[0, 1] / reach - z * of_jacobian[1, 0] / square
        of_sine = -of_jacobian[0, 0] / reach - z * of_jacobian[1, 1] / square
        of_horizontal = of_jacobian[1, 2] / square - of_elevation * z
        of_horizontal -= (of_cosine * cosine + of_sine * sine) / horizontal
        if horizontal > POLE_DISTANCE * counted:
            of_horizontal += of_reach
        else:
            of_counted += POLE_DISTANCE * of_reach
        of_range = of_counted / range_m if range_m >= MIN_RANGE_M else 0.0
        of_azimuth = float(slope[n, 0]) / (horizontal * horizontal)
        of_x = of_cosine / horizontal + of_horizontal * cosine - of_azimuth * y
        of_y = of_sine / horizontal + of_horizontal * sine + of_azimuth * x
        gradient[n, 0], gradient[n, 1] = of_x + of_range * x, of_y + of_range * y
        gradient[n, 2] = of_z + of_range * z


@njit(error_model="numpy")
def _write_slope_of_rotation(unit: FloatArray, of_turn: FloatArray, of_unit: FloatArray) -> None:
    """Write the gradient by a quaternion (w, x, y, z) of length 1, from that by its rotation matrix, to `of_unit`."""
    w, x, y, z = unit[0], unit[1], unit[2], unit[3]
    t = of_turn
    of_unit[0] = 2 * (x * (t[2, 1] - t[1, 2]) + y * (t[0, 2] - t[2, 0]) + z * (t[1, 0] - t[0, 1]))
    of_unit[1] = 2 * (y * (t[0, 1] + t[1, 0]) + z * (t[0, 2] + t[2, 0]) + w * (t[2, 1] - t[1, 2]))
    of_unit[1] -= 4 * x * (t[1, 1] + t[2, 2])
    of_unit[2] = 2 * (x * (t[0, 1] + t[1, 0]) + z * (t[1, 2] + t[2, 1]) + w * (t[0, 2] - t[2, 0]))
    of_unit[2] -= 4 * y * (t[0, 0] + t[2, 2])
    of_unit[3] = 2 * (x * (t[0, 2] + t[2, 0]) + y * (t[1, 2] + t[2, 1]) + w * (t[1, 0] - t[0, 1]))
    of_unit[3] -= 4 * z * (t[0, 0] + t[1, 1])
