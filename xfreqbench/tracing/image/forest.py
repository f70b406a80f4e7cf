"""Bounding-volume trees over the facets of a furnished room, for kernels that ask what a segment meets.

A median split keeps the boxes of small facets small only where none of them is large. So facets are sorted into
trees by their extent, a tree for each factor of eight: a wall and a leaf of a plant never share a box.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from xfreqbench.types import FloatArray, IntArray

FACETS_IN_A_LEAF = 4
EXTENT_RATIO = 8.0  # of the largest to the smallest facet in a tree


class Forest(NamedTuple):
    """Facets in the order of their leaves, and the boxes about them. (Q facets, N boxes, R trees)"""

    face: Float[
        FloatArray, "Q 12"
    ]  # normal n, n·x of its plane; u* and its offset, v* and its offset: u = x·u* − offset
    is_triangle: Bool[NDArray[np.bool_], "Q"]  # u + v ≤ 1 holds too
    is_opaque: Bool[NDArray[np.bool_], "Q"]
    plane: Int[IntArray, "Q"]
    box: Float[FloatArray, "N 6"]  # lowest corner, highest corner
    child: Int[IntArray, "N"]  # the first of its two boxes, or −1 for a leaf
    first: Int[IntArray, "N"]  # a leaf holds facets first:last
    last: Int[IntArray, "N"]
    root: Int[IntArray, "R"]


def plant(
    low_m: Float[FloatArray, "Q 3"], high_m: Float[FloatArray, "Q 3"]
) -> tuple[Int[IntArray, "Q"], tuple[FloatArray, IntArray, IntArray, IntArray, IntArray]]:
    """Order of facets by leaves, and `box` to `root` of a `Forest`, from each facet's own bounding box."""
    extent_m = np.maximum((high_m - low_m).max(axis=1, initial=0.0), 1e-9)
    size_class = np.floor(np.log(extent_m.max(initial=1e-9) / extent_m) / np.log(EXTENT_RATIO))
    orders, trees, num_facets, num_boxes = [np.zeros(0, np.int64)], [], 0, 0
    roots = []
    for size in np.unique(size_class):
        rows = np.flatnonzero(size_class == size)
        order, depth = _leaf_order(low_m[rows] + high_m[rows])
        order = rows[order]
        trees.append(_boxes(low_m[order], high_m[order], depth, num_facets, num_boxes))
        orders.append(order)
        roots.append(num_boxes)
        num_facets += len(rows)
        num_boxes += len(trees[-1][0])
    nothing = np.zeros((0, 6)), *[np.zeros(0, np.int64)] * 3
    box, child, first, last = (np.concatenate(column) for column in zip(nothing, *trees, strict=True))
    return np.concatenate(orders), (box, child, first, last, np.array(roots, dtype=np.int64))


def _leaf_order(centre: Float[FloatArray, "n 3"]) -> tuple[Int[IntArray, "n"], int]:
    """Order of facets by leaves of a tree that halves them along the widest axis, and the tree's depth."""
    number = len(centre)
    depth = max(0, int(np.ceil(np.log2(number / FACETS_IN_A_LEAF))))
    order = np.arange(number)
    for level in range(depth):
        bound = _bounds(number, level)
        node = np.repeat(np.arange(2**level), np.diff(bound))
        ordered = centre[order]
        span = np.maximum.reduceat(ordered, bound[:-1]) - np.minimum.reduceat(ordered, bound[:-1])
        along = ordered[np.arange(number), span.argmax(axis=1)[node]]
        order = order[np.lexsort((along, node))]
    return order, depth


def _bounds(number: int, level: int) -> Int[IntArray, "b"]:
    """Where each box of a level begins among so many facets, and the last ends."""
    return np.arange(2**level + 1) * number >> level


def _boxes(
    low_m: Float[FloatArray, "n 3"],
    high_m: Float[FloatArray, "n 3"],
    depth: int,
    num_facets: int,
    num_boxes: int,
) -> tuple[Float[FloatArray, "N 6"], Int[IntArray, "N"], Int[IntArray, "N"], Int[IntArray, "N"]]:
    """Boxes of one tree, level by level from its root, their children, and the facets of its leaves.

    Facets and boxes of trees before it count `num_facets` and `num_boxes`.
    """
    bound = _bounds(len(low_m), depth)
    level = np.hstack([np.minimum.reduceat(low_m, bound[:-1]), np.maximum.reduceat(high_m, bound[:-1])])
    levels = [level]
    for _ in range(depth):
        pairs = level.reshape(-1, 2, 6)
        level = np.hstack([pairs[:, :, :3].min(axis=1), pairs[:, :, 3:].max(axis=1)])
        levels.append(level)
    box = np.concatenate(levels[::-1])
    inner = len(box) - len(bound) + 1
    child = np.full(len(box), -1)
    child[:inner] = num_boxes + 2 * np.arange(inner) + 1
    first, last = np.zeros(len(box), np.int64), np.zeros(len(box), np.int64)
    first[inner:], last[inner:] = num_facets + bound[:-1], num_facets + bound[1:]
    return box, child, first, last
