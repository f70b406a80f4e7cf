"""Changes of a learned room that are tried: other slabs, edges and depths of its faces, or a room without them.

`Trial` is a kind of change, and how much better the best of its rooms has to be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, count, product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from xfreqbench.types import FloatArray

from ..search.planes import Vector
from .boxes import THICKNESSES
from .faces import cut_out, tidied
from .surfaces import LEAST_AREA_M2, NO_PLANE, NamedSlab, RoomSurface, Surfaces

EDGES_M = (-0.2, -0.1, -0.05, 0.05, 0.1, 0.2)
NEAR_EDGES_M = (-0.05, 0.05)  # a front that ends so far off hides other paths, and no depth is right then
_PARALLEL = 0.999  # cosine between normals, or between the directions in which two edges point
_SAME_END_M = 0.05  # edges that are so near each other end at the same place
_SAME_PLANE_M = 1e-3
_MIN_WIDTH_M = 0.1
_DEPTHS_M = (0.05, 0.1, 0.2, 0.3, 0.45, 0.6)
FINER_M = (-0.04, -0.02, -0.01, -0.005, -0.002, -0.001, 0.001, 0.002, 0.005, 0.01, 0.02, 0.04)
_THINNER = (1.0, 0.9, 0.8, 0.5)  # of sheets in front and behind that were learned as one
NEARLY = (0.96, 0.98, 0.99, 1.01, 1.02, 1.04)  # of thicknesses of walls
OTHERWISE = (*THICKNESSES, 0.9, 1.1)
_THICK_M = 0.05  # of a thicker slab all carriers see the front alone
_BACK_M = 0.15  # a plane that is found so little behind a face may be what is seen of its back

Room = list[RoomSurface]
_FIRST_PIECE = 1000  # number of the first new piece of a wall, at least
_STEPS_M = (-0.3, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.3)
MIN_CHANGE = 3e-4  # of the mean SSIM, for which a surface is changed
_REPEATS = 4  # most changes of one kind of one face, one after another


def other_slabs(
    key: tuple[int, int], slabs: Sequence[NamedSlab], factors: Sequence[float], room: Room
) -> Iterator[Room]:
    """The room with other slabs in all parts of a plane that were found to be of one slab.

    Tried are some slabs, the other slabs of the plane, and other thicknesses.
    """
    own = next((surface.slab for surface in room if (surface.plane, surface.found_slab) == key), None)
    if own is None:
        return
    beside = {surface.slab for surface in room if surface.plane == key[0]} - {own}
    for slab in [*slabs, *sorted(beside), *(own.thinned(factor) for factor in factors)]:
        yield [
            replace(surface, slab=slab) if (surface.plane, surface.found_slab) == key else surface for surface in room
        ]


def with_wall_at(plane: int, places_m: Sequence[float], slabs: Sequence[NamedSlab], room: Room) -> Iterator[Room]:
    """The room with a wall moved along its normal, with its own slabs or another; surfaces that met it still do."""
    own = next(surface for surface in room if surface.is_wall and surface.plane == plane)
    for by_m in places_m:
        moved = [surface if surface.depth_m else _stretched(surface, own, by_m) for surface in room]
        for slab in slabs:
            yield [
                replace(surface, slab=slab) if surface.is_wall and surface.plane == plane else surface
                for surface in moved
            ]
        yield moved


def _stretched(other: RoomSurface, wall: RoomSurface, by_m: float) -> RoomSurface:
    """A surface with its corners that lie on a wall moved along the wall's normal."""
    on_wall = np.abs((other.corners_m - wall.corners_m[0]) @ wall.normal) < _SAME_END_M
    return replace(other, corners_m=other.corners_m + by_m * on_wall[:, None] * wall.normal) if on_wall.any() else other


def without(number: int, room: Room) -> Iterator[Room]:
    """The room without a face."""
    if any(surface.number == number for surface in room):
        yield [surface for surface in room if surface.number != number]


