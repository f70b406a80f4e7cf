"""A closed room of six walls, and planes as a search finds them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from xfreqbench.baselines.virtual_source.search.planes import Plane

from xfreqbench.scene.model import ReceiverArray, Scene, Surface, TransmitterGrid

SIZE_M = (5.0, 4.0, 2.6)
SIDES = tuple(product(range(3), range(2)))  # axis, and whether the wall is at its upper end


def closed_room(receiver: ReceiverArray, slabs: Sequence[tuple[str, float]]) -> Scene:
    """The room, with a material and a thickness for the wall at each of `SIDES`."""
    surfaces = []
    for (axis, side), slab in zip(SIDES, slabs, strict=True):
        low, high = [0.0, 0.0, 0.0], list(SIZE_M)
        low[axis] = high[axis] = side * SIZE_M[axis]
        surfaces.append(Surface(f"wall {axis}{side}", *slab, (*low,), (*high,)))
    grid = TransmitterGrid((1.0, 1.0, 1.0), (2.0, 2.0, 2.0), (1.0, 1.0, 1.0))
    return Scene("box", receiver, grid, surface=tuple(surfaces))


def plane(normal: Sequence[float], distance_m: float) -> Plane:
    return Plane(np.array(normal, dtype=float), distance_m, 1e-4, 1e-4, 0.0)
