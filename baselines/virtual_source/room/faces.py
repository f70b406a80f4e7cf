"""Faces of a learned room: where its planes hold something, as convex polygons whose edges meet at the walls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from xfreqbench.types import FloatArray, IntArray, NDArray

from ..search.planes import Vector

_STRAIGHT_M = 1e-3  # a corner that stands out by less is removed
# Power of the paths that touch a cell, relative to the line of sight: with less, nothing is known of the cell.
_MIN_SEEN = 0.01
_MIN_WALL = 0.25  # share of the touched cells that a wall of the room holds
_MIN_CELLS = 3.0  # cells that a face has more than openings in it
_UNSEEN = -0.02  # what a cell counts for a face if no path touches it, where a full cell counts 1
_REACH = 1.5  # cells from an edge to a wall, up to which the two meet
ALIKE = 0.9  # cosine between the normals of planes that face the same way
_NONE_M = 1e-6


def clipped(place_m: Float[FloatArray, "n 2"], inward: Float[FloatArray, "n"]) -> Float[FloatArray, "m 2"]:
    """The part of a convex polygon where a linear function, given at its corners, is not negative."""
    kept = []
    corners = zip(place_m, inward.tolist(), np.roll(place_m, -1, axis=0), np.roll(inward, -1).tolist(), strict=True)
    for start, height, end, next_height in corners:
        if height >= 0:
            kept.append(start)
        if height * next_height < 0:
            kept.append(start + height / (height - next_height) * (end - start))
    return np.array(kept).reshape(-1, 2)


def beyond(
    point_m: Float[FloatArray, "*n 2"], start: Float[FloatArray, "2"], end: Float[FloatArray, "2"]
) -> Float[FloatArray, "*n"]:
    """How far to the left of an edge points lie, times its length."""
    (along, across), offset_m = end - start, point_m - start
    return along * offset_m[..., 1] - across * offset_m[..., 0]


def convex_common(place_m: Float[FloatArray, "n 2"], other_m: Float[FloatArray, "m 2"]) -> Float[FloatArray, "k 2"]:
    """The common part of two convex polygons, whose corners turn left."""
    for start, end in zip(other_m, np.roll(other_m, -1, axis=0), strict=True):
        place_m = clipped(place_m, beyond(place_m, start, end))
    return place_m


def cut_out(place_m: Float[FloatArray, "n 2"], hole_m: Float[FloatArray, "4 2"]) -> Iterator[Float[FloatArray, "k 2"]]:
    """A convex polygon without a rectangle, as convex pieces."""
    for start, end in zip(hole_m, np.roll(hole_m, -1, axis=0), strict=True):
        inward = beyond(place_m, start, end)
        outside = clipped(place_m, -inward)
        if len(outside) >= 3 and np.ptp(outside, axis=0).min() > _NONE_M:
            yield outside
        place_m = clipped(place_m, inward)


def tidied(place_m: Float[FloatArray, "n 2"]) -> Float[FloatArray, "m 2"]:
    """A convex polygon without corners that are hardly there; empty where nothing is left."""
    while len(place_m) >= 3:
        before, after = np.roll(place_m, 1, axis=0), np.roll(place_m, -1, axis=0)
        length_m = np.linalg.norm(after - before, axis=1)
        (along, across), (x, y) = (after - before).T, (place_m - before).T
        out_m = np.abs(along * y - across * x) / length_m.clip(_NONE_M)
        if out_m.min() > _STRAIGHT_M:
            return place_m
        place_m = np.delete(place_m, out_m.argmin(), axis=0)
    return place_m[:0]


@dataclass(frozen=True, eq=False)
class Cells:
    """What has been learned of one plane n·x = s, on a lattice of I × J places along its two axes.

    `share` holds the shares of nothing and of the slabs, `seen` the power of the training paths that touch each place,
    relative to the line of sight, were the plane full there. Places are `low_m` + (i, j)·`cell_m`.
    """

    normal: Vector
    distance_m: float
    axes: Float[FloatArray, "2 3"]
    low_m: Float[FloatArray, "2"]
    cell_m: float
    share: Float[FloatArray, "I J S"]
    seen: Float[FloatArray, "I J"]

    @property
    def is_seen(self) -> Bool[NDArray[np.bool_], "I J"]:
        """Where paths are strong enough to tell what is there."""
        return np.asarray(self.seen > _MIN_SEEN)

    def points_m(self, place_m: Float[FloatArray, "n 2"]) -> Float[FloatArray, "n 3"]:
        """Points of the plane, given along its axes."""
        return self.distance_m * self.normal + place_m @ self.axes

    def sides(self, low: Int[IntArray, "2"], high: Int[IntArray, "2"]) -> Float[FloatArray, "4 2"]:
        """Corners in turn of the rectangle around the cells from `low` to `high`, both inside, along the axes."""
        left, below = (self.low_m + (low - 0.5) * self.cell_m).tolist()
        right, above = (self.low_m + (high + 0.5) * self.cell_m).tolist()
        return np.array([[left, below], [right, below], [right, above], [left, above]])


class Face(NamedTuple):
    """A convex polygon of one plane, filled by one of its slabs; corners in turn, relative to the array centre.

    `seen` is the share of its cells that training paths tell of. `is_wall` says that it bounds the room.
    """

    plane: int
    slab: int
    corners_m: Float[FloatArray, "n 3"]
    seen: float
    is_wall: bool


def walls(planes: Sequence[Cells], offset_m: Float[FloatArray, "T 3"]) -> list[int]:
    """The planes that bound the room: all transmitters are in front, and no nearer such plane faces the same way."""
    found: list[int] = []
    for index in np.argsort([plane.distance_m for plane in planes], kind="stable").tolist():
        plane = planes[index]
        holds_all = bool((offset_m @ plane.normal < plane.distance_m).all())
        is_first = all(planes[other].normal @ plane.normal <= ALIKE for other in found)
        held = 1 - plane.share[..., 0][plane.is_seen]
        if holds_all and is_first and held.size and held.mean() >= _MIN_WALL:
            found.append(index)
    return found


def faces(planes: Sequence[Cells], offset_m: Float[FloatArray, "T 3"]) -> list[Face]:
    """All faces of a room, from the contents of the planes' cells; `offset_m` are the training transmitters.

    A wall is filled up to its neighbours, because what does not reflect there may be hidden by furniture; it is made
    of the slab that most of it shows, and of the other one in rectangles that show that. Other planes have the
    rectangles that hold most, up to a wall that is near, without those that hold nothing, such as doorways.
    """
    bounds = walls(planes, offset_m)
    found: list[Face] = []
    for index, plane in enumerate(planes):
        around = [planes[bound] for bound in bounds if bound != index]
        found += _wall(index, plane, around) if index in bounds else _inside(index, plane, around)
    return found


def _wall(index: int, plane: Cells, around: Sequence[Cells]) -> Iterator[Face]:
    held = plane.is_seen & (plane.share[..., 0] < 0.5)
    whole = _room_section(plane, around, held)
    if len(whole) < 3:  # behind a corner of the room
        return
    main, other = np.argsort(-plane.share[held].sum(0)[1:]).tolist()[:2]
    difference = plane.share[..., 1 + other] - plane.share[..., 1 + main]
    signed = np.where(held, difference, _UNSEEN)
    rest = [whole]
    for low, high in best_rectangles(signed):
        rectangle = _snapped(plane, plane.sides(low, high), whole)
        inside = convex_common(rectangle, whole)
        if len(inside) >= 3:
            yield _face(index, other, plane, inside, is_wall=True)
            rest = [piece for part in rest for piece in cut_out(part, rectangle)]
    for piece in rest:
        yield _face(index, main, plane, piece, is_wall=True)


def _inside(index: int, plane: Cells, around: Sequence[Cells]) -> Iterator[Face]:
    is_seen = plane.is_seen
    held = is_seen & (plane.share[..., 0] < 0.5)
    if not held.any():
        return
    whole = _room_section(plane, around, held)
    if len(whole) < 3:  # behind a wall, where images of the room's surfaces are
        return
    signed = np.where(is_seen, 1 - 2 * plane.share[..., 0], _UNSEEN)
    for low, high in best_rectangles(signed):
        here = tuple(slice(a, b + 1) for a, b in zip(low.tolist(), high.tolist(), strict=True))
        slab = int(plane.share[here][held[here]].sum(0)[1:].argmax())
        inside = convex_common(_snapped(plane, plane.sides(low, high), whole), whole)
        if len(inside) < 3:
            continue
        empty = np.full(signed.shape, -np.inf)
        empty[here] = np.where(is_seen, -signed, _UNSEEN)[here]
        rest = [inside]
        for opening in best_rectangles(empty):
            hole = _snapped(plane, plane.sides(*opening), inside)
            rest = [piece for part in rest for piece in cut_out(part, hole)]
        for piece in rest:
            yield _face(index, slab, plane, piece, is_wall=False)


def _face(index: int, slab: int, plane: Cells, place_m: Float[FloatArray, "n 2"], *, is_wall: bool) -> Face:
    count = plane.seen.shape
    grid = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), -1) * plane.cell_m + plane.low_m
    inner = np.ones(count, bool)
    for start, end in zip(place_m, np.roll(place_m, -1, axis=0), strict=True):
        inner &= beyond(grid, start, end) >= 0
    seen = float(plane.is_seen[inner].mean()) if inner.any() else 0.0
    return Face(index, slab, plane.points_m(place_m), seen, is_wall)


def best_rectangles(signed: Float[FloatArray, "I J"]) -> Iterator[tuple[Int[IntArray, "2"], Int[IntArray, "2"]]]:
    """The rectangles of largest sum, as first and last cells (both inside), without overlap, down to `_MIN_CELLS`."""
    left = np.array(signed)
    while True:
        low, high, total = _largest_sum(left)
        if total < _MIN_CELLS:
            return
        left[low[0] : high[0] + 1, low[1] : high[1] + 1] = -np.inf
        yield low, high


def _largest_sum(signed: Float[FloatArray, "I J"]) -> tuple[Int[IntArray, "2"], Int[IntArray, "2"], float]:
    """The rectangle of largest sum: for every pair of first and last rows, Kadane's scan along the columns."""
    best = -np.inf
    place = np.zeros((2, 2), np.int64)
    for first in range(len(signed)):
        sums = np.cumsum(signed[first:], axis=0)  # of rows from `first` to each last one
        run = np.full(len(sums), -np.inf)
        begin = np.zeros(len(sums), np.int64)
        for column in range(signed.shape[1]):
            is_new = run <= 0
            run = np.where(is_new, sums[:, column], run + sums[:, column])
            begin = np.where(is_new, column, begin)
            last = int(run.argmax())
            if run[last] > best:
                best = float(run[last])
                place = np.array([[first, begin[last]], [first + last, column]])
    return place[0], place[1], best


