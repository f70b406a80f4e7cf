"""Changes of a learned room that are tried: other slabs, edges and depths of its faces, or none of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from xfreqbench.methods.virtual_source.boxes import THICKNESSES
from xfreqbench.methods.virtual_source.materials import NamedSlab
from xfreqbench.methods.virtual_source.surfaces import NO_PLANE, RoomSurface
from xfreqbench.types import FloatArray

EDGES_M = (-0.2, -0.1, -0.05, 0.05, 0.1, 0.2)
_MIN_WIDTH_M = 0.1
_TO_WALL_M = 1.0  # an edge that is so near may reach the wall
_DEPTHS_M = (0.05, 0.1, 0.2, 0.3, 0.45, 0.6)
FINER_M = (-0.04, -0.02, -0.01, -0.005, -0.002, -0.001, 0.001, 0.002, 0.005, 0.01, 0.02, 0.04)
_THINNER = (1.0, 0.9, 0.8, 0.5)  # of sheets in front and behind that were learned as one
NEARLY = (0.96, 0.98, 0.99, 1.01, 1.02, 1.04)  # of thicknesses of walls
OTHERWISE = (*THICKNESSES, 0.9, 1.1)
_THICK_M = 0.05  # with more, all carriers tell of the front alone
_BACK_M = 0.15  # a plane that is found so little behind a face may be what is seen of its back

Room = list[RoomSurface]


def other_slabs(
    key: tuple[int, int], slabs: Sequence[NamedSlab], factors: Sequence[float], room: Room
) -> Iterator[Room]:
    """The room with another slab, or another thickness, in all parts of a plane that were found to be of one slab.

    The other slabs of the plane are among those that are tried.
    """
    own = next((each.slab for each in room if (each.plane, each.found_slab) == key), None)
    if own is None:
        return
    beside = {each.slab for each in room if each.plane == key[0]} - {own}
    for slab in [*slabs, *sorted(beside), *(own.thinned(factor) for factor in factors)]:
        yield [replace(each, slab=slab) if (each.plane, each.found_slab) == key else each for each in room]


def without(number: int, room: Room) -> Iterator[Room]:
    """The room without a face."""
    if any(each.number == number for each in room):
        yield [each for each in room if each.number != number]


def with_edges(number: int, steps_m: Sequence[float], room: Room) -> Iterator[Room]:
    """The room with one edge of a face moved."""
    walls = [each for each in room if each.is_wall]
    for own in room:
        if own.number == number:
            for changed in edged(own, walls, steps_m):
                yield [changed if each is own else each for each in room]


def with_depths(number: int, slabs: Sequence[NamedSlab], room: Room) -> Iterator[Room]:
    """The room with a face as the front of a box, or of a deeper one, in place of what was found just behind it.

    Two thin sheets that were learned as one are thinner than that.
    """
    walls = [each for each in room if each.is_wall]
    for own in room:
        if own.number == number and own.plane != NO_PLANE:
            others = [each for each in room if not _is_back(each, own)]
            for slab in slabs:
                is_thin = slab.thickness_m < _THICK_M and slab.material != "metal"
                for factor in _THINNER if is_thin else (1.0,):
                    sheet = replace(own, slab=slab.thinned(factor))
                    for depth_m in _DEPTHS_M:
                        box = sheet.with_depth(depth_m, walls)
                        yield [box if each is own else each for each in others]


def deeper(number: int, room: Room) -> Iterator[Room]:
    """The room with a box of another depth, or of another thickness."""
    walls = [each for each in room if each.is_wall]
    for own in room:
        if own.number == number and own.depth_m:
            changed = [
                own.with_depth(own.depth_m + by_m, walls) for by_m in FINER_M if own.depth_m + by_m > 0
            ]
            changed += [replace(own, slab=own.slab.thinned(factor)) for factor in THICKNESSES]
            for box in changed:
                yield [box if each is own else each for each in room]


def _is_back(other: RoomSurface, front: RoomSurface) -> bool:
    """Whether a face is parallel to another one, and little behind it."""
    behind_m = float((other.corners_m[0] - front.corners_m[0]) @ front.normal)
    return not other.is_wall and 0 < behind_m < _BACK_M and float(other.normal @ front.normal) > 0.999


def edged(own: RoomSurface, walls: Sequence[RoomSurface], by_m: Sequence[float]) -> Iterator[RoomSurface]:
    """The surface with one edge moved within its plane, up to a wall at most."""
    number = len(own.corners_m)
    for edge in range(number):
        ends = [edge, (edge + 1) % number]
        outward = own.outward[edge]
        room_m = _way_to_wall(own.corners_m[ends], outward, walls)
        size_m = np.ptp(own.corners_m @ outward)
        steps_m = {min(step_m, room_m) for step_m in by_m if size_m + step_m > _MIN_WIDTH_M}
        if room_m < _TO_WALL_M:
            steps_m.add(room_m)
        for step_m in sorted(steps_m - {0.0}):
            corners_m = own.corners_m.copy()
            corners_m[ends] += step_m * outward
            yield replace(own, corners_m=corners_m).with_depth(own.depth_m, walls)


def _way_to_wall(
    points_m: Float[FloatArray, "2 3"], outward: Float[FloatArray, "3"], walls: Sequence[RoomSurface]
) -> float:
    """How far points can go before one of them meets the plane of a wall; infinite without a wall there."""
    ways_m = [np.inf]
    for wall in walls:
        slope = float(wall.normal @ outward)
        if slope > 1e-3:
            ways_m += (((wall.corners_m[0] - points_m) @ wall.normal) / slope).clip(0).tolist()
    return min(ways_m)
