"""The tree of boxes over the facets of a furnished room, for kernels that ask what a segment meets.

A wall and a leaf of a plant stand in one tree: boxes are divided where the sum of number × area of their parts, what a
segment has to look into in the mean, is least (the surface-area heuristic).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from xfreqbench.tracing.image import growing_kernels
from xfreqbench.types import FloatArray, IntArray


class BoxTree(NamedTuple):
    """Facets in the order of their leaves, and the boxes about them, the first of which holds all. (Q, N boxes)"""

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


def grow(
    low_m: Float[FloatArray, "Q 3"], high_m: Float[FloatArray, "Q 3"]
) -> tuple[Int[IntArray, "Q"], tuple[FloatArray, IntArray, IntArray, IntArray]]:
    """Order of facets by leaves, and `box` to `last` of a `BoxTree`, from each facet's own bounding box."""
    if not len(low_m):
        nothing = np.zeros(0, np.int64)
        return nothing, (np.zeros((0, 6)), nothing, nothing, nothing)
    order, box, child, first, last = growing_kernels.divide(np.hstack([low_m, high_m]))
    return order, (box, child, first, last)
