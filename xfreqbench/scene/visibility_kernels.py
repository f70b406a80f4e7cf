"""Loops over all triangles of a scene, in float64, compiled: segments that are free, and distances to surfaces."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from xfreqbench.system.kernels import entry
from xfreqbench.types import NDArray

Array = NDArray[np.float64]


@entry()
def free_segments(corner: Array, start: Array, end: Array) -> NDArray[np.bool_]:
    """Whether the segment from each start (N, 3) to the end (3,) meets no triangle (K, 3, 3) (Möller–Trumbore)."""
    free = np.ones(len(start), np.bool_)
    edges = corner[:, 1:] - corner[:, :1]
    for n in range(len(start)):
        sx, sy, sz = start[n]
        dx, dy, dz = end[0] - sx, end[1] - sy, end[2] - sz
        for k in range(len(corner)):
            ux, uy, uz = edges[k, 0]
            vx, vy, vz = edges[k, 1]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            along = dx * nx + dy * ny + dz * nz
            if along == 0.0:
                continue
            ox, oy, oz = sx - corner[k, 0, 0], sy - corner[k, 0, 1], sz - corner[k, 0, 2]
            t = -(ox * nx + oy * ny + oz * nz) / along
            if not 0.0 < t < 1.0:
                continue
            tx, ty, tz = oy * dz - oz * dy, oz * dx - ox * dz, ox * dy - oy * dx
            u = -(tx * vx + ty * vy + tz * vz) / along
            v = (tx * ux + ty * uy + tz * uz) / along
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                free[n] = False
                break
    return free


@entry()
def nearest_distances(corner: Array, point: Array) -> Array:
    """Distance from each point (N, 3) to the nearest triangle (K, 3, 3); infinite where there is none.

    Triangles whose bounding box is farther away than the nearest so far are passed over.
    """
    low, high = np.empty((len(corner), 3)), np.empty((len(corner), 3))
    for k in range(len(corner)):
        for axis in range(3):
            low[k, axis] = min(corner[k, 0, axis], corner[k, 1, axis], corner[k, 2, axis])
            high[k, axis] = max(corner[k, 0, axis], corner[k, 1, axis], corner[k, 2, axis])
    nearest = np.empty(len(point))
    for n in range(len(point)):
        least = np.inf
        for k in range(len(corner)):
            beyond = 0.0
            for axis in range(3):
                gap = max(low[k, axis] - point[n, axis], point[n, axis] - high[k, axis], 0.0)
                beyond += gap * gap
            if beyond < least:
                least = min(least, _squared_distance(corner[k], point[n]))
        nearest[n] = math.sqrt(least)
    return nearest


@njit()
def _squared_distance(corner: Array, point: Array) -> float:
    """Squared distance from a point to a triangle, by the region of its plane in which the foot lies."""
    first, second = corner[1] - corner[0], corner[2] - corner[0]
    from_a, from_b, from_c = point - corner[0], point - corner[1], point - corner[2]
    a1, a2 = np.dot(first, from_a), np.dot(second, from_a)
    b1, b2 = np.dot(first, from_b), np.dot(second, from_b)
    c1, c2 = np.dot(first, from_c), np.dot(second, from_c)
    opposite_a, opposite_b, opposite_c = b1 * c2 - c1 * b2, c1 * a2 - a1 * c2, a1 * b2 - b1 * a2
    if a1 <= 0.0 and a2 <= 0.0:
        u, v = 0.0, 0.0
    elif b1 >= 0.0 and b2 <= b1:
        u, v = 1.0, 0.0
    elif opposite_c <= 0.0 and a1 >= 0.0 and b1 <= 0.0:
        u, v = a1 / (a1 - b1), 0.0
    elif c2 >= 0.0 and c1 <= c2:
        u, v = 0.0, 1.0
    elif opposite_b <= 0.0 and a2 >= 0.0 and c2 <= 0.0:
        u, v = 0.0, a2 / (a2 - c2)
    elif opposite_a <= 0.0 and b2 - b1 >= 0.0 and c1 - c2 >= 0.0:
        v = (b2 - b1) / ((b2 - b1) + (c1 - c2))
        u = 1.0 - v
    else:
        whole = opposite_a + opposite_b + opposite_c
        u, v = opposite_b / whole, opposite_c / whole
    gap = from_a - u * first - v * second
    return np.dot(gap, gap)
