"""Rectangles of another slab in walls, such as doors and windows: their sides moved, with the wall around them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, count

import numpy as np
from scipy.spatial import ConvexHull

from .changes import Room, edged
from .polygons import tidied, without
from .surfaces import LEAST_AREA_M2, RoomSurface

_FIRST_PIECE = 1000  # number of the first piece of a wall that was none before
_STEPS_M = (-0.3, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.3)


def without_patches(plane: int, room: Room) -> Iterator[Room]:
    """The room with a rectangle, or all of them, of the slab of most of the wall around it."""
    patches, rest = _patches(plane, room)
    each_alone = [[each] for each in patches]
    for gone in [patches, *each_alone] if len(patches) > 1 else each_alone:
        slab, found = rest[0].slab, rest[0].found_slab
        yield [replace(each, slab=slab, found_slab=found) if each in gone else each for each in room]


def with_patches(plane: int, room: Room) -> Iterator[Room]:
    """The room with one side of a rectangle moved that is of another slab than most of the wall around it."""
    walls = [each for each in room if each.is_wall]
    patches, rest = _patches(plane, room)
    tiles = [*patches, *rest]
    first = max(_FIRST_PIECE, *(1 + each.number for each in room))
    for own in patches:
        for changed in edged(own, walls, _STEPS_M):
            others = [changed if each is own else each for each in patches]
            if pieces := _around(tiles, others, rest, first):
                yield [*(each for each in room if each not in tiles), *others, *pieces]


def _patches(plane: int, room: Room) -> tuple[list[RoomSurface], list[RoomSurface]]:
    """The parts of a wall that are of another slab than most of it, and the others."""
    tiles = [each for each in room if each.is_wall and each.plane == plane]
    main = max(tiles, key=lambda each: sum(one.area_m2 for one in tiles if one.slab == each.slab)).slab
    return [each for each in tiles if each.slab != main], [each for each in tiles if each.slab == main]


def _around(
    tiles: Sequence[RoomSurface], patches: Sequence[RoomSurface], rest: Sequence[RoomSurface], first: int
) -> list[RoomSurface]:
    """The pieces of a wall around its patches, in place of what was the rest of it; none where patches overlap.

    The wall is what all its tiles cover. Pieces that are more than before are numbered from `first` on.
    """
    own = patches[0]
    axes = np.stack([own.outward[0], np.cross(own.normal, own.outward[0])])
    places, holes = ([(each.corners_m - own.corners_m[0]) @ axes.T for each in of] for of in (tiles, patches))
    whole = ConvexHull(np.concatenate(places))
    left = [tidied(whole.points[whole.vertices])]
    for place_m in holes:
        hole_m = place_m[ConvexHull(place_m).vertices]  # in turn to the left
        left = [tidied(piece_m) for each in left for piece_m in without(each, hole_m)]
    numbers = chain((each.number for each in rest), count(first))
    pieces = [
        replace(rest[0], number=number, corners_m=own.corners_m[0] + each @ axes)
        for number, each in zip(numbers, left, strict=False)
    ]
    is_whole = abs(sum(each.area_m2 for each in (*patches, *pieces)) - whole.volume) < LEAST_AREA_M2
    return [each for each in pieces if each.area_m2 > LEAST_AREA_M2] if is_whole else []
