"""Compiled kernels: over which planes a point sees each edge, and which part of it.

From the image of the point behind its last plane, the edge is seen through the facets of that plane, from the
image before that through the facets of the plane before, and so on. In homogeneous coordinates all of this is
linear along the edge, so what is left of it is found by clipping.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from xfreqbench.tracing.image.kernels.arrays import F64, I16, I64, Facets
from xfreqbench.tracing.image.kernels.compiled import bare, entry, part, whole
from xfreqbench.tracing.image.kernels.tree import beyond_edges
from xfreqbench.tracing.image.kernels.wedges import Wedges, polar

Span = tuple[float, float]

MAX_SIDE_PLANES = 3  # on either side of the edge
NOTHING = (1.0, 0.0)
ROUNDING = 1e-9  # of a facet or an edge, by which what is seen is widened: the exact test comes later


class Reflectors(NamedTuple):
    """What is known of the planes that mirror, and of their facets, beside `Facets`. (P planes, Q facets)"""

    first: I64  # (P + 1,): facets of plane p are facet[first[p]:first[p + 1]]
    facet: I64  # (Q,)
    corner: F64  # (Q, 4, 3) of these facets: a triangle's last twice
    most: F64  # (F, P, L): largest factor of the field at a carrier where the angle's cosine is l/L or more


class Sides(NamedTuple):
    """How points at one end of a path see all edges, sorted by edge. (S sides, E edges)"""

    first: I64  # (E + 1,): sides of edge e are first[e]:first[e + 1], those that can weigh most first
    length: I64  # (S,) number of planes
    plane: I16  # (S, MAX_SIDE_PLANES) in the order in which a wave from the end meets them
    image: F64  # (S, 3) of the end
    polar: F64  # (S, 3): the image's distance from the edge's line, place along it, and angle about it
    mirror: F64  # (S, 3, 3): what the planes make of an offset of the end
    span: F64  # (S, 2): the part of the edge that is seen, in metres from its start
    most: F64  # (S, F): bound of the factor of the field that the reflections make at each carrier


class Found(NamedTuple):
    """Sides as they are found, in arrays that are longer than needed."""

    edge: I64
    length: I64
    plane: I16
    span: F64
    most: F64


@part
def _clip(span: Span, first: float, last: float) -> Span:
    """The part of a span in which a linear function, given at 0 and 1, is not negative."""
    if first >= 0.0 and last >= 0.0:
        return span
    if first < 0.0 and last < 0.0:
        return NOTHING
    root = first / (first - last)
    return (max(span[0], root), span[1]) if first < 0.0 else (span[0], min(span[1], root))


@bare
def _seen_through(facets: Facets, mirrors: Reflectors, p: int, span: Span, point: F64, weight: F64) -> Span:
    """The part of a span whose points, in homogeneous coordinates at 0 and 1, lie in the facets of plane p."""
    low, high = NOTHING
    face, slack0, slack1 = facets.face, ROUNDING * weight[0], ROUNDING * weight[1]
    for i in range(mirrors.first[p], mirrors.first[p + 1]):
        q = mirrors.facet[i]
        u0, u1 = -face[q, 7] * weight[0], -face[q, 7] * weight[1]
        v0, v1 = -face[q, 11] * weight[0], -face[q, 11] * weight[1]
        for c in range(3):
            u0 += point[0, c] * face[q, 4 + c]
            u1 += point[1, c] * face[q, 4 + c]
            v0 += point[0, c] * face[q, 8 + c]
            v1 += point[1, c] * face[q, 8 + c]
        seen = _clip(_clip(span, u0 + slack0, u1 + slack1), v0 + slack0, v1 + slack1)
        if facets.is_triangle[q]:
            seen = _clip(seen, weight[0] - u0 - v0 + slack0, weight[1] - u1 - v1 + slack1)
        else:
            seen = _clip(seen, weight[0] - u0 + slack0, weight[1] - u1 + slack1)
            seen = _clip(seen, weight[0] - v0 + slack0, weight[1] - v1 + slack1)
        if seen[0] <= seen[1]:
            low, high = min(low, seen[0]), max(high, seen[1])
    return low, high


@bare
def _seen(
    facets: Facets, mirrors: Reflectors, wedges: Wedges, e: int, sequence: I64, n: int, images: F64, work: F64
) -> Span:
    """The part of edge e, between 0 and 1, that a point sees over n planes; `images` (n + 1, 3) holds its images."""
    point, weight, span = work[:2], work[2], (-ROUNDING, 1.0 + ROUNDING)
    weight[0] = weight[1] = 1.0
    for c in range(3):
        point[0, c] = wedges.start[e, c]
        point[1, c] = wedges.start[e, c] + wedges.length[e] * wedges.along[e, c]
    for j in range(n - 1, -1, -1):
        p, image = sequence[j], images[j + 1]
        there = here0 = here1 = 0.0
        for c in range(3):
            there += facets.normal[c, p] * image[c]
            here0 += facets.normal[c, p] * point[0, c]
            here1 += facets.normal[c, p] * point[1, c]
        there -= facets.offset[p]
        here0 -= facets.offset[p] * weight[0]
        here1 -= facets.offset[p] * weight[1]
        if there > 0.0:
            here0, here1 = -here0, -here1
        there = abs(there)
        span = _clip(span, here0, here1)
        if span[0] > span[1]:
            return NOTHING
        for c in range(3):
            point[0, c] = there * point[0, c] + here0 * image[c]
            point[1, c] = there * point[1, c] + here1 * image[c]
        weight[0], weight[1] = there * weight[0] + here0, there * weight[1] + here1
        span = _seen_through(facets, mirrors, p, span, point, weight)
        if span[0] > span[1]:
            return NOTHING
    return span


@bare
def _most(
    facets: Facets, mirrors: Reflectors, ends: F64, sequence: I64, n: int, image: F64, way: F64, most: F64
) -> None:
    """Bound, at each carrier, of the factor of the field that n reflections make from a part of an edge to a point.

    `ends` (2, 3) are those of the part; between them no angle of incidence is wider. The bounds are written to
    `most` (F,); `way` (2, 3) is work space.
    """
    steps = mirrors.most.shape[2] - 1
    for f in range(most.shape[0]):
        most[f] = 1.0
    for i in range(2):
        length = 0.0
        for c in range(3):
            way[i, c] = image[c] - ends[i, c]
            length += way[i, c] ** 2
        for c in range(3):
            way[i, c] /= math.sqrt(length)
    for j in range(n - 1, -1, -1):
        p, least = sequence[j], 1.0
        for i in range(2):
            slope = 0.0
            for c in range(3):
                slope += facets.normal[c, p] * way[i, c]
            least = min(least, abs(slope))
            for c in range(3):
                way[i, c] -= 2.0 * slope * facets.normal[c, p]
        for f in range(most.shape[0]):
            most[f] *= mirrors.most[f, p, int(least * steps)]


@bare
def _can_follow(facets: Facets, mirrors: Reflectors, last: int, p: int, image: F64) -> bool:
    """Whether a wave that plane `last` reflects, as if from `image` behind it, could meet a facet of plane p."""
    there = -facets.offset[last]
    for c in range(3):
        there += facets.normal[c, last] * image[c]
    for q in range(mirrors.first[p], mirrors.first[p + 1]):
        for through in range(mirrors.first[last], mirrors.first[last + 1]):
            num_behind, beyond_all = 0, 31
            for i in range(4):
                x, gap = mirrors.corner[q, i], -facets.offset[last]
                for c in range(3):
                    gap += facets.normal[c, last] * x[c]
                if gap * there >= 0.0:
                    num_behind += 1
                    continue
                t = gap / (gap - there)
                y0, y1, y2 = image[0] - x[0], image[1] - x[1], image[2] - x[2]
                y = x[0] + t * y0, x[1] + t * y1, x[2] + t * y2
                beyond_all &= beyond_edges(facets, mirrors.facet[through], *y)
            if 0 < num_behind < 4 or (num_behind == 0 and beyond_all == 0):
                return True
    return False


@bare
def _mirrored(facets: Facets, p: int, x: F64, out: F64) -> None:
    """The image of a point behind plane p."""
    gap = -facets.offset[p]
    for c in range(3):
        gap += facets.normal[c, p] * x[c]
    for c in range(3):
        out[c] = x[c] - 2.0 * gap * facets.normal[c, p]


@bare
def _look(
    facets: Facets,
    mirrors: Reflectors,
    wedges: Wedges,
    sequence: I64,
    n: int,
    images: F64,
    work: F64,
    most: F64,
    found: Found,
    num: int,
) -> int:
    """Add to `found`, which holds `num`, the edges that points see over n planes; images (O, n + 1, 3) are theirs.

    Bounds are those of the first point that sees an edge. `work` (7, 3) and `most` (F,) are work space.
    """
    ends, way = work[3:5], work[5:7]
    for e in range(wedges.length.shape[0]):
        low, high = 2.0, -1.0
        for o in range(images.shape[0]):
            image = images[o, n]
            seen = _seen(facets, mirrors, wedges, e, sequence, n, images[o], work)
            if seen[0] > seen[1] or polar(wedges, e, image)[2] >= wedges.angle[e]:
                continue
            if low > high:
                for c in range(3):
                    for i in range(2):
                        ends[i, c] = wedges.start[e, c] + seen[i] * wedges.length[e] * wedges.along[e, c]
                _most(facets, mirrors, ends, sequence, n, image, way, most)
            low, high = min(low, seen[0]), max(high, seen[1])
        if low > high:
            continue
        if num < found.edge.shape[0]:
            found.edge[num], found.length[num] = e, n
            for f in range(most.shape[0]):
                found.most[num, f] = most[f]
            found.span[num, 0], found.span[num, 1] = low * wedges.length[e], high * wedges.length[e]
            for j in range(MAX_SIDE_PLANES):
                found.plane[num, j] = sequence[j] if j < n else -1
        num += 1
    return num


@bare
def _search(
    facets: Facets,
    mirrors: Reflectors,
    wedges: Wedges,
    max_planes: int,
    images: F64,
    sequence: I64,
    work: F64,
    most: F64,
    found: Found,
) -> int:
    """Find all sides of the points images[:, 0] over at most `max_planes` planes; how many there are, kept or not.

    `images` (O, MAX_SIDE_PLANES + 1, 3) and `sequence` (MAX_SIDE_PLANES + 1,) are otherwise work space.
    """
    level, num_points = 0, images.shape[0]
    none: Any = np.int64(0)  # no literal, as in later calls, so that it is compiled for one type
    num = _look(facets, mirrors, wedges, sequence, none, images, work, most, found, none)
    sequence[0] = -1
    while level >= 0 and max_planes > 0:
        sequence[level] += 1
        p = sequence[level]
        if p == mirrors.most.shape[1]:
            level -= 1
            continue
        if level > 0:
            last = sequence[level - 1]
            follows = False
            for o in range(num_points):
                follows |= p != last and _can_follow(facets, mirrors, last, p, images[o, level])
            if not follows:
                continue
        for o in range(num_points):
            _mirrored(facets, p, images[o, level], images[o, level + 1])
        num = _look(facets, mirrors, wedges, sequence, level + 1, images, work, most, found, num)
        if level + 1 < max_planes:
            level += 1
            sequence[level] = -1
    return num


@whole
def _new_found(capacity: int, num_carriers: int) -> Found:
    return Found(
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
        np.empty((capacity, MAX_SIDE_PLANES), np.int16),
        np.empty((capacity, 2)),
        np.empty((capacity, num_carriers)),
    )


@bare
def _order(found: Found, num: int, first: I64, end: I64, order: I64) -> None:
    """Write rows of `found` by edge to `order`, those that can weigh most at the lowest carrier first.

    `first` (E + 1,) of zeros gets where edges begin; `end` (E,) is work space.
    """
    for i in range(num):
        first[found.edge[i] + 1] += 1
    for e in range(len(first) - 1):
        first[e + 1] += first[e]
    for e in range(len(first) - 1):
        end[e] = first[e]
    for i in range(num):
        e = found.edge[i]
        at = end[e]
        while at > first[e] and found.most[order[at - 1], 0] < found.most[i, 0]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = i
        end[e] += 1


@entry
def find_sides(facets: Facets, mirrors: Reflectors, wedges: Wedges, points: F64, max_planes: int) -> Sides:
    """How points (O, 3) that are close together see all edges over at most `max_planes` planes.

    Images are those of the first point; a part of an edge counts as seen where one of the points sees it.
    """
    num_carriers, num_edges = mirrors.most.shape[0], len(wedges.length)
    images, sequence = np.empty((len(points), MAX_SIDE_PLANES + 1, 3)), np.full(MAX_SIDE_PLANES + 1, -1)
    images[:, 0] = points
    work, most, found = np.empty((7, 3)), np.empty(num_carriers), _new_found(4096, num_carriers)
    num = _search(facets, mirrors, wedges, max_planes, images, sequence, work, most, found)
    if num > len(found.edge):
        found = _new_found(num, num_carriers)
        _search(facets, mirrors, wedges, max_planes, images, sequence, work, most, found)
    sides = Sides(
        np.zeros(num_edges + 1, np.int64),
        np.empty(num, np.int64),
        np.empty((num, MAX_SIDE_PLANES), np.int16),
        np.empty((num, 3)),
        np.empty((num, 3)),
        np.zeros((num, 3, 3)),
        np.empty((num, 2)),
        np.empty((num, num_carriers)),
    )
    order = np.empty(num, np.int64)
    _order(found, num, sides.first, np.empty(num_edges, np.int64), order)
    for i in range(num):
        s = order[i]
        sides.length[i] = found.length[s]
        sides.most[i] = found.most[s]
        sides.span[i, 0], sides.span[i, 1] = found.span[s, 0], found.span[s, 1]
        image, mirror = sides.image[i], sides.mirror[i]
        for c in range(3):
            sides.plane[i, c], image[c], mirror[c, c] = found.plane[s, c], points[0, c], 1.0
        for j in range(found.length[s]):
            p = found.plane[s, j]
            _mirrored(facets, p, image, image)
            for b in range(3):
                slope = 0.0
                for c in range(3):
                    slope += facets.normal[c, p] * mirror[c, b]
                for c in range(3):
                    mirror[c, b] -= 2.0 * slope * facets.normal[c, p]
        sides.polar[i, 0], sides.polar[i, 1], sides.polar[i, 2] = polar(wedges, found.edge[s], image)
    return sides
