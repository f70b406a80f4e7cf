"""Compiled kernels: over which planes a point sees each edge, and which part of it.

From the image of the point behind its last plane, the edge is seen through the facets of that plane, from the
image before that through the facets of the plane before, and so on. In homogeneous coordinates all of this is
linear along the edge, so what is left of it is found by clipping. These kernels are not cached: they become part
of those of `diffraction_kernels`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xfreqbench.tracing.image.edge_path_kernels import MAX_SIDE_PLANES, polar
from xfreqbench.tracing.image.kernels import F64, I64, Facets, _beyond
from xfreqbench.tracing.image.wedge_kernels import Wedges, inner

I16 = NDArray[np.int16]
Span = tuple[float, float]

NOTHING = (1.0, 0.0)
ROUNDING = 1e-9  # of a facet or an edge, by which what is seen is widened: the exact test comes later


class Reflectors(NamedTuple):
    """What is known of reflecting facets and planes beside `Facets`. (Q facets, P planes)"""

    corner: F64  # (Q, 4, 3): a triangle's last twice
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


@inner
def _clip(span: Span, first: float, last: float) -> Span:
    """The part of a span in which a linear function, given at 0 and 1, is not negative."""
    if first >= 0.0 and last >= 0.0:
        return span
    if first < 0.0 and last < 0.0:
        return NOTHING
    root = first / (first - last)
    return (max(span[0], root), span[1]) if first < 0.0 else (span[0], min(span[1], root))


@inner
def _seen_through(facets: Facets, p: int, span: Span, point: F64, weight: F64) -> Span:
    """The part of a span whose points, in homogeneous coordinates at 0 and 1, lie in the facets of plane p."""
    low, high = NOTHING
    for q in range(facets.first[p], facets.first[p + 1]):
        u0 = u1 = v0 = v1 = 0.0
        for c in range(3):
            gap0 = point[0, c] - weight[0] * facets.origin[q, c]
            gap1 = point[1, c] - weight[1] * facets.origin[q, c]
            u0 += gap0 * facets.along_u[q, c]
            u1 += gap1 * facets.along_u[q, c]
            v0 += gap0 * facets.along_v[q, c]
            v1 += gap1 * facets.along_v[q, c]
        slack0, slack1 = ROUNDING * weight[0], ROUNDING * weight[1]
        seen = _clip(_clip(span, u0 + slack0, u1 + slack1), v0 + slack0, v1 + slack1)
        if facets.is_triangle[q]:
            seen = _clip(seen, weight[0] - u0 - v0 + slack0, weight[1] - u1 - v1 + slack1)
        else:
            seen = _clip(seen, weight[0] - u0 + slack0, weight[1] - u1 + slack1)
            seen = _clip(seen, weight[0] - v0 + slack0, weight[1] - v1 + slack1)
        if seen[0] <= seen[1]:
            low, high = min(low, seen[0]), max(high, seen[1])
    return low, high


@inner
def _seen(facets: Facets, wedges: Wedges, e: int, sequence: I64, n: int, images: F64, work: F64) -> Span:
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
        span = _seen_through(facets, p, span, point, weight)
        if span[0] > span[1]:
            return NOTHING
    return span


@inner
def _most(
    facets: Facets, mirrors: Reflectors, ends: F64, sequence: I64, n: int, image: F64, most: F64
) -> None:
    """Bound, at each carrier, of the factor of the field that n reflections make from a part of an edge to a point.

    `ends` (2, 3) are those of the part; between them no angle of incidence is wider. The bounds are written to
    `most` (F,).
    """
    way, steps = np.empty((2, 3)), mirrors.most.shape[2] - 1
    most[:] = 1.0
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


@inner
def _can_follow(facets: Facets, mirrors: Reflectors, last: int, p: int, image: F64) -> bool:
    """Whether a wave that plane `last` reflects, as if from `image` behind it, could meet a facet of plane p."""
    there = -facets.offset[last]
    for c in range(3):
        there += facets.normal[c, last] * image[c]
    for q in range(facets.first[p], facets.first[p + 1]):
        for mirror in range(facets.first[last], facets.first[last + 1]):
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
                beyond_all &= _beyond(facets, mirror, x[0] + t * y0, x[1] + t * y1, x[2] + t * y2)
            if 0 < num_behind < 4 or (num_behind == 0 and beyond_all == 0):
                return True
    return False


@inner
def _mirrored(facets: Facets, p: int, x: F64, out: F64) -> None:
    """The image of a point behind plane p."""
    gap = -facets.offset[p]
    for c in range(3):
        gap += facets.normal[c, p] * x[c]
    for c in range(3):
        out[c] = x[c] - 2.0 * gap * facets.normal[c, p]


@inner
def _look(
    facets: Facets,
    mirrors: Reflectors,
    wedges: Wedges,
    sequence: I64,
    n: int,
    images: F64,
    found: Found,
    num: int,
) -> int:
    """Add to `found`, which holds `num`, the edges that points see over n planes; images (O, n + 1, 3) are theirs.

    Bounds are those of the first point that sees an edge.
    """
    work, ends, most = np.empty((3, 3)), np.empty((2, 3)), np.empty(mirrors.most.shape[0])
    for e in range(wedges.length.shape[0]):
        low, high = 2.0, -1.0
        for o in range(images.shape[0]):
            image = images[o, n]
            seen = _seen(facets, wedges, e, sequence, n, images[o], work)
            if seen[0] > seen[1] or polar(wedges, e, image)[2] >= wedges.angle[e]:
                continue
            if low > high:
                for c in range(3):
                    for i in range(2):
                        ends[i, c] = wedges.start[e, c] + seen[i] * wedges.length[e] * wedges.along[e, c]
                _most(facets, mirrors, ends, sequence, n, image, most)
            low, high = min(low, seen[0]), max(high, seen[1])
        if low > high:
            continue
        if num < found.edge.shape[0]:
            found.edge[num], found.length[num] = e, n
            found.most[num] = most
            found.span[num, 0], found.span[num, 1] = low * wedges.length[e], high * wedges.length[e]
            for j in range(MAX_SIDE_PLANES):
                found.plane[num, j] = sequence[j] if j < n else -1
        num += 1
    return num


@inner
def _search(
    facets: Facets, mirrors: Reflectors, wedges: Wedges, points: F64, max_planes: int, found: Found
) -> int:
    """Find all sides of `points` (O, 3) over at most `max_planes` planes; how many there are, kept or not."""
    images = np.empty((points.shape[0], MAX_SIDE_PLANES + 1, 3))
    for o in range(points.shape[0]):
        for c in range(3):
            images[o, 0, c] = points[o, c]
    sequence, level = np.full(MAX_SIDE_PLANES + 1, -1), 0
    none: Any = np.int64(0)  # no literal, as in later calls, so that it is compiled for one type
    num = _look(facets, mirrors, wedges, sequence, none, images, found, none)
    while level >= 0 and max_planes > 0:
        sequence[level] += 1
        p = sequence[level]
        if p == facets.offset.shape[0]:
            level -= 1
            continue
        if level > 0:
            last = sequence[level - 1]
            follows = False
            for o in range(points.shape[0]):
                follows |= p != last and _can_follow(facets, mirrors, last, p, images[o, level])
            if not follows:
                continue
        for o in range(points.shape[0]):
            _mirrored(facets, p, images[o, level], images[o, level + 1])
        num = _look(facets, mirrors, wedges, sequence, level + 1, images, found, num)
        if level + 1 < max_planes:
            level += 1
            sequence[level] = -1
    return num


@inner
def _new_found(capacity: int, num_carriers: int) -> Found:
    return Found(
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
        np.empty((capacity, MAX_SIDE_PLANES), np.int16),
        np.empty((capacity, 2)),
        np.empty((capacity, num_carriers)),
    )


@inner
def _ordered(found: Found, num: int, first: I64) -> I64:
    """Rows of `found` by edge, those that can weigh most first; `first` (E + 1,) of zeros gets where edges begin.

    What counts is the weight at the lowest carrier.
    """
    for i in range(num):
        first[found.edge[i] + 1] += 1
    for e in range(len(first) - 1):
        first[e + 1] += first[e]
    order, end = np.empty(num, np.int64), first.copy()
    for i in range(num):
        e = found.edge[i]
        at = end[e]
        while at > first[e] and found.most[order[at - 1], 0] < found.most[i, 0]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = i
        end[e] += 1
    return order


@inner
def find_sides(facets: Facets, mirrors: Reflectors, wedges: Wedges, points: F64, max_planes: int) -> Sides:
    """How points (O, 3) that are close together see all edges over at most `max_planes` planes.

    Images are those of the first point; a part of an edge counts as seen where one of the points sees it.
    """
    num_carriers = mirrors.most.shape[0]
    found = _new_found(4096, num_carriers)
    num = _search(facets, mirrors, wedges, points, max_planes, found)
    if num > len(found.edge):
        found = _new_found(num, num_carriers)
        _search(facets, mirrors, wedges, points, max_planes, found)
    sides = Sides(
        np.zeros(len(wedges.length) + 1, np.int64),
        np.empty(num, np.int64),
        np.empty((num, MAX_SIDE_PLANES), np.int16),
        np.empty((num, 3)),
        np.empty((num, 3)),
        np.zeros((num, 3, 3)),
        np.empty((num, 2)),
        np.empty((num, num_carriers)),
    )
    order = _ordered(found, num, sides.first)
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
