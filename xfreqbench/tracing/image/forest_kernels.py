"""Kernels that look up what a ray meets in a `Forest`; compiled by who calls them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from xfreqbench.tracing.image.forest import Forest
from xfreqbench.tracing.image.kernels import FAST, MAX_CROSSED, Scratch

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Ray = tuple[float, float, float, float, float, float]

FAR = 1e30  # where a ray meets nothing
MOST_BOXES = 256  # on the stack of boxes still to look into
MOST_NEAR = 32  # facets that a bundle may meet on one segment; of more, each path is followed by itself

part = njit(fastmath=FAST, error_model="numpy", forceinline=True)
whole = njit(fastmath=FAST, error_model="numpy")


class Walk(NamedTuple):
    """Work space of one thread."""

    scratch: Scratch
    box: I64  # boxes still to look into
    box_at: F64  # where the ray enters them
    mirrors: I64  # (D, MOST_NEAR) facets of each plane where the paths turn
    num_mirrors: I64  # (D,)
    slabs: I64  # (D + 1, MOST_NEAR) facets that some path may cross, by segment
    num_slabs: I64  # (D + 1,)
    plane: NDArray[np.int16]  # (D,) of the path at hand
    image: F64  # (3,)
    mirror: F64  # (3, 3)


@whole
def new_walk(max_depth: int, num_nodes: int, tx: F64) -> Walk:
    """Work space for paths of the transmitter at `tx` (3,)."""
    scratch = Scratch(
        tx,
        np.zeros((4, max_depth + 2, 3)),
        np.zeros((0, 0, 0)),
        np.zeros(max_depth + 1, np.int64),
        np.zeros((max_depth + 1, MAX_CROSSED), np.int64),
        np.zeros((max_depth + 1, MAX_CROSSED)),
        np.zeros(max_depth + 1, np.int64),
        np.zeros(1, np.int64),
        np.zeros(3),
        np.zeros(3, np.complex128),
        np.zeros(num_nodes, np.complex128),
    )
    return Walk(
        scratch,
        np.zeros(MOST_BOXES, np.int64),
        np.zeros(MOST_BOXES),
        np.zeros((max_depth, MOST_NEAR), np.int64),
        np.zeros(max_depth, np.int64),
        np.zeros((max_depth + 1, MOST_NEAR), np.int64),
        np.zeros(max_depth + 1, np.int64),
        np.zeros(max_depth, np.int16),
        np.zeros(3),
        np.zeros((3, 3)),
    )


@part
def beyond_edges(face: F64, q: int, x: float, y: float, z: float, is_triangle: bool) -> int:
    """Bit set of the edges of facet q that a point of its plane lies beyond; 0 means inside."""
    u = face[q, 4] * x + face[q, 5] * y + face[q, 6] * z - face[q, 7]
    v = face[q, 8] * x + face[q, 9] * y + face[q, 10] * z - face[q, 11]
    if is_triangle:
        return (u < 0.0) | (v < 0.0) << 1 | (u + v > 1.0) << 4
    return (u < 0.0) | (v < 0.0) << 1 | (u > 1.0) << 2 | (v > 1.0) << 3


@part
def side_of(face: F64, q: int, x: float, y: float, z: float) -> float:
    """Signed distance of a point from the plane of facet q."""
    return face[q, 0] * x + face[q, 1] * y + face[q, 2] * z - face[q, 3]


@part
def inverse_of(d: float) -> float:
    """1 / d, and a large number where d is next to nothing."""
    return 1.0 / d if abs(d) > 1e-12 else 1e12


@part
def _stretch_in(box: F64, b: int, ray: Ray, margin: float, reach: float) -> tuple[float, float]:
    """Where a ray enters and leaves a box that is widened by a margin; in reverse where it misses it up to `reach`."""
    ox, oy, oz, ix, iy, iz = ray
    low, high = (box[b, 0] - margin - ox) * ix, (box[b, 3] + margin - ox) * ix
    enters, leaves = max(0.0, min(low, high)), min(reach, max(low, high))
    low, high = (box[b, 1] - margin - oy) * iy, (box[b, 4] + margin - oy) * iy
    enters, leaves = max(enters, min(low, high)), min(leaves, max(low, high))
    low, high = (box[b, 2] - margin - oz) * iz, (box[b, 5] + margin - oz) * iz
    return max(enters, min(low, high)), min(leaves, max(low, high))


@part
def _entry(box: F64, b: int, ray: Ray, margins: tuple[float, float], reach: float) -> float:
    """Where a ray enters a box, or `FAR` where it does not up to `reach`.

    The ray is the axis of a cone that is as wide as the `margins` at the ray's start and at 1.
    """
    start, end = margins
    enters, leaves = _stretch_in(box, b, ray, max(start, end), reach)
    if enters <= leaves and start != end:
        margin = max(start + enters * (end - start), start + leaves * (end - start))
        enters, leaves = _stretch_in(box, b, ray, margin, reach)
    return enters if enters <= leaves else FAR


@part
def next_leaf(
    forest: Forest, ray: Ray, margins: tuple[float, float], reach: float, walk: Walk, top: int
) -> tuple[int, int]:
    """The next leaf on a ray's way, or −1, and the number of boxes that are then still to be looked into.

    With `top` −1 the search begins anew. Nearer boxes come first.
    """
    box, box_at = walk.box, walk.box_at
    if top < 0:
        top = 0
        for r in range(len(forest.root)):
            enters = _entry(forest.box, forest.root[r], ray, margins, reach)
            if enters < FAR:
                box[top], box_at[top] = forest.root[r], enters
                top += 1
    while top > 0:
        top -= 1
        b = box[top]
        if box_at[top] > reach:
            continue
        near = forest.child[b]
        if near < 0:
            return top, b
        far = near + 1
        near_at = _entry(forest.box, near, ray, margins, reach)
        far_at = _entry(forest.box, far, ray, margins, reach)
        if far_at < near_at:
            near, far, near_at, far_at = far, near, far_at, near_at
        if far_at < FAR:
            box[top], box_at[top] = far, far_at
            top += 1
        if near_at < FAR:
            box[top], box_at[top] = near, near_at
            top += 1
    return 0, -1


@whole
def first_hit(forest: Forest, o: F64, d: F64, walk: Walk) -> tuple[int, float]:
    """Facet and distance of what a ray from o along d meets first; facet −1 where it meets nothing."""
    hit, nearest, top, face = -1, FAR, -1, forest.face
    ray = (o[0], o[1], o[2], inverse_of(d[0]), inverse_of(d[1]), inverse_of(d[2]))
    while True:
        top, leaf = next_leaf(forest, ray, (0.0, 0.0), nearest, walk, top)
        if leaf < 0:
            return hit, nearest
        for q in range(forest.first[leaf], forest.last[leaf]):
            speed = face[q, 0] * d[0] + face[q, 1] * d[1] + face[q, 2] * d[2]
            if speed == 0.0:
                continue
            t = -side_of(face, q, o[0], o[1], o[2]) / speed
            if t < 1e-7 or t >= nearest:
                continue
            x, y, z = o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]
            if beyond_edges(face, q, x, y, z, forest.is_triangle[q]) == 0:
                hit, nearest = q, t
