"""Compiled kernels: over which planes a point sees each edge, and which part of it.

From the image of the point behind its last plane, the edge is seen through the facets of that plane, from the
image before that through the facets of the plane before, and so on. In homogeneous coordinates all of this is
linear along the edge, so what is left of it is found by clipping.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from .arrays import F64, FAR, I16, I64, Facets, Path, new_walk
from .bundles import EVERYWHERE, UNKNOWN, follow
from .compiled import bare, entry, part, whole, within
from .sequences import mirrored_offsets
from .tree import LONE, beyond_edges
from .wedges import Wedges, polar

Span = tuple[float, float]

MAX_SIDE_PLANES = 3  # on either side of the edge
NOTHING = (1.0, 0.0)
STEP_M, MAX_STEPS = 0.02, 2000  # in which is looked along an edge for what hides it
ROUNDING = 1e-9  # of a facet or an edge, by which what is seen is widened: the exact test comes later


class Reflectors(NamedTuple):
    """What is known of the planes that mirror, and of their facets, beside `Facets`. (P planes, Q facets)"""

    first: I64  # (P + 1,): facets of plane p are facet[first[p]:first[p + 1]]
    facet: I64  # (Q,)
    corner: F64  # (Q, 4, 3) of these facets: a triangle's last twice
    axis: F64  # (P, 2, 3) of each plane, at right angles in it
    box: F64  # (Q, 4) of these facets: lowest and highest place along the first axis of the plane, and along the second
    most: F64  # (F, P, L): largest factor of the field at a carrier where the angle's cosine is l/L or more


class Sides(NamedTuple):
    """How points at one end of a path see all edges, sorted by edge. (S sides, E edges)"""

    first: I64  # (E + 1,): sides of edge e are first[e]:first[e + 1], those that can weigh most first
    edge: I64  # (S,)
    length: I64  # (S,) number of planes
    plane: I16  # (S, MAX_SIDE_PLANES) in the order in which a wave from the end meets them
    image: F64  # (S, 3) of the end
    polar: F64  # (S, 3): the image's distance from the edge's line, place along it, and angle about it
    mirror: F64  # (S, 3, 3): what the planes make of an offset of the end
    span: F64  # (S, 2): the part of the edge that is seen, in metres from its start
    most: F64  # (S, F): bound of the factor of the field that the reflections make at each carrier


class Search(NamedTuple):
    """Where to look for sides, what is found, and work space. (O points, S sides that there is room for)"""

    facets: Facets
    mirrors: Reflectors
    wedges: Wedges
    ends: I64  # (E,): whether no points count at an edge, 0, those outside of its wedge, 1, or those inside too, 2
    found: Sides
    images: F64  # (O, MAX_SIDE_PLANES + 1, 3) of the points over the first planes of the sequence
    sequence: I64  # (MAX_SIDE_PLANES + 1,) planes
    work: F64  # (7, 3)


@part
def _clip(span: Span, first: float, last: float) -> Span:
    """The part of a span in which a linear function, given at 0 and 1, is not negative."""
    if first >= 0.0 and last >= 0.0:
        return span
    if first < 0.0 and last < 0.0:
        return NOTHING
    root = first / (first - last)
    return (max(span[0], root), span[1]) if first < 0.0 else (span[0], min(span[1], root))


@part
def _height(facets: Facets, p: int, x: F64, weight: float) -> float:
    """Height of a point above plane p times its weight; of weight 0 is a direction, which has a slope."""
    normal = facets.normal
    return normal[0, p] * x[0] + normal[1, p] * x[1] + normal[2, p] * x[2] - facets.offset[p] * weight


@part
def _share(dual: F64, x: F64, weight: float) -> float:
    """How far along a side of its facet a point is, in lengths of the side, times its weight."""
    return dual[0] * x[0] + dual[1] * x[1] + dual[2] * x[2] - dual[3] * weight


@part
def _extent(axis: F64, span: Span, point: F64, weight: F64) -> Span:
    """Lowest and highest place along an axis of the ends of a span, a little widened."""
    here = axis[0] * point[0, 0] + axis[1] * point[0, 1] + axis[2] * point[0, 2]
    there = axis[0] * point[1, 0] + axis[1] * point[1, 1] + axis[2] * point[1, 2]
    start = ((1.0 - span[0]) * here + span[0] * there) / ((1.0 - span[0]) * weight[0] + span[0] * weight[1])
    end = ((1.0 - span[1]) * here + span[1] * there) / ((1.0 - span[1]) * weight[0] + span[1] * weight[1])
    return min(start, end) - 1e-6, max(start, end) + 1e-6


@bare
def _seen_through(facets: Facets, mirrors: Reflectors, p: int, span: Span, point: F64, weight: F64) -> Span:
    """The part of a span whose points, in homogeneous coordinates at 0 and 1, lie in the facets of plane p."""
    low, high = NOTHING
    face, slack0, slack1 = facets.face, ROUNDING * weight[0], ROUNDING * weight[1]
    low_u, high_u = _extent(mirrors.axis[p, 0], span, point, weight)
    low_v, high_v = _extent(mirrors.axis[p, 1], span, point, weight)
    for i in range(mirrors.first[p], mirrors.first[p + 1]):
        if mirrors.box[i, 0] > high_u or mirrors.box[i, 1] < low_u:
            continue
        if mirrors.box[i, 2] > high_v or mirrors.box[i, 3] < low_v:
            continue
        q = mirrors.facet[i]
        dual_u, dual_v = face[q, 4:8], face[q, 8:12]
        u0, u1 = _share(dual_u, point[0], weight[0]), _share(dual_u, point[1], weight[1])
        v0, v1 = _share(dual_v, point[0], weight[0]), _share(dual_v, point[1], weight[1])
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
        there = _height(facets, p, image, 1.0)
        here0, here1 = _height(facets, p, point[0], weight[0]), _height(facets, p, point[1], weight[1])
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
            slope = _height(facets, p, way[i], 0.0)
            least = min(least, abs(slope))
            for c in range(3):
                way[i, c] -= 2.0 * slope * facets.normal[c, p]
        for f in range(most.shape[0]):
            most[f] *= mirrors.most[f, p, int(least * steps)]


@bare
def _can_follow(facets: Facets, mirrors: Reflectors, last: int, p: int, image: F64) -> bool:
    """Whether a wave that plane `last` reflects, as if from `image` behind it, could meet a facet of plane p."""
    there = _height(facets, last, image, 1.0)
    for q in range(mirrors.first[p], mirrors.first[p + 1]):
        for through in range(mirrors.first[last], mirrors.first[last + 1]):
            num_behind, beyond_all = 0, 31
            for i in range(4):
                x = mirrors.corner[q, i]
                gap = _height(facets, last, x, 1.0)
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
    gap = _height(facets, p, x, 1.0)
    for c in range(3):
        out[c] = x[c] - 2.0 * gap * facets.normal[c, p]


@bare
def _look(search: Search, n: int, num: int) -> int:
    """Add the edges that the points see over n planes to those found, `num` until now; how many there are then.

    Bounds are those of the first point that sees an edge. Those for which there is no room overwrite the last.
    """
    facets, mirrors, wedges, ends, found, images, sequence, work = search
    part_ends, way = work[3:5], work[5:7]
    for e in range(wedges.length.shape[0]):
        if ends[e] == 0:
            continue
        low, high, row = 2.0, -1.0, min(num, found.edge.shape[0] - 1)
        for o in range(images.shape[0]):
            image = images[o, n]
            if ends[e] == 1 and polar(wedges, e, image)[2] >= wedges.angle[e]:
                continue
            seen = _seen(facets, mirrors, wedges, e, sequence, n, images[o], work)
            if seen[0] > seen[1]:
                continue
            if low > high:
                for c in range(3):
                    for i in range(2):
                        part_ends[i, c] = wedges.start[e, c] + seen[i] * wedges.length[e] * wedges.along[e, c]
                _most(facets, mirrors, part_ends, sequence, n, image, way, found.most[row])
            low, high = min(low, seen[0]), max(high, seen[1])
        if low > high:
            continue
        num += 1
        found.edge[row], found.length[row] = e, n
        found.span[row, 0], found.span[row, 1] = low * wedges.length[e], high * wedges.length[e]
        for j in range(MAX_SIDE_PLANES):
            found.plane[row, j] = sequence[j] if j < n else -1
        for c in range(3):
            found.image[row, c] = images[0, n, c]
        distance, along, angle = polar(wedges, e, images[0, n])
        found.polar[row, 0], found.polar[row, 1], found.polar[row, 2] = distance, along, angle
        mirrored_offsets(facets, found.plane[row], n, found.mirror[row])
    return num


@bare
def _search(search: Search, max_planes: int) -> int:
    """Find all sides of the points over at most `max_planes` planes; how many there are, with room for them or not."""
    facets, mirrors, images, sequence = search.facets, search.mirrors, search.images, search.sequence
    level, num_points = 0, images.shape[0]
    none: Any = np.int64(0)  # no literal, as in later calls, so that it is compiled for one type
    num = _look(search, none, none)
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
        num = _look(search, level + 1, num)
        if level + 1 < max_planes:
            level += 1
            sequence[level] = -1
    return num


@whole
def _new_sides(num: int, num_carriers: int) -> Sides:
    return Sides(
        np.empty(0, np.int64),
        np.empty(num, np.int64),
        np.empty(num, np.int64),
        np.empty((num, MAX_SIDE_PLANES), np.int16),
        np.empty((num, 3)),
        np.empty((num, 3)),
        np.empty((num, 3, 3)),
        np.empty((num, 2)),
        np.empty((num, num_carriers)),
    )


@entry
def find_sides(facets: Facets, mirrors: Reflectors, wedges: Wedges, ends: I64, points: F64, max_planes: int) -> Sides:
    """How points (O, 3) that are close together see all edges over at most `max_planes` planes.

    Images are those of the first point; a part of an edge counts as seen where one of the points sees it. `ends` (E,)
    are those of `Search`.
    """
    images, sequence = np.empty((len(points), MAX_SIDE_PLANES + 1, 3)), np.full(MAX_SIDE_PLANES + 1, -1)
    images[:, 0] = points
    num, room = 4096, 0
    while num > room:  # the first time, and once more where there are more
        room = num
        found = _new_sides(room, mirrors.most.shape[0])
        search = Search(facets, mirrors, wedges, ends, found, images, sequence, np.empty((7, 3)))
        num = _search(search, max_planes)
    order = np.argsort(-found.most[:num, 0], kind="mergesort")
    order = order[np.argsort(found.edge[order], kind="mergesort")]
    edge = found.edge[order]
    return Sides(
        np.searchsorted(edge, np.arange(len(wedges.length) + 1)),
        edge,
        found.length[order],
        found.plane[order],
        found.image[order],
        found.polar[order],
        found.mirror[order],
        found.span[order],
        found.most[order],
    )


sides_of = within(find_sides)


@entry
def open_spans(facets: Facets, wedges: Wedges, sides: Sides, offset: F64, max_depth: int, first: int, last: int) -> F64:
    """The parts (n, 2) of their edges that sides `first` to `last` see past all facets, reversed where there is none.

    Points `STEP_M` apart, or `MAX_STEPS` of a long edge, are looked at from each offset (O, 3) of the end; what is open
    reaches a step farther.
    """
    walk, spans = new_walk(MAX_SIDE_PLANES, 1, 1, np.zeros(3)), np.empty((last - first, 2))
    for s in range(first, last):
        e, low, high = sides.edge[s], FAR, -FAR
        path = Path(sides.length[s], sides.plane[s], sides.image[s], sides.mirror[s])
        walk.limit[0] = max_depth - 1 - path.length
        for c in range(3):
            walk.edge[0, c] = wedges.start[e, c]
            walk.edge[1, c] = wedges.start[e, c] + wedges.length[e] * wedges.along[e, c]
        width = sides.span[s, 1] - sides.span[s, 0]
        number = min(1 + math.ceil(width / STEP_M), MAX_STEPS)
        for i in range(number + 1):
            z = sides.span[s, 0] + width * i / number
            for c in range(3):
                walk.start[0, c] = wedges.start[e, c] + z * wedges.along[e, c]
            for o in range(len(offset)):
                if follow(facets, path, offset[o : o + 1], UNKNOWN, LONE, walk)[0] == EVERYWHERE:
                    low, high = min(low, z), max(high, z)
                    break
        spans[s - first, 0] = max(sides.span[s, 0], low - width / number)
        spans[s - first, 1] = min(sides.span[s, 1], high + width / number)
    return spans
