"""Convex polygons in a plane, whose corners turn left: their common parts, and one without another."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from xfreqbench.types import FloatArray

_NONE_M = 1e-6
_STRAIGHT_M = 1e-3  # a corner that stands out by less is none


def clipped(place_m: Float[FloatArray, "n 2"], inward: Float[FloatArray, "n"]) -> Float[FloatArray, "m 2"]:
    """The part of a convex polygon where a linear function, given at its corners, is not negative."""
    kept = []
    corners = zip(
        place_m, inward.tolist(), np.roll(place_m, -1, axis=0), np.roll(inward, -1).tolist(), strict=True
    )
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


def convex_common(
    place_m: Float[FloatArray, "n 2"], other_m: Float[FloatArray, "m 2"]
) -> Float[FloatArray, "k 2"]:
    """The common part of two convex polygons, whose corners turn left."""
    for start, end in zip(other_m, np.roll(other_m, -1, axis=0), strict=True):
        place_m = clipped(place_m, beyond(place_m, start, end))
    return place_m


def without(
    place_m: Float[FloatArray, "n 2"], hole_m: Float[FloatArray, "4 2"]
) -> Iterator[Float[FloatArray, "k 2"]]:
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
