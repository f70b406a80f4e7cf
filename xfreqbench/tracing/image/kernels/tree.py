"""Kernels of the tree of boxes: what a ray, or a bundle of segments, meets in it, and how it is built.

Facets are divided by the surface-area heuristic.
"""

from __future__ import annotations

import numpy as np

from .arrays import F64, FAR, I64, Facets, Walk
from .compiled import bare, entry, part, whole

Bundle = tuple[int, ...]  # its paths
Span = tuple[float, float, float, float]
Tube = tuple[Span, Span, Span]  # see `tube_between`

# Paths that are followed side by side: one; those to the array's corners, which stand for all between them; and four
# with none between them. Numba compiles the loops for each length.
LONE, CORNERS, QUAD = (0,), (0, 1, 2, 3), (1, 1, 1, 1)

SLACK_M = 1e-9  # by which a tube is wider than its paths
NUM_BINS = 16  # between which a box may be divided along an axis


@part
def beyond_edges(facets: Facets, q: int, x: float, y: float, z: float) -> int:
    """Bit set of the edges of facet q that a point of its plane lies beyond; 0 means inside."""
    face = facets.face
    u = face[q, 4] * x + face[q, 5] * y + face[q, 6] * z - face[q, 7]
    v = face[q, 8] * x + face[q, 9] * y + face[q, 10] * z - face[q, 11]
    if facets.is_triangle[q]:
        return (u < 0.0) | (v < 0.0) << 1 | (u + v > 1.0) << 4
    return (u < 0.0) | (v < 0.0) << 1 | (u > 1.0) << 2 | (v > 1.0) << 3


@part
def side_of(face: F64, q: int, x: float, y: float, z: float) -> float:
    """Signed distance of a point from the plane of facet q."""
    return face[q, 0] * x + face[q, 1] * y + face[q, 2] * z - face[q, 3]


@part
def _inverse_of(d: float) -> float:
    """1 / d, and a large number where d is next to nothing."""
    return 1.0 / d if abs(d) > 1e-12 else 1e12


@part
def _extent(vertex: F64, v: int, a: int, bundle: Bundle) -> tuple[float, float]:
    """Lowest and highest coordinate a of vertex v of the paths of a bundle."""
    low = high = vertex[0, v, a]
    for k in range(1, len(bundle)):
        low, high = min(low, vertex[k, v, a]), max(high, vertex[k, v, a])
    return low, high


@part
def _span(vertex: F64, v: int, end: int, a: int, margin: float, bundle: Bundle) -> Span:
    (low, high), (low_end, high_end) = _extent(vertex, v, a, bundle), _extent(vertex, end, a, bundle)
    return low - margin, _inverse_of(low_end - low), high + margin, _inverse_of(high_end - high)


@part
def tube_between(vertex: F64, v: int, end: int, margin: float, bundle: Bundle) -> Tube:
    """The tube from vertex v to vertex `end` of all paths of a bundle, wider than they by a margin.

    For each axis it has the lowest and the highest coordinate at its start, each followed by the inverse of how much
    that grows along the tube. So at the share t of its length it is a box, of which each face moves evenly with t.
    """
    x, y = _span(vertex, v, end, 0, margin, bundle), _span(vertex, v, end, 1, margin, bundle)
    return x, y, _span(vertex, v, end, 2, margin, bundle)


@part
def _shared(low: float, high: float, span: Span, enters: float, leaves: float) -> tuple[float, float]:
    """The part of the stretch enters … leaves in which a tube's span meets that from low to high; reversed for none."""
    until, since = (high - span[0]) * span[1], (low - span[2]) * span[3]
    if span[1] > 0.0:
        leaves = min(leaves, until)
    else:
        enters = max(enters, until)
    if span[3] > 0.0:
        enters = max(enters, since)
    else:
        leaves = min(leaves, since)
    return enters, leaves


@part
def _entry(box: F64, b: int, tube: Tube, reach: float) -> float:
    """Where a tube enters a box, or `FAR` where it does not up to `reach`."""
    enters, leaves = _shared(box[b, 0], box[b, 3], tube[0], 0.0, reach)
    enters, leaves = _shared(box[b, 1], box[b, 4], tube[1], enters, leaves)
    enters, leaves = _shared(box[b, 2], box[b, 5], tube[2], enters, leaves)
    return enters if enters <= leaves else FAR


@part
def next_leaf(facets: Facets, tube: Tube, reach: float, walk: Walk, top: int) -> tuple[int, int]:
    """The next leaf on a tube's way, or −1, and the number of boxes that are then still to be looked into.

    With `top` −1 the search begins anew. Nearer boxes come first.
    """
    box, box_at = walk.box, walk.box_at
    if top < 0:
        top = 0
        if len(facets.box):
            box[0], box_at[0] = 0, _entry(facets.box, 0, tube, reach)
            top = 1
    while top > 0:
        top -= 1
        b = box[top]
        if box_at[top] > reach:
            continue
        near = facets.child[b]
        if near < 0:
            return top, b
        far = near + 1
        near_at = _entry(facets.box, near, tube, reach)
        far_at = _entry(facets.box, far, tube, reach)
        if far_at < near_at:
            near, far, near_at, far_at = far, near, far_at, near_at
        if far_at < FAR:
            box[top], box_at[top] = far, far_at
            top += 1
        if near_at < FAR:
            box[top], box_at[top] = near, near_at
            top += 1
    return 0, -1


