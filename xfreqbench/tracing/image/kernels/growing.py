"""The kernel that divides facets into a tree of boxes by the surface-area heuristic."""

from __future__ import annotations

import numpy as np

from xfreqbench.tracing.image.kernels.arrays import F64, FAR, I64
from xfreqbench.tracing.image.kernels.compiled import bare, entry, whole

NUM_BINS = 16  # between which a box may be divided along an axis
FACETS_IN_A_LEAF = 4  # at most, where dividing does not pay
MAX_SAH_LEVELS = 64  # below them boxes are halved by number, so that no chain of facets makes a deep tree
WORTH_DIVIDING = 0.7  # at most so much of what looking at all facets of a small leaf costs


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
        if number <= FACETS_IN_A_LEAF and cost >= WORTH_DIVIDING * number * _half_area(box[b]):
            continue
        middle = (first[b] + last[b]) // 2
        if axis >= 0 and level[b] < MAX_SAH_LEVELS:
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
