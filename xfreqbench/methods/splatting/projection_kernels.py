"""Compiled kernels of Eqs. 5, 8 and 9 on the CPU: footprints of Gaussians, and their gradients, computed in float64.

`projection` has the same in plain torch. Kernels see a flat table in blocks of `_LANES` Gaussians: each block is
`_FIELDS` runs of `_LANES` numbers, so that LLVM computes several Gaussians at once. Angles are NumPy's, which does so
too.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from xfreqbench.system.kernels import entry
from xfreqbench.types import FloatArray, NDArray

POLE_DISTANCE = math.sin(math.radians(1.0))
MIN_VARIANCE = math.radians(0.5) ** 2  # rad²: a footprint's deviation is at least half a step of the grid
MIN_RANGE_M = 1e-2  # a Gaussian at the receiver has no direction
LEAST_DECORRELATION = 1e-6  # sixteen roundings of float32; the ellipse is a thousand times as long as wide
OFF_AXIS_M = 1e-6  # points closer to the pole's axis are moved off it, so that they have an azimuth
_LEAST_LENGTH = 1e-12  # of a quaternion, as `torch.nn.functional.normalize` has it

_LANES = 64
_FIELDS = 16  # a Gaussian's ten, with sizes in metres; its footprint's five; and its range in metres
_X, _Y, _Z, _QW, _QX, _QY, _QZ, _S0, _S1, _S2, _AZ, _EL, _A, _B, _C, _RANGE = (nth * _LANES for nth in range(_FIELDS))


@entry()
def _table(gaussians: FloatArray, slope: FloatArray) -> FloatArray:
    """The flat table of Gaussians (N, 10), moved off the pole's axis, and of gradients by footprints, (N, 5) or none.

    Lanes without a Gaussian hold ones.
    """
    table = np.ones(-(-len(gaussians) // _LANES) * _FIELDS * _LANES)
    for n in range(len(gaussians)):
        lane = n // _LANES * _FIELDS * _LANES + n % _LANES
        for field in range(7):
            table[lane + field * _LANES] = gaussians[n, field]
        for field in range(7, 10):
            table[lane + field * _LANES] = math.exp(gaussians[n, field])
        if abs(table[lane + _X]) + abs(table[lane + _Y]) < OFF_AXIS_M:
            table[lane + _X] += 2 * OFF_AXIS_M
    for n in range(len(slope)):
        lane = n // _LANES * _FIELDS * _LANES + n % _LANES
        for field in range(5):
            table[lane + _AZ + field * _LANES] = slope[n, field]
    return table


@entry()
def _read(table: FloatArray, first: int, rows: FloatArray) -> None:
    """Write fields from `first` on to rows (N, F)."""
    for n in range(len(rows)):
        lane = first + n // _LANES * _FIELDS * _LANES + n % _LANES
        for field in range(rows.shape[1]):
            rows[n, field] = table[lane + field * _LANES]


def project(gaussians: FloatArray, footprint: FloatArray, range_m: NDArray[Any]) -> None:
    """Write azimuth, elevation and a, b, c of the covariance to `footprint` (N, 5), and ranges (N,).

    `gaussians` (N, 10) are positions, quaternions and log-scales.
    """
    table = _table(gaussians, footprint[:0])
    _project(table)
    x, y, z, azimuth, elevation = (table.reshape(-1, _FIELDS, _LANES)[:, nth] for nth in (0, 1, 2, 10, 11))
    np.arctan2(y, x, out=azimuth)
    np.arctan2(z, elevation, out=elevation)
    _read(table, _AZ, footprint)
    _read(table, _RANGE, range_m[:, None])


def project_backward(gaussians: FloatArray, slope: FloatArray, gradient: FloatArray) -> None:
    """Write gradients by `gaussians` (N, 10), from those by the footprint, `slope` (N, 5)."""
    table = _table(gaussians, slope)
    _project_backward(table)
    _read(table, _X, gradient)


@njit(error_model="numpy")
def _turn(w: float, x: float, y: float, z: float) -> tuple[tuple[float, float, float], ...]:
    """The columns of the rotation matrix R of a quaternion of length 1 (Eq. 5)."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