def _room_section(
    plane: Cells, around: Sequence[Cells], held: Bool[NDArray[np.bool_], "I J"]
) -> Float[FloatArray, "n 2"]:
    """The plane's part inside the walls `around`; where no wall ends it, it ends with the cells that are held."""
    size = np.array(plane.seen.shape)
    whole = plane.sides(np.zeros(2, np.int64), size - 1)
    for wall in around:  # the part in front of it
        whole = clipped(whole, wall.distance_m - plane.points_m(whole) @ wall.normal)
    if not len(whole):
        return whole
    rows = np.argwhere(held)
    low, high = plane.sides(rows.min(0), rows.max(0))[[0, 2]] if len(rows) else (whole.min(0), whole.max(0))
    border_low, border_high = plane.sides(np.zeros(2, np.int64), size - 1)[[0, 2]]
    low = np.where(whole.min(0) <= border_low + _NONE_M, low, border_low)
    high = np.where(whole.max(0) >= border_high - _NONE_M, high, border_high)
    limits = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    return convex_common(limits, whole)


def _snapped(
    plane: Cells, rectangle: Float[FloatArray, "4 2"], whole: Float[FloatArray, "n 2"]
) -> Float[FloatArray, "4 2"]:
    """A rectangle, each side moved to the border of the room where that is near."""
    (low, high), (least, most) = rectangle[[0, 2]], (whole.min(0), whole.max(0))
    reach_m = _REACH * plane.cell_m
    low = np.where(low - least < reach_m, least, low)
    high = np.where(most - high < reach_m, most, high)
    return np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