def with_edges(number: int, steps_m: Sequence[float], room: Room) -> Iterator[Room]:
    """The room with one edge of a face moved, alone or together with those of parallel faces that end there too."""
    walls = [surface for surface in room if surface.is_wall]
    for own in room:
        if own.number == number:
            near = [surface for surface in room if surface is not own and abs(_behind_m(surface, own)) < _BACK_M]
            for edge, step_m in _edge_steps(own, walls, steps_m):
                changed = _with_edge(own, edge, step_m * own.outward[edge], walls)
                yield [changed if surface is own else surface for surface in room]
                along = {surface: _moved_along(surface, own, edge, step_m, walls) for surface in near}
                if any(old is not new for old, new in along.items()):
                    yield [changed if surface is own else along.get(surface, surface) for surface in room]


def as_one(plane: int, room: Room) -> Iterator[Room]:
    """The room with several faces of a plane as one rectangle about all of them, with sides moved to the walls or not.

    A single object may be found as several faces, where few paths touch the cells between them.
    """
    walls = [surface for surface in room if surface.is_wall]
    parts = [surface for surface in room if surface.plane == plane and not surface.is_wall]
    if len(parts) < 2:
        return
    largest = max(parts, key=lambda surface: surface.area_m2)
    own = replace(largest, corners_m=_rectangle_about(largest, parts))
    slabs = dict.fromkeys(surface.slab for surface in parts)
    others = [surface for surface in room if surface not in parts]
    ways_m = [_way_to_wall(own.corners_m[[side, (side + 1) % 4]], own.outward[side], walls) for side in range(4)]
    for moves_m in product(*([0.0, way_m] if 0 < way_m < np.inf else [0.0] for way_m in ways_m)):
        whole = own
        for side, by_m in enumerate(moves_m):
            whole = _with_edge(whole, side, by_m * own.outward[side], walls)
        for slab in slabs:
            yield [*others, replace(whole, slab=slab)]


def with_depths(number: int, slabs: Sequence[NamedSlab], room: Room) -> Iterator[Room]:
    """The room with a face as the front of a box, or of a deeper one, in place of what was found just behind it.

    The box may also replace what was found in it or just before it: such a plane may be the box's back, which is a
    part of a wavelength off at some carriers. Of two thin sheets that were learned as one slab, each is thinner.
    """
    walls = [surface for surface in room if surface.is_wall]
    for own in room:
        if own.number == number and own.plane != NO_PLANE:
            sheets = [
                replace(own, slab=slab.thinned(factor))
                for slab in slabs
                for factor in (_THINNER if slab.thickness_m < _THICK_M and slab.material != "metal" else (1.0,))
            ]
            over = {
                surface: _behind_m(surface, own) for surface in room if surface is not own and _is_over(surface, own)
            }
            alone = [surface for surface in room if not 0 < over.get(surface, 0.0) < _BACK_M]
            apart = [surface for surface in alone if abs(over.get(surface, np.inf)) >= _BACK_M]
            for others in [alone, apart] if len(apart) < len(alone) else [alone]:
                for sheet, depth_m in product(sheets, _DEPTHS_M):
                    box = sheet.with_depth(depth_m, walls)
                    yield [box if surface is own else surface for surface in others]


def deeper(number: int, room: Room) -> Iterator[Room]:
    """The room with a box of another depth, or of another thickness."""
    walls = [surface for surface in room if surface.is_wall]
    for own in room:
        if own.number == number and own.depth_m:
            changed = [own.with_depth(own.depth_m + by_m, walls) for by_m in FINER_M if own.depth_m + by_m > 0]
            changed += [replace(own, slab=own.slab.thinned(factor)) for factor in THICKNESSES]
            for box in changed:
                yield [box if surface is own else surface for surface in room]


def _behind_m(other: RoomSurface, front: RoomSurface) -> float:
    """How far a face is behind another one, if they are parallel; infinite otherwise, and for walls."""
    if other.is_wall or float(other.normal @ front.normal) <= _PARALLEL:
        return np.inf
    return float((other.corners_m[0] - front.corners_m[0]) @ front.normal)


