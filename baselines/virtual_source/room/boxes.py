"""Boxes in a learned room that stand along its walls: how they become surfaces, and what may be changed in one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Literal

import numpy as np
from jaxtyping import Float

from xfreqbench.types import FloatArray

from ..search.planes import Points, Vector
from .surfaces import METAL_THICKNESS_M, NO_PLANE, NamedSlab, RoomSurface, Surfaces

THICKNESSES = (0.5, 0.7, 0.96, 0.98, 0.99, 1.01, 1.02, 1.04, 1.4, 2.0, 2.8)
GAP_M = 0.02  # between a box and the walls, and whatever is known not to be in it
_SHEET_M = 0.015  # thickness of the slabs of which boxes are made at first
_BOARD_M = 0.03  # height of a table's top
MOST_BOARD_M = 0.05
_ALONG = 1 - 1e-5  # cosine of what stands along an axis
_THINNEST_M = 0.01

Box = Float[FloatArray, "2 3"]  # lowest and highest corner, along axes of the room
Change = Callable[[RoomSurface], Iterator[RoomSurface]]
Faces = tuple[int | tuple[int, int], int]  # of a box: the lower or upper one, or both, along which axis
# Across are two opposite upright faces, and in line a shown face and a hidden one, that are moved together.
Kind = Literal["board", "top", "shown", "hidden", "across", "in line"]
_TOP, _WHOLE = (1, 2), ((0, 1), 2)  # the latter: a board as a whole, upwards
_IN_TURN: tuple[Kind, ...] = ("top", "shown", "hidden", "across")
Ways = Mapping[Kind, Sequence[Sequence[float]]]


def _within(most_m: float, apart_m: float) -> tuple[float, ...]:
    """Steps up to `most_m` in either direction, none of them 0."""
    number = round(most_m / apart_m)
    return tuple(apart_m * step for step in range(-number, number + 1) if step)


# By which faces are moved: roughly, and then those that mirror in small steps, for they agree at one place only.
WAYS_M: tuple[Ways, ...] = (
    {
        "board": ((0.0, *_within(0.2, 0.05)),),
        "top": (_within(0.25, 0.05), _within(0.04, 0.01)),
        "shown": (_within(0.12, 0.04), _within(0.03, 0.01)),
        "hidden": ((*_within(0.2, 0.05), -0.4, -0.3, 0.3, 0.4),),
        "across": (_within(0.2, 0.05),),
        "in line": (_within(0.2, 0.05),),
    },
    {
        "board": ((0.0,),),
        "top": (_within(0.24, 0.02), _within(0.015, 0.005)),
        "shown": (_within(0.24, 0.02), _within(0.015, 0.005)),
        "hidden": (_within(0.1, 0.05),),
        "across": (_within(0.03, 0.01),),
        "in line": (_within(0.2, 0.05),),
    },
)


@dataclass(frozen=True, eq=False)
class BoxFrame:
    """The walls of a room, and unit vectors across the largest upright one, along it, and upwards.

    Without such a wall they are the axes of the world.
    """

    walls: Surfaces
    axes: Float[FloatArray, "3 3"]

    @classmethod
    def of(cls, room: Surfaces) -> BoxFrame:
        """The frame of a room."""
        walls = [surface for surface in room if surface.is_wall]
        upright = [surface for surface in walls if abs(surface.normal[2]) < 0.1]
        if not upright:
            return cls(walls, np.eye(3))
        across = max(upright, key=lambda surface: surface.area_m2).normal * [1.0, 1.0, 0.0]
        across = across / np.linalg.norm(across)
        up = np.array([0.0, 0.0, 1.0])
        return cls(walls, np.stack([across, np.cross(up, across), up]))

    @cached_property
    def bounds(self) -> Box:
        """The box about the walls; an infinite one without walls."""
        if not self.walls:
            return np.array([[-np.inf], [np.inf]]).repeat(3, axis=1)
        corners_m = self.along(np.concatenate([surface.corners_m for surface in self.walls]))
        return np.stack([corners_m.min(axis=0), corners_m.max(axis=0)])

    def along(self, point_m: Float[FloatArray, "*N 3"]) -> Float[FloatArray, "*N 3"]:
        """Points along the axes."""
        return point_m @ self.axes.T

    def surface(self, box: Box, number: int, slab: NamedSlab) -> RoomSurface:
        """A box of a slab as a surface: its top, and what is below."""
        (west, south, bottom), (east, north, top) = box.tolist()
        corners = [[west, south, top], [east, south, top], [east, north, top], [west, north, top]]
        surface = RoomSurface(
            number, NO_PLANE, 0, -self.axes[2], np.array(corners) @ self.axes, slab, seen=1.0, is_wall=False
        )
        return surface.with_depth(top - bottom, self.walls)

    def box_of(self, surface: RoomSurface) -> Box:
        """Inverse of `surface`."""
        place_m = self.along(surface.mesh.vertices_m)
        return np.stack([place_m.min(axis=0), place_m.max(axis=0)])

    def face_of(self, surface: RoomSurface) -> Faces | None:
        """Which face of a box behind it an upright polygon along the axes is; None for any other polygon."""
        outward = self.along(surface.normal)
        axis = int(np.abs(outward).argmax())
        if axis == 2 or abs(outward[axis]) < _ALONG:
            return None
        return int(outward[axis] < 0), axis

    def changes(
        self, box: Box, slabs: Sequence[NamedSlab], array_m: Vector, ways_m: Ways, held: Faces | None = None
    ) -> list[Change]:
        """Kinds of changes of a box, to try in turn: slabs, faces by steps of `ways_m`, the height, and slabs again.

        The edges between faces that the array sees and those that it does not see decide what a box hides; how far a
        face is from the array matters less. The face `held` stays where it is, and so does the box along its normal.
        """
        fixed = (held, ((0, 1), held[1])) if held else ()
        place_m = self.along(array_m)
        faces = [(face, kind) for face, kind in _faces(box, place_m) if face not in fixed]
        moves = [partial(self._moved, face, by_m) for face, kind in faces for by_m in ways_m[kind]]
        moves += [
            partial(self._moved_in_line, place_m, shown, hidden, by_m)
            for (shown, one), (hidden, other) in product(faces, repeat=2)
            if one in ("top", "shown") and other == "hidden" and shown[1] != hidden[1]
            for by_m in ways_m["in line"]
        ]
        of_slabs = partial(_of_slabs, slabs)
        boards = [partial(self.as_board, steps_m) for steps_m in ways_m["board"]]
        return [of_slabs, *moves, *boards, self.to_floor, of_slabs]

    def _moved(self, faces: Faces, steps_m: Sequence[float], own: RoomSurface) -> Iterator[RoomSurface]:
        """Boxes with a face moved, or two opposite ones: by each of some steps along one of the axes."""
        for step_m in steps_m:
            box = self.box_of(own)
            is_board = box[1, 2] - box[0, 2] < MOST_BOARD_M
            box[_WHOLE if is_board and faces == _TOP else faces] += step_m
            if (box[1] - box[0] > _THINNEST_M).all():
                yield self.surface(box, own.number, own.slab)

    def _moved_in_line(
        self, array_m: Vector, shown: Faces, hidden: Faces, steps_m: Sequence[float], own: RoomSurface
    ) -> Iterator[RoomSurface]:
        """A box with a hidden face moved, and a shown one so that the edge between hides the same from the array."""
        for step_m in steps_m:
            box = self.box_of(own)
            far_m = box[hidden] - array_m[hidden[1]]
            if abs(far_m) > _THINNEST_M:
                box[hidden] += step_m
                box[shown] += (box[shown] - array_m[shown[1]]) * step_m / far_m
                if (box[1] - box[0] > _THINNEST_M).all():
                    yield self.surface(box, own.number, own.slab)

    def as_board(self, steps_m: Sequence[float], own: RoomSurface) -> Iterator[RoomSurface]:
        """The top of a box alone, as of a table, at its height or at other heights."""
        top_m = float(self.box_of(own)[1, 2])
        for step_m in steps_m:
            box = self.box_of(own)
            box[:, 2] = top_m + step_m - _BOARD_M, top_m + step_m
            yield self.surface(box, own.number, own.slab)

    def to_floor(self, own: RoomSurface) -> Iterator[RoomSurface]:
        """A box extended down to the floor, as a cabinet, however little of it was found."""
        box = self.box_of(own)
        box[0, 2] = self.bounds[0, 2] + GAP_M if self.walls else box[0, 2]
        if box[1, 2] - box[0, 2] > MOST_BOARD_M:
            yield self.surface(box, own.number, own.slab)


def holds_any(box: Box, point_m: Points) -> bool:
    """Whether a point, given along the same axes, is in a box or near it."""
    low_m, high_m = box
    return bool(((point_m > low_m - GAP_M) & (point_m < high_m + GAP_M)).all(axis=1).any())


def box_slabs(materials: Sequence[str]) -> list[NamedSlab]:
    """Slabs of these materials for boxes, metal first."""
    return [
        NamedSlab(name, METAL_THICKNESS_M if name == "metal" else _SHEET_M, 0.0)
        for name in sorted(materials, key="metal".__ne__)
    ]


def _of_slabs(slabs: Sequence[NamedSlab], own: RoomSurface) -> Iterator[RoomSurface]:
    """A box of other slabs, and of other thicknesses; the thickness of metal does not matter."""
    thinner = () if own.slab.material == "metal" else map(own.slab.thinned, THICKNESSES)
    for slab in [*slabs, *thinner]:
        yield replace(own, slab=slab)


def _faces(box: Box, array_m: Vector) -> list[tuple[Faces, Kind]]:
    """The faces of a box, the top first, then others that the array sees, then the rest, and pairs of upright ones."""
    kinds: dict[Faces, Kind] = {((0, 1), axis): "across" for axis in (0, 1)}
    for is_upper, axis in product((0, 1), range(3)):
        is_shown = array_m[axis] > box[1, axis] if is_upper else array_m[axis] < box[0, axis]
        kinds[is_upper, axis] = "top" if is_upper and axis == 2 else "shown" if is_shown else "hidden"
    return sorted(kinds.items(), key=lambda pair: _IN_TURN.index(pair[1]))
