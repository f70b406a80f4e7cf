"""Compiled kernels: the way of a path over one edge, with planes that reflect it before and after.

Each end of a path sees the edge directly or over some planes: that is a `Side`, the image of the end mirrored in
one plane after another. Unfolded, a path is the shortest way from one image over the edge to the other. Turned
about the edge into one half-plane it is a straight line, which gives the point of the edge in closed form. These
kernels are not cached: they become part of those of `diffraction_kernels`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xfreqbench.tracing.image.kernels import F64, I64, MAX_CROSSED, MIN_SEGMENT_M, Facets, _beyond
from xfreqbench.tracing.image.wedge_kernels import Wedges, inner

Polar = tuple[float, float, float]
Legs = tuple["Leg", "Leg"]

MAX_SIDE_PLANES = 3  # on either side of the edge


class Leg(NamedTuple):
    """One side of a path, from the edge to its end: what it meets on at most S segments."""

    vertex: F64  # (S + 1, 3)
    hit: I64  # (S,) facet of each reflection
    crossed: I64  # (S, MAX_CROSSED) facets crossed on each segment
    crossed_at: F64  # (S, MAX_CROSSED): where, as a share of the segment
    num_crossed: I64  # (S,)


class Side(NamedTuple):
    """How one end of a path sees an edge; the planes are in the order in which a wave from the end meets them."""

    length: int
    plane: NDArray[np.int16]  # (MAX_SIDE_PLANES,)
    image: F64  # (3,) of the end
    mirror: F64  # (3, 3): what the planes make of an offset of the end


@inner
def new_leg() -> Leg:
    """Work space for one side of a path."""
    segments = MAX_SIDE_PLANES + 1
    return Leg(
        np.zeros((segments + 1, 3)),
        np.zeros(segments, np.int64),
        np.zeros((segments, MAX_CROSSED), np.int64),
        np.zeros((segments, MAX_CROSSED)),
        np.zeros(segments, np.int64),
    )


@inner
def place(wedges: Wedges, e: int, x: F64) -> Polar:
    """Where a point is from the start of an edge: along its face 0, away from that face, and along the edge."""
    a, b, z = 0.0, 0.0, 0.0
    for c in range(3):
        gap = x[c] - wedges.start[e, c]
        a += gap * wedges.tangent[e, c]
        b += gap * wedges.normal[e, c]
        z += gap * wedges.along[e, c]
    return a, b, z


@inner
def polar(wedges: Wedges, e: int, x: F64) -> Polar:
    """Distance of a point from the line of an edge, its place along the line in metres, and its angle φ."""
    a, b, z = place(wedges, e, x)
    angle = math.atan2(b, a)
    return math.sqrt(a * a + b * b), z, angle if angle >= 0.0 else angle + 2.0 * math.pi


@inner
def edge_point(near: Polar, far: Polar) -> float:
    """Where along its line the shortest way over the edge between two points, in polar coordinates, meets it."""
    together = near[0] + far[0]
    return (near[1] * far[0] + far[1] * near[0]) / together if together > 0.0 else -1.0


@inner
def _distance_to(facets: Facets, p: int, x: F64) -> float:
    return (
        facets.normal[0, p] * x[0]
        + facets.normal[1, p] * x[1]
        + facets.normal[2, p] * x[2]
        - facets.offset[p]
    )


@inner
def _fold_leg(facets: Facets, holds: NDArray[np.bool_], side: Side, end: F64, leg: Leg) -> tuple[bool, int]:
    """Fold the line from the point of the edge, vertex 0, to the end's image; whether it meets all its planes.

    Also returned is a number that stands for what was met and missed: where it is the same for the corners of a
    convex set of ends, all of its ends fold alike.
    """
    n, vertex, met = side.length, leg.vertex, 17
    for c in range(3):
        vertex[n + 1, c] = end[c]
    for j in range(n):
        p = side.plane[n - 1 - j]
        here, there = _distance_to(facets, p, vertex[j]), _distance_to(facets, p, vertex[n + 1])
        if (j == 0 and holds[p]) or here * there >= 0.0:
            return False, met * 31 + (here > 0.0)
        t = here / (here - there)
        for c in range(3):
            vertex[j + 1, c] = vertex[j, c] + t * (vertex[n + 1, c] - vertex[j, c])
            vertex[n + 1, c] -= 2.0 * there * facets.normal[c, p]
        leg.hit[j], missed = -1, 0
        for q in range(facets.first[p], facets.first[p + 1]):
            beyond = _beyond(facets, q, vertex[j + 1, 0], vertex[j + 1, 1], vertex[j + 1, 2])
            if beyond == 0:
                leg.hit[j] = q
                break
            missed = missed * 32 + beyond
        if leg.hit[j] < 0:
            return False, met * 31 + missed + 2
        met = met * 1009 + leg.hit[j]
    return True, met


@inner
def _cross_leg(
    facets: Facets, holds: NDArray[np.bool_], side: Side, num_left: int, leg: Leg
) -> tuple[int, int]:
    """Find what the segments of a folded leg cross; interactions left, negative where the path ends, and a number.

    No facet in a plane that holds the edge is met: the leg leaves that plane at its first point.
    """
    n, vertex, met = side.length, leg.vertex, 0
    for s in range(n + 1):
        leg.num_crossed[s] = 0
        before, after = side.plane[n - s] if s > 0 else -1, side.plane[n - 1 - s] if s < n else -1
        for p in range(facets.offset.shape[0]):
            if p in (before, after) or (s == 0 and holds[p]):
                continue
            here, there = _distance_to(facets, p, vertex[s]), _distance_to(facets, p, vertex[s + 1])
            if here * there >= 0.0:
                continue
            t = here / (here - there)
            x = vertex[s, 0] + t * (vertex[s + 1, 0] - vertex[s, 0])
            y = vertex[s, 1] + t * (vertex[s + 1, 1] - vertex[s, 1])
            z = vertex[s, 2] + t * (vertex[s + 1, 2] - vertex[s, 2])
            for q in range(facets.first[p], facets.first[p + 1]):
                if _beyond(facets, q, x, y, z) == 0:
                    num_left -= 1
                    met = met * 1009 + q + 1
                    if facets.is_opaque[q] or num_left < 0 or leg.num_crossed[s] >= MAX_CROSSED:
                        return -1, met
                    _keep_in_order(leg, s, q, t)
                    break  # of the facets in a plane only the first that a path meets counts
    return num_left, met


@inner
def _keep_in_order(leg: Leg, s: int, q: int, t: float) -> None:
    """Put facet q, crossed at share t of segment s, among the others, in order from the edge."""
    i = leg.num_crossed[s]
    while i > 0 and leg.crossed_at[s, i - 1] > t:
        leg.crossed[s, i], leg.crossed_at[s, i] = leg.crossed[s, i - 1], leg.crossed_at[s, i - 1]
        i -= 1
    leg.crossed[s, i], leg.crossed_at[s, i] = q, t
    leg.num_crossed[s] += 1


@inner
def _shortest_stretch(n: int, leg: Leg) -> float:
    """Shortest stretch of a leg in metres between successive interactions, or an interaction and its end."""
    shortest = 1e30
    for s in range(n + 1):
        span = 0.0
        for c in range(3):
            span += (leg.vertex[s + 1, c] - leg.vertex[s, c]) ** 2
        span, last = math.sqrt(span), 0.0
        for i in range(leg.num_crossed[s]):
            shortest = min(shortest, (leg.crossed_at[s, i] - last) * span)
            last = leg.crossed_at[s, i]
        shortest = min(shortest, (1.0 - last) * span)
    return shortest


@inner
def _is_free(wedges: Wedges, e: int, polar: Polar) -> bool:
    """Whether a point lies in the free space around an edge, off its line."""
    return polar[0] > 1e-9 and 0.0 < polar[2] < wedges.angle[e]


@inner
def reach(
    facets: Facets,
    wedges: Wedges,
    e: int,
    sides: tuple[Side, Side],
    ends: tuple[F64, F64],
    most: int,
    legs: Legs,
) -> tuple[bool, int, float]:
    """Whether a path of at most `most` interactions besides the edge joins the two ends' images over edge e.

    Also returned are a number that is the same for ends whose paths meet, or fail at, the same, and the shortest
    stretch in metres. What it meets is left in `legs`.
    """
    near, far = polar(wedges, e, ends[0]), polar(wedges, e, ends[1])
    if not _is_free(wedges, e, near) or not _is_free(wedges, e, far):
        return False, 1, 0.0
    z = edge_point(near, far)
    if not 0.0 <= z < wedges.length[e]:
        return False, 2 + (z < 0.0), 0.0
    holds, num_left, met = wedges.holds[e], most, 0
    for i in range(2):
        leg, side = legs[i], sides[i]
        for c in range(3):
            leg.vertex[0, c] = wedges.start[e, c] + z * wedges.along[e, c]
        folds, folded = _fold_leg(facets, holds, side, ends[i], leg)
        if not folds:
            return False, 7 * folded + i + 4, 0.0
        num_left, crossed = _cross_leg(facets, holds, side, num_left - side.length, leg)
        met = (met * 8191 + folded) * 8191 + crossed
        if num_left < 0:
            return False, 7 * met + i + 4, 0.0
    shortest = min(_shortest_stretch(sides[0].length, legs[0]), _shortest_stretch(sides[1].length, legs[1]))
    return shortest >= MIN_SEGMENT_M, met, shortest