@njit(error_model="numpy")
def _jacobian(x: float, y: float, z: float) -> tuple[tuple[float, float, float, float], tuple[float, ...]]:
    """Distance from the axis, range, what counts for them; and Eq. 9's J, rad/m, without its zero, row by row."""
    horizontal = math.sqrt(x * x + y * y)
    range_m = math.sqrt(horizontal * horizontal + z * z)
    counted = max(range_m, MIN_RANGE_M)
    reach = max(horizontal, POLE_DISTANCE * counted)
    cosine, sine, square = x / horizontal, y / horizontal, counted * counted
    j = -sine / reach, cosine / reach, -z * cosine / square, -z * sine / square, horizontal / square
    return (horizontal, range_m, counted, reach), j


@njit(error_model="numpy")
def _side(j: tuple[float, ...], axis: tuple[float, float, float], size_m: float) -> tuple[float, float]:
    """J times one axis of a Gaussian: a column of J R S."""
    return (size_m * (j[0] * axis[0] + j[1] * axis[1]), size_m * (j[2] * axis[0] + j[3] * axis[1] + j[4] * axis[2]))


@njit(error_model="numpy")
def _covariance(
    p: tuple[float, float], q: tuple[float, float], r: tuple[float, float]
) -> tuple[float, float, float, float]:
    """Entries a, b, c of the footprint's covariance, and the most that |b| may be, from the columns of J R S."""
    a = MIN_VARIANCE + p[0] * p[0] + q[0] * q[0] + r[0] * r[0]
    b = p[0] * p[1] + q[0] * q[1] + r[0] * r[1]
    c = MIN_VARIANCE + p[1] * p[1] + q[1] * q[1] + r[1] * r[1]
    return a, b, c, math.sqrt(a * c) * (1 - LEAST_DECORRELATION)


@entry(error_model="numpy")
def _project(table: FloatArray) -> None:
    """Write a, b, c, ranges, and distances from the axis in place of elevations, to a flat table."""
    for start in range(0, len(table), _FIELDS * _LANES):
        block = table[start : start + _FIELDS * _LANES]
        for n in range(_LANES):
            w, qx, qy, qz = block[_QW + n], block[_QX + n], block[_QY + n], block[_QZ + n]
            length = max(math.sqrt(w * w + qx * qx + qy * qy + qz * qz), _LEAST_LENGTH)
            turn = _turn(w / length, qx / length, qy / length, qz / length)
            (horizontal, range_m, _, _), j = _jacobian(block[_X + n], block[_Y + n], block[_Z + n])
            p, q = _side(j, turn[0], block[_S0 + n]), _side(j, turn[1], block[_S1 + n])
            a, b, c, most = _covariance(p, q, _side(j, turn[2], block[_S2 + n]))
            block[_EL + n], block[_RANGE + n] = horizontal, range_m
            block[_A + n], block[_B + n], block[_C + n] = a, min(max(b, -most), most), c


@njit(error_model="numpy")
def _of_side(side: tuple[float, float], of_a: float, of_b: float, of_c: float) -> tuple[float, float]:
    """Gradients by a column of J R S from those by the covariance's entries."""
    return 2 * of_a * side[0] + of_b * side[1], 2 * of_c * side[1] + of_b * side[0]


@njit(error_model="numpy")
def _of_axis(j: tuple[float, ...], of: tuple[float, float], size_m: float) -> tuple[float, float, float]:
    """Gradients by a column of R."""
    return (size_m * (of[0] * j[0] + of[1] * j[2]), size_m * (of[0] * j[1] + of[1] * j[3]), size_m * of[1] * j[4])


