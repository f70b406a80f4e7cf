"""Kernels that look for the edges of a scene: pieces of the lines of its facets' sides, and the wedge around each."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from xfreqbench.scene.patches import PLANE_TOLERANCE

from .arrays import F64, FAR, I64, MAX_BOXES, Bools
from .compiled import entry, part, whole

BESIDE_M = 1e-3  # how far beside an edge a facet must reach to count as one of its faces; shorter edges are none
GROOVE_M = 0.01  # gaps in a plane that are narrower have no edges: joints of planks and tiles
SEAM_M = 1e-6  # by which a facet is wider, so that two that meet in a seam leave no gap
MIN_TURN_RAD = 1e-3  # by which the angle that is left free exceeds a half turn


class Flat(NamedTuple):
    """Facets (Q) in the order of a tree's leaves, whose boxes are wider by 2·`BESIDE_M`, and the tree of N boxes."""

    number: I64  # (Q,) in the order in which they were given
    normal: F64  # (Q, 3)
    corner: F64  # (Q, 3)
    dual: F64  # (Q, 2, 3) vectors of two sides
    is_triangle: Bools  # (Q,)
    box: F64  # (N, 6), and child to last as in `Facets`
    child: I64
    first: I64
    last: I64


@part
def _distance_m(x: F64, origin: F64, along: F64) -> float:
    """Distance of a point from a line."""
    a, b, c = x[0] - origin[0], x[1] - origin[1], x[2] - origin[2]
    u, v, w = b * along[2] - c * along[1], c * along[0] - a * along[2], a * along[1] - b * along[0]
    return math.sqrt(u * u + v * v + w * w)


@part
def _place(x: F64, origin: F64, along: F64) -> float:
    return (x[0] - origin[0]) * along[0] + (x[1] - origin[1]) * along[1] + (x[2] - origin[2]) * along[2]


@part
def _crossing(start: F64, end: F64, origin: F64, along: F64) -> float:
    """Where on a line a side crosses it, or `FAR` where it does not."""
    here, there = _place(start, origin, along), _place(end, origin, along)
    squared = dot = 0.0
    for c in range(3):
        off = start[c] - origin[c] - here * along[c]
        way = end[c] - start[c] - (there - here) * along[c]
        squared, dot = squared + way * way, dot + off * way
    if squared < PLANE_TOLERANCE**2 or not 0.0 < -dot < squared:
        return FAR
    share, gap = -dot / squared, 0.0
    for c in range(3):
        gap += (start[c] + share * (end[c] - start[c]) - origin[c] - (here + share * (there - here)) * along[c]) ** 2
    return here + share * (there - here) if gap < PLANE_TOLERANCE**2 else FAR


@entry
def pieces(start: F64, end: F64) -> list[tuple[F64, F64, float]]:
    """Start, direction and length of the pieces into which the lines of facets' sides (S, 3) are divided.

    They are divided where a corner lies on them, and where another side crosses them.
    """
    found, lengths = [], np.sqrt(np.sum((end - start) ** 2, axis=1))
    left = lengths > BESIDE_M
    for s in range(len(start)):
        if not left[s]:
            continue
        length = lengths[s]
        along = (end[s] - start[s]) / length
        low, high, corner = 0.0, length, [0.0]
        for i in range(len(start)):
            if _distance_m(start[i], start[s], along) < PLANE_TOLERANCE:
                at = _place(start[i], start[s], along)
                corner.append(at)
                if left[i] and _distance_m(end[i], start[s], along) < PLANE_TOLERANCE:
                    other = _place(end[i], start[s], along)
                    low, high = min(low, min(at, other)), max(high, max(at, other))
                    left[i] = False
            else:
                at = _crossing(start[i], end[i], start[s], along)
                if at < FAR:
                    corner.append(at)
        left[s] = False
        before, since = -FAR, -FAR
        for at in np.sort(np.array(corner)):
            if low <= at <= high and at - before > BESIDE_M:
                if since >= low:
                    found.append((start[s] + since * along, along, at - since))
                since = at
            before = at if low <= at <= high else before
    return found