def _edge_steps(own: RoomSurface, walls: Surfaces, by_m: Sequence[float]) -> Iterator[tuple[int, float]]:
    """Each edge of a surface with how far outwards it may be moved: up to a wall at most, and to the wall itself."""
    number = len(own.corners_m)
    for edge, outward in enumerate(own.outward):
        room_m = _way_to_wall(own.corners_m[[edge, (edge + 1) % number]], outward, walls)
        size_m = np.ptp(own.corners_m @ outward)
        steps_m = {min(step_m, room_m) for step_m in by_m if size_m + step_m > _MIN_WIDTH_M}
        if np.isfinite(room_m):
            steps_m.add(room_m)
        yield from ((edge, step_m) for step_m in sorted(steps_m - {0.0}))


def _with_edge(own: RoomSurface, edge: int, by_m: Vector, walls: Surfaces) -> RoomSurface:
    """A surface with the edge from one of its corners to the next moved."""
    corners_m = own.corners_m.copy()
    corners_m[[edge, (edge + 1) % len(corners_m)]] += by_m
    return replace(own, corners_m=corners_m).with_depth(own.depth_m, walls)


def _is_over(other: RoomSurface, own: RoomSurface) -> bool:
    """Whether a face covers some of another one, as seen along the latter's normal."""
    axes = np.stack([own.outward[0], np.cross(own.normal, own.outward[0])])
    (low, high), (own_low, own_high) = (
        (place_m.min(axis=1), place_m.max(axis=1)) for place_m in (axes @ face.corners_m.T for face in (other, own))
    )
    return bool((np.minimum(high, own_high) - np.maximum(low, own_low) > _SAME_END_M).all())


def _moved_along(other: RoomSurface, own: RoomSurface, edge: int, step_m: float, walls: Surfaces) -> RoomSurface:
    """A parallel face, its edge moved with one of `own` if both end, or meet in a plane, at one place."""
    outward, number = own.outward[edge], len(own.corners_m)
    if _way_to_wall(own.corners_m[[edge, (edge + 1) % number]], outward, walls) < _SAME_END_M:
        return other
    same_way = other.outward @ outward
    apart_m = (other.corners_m - own.corners_m[edge]) @ outward
    may_meet = abs(_behind_m(other, own)) < _SAME_PLANE_M
    for found in np.flatnonzero(np.abs(apart_m) < _SAME_END_M).tolist():
        if same_way[found] > _PARALLEL or (may_meet and same_way[found] < -_PARALLEL):
            return _with_edge(other, found, step_m * outward, walls)
    return other


def _rectangle_about(largest: RoomSurface, parts: Surfaces) -> Float[FloatArray, "4 3"]:
    """The corners of the rectangle about some faces of a plane, along the first side of the largest one."""
    along = largest.corners_m[1] - largest.corners_m[0]
    along /= np.linalg.norm(along)
    across = np.cross(largest.normal, along)
    at_m = np.concatenate([surface.corners_m for surface in parts]) - largest.corners_m[0]
    (low, down), (high, up) = (ends(at_m @ np.array([along, across]).T, axis=0) for ends in (np.min, np.max))
    corners = [[low, down], [high, down], [high, up], [low, up]]
    return largest.corners_m[0] + np.array(corners) @ np.array([along, across])


def _way_to_wall(points_m: Float[FloatArray, "2 3"], outward: Vector, walls: Surfaces) -> float:
    """How far points can go before one of them meets the plane of a wall; infinite without a wall there."""
    ways_m = [np.inf]
    for wall in walls:
        slope = float(wall.normal @ outward)
        if slope > 1e-3:
            ways_m += (((wall.corners_m[0] - points_m) @ wall.normal) / slope).clip(0).tolist()
    return min(ways_m)


def without_patches(plane: int, room: Room) -> Iterator[Room]:
    """The room with one patch of a wall, or all of them, made of the slab that most of the wall has."""
    patches, rest = _patches(plane, room)
    alone = [[patch] for patch in patches]
    for gone in [patches, *alone] if len(patches) > 1 else alone:
        slab, found = rest[0].slab, rest[0].found_slab
        yield [replace(surface, slab=slab, found_slab=found) if surface in gone else surface for surface in room]