@njit(error_model="numpy")
def _product(p: tuple[float, float, float], q: tuple[float, float, float]) -> float:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@entry(error_model="numpy")
def _project_backward(table: FloatArray) -> None:
    """Write gradients by the Gaussians over them in a flat table, where footprints have their gradients."""
    for start in range(0, len(table), _FIELDS * _LANES):
        block = table[start : start + _FIELDS * _LANES]
        for n in range(_LANES):
            x, y, z = block[_X + n], block[_Y + n], block[_Z + n]
            s0, s1, s2 = block[_S0 + n], block[_S1 + n], block[_S2 + n]
            qw, qx, qy, qz = block[_QW + n], block[_QX + n], block[_QY + n], block[_QZ + n]
            length = max(math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz), _LEAST_LENGTH)
            qw, qx, qy, qz = qw / length, qx / length, qy / length, qz / length
            r0, r1, r2 = _turn(qw, qx, qy, qz)
            (horizontal, range_m, counted, reach), j = _jacobian(x, y, z)
            p, q, r = _side(j, r0, s0), _side(j, r1, s1), _side(j, r2, s2)
            a, b, c, most = _covariance(p, q, r)
            of_a, of_b, of_c = block[_A + n], block[_B + n], block[_C + n]
            is_clipped = abs(b) > most  # the covariance has ±most in place of b
            of_most = (of_b if b > 0 else -of_b) * most if is_clipped else 0.0
            of_a, of_b, of_c = of_a + of_most / (2 * a), 0.0 if is_clipped else of_b, of_c + of_most / (2 * c)
            of_p, of_q, of_r = (
                _of_side(p, of_a, of_b, of_c),
                _of_side(q, of_a, of_b, of_c),
                _of_side(r, of_a, of_b, of_c),
            )
            t0, t1, t2 = _of_axis(j, of_p, s0), _of_axis(j, of_q, s1), _of_axis(j, of_r, s2)
            block[_S0 + n], block[_S1 + n], block[_S2 + n] = _product(t0, r0), _product(t1, r1), _product(t2, r2)
            of_w = 2 * (qx * (t1[2] - t2[1]) + qy * (t2[0] - t0[2]) + qz * (t0[1] - t1[0]))
            of_x = 2 * (qy * (t1[0] + t0[1]) + qz * (t2[0] + t0[2]) + qw * (t1[2] - t2[1])) - 4 * qx * (t1[1] + t2[2])
            of_y = 2 * (qx * (t1[0] + t0[1]) + qz * (t2[1] + t1[2]) + qw * (t2[0] - t0[2])) - 4 * qy * (t0[0] + t2[2])
            of_z = 2 * (qx * (t2[0] + t0[2]) + qy * (t2[1] + t1[2]) + qw * (t0[1] - t1[0])) - 4 * qz * (t0[0] + t1[1])
            along = qw * of_w + qx * of_x + qy * of_y + qz * of_z
            block[_QW + n], block[_QX + n] = (of_w - qw * along) / length, (of_x - qx * along) / length
            block[_QY + n], block[_QZ + n] = (of_y - qy * along) / length, (of_z - qz * along) / length
            f0, f1, f2 = s0 * of_p[0], s1 * of_q[0], s2 * of_r[0]
            g0, g1, g2 = s0 * of_p[1], s1 * of_q[1], s2 * of_r[1]
            of_j00, of_j01 = f0 * r0[0] + f1 * r1[0] + f2 * r2[0], f0 * r0[1] + f1 * r1[1] + f2 * r2[1]
            of_j10, of_j11 = g0 * r0[0] + g1 * r1[0] + g2 * r2[0], g0 * r0[1] + g1 * r1[1] + g2 * r2[1]
            of_j12 = g0 * r0[2] + g1 * r1[2] + g2 * r2[2]
            cosine, sine, square = x / horizontal, y / horizontal, counted * counted
            of_reach = -(of_j00 * j[0] + of_j01 * j[1]) / reach
            of_counted = -2 * (of_j10 * j[2] + of_j11 * j[3] + of_j12 * j[4]) / counted
            of_elevation, of_azimuth = block[_EL + n] / (range_m * range_m), block[_AZ + n] / (horizontal * horizontal)
            of_cosine, of_sine = of_j01 / reach - z * of_j10 / square, -of_j00 / reach - z * of_j11 / square
            of_horizontal = of_j12 / square - of_elevation * z - (of_cosine * cosine + of_sine * sine) / horizontal
            is_reached = horizontal > POLE_DISTANCE * counted
            of_horizontal += of_reach if is_reached else 0.0
            of_counted += 0.0 if is_reached else POLE_DISTANCE * of_reach
            of_range = of_counted / range_m if range_m >= MIN_RANGE_M else 0.0
            block[_X + n] = of_cosine / horizontal + of_horizontal * cosine - of_azimuth * y + of_range * x
            block[_Y + n] = of_sine / horizontal + of_horizontal * sine + of_azimuth * x + of_range * y
            block[_Z + n] = of_elevation * horizontal - (cosine * of_j10 + sine * of_j11) / square + of_range * z
