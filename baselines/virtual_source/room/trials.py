"""Trials of a refinement: which changes of a room are compared, and how much better the best of them has to be."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from .changes import (
    EDGES_M,
    FINER_M,
    NEAR_EDGES_M,
    Room,
    deeper,
    other_slabs,
    with_depths,
    with_edges,
    without,
)
from .materials import NamedSlab
from .surfaces import RoomSurface

MIN_CHANGE = 3e-4  # of the mean SSIM, for which a surface is changed
_REPEATS = 4  # most changes of one kind of one face, one after another, where many may follow each other


class Trial(NamedTuple):
    """Changes of a room that are tried, and whether the lowest carriers judge too, to which a centimetre is little.

    `besides` are further changes that are tried together with the best of them. A change is kept that raises the mean
    SSIM by `least`; where it makes a room simpler, it has to be no worse.
    """

    changes: Callable[[Room], Iterator[Room]]
    at_lowest: bool = False
    besides: Callable[[Room], Iterator[Room]] | None = None
    least: float = MIN_CHANGE
    repeats: int = _REPEATS


def trials_of_face(
    own: RoomSurface, known: Sequence[NamedSlab], of_boxes: Sequence[NamedSlab]
) -> list[Trial]:
    """Trials of a face that may be of `known` slabs, or of others of which boxes are made.

    They are of its edges, of its depth, twice of edges again, and of the room without it.
    """
    others = [each for each in of_boxes if each.material not in {one.material for one in known}]
    slabs = known if known[0].material == "metal" else [*known, *others]  # nothing else becomes metal
    edges, finer, nearly = (
        partial(with_edges, own.number, steps_m) for steps_m in (EDGES_M, FINER_M, NEAR_EDGES_M)
    )
    return [
        Trial(edges, at_lowest=True),
        Trial(partial(with_depths, own.number, slabs), at_lowest=True, besides=nearly, repeats=1),
        Trial(partial(deeper, own.number)),
        Trial(edges),
        Trial(finer),
        Trial(partial(without, own.number), least=0.0),
    ]


def trials_of_slabs(
    known: Mapping[tuple[int, int], Sequence[NamedSlab]], factors: Sequence[float], *, at_lowest: bool = False
) -> list[Trial]:
    """Trials of other slabs, and of other thicknesses, for each slab of a plane that was found."""
    return [Trial(partial(other_slabs, *each, factors), at_lowest) for each in known.items()]