@bare
def first_hit(facets: Facets, o: F64, d: F64, walk: Walk) -> tuple[int, float]:
    """Facet and distance of what a ray from o along d meets first; facet −1 where it meets nothing."""
    hit, nearest, top, face = -1, FAR, -1, facets.face
    ix, iy, iz, m = _inverse_of(d[0]), _inverse_of(d[1]), _inverse_of(d[2]), SLACK_M
    x, y, z = o[0], o[1], o[2]
    tube = (x - m, ix, x + m, ix), (y - m, iy, y + m, iy), (z - m, iz, z + m, iz)
    while True:
        top, leaf = next_leaf(facets, tube, nearest, walk, top)
        if leaf < 0:
            return hit, nearest
        for q in range(facets.first[leaf], facets.last[leaf]):
            speed = face[q, 0] * d[0] + face[q, 1] * d[1] + face[q, 2] * d[2]
            if speed == 0.0:
                continue
            t = -side_of(face, q, o[0], o[1], o[2]) / speed
            if t < 1e-7 or t >= nearest:
                continue
            x, y, z = o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]
            if beyond_edges(facets, q, x, y, z) == 0:
                hit, nearest = q, t


@bare
def _half_area(corner: F64) -> float:
    x, y, z = corner[3] - corner[0], corner[4] - corner[1], corner[5] - corner[2]
    return x * y + y * z + z * x


@bare
def _widen(box: F64, by: F64) -> None:
    for a in range(3):
        box[a], box[a + 3] = min(box[a], by[a]), max(box[a + 3], by[a + 3])


@whole
def _cheapest(facet: F64, order: I64, least: F64, most: F64) -> tuple[int, int, float]:
    """Axis and bin after which to divide facets, and the sum of number × area of both parts; axis −1 for none.

    Facets fall into bins by the middles of their boxes, which lie between `least` and `most` (3,).
    """
    axis, after, cheapest = -1, -1, FAR
    box, number = np.empty((NUM_BINS, 6)), np.empty(NUM_BINS, np.int64)
    behind, part = np.empty(NUM_BINS), np.empty(6)
    for a in range(3):
        if most[a] - least[a] < 1e-12:
            continue
        number[:] = 0
        box[:, :3], box[:, 3:] = FAR, -FAR
        scale = NUM_BINS / (most[a] - least[a])
        for q in order:
            b = min(NUM_BINS - 1, int((facet[q, a] + facet[q, a + 3] - least[a]) * scale))
            number[b] += 1
            _widen(box[b], facet[q])
        part[:3], part[3:] = FAR, -FAR
        num_behind, num_before = 0, 0
        for b in range(NUM_BINS - 1, 0, -1):
            num_behind += number[b]
            _widen(part, box[b])
            behind[b] = num_behind * _half_area(part) if num_behind else FAR
        part[:3], part[3:] = FAR, -FAR
        for b in range(NUM_BINS - 1):
            num_before += number[b]
            _widen(part, box[b])
            if num_before:
                cost = num_before * _half_area(part) + behind[b + 1]
                if cost < cheapest:
                    axis, after, cheapest = a, b, cost
    return axis, after, cheapest


@entry
def divide(facet: F64) -> tuple[I64, F64, I64, I64, I64]:
    """Order of facets (Q, 6), given by lowest and highest corner, and the boxes about them, as `Facets` has them."""
    num_facets, num_boxes = len(facet), 1
    order, parted = np.arange(num_facets), np.empty(num_facets, np.int64)
    box, child = np.empty((2 * num_facets, 6)), np.full(2 * num_facets, -1)
    first, last = np.zeros(2 * num_facets, np.int64), np.zeros(2 * num_facets, np.int64)
    level, left = np.zeros(2 * num_facets, np.int64), [0]
    last[0] = num_facets
    least, most = np.empty(3), np.empty(3)
    while left:
        b = left.pop()
        box[b, :3], box[b, 3:], least[:], most[:] = FAR, -FAR, FAR, -FAR
        for q in order[first[b] : last[b]]:
            _widen(box[b], facet[q])
            for a in range(3):
                middle = facet[q, a] + facet[q, a + 3]
                least[a], most[a] = min(least[a], middle), max(most[a], middle)
        number = last[b] - first[b]
        if number == 1:
            continue
        axis, after, cost = _cheapest(facet, order[first[b] : last[b]], least, most)
        # dividing a small leaf has to save 30 % of what looking at all of its facets costs
        if number <= 4 and cost >= 0.7 * number * _half_area(box[b]):
            continue
        middle = (first[b] + last[b]) // 2
        # below 64 levels boxes are halved by number, so that no chain of facets makes a deep tree
        if axis >= 0 and level[b] < 64:
            scale, num_behind, middle = NUM_BINS / (most[axis] - least[axis]), 0, first[b]
            for i in range(first[b], last[b]):
                q = order[i]
                if int((facet[q, axis] + facet[q, axis + 3] - least[axis]) * scale) <= after:
                    order[middle] = q
                    middle += 1
                else:
                    parted[num_behind] = q
                    num_behind += 1
            order[middle : last[b]] = parted[:num_behind]
        child[b] = num_boxes
        first[num_boxes], last[num_boxes] = first[b], middle
        first[num_boxes + 1], last[num_boxes + 1] = middle, last[b]
        level[num_boxes : num_boxes + 2] = level[b] + 1
        left.append(num_boxes + 1)
        left.append(num_boxes)
        num_boxes += 2
    return order, box[:num_boxes].copy(), child[:num_boxes], first[:num_boxes], last[:num_boxes]
