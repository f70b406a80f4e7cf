"""Parts of a learned room that can be moved: walls, which also tilt, and the faces of furniture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from xfreqbench.types import FloatArray

from .boxes import MOST_BOARD_M
from .surfaces import NO_PLANE, RoomSurface


class RoomPart(NamedTuple):
    """What moves along a normal: the wall of a plane, evenly or the more the farther along an axis, or a face.

    A board is the front and the back of a thin box together. `number` is that of the plane of a wall, of any other
    surface its own; `nth` is that of the axis, or of the first corner of a side.
    """

    kind: Literal["wall", "tilt", "front", "back", "board", "side"]
    number: int
    nth: int = 0


def parts_at(surface: RoomSurface, point_m: Float[FloatArray, "3"]) -> list[RoomPart]:
    """The parts that move the point of a surface at which a path is reflected."""
    number = surface.number
    if surface.is_wall:
        return [
            RoomPart("wall", surface.plane),
            RoomPart("tilt", surface.plane, 0),
            RoomPart("tilt", surface.plane, 1),
        ]
    if not surface.depth_m:
        return [RoomPart("front", number)]
    behind_m = float((point_m - surface.corners_m[0]) @ surface.normal)
    away_m = {
        RoomPart("front", number): abs(behind_m),
        RoomPart("back", number): abs(behind_m - surface.depth_m),
    }
    beside_m = np.einsum("nc,nc->n", point_m - surface.corners_m, surface.outward)
    away_m |= {RoomPart("side", number, side): abs(by_m) for side, by_m in enumerate(beside_m.tolist())}
    nearest = min(away_m, key=away_m.__getitem__)
    is_board = nearest.kind != "side" and surface.depth_m < MOST_BOARD_M
    return [nearest, RoomPart("board", number)] if is_board else [nearest]


def moves_with(own: RoomSurface) -> tuple[int, int]:
    """The same for all parts of a wall, which move together, and for no other surfaces."""
    return (own.plane, NO_PLANE) if own.is_wall else (NO_PLANE, own.number)


class Motion(NamedTuple):
    """By which vector points move for each metre that their part is moved: all alike, or the more the farther along.

    Tilted points move by their distance from `middle_m` along `axis`.
    """

    normal: Float[FloatArray, "3"]
    middle_m: Float[FloatArray, "3"] | None = None
    axis: Float[FloatArray, "3"] | None = None

    @classmethod
    def of(cls, room: Sequence[RoomSurface], part: RoomPart) -> Motion:
        """How a part of a room moves."""
        own = _own(room, part)[0]
        if part.kind == "tilt":
            return cls(own.normal, *_axis(room, part))
        return cls(own.outward[part.nth] if part.kind == "side" else own.normal)

    def at(self, point_m: Float[FloatArray, "3"]) -> Float[FloatArray, "3"]:
        """How a point of the part moves."""
        if self.axis is None or self.middle_m is None:
            return self.normal
        return float((point_m - self.middle_m) @ self.axis) * self.normal


def moved(room: Sequence[RoomSurface], part: RoomPart, by_m: float) -> list[RoomSurface]:
    """The room with a part moved along its normal, which leads away from the array or out of a box."""
    chosen = _own(room, part)
    return [_moved(each, room, part, by_m) if each in chosen else each for each in room]


def _moved(own: RoomSurface, room: Sequence[RoomSurface], part: RoomPart, by_m: float) -> RoomSurface:
    corners_m, depth_m, normal = own.corners_m.copy(), own.depth_m, own.normal
    if part.kind == "side":
        corners_m[[part.nth, (part.nth + 1) % len(corners_m)]] += by_m * own.outward[part.nth]
    elif part.kind == "back":
        depth_m += by_m
    elif part.kind == "tilt":
        centre_m, axis = _axis(room, part)
        corners_m += by_m * ((corners_m - centre_m) @ axis)[:, None] * normal
        normal = normal - by_m * axis
        normal = normal / np.linalg.norm(normal)
    else:
        corners_m += by_m * normal
        depth_m -= by_m if part.kind == "front" and depth_m else 0.0
    return replace(own, corners_m=corners_m, depth_m=depth_m, normal=normal)


def _own(room: Sequence[RoomSurface], part: RoomPart) -> list[RoomSurface]:
    """The surfaces that a part belongs to."""
    if part.kind in ("wall", "tilt"):
        return [each for each in room if each.is_wall and each.plane == part.number]
    return [each for each in room if not each.is_wall and each.number == part.number]


def _axis(
    room: Sequence[RoomSurface], part: RoomPart
) -> tuple[Float[FloatArray, "3"], Float[FloatArray, "3"]]:
    """The middle of a wall, and the axis in it along which it tilts."""
    own = _own(room, part)
    corners_m, normal = np.concatenate([each.corners_m for each in own]), own[0].normal
    along = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    along = along / np.linalg.norm(along)
    middle_m = (corners_m.min(axis=0) + corners_m.max(axis=0)) / 2
    return middle_m, (along, np.cross(normal, along))[part.nth]