@whole
def _facets_at(flat: Flat, x: F64, stack: I64) -> I64:
    """Facets whose boxes hold a point, in the order in which they were given."""
    held, top = [], min(1, len(flat.box))
    stack[0] = 0
    while top > 0:
        top -= 1
        b = stack[top]
        is_inside = True
        for a in range(3):
            is_inside &= flat.box[b, a] < x[a] < flat.box[b, a + 3]
        if is_inside and flat.child[b] >= 0:
            stack[top], stack[top + 1] = flat.child[b], flat.child[b] + 1
            top += 2
        elif is_inside:
            for q in range(flat.first[b], flat.last[b]):
                held.append(q)
    found = np.array(held, np.int64)
    return found[np.argsort(flat.number[found])]


@part
def _holds(flat: Flat, q: int, x: F64) -> bool:
    """Whether a point in the plane of facet q lies in it, or beside it by a seam."""
    u = v = slack_u = slack_v = 0.0
    for c in range(3):
        u += flat.dual[q, 0, c] * (x[c] - flat.corner[q, c])
        v += flat.dual[q, 1, c] * (x[c] - flat.corner[q, c])
        slack_u += SEAM_M * abs(flat.dual[q, 0, c])
        slack_v += SEAM_M * abs(flat.dual[q, 1, c])
    if u < -slack_u or v < -slack_v:
        return False
    return u + v < 1.0 + slack_u + slack_v if flat.is_triangle[q] else u < 1.0 + slack_u and v < 1.0 + slack_v


@whole
def _goes_on(flat: Flat, face: int, x: F64, stack: I64) -> bool:
    """Whether another facet holds a point of the plane of a face."""
    normal, is_held = flat.normal[face], False
    for q in _facets_at(flat, x, stack):
        gap = abs(np.sum((x - flat.corner[q]) * flat.normal[q]))
        is_parallel = abs(np.sum(normal * flat.normal[q])) > 1.0 - 0.5 * PLANE_TOLERANCE**2
        is_held |= gap < PLANE_TOLERANCE and is_parallel and _holds(flat, q, x)
    return is_held


@entry
def wedge_around(flat: Flat, start: F64, along: F64, length: float) -> tuple[float, F64, I64]:
    """The angle that the facets around a piece of a line leave free, the ways (2, 3) along faces 0 and n, and these.

    It is 0 where they leave no more than half of the space, and where the plane of a face goes on behind a gap of
    less than `GROOVE_M`, as between planks: no wave turns into a groove.
    """
    middle, stack = start + length / 2 * along, np.empty(MAX_BOXES, np.int64)
    towards, faces = [], []
    near = _facets_at(flat, middle, stack)
    for side in (1.0, -1.0):
        for q in near:
            normal = flat.normal[q]
            gap, slope = 0.0, 0.0
            for c in range(3):
                gap += (middle[c] - flat.corner[q, c]) * normal[c]
                slope += normal[c] * along[c]
            if abs(gap) >= PLANE_TOLERANCE or abs(slope) >= PLANE_TOLERANCE:
                continue
            way = side * np.cross(normal, along)
            way /= math.sqrt(np.sum(way**2))
            if _holds(flat, q, middle + BESIDE_M * way):
                towards.append(way)
                faces.append(q)
    ways, face = np.zeros((2, 3)), np.zeros(2, np.int64)
    if not len(faces):
        return 0.0, ways, face
    across, angle = np.cross(along, towards[0]), np.empty(len(faces))
    for i, way in enumerate(towards):
        angle[i] = math.atan2(np.sum(way * across), np.sum(way * towards[0])) % (2.0 * math.pi)
        if angle[i] > 2.0 * math.pi - MIN_TURN_RAD:
            angle[i] = 0.0  # the first facet again, rounded
    order = np.argsort(angle, kind="mergesort")
    widest, free = 0, 0.0
    for i in range(len(order)):
        after = angle[order[i + 1]] if i + 1 < len(order) else angle[order[0]] + 2.0 * math.pi
        if after - angle[order[i]] > free:
            widest, free = i, after - angle[order[i]]
    if free < math.pi + MIN_TURN_RAD:
        return 0.0, ways, face
    for i in range(2):
        which = order[(widest + i) % len(order)]
        ways[i], face[i] = towards[which], faces[which]
        if _goes_on(flat, face[i], middle - GROOVE_M * ways[i], stack):
            free = 0.0
    return free, ways, face