def with_patches(plane: int, room: Room) -> Iterator[Room]:
    """The room with one side of a patch moved: of a rectangle whose slab is not that of most of the wall."""
    walls = [surface for surface in room if surface.is_wall]
    patches, rest = _patches(plane, room)
    tiles = [*patches, *rest]
    first = max(_FIRST_PIECE, *(1 + surface.number for surface in room))
    for own in patches:
        for edge, step_m in _edge_steps(own, walls, _STEPS_M):
            changed = _with_edge(own, edge, step_m * own.outward[edge], walls)
            others = [changed if patch is own else patch for patch in patches]
            if pieces := _around(tiles, others, rest, first):
                yield [*(surface for surface in room if surface not in tiles), *others, *pieces]


def _patches(plane: int, room: Room) -> tuple[list[RoomSurface], list[RoomSurface]]:
    """The parts of a wall whose slab is not that of most of the wall, and the other parts."""
    tiles = [surface for surface in room if surface.is_wall and surface.plane == plane]
    main = max(tiles, key=lambda tile: sum(one.area_m2 for one in tiles if one.slab == tile.slab)).slab
    return [tile for tile in tiles if tile.slab != main], [tile for tile in tiles if tile.slab == main]


def _around(tiles: Surfaces, patches: Surfaces, rest: Surfaces, first: int) -> list[RoomSurface]:
    """The pieces of a wall around its patches, in place of the other pieces; none where patches overlap.

    All tiles together cover the wall. Additional pieces get numbers from `first` on.
    """
    own = patches[0]
    axes = np.stack([own.outward[0], np.cross(own.normal, own.outward[0])])
    places, holes = ([(tile.corners_m - own.corners_m[0]) @ axes.T for tile in of] for of in (tiles, patches))
    whole = ConvexHull(np.concatenate(places))
    left = [tidied(whole.points[whole.vertices])]
    for place_m in holes:
        hole_m = place_m[ConvexHull(place_m).vertices]  # in turn to the left
        left = [tidied(piece_m) for piece in left for piece_m in cut_out(piece, hole_m)]
    numbers = chain((tile.number for tile in rest), count(first))
    pieces = [
        replace(rest[0], number=number, corners_m=own.corners_m[0] + piece_m @ axes)
        for number, piece_m in zip(numbers, left, strict=False)
    ]
    is_whole = abs(sum(tile.area_m2 for tile in (*patches, *pieces)) - whole.volume) < LEAST_AREA_M2
    return [piece for piece in pieces if piece.area_m2 > LEAST_AREA_M2] if is_whole else []


class Trial(NamedTuple):
    """Changes of a room that are tried; `at_lowest` says that the lowest carriers are compared, too.

    A centimetre is little to these. `besides` are further changes that are tried together with the best ones. A
    change is kept if it raises the mean SSIM by `least`, which is 0 where it makes a room simpler.
    """

    changes: Callable[[Room], Iterator[Room]]
    at_lowest: bool = False
    besides: Callable[[Room], Iterator[Room]] | None = None
    least: float = MIN_CHANGE
    repeats: int = _REPEATS


def trials_of_face(own: RoomSurface, known: Sequence[NamedSlab], of_boxes: Sequence[NamedSlab]) -> list[Trial]:
    """Trials of a face, which is one of the slabs `known` or else `of_boxes`: edges, depth, edges again, no face."""
    others = [slab for slab in of_boxes if slab.material not in {one.material for one in known}]
    slabs = known if known[0].material == "metal" else [*known, *others]  # nothing else becomes metal
    edges, finer, nearly = (partial(with_edges, own.number, steps_m) for steps_m in (EDGES_M, FINER_M, NEAR_EDGES_M))
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
    return [Trial(partial(other_slabs, *named, factors), at_lowest) for named in known.items()]
