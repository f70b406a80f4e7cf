"""The check that no two surfaces of different slabs overlap in one plane, where a ray could meet either."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.errors import SceneError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import slabs_of, triangle_corners_m
from xfreqbench.scene.patches import PLANE_TOLERANCE, rounding_m, sides_m
from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import format_point

_MAX_NAMED = 10  # overlaps in a message


def check_overlaps(geometry: Geometry) -> None:
    """Raise `SceneError` that names the surfaces of different slabs that overlap in one plane, pair by pair.

    They are parallel within `PLANE_TOLERANCE`, or what float32 leaves uncertain of the narrower triangle, and the
    smaller triangle lies within as many metres of the plane of the larger.
    """
    corners_m = triangle_corners_m(geometry.meshes)
    if not len(corners_m):
        return
    slabs = slabs_of(geometry.meshes)
    slab = np.array([slabs.index(mesh.slab) for mesh in geometry.meshes])[geometry.mesh_of_triangle]
    found: dict[str, str] = {}  # a place by the two names
    # edges may touch, and PLY files hold float32
    for pair in _overlapping(corners_m, slab, PLANE_TOLERANCE, 1e-4):
        a, b = (geometry.meshes[mesh] for mesh in sorted(geometry.mesh_of_triangle[list(pair)]))
        names = f"{a.name!r} ({a.material}) and {b.name!r} ({b.material})"
        if names not in found:
            found[names] = format_point(corners_m[pair[1]].mean(axis=0))
        if len(found) > _MAX_NAMED:
            break
    if found:
        shown = [f"{names} overlap in one plane, at {place} m" for names, place in [*found.items()][:_MAX_NAMED]]
        more = ", and more do" if len(found) > _MAX_NAMED else ""
        raise SceneError(
            f"{'; '.join(shown)}{more}: a ray could meet either. Cut the one out of the other, set them at least 1 cm "
            "apart, or give both the same slab."
        )


def nearly_in_one_plane(geometry: Geometry) -> str | None:
    """A text that names two objects with parallel surfaces less than 1 mm apart, or None if there are none.

    They may be a pane in front of a wall, or one object that is given twice. A path passes both surfaces.
    """
    corners_m = triangle_corners_m(geometry.meshes)
    if not len(corners_m):
        return None
    # surfaces that are nearer, and share more, were most likely meant to be one
    pair = next(_overlapping(corners_m, geometry.mesh_of_triangle, 1e-3, 0.02), None)
    if pair is None:
        return None
    large_m, small_m = corners_m[list(pair)]
    normal = np.cross(large_m[1] - large_m[0], large_m[2] - large_m[0])
    apart_m = np.abs((small_m - large_m[0]) @ normal).max() / np.linalg.norm(normal)
    a, b = (geometry.meshes[mesh].name for mesh in sorted(geometry.mesh_of_triangle[list(pair)]))
    return f"{a!r} and {b!r} are {apart_m * 1e3:.2g} mm apart at {format_point(small_m.mean(axis=0))} m"


def _overlapping(
    corners_m: Float[FloatArray, "K 3 3"], slab: Int[IntArray, "K"], tolerance_m: float, least_shared_m: float
) -> Iterator[tuple[int, int]]:
    """Every two triangles of different slabs that overlap in one plane within a tolerance, the larger first.

    Halves of a sorted list of triangles are compared with each other, and with themselves, and halves of those as long
    as the boxes about them meet. A box holds places, and the feet of perpendiculars from one point, which are the same
    for triangles of one plane.
    """
    low_m, high_m = corners_m.min(axis=1), corners_m.max(axis=1)
    least_m, extent_m = low_m.min(axis=0), np.ptp(corners_m, axis=(0, 1))
    normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    doubled_m2 = np.linalg.norm(normal, axis=1)
    normal /= doubled_m2[:, None]
    longest_m = sides_m(corners_m).max(axis=1)
    tilt_rad = PLANE_TOLERANCE + 2 * rounding_m(corners_m) * longest_m / doubled_m2
    apart_m = corners_m[:, 0] - (least_m - 0.5 * extent_m - 1)  # from a point in no wall's plane, if they are upright
    foot_m = np.einsum("kc,kc->k", apart_m, normal)[:, None] * normal
    slack_m = tolerance_m + 2 * np.linalg.norm(apart_m, axis=1) * np.minimum(tilt_rad, 1)
    low = np.hstack([low_m - tolerance_m, foot_m - slack_m[:, None], slab[:, None]])
    high = np.hstack([high_m + tolerance_m, foot_m + slack_m[:, None], slab[:, None]])
    order = np.lexsort([_morton((low_m + high_m) / 2 - least_m, extent_m), slab])
    levels = [np.hstack([low, -high])[order]]
    while len(levels[-1]) > 1:
        padded = np.pad(levels[-1], ((0, len(levels[-1]) % 2), (0, 0)), constant_values=np.inf)
        levels.append(np.minimum(padded[::2], padded[1::2]))
    waiting = [(len(levels) - 1, _meeting(levels[-1], np.zeros((2, 1), np.int64)))]
    while waiting:
        level, pairs = waiting.pop()
        if level > 0:
            halves = (2 * pairs[:, None] + np.array([[0, 0, 1, 1], [0, 1, 0, 1]])[:, :, None]).reshape(2, -1)
            meeting = _meeting(levels[level - 1], halves)
            # the number that is checked at once
            parts = np.array_split(meeting, len(meeting.T) // 250_000 + 1, axis=1)
            waiting += [(level - 1, part) for part in parts if part.size]
            continue
        pairs = order[pairs]
        is_smaller = longest_m[pairs[0]] < longest_m[pairs[1]]
        large, small = np.where(is_smaller, pairs[::-1], pairs)
        height_m = np.einsum("pkc,pc->pk", corners_m[small] - corners_m[large, :1], normal[large])
        tilt = np.linalg.norm(np.cross(normal[large], normal[small]), axis=1)
        in_plane = (np.abs(height_m).max(axis=1) < tolerance_m) & (tilt <= np.maximum(*tilt_rad[pairs]))
        large, small = large[in_plane], small[in_plane]
        shared_m = _shared_m(corners_m[large], corners_m[small], normal[large])
        for place in np.argsort(-shared_m, kind="stable"):  # the widest overlap first
            if shared_m[place] < least_shared_m:
                break
            yield int(large[place]), int(small[place])


def _meeting(box: Float[FloatArray, "n 14"], pairs: Int[IntArray, "2 p"]) -> Int[IntArray, "2 m"]:
    """Pairs of boxes, the first not after the second, that meet and have more than one slab; a box is low, −high."""
    pairs = pairs[:, (pairs[0] <= pairs[1]) & (pairs[1] < len(box))]
    for axis in range(6):
        low, high = box[pairs, axis], -box[pairs, axis + 7]
        pairs = pairs[:, low.max(axis=0) <= high.min(axis=0)]
    least, most = box[pairs, 6], -box[pairs, 13]
    return pairs[:, least.min(axis=0) < most.max(axis=0)]


def _morton(place_m: Float[FloatArray, "K 3"], extent_m: Float[FloatArray, "3"]) -> Int[IntArray, "K"]:
    """Numbers that put neighbours in space next to each other: the bits of the coordinates in turn."""
    cell = (place_m / np.maximum(extent_m, 1e-9) * (2**10 - 1)).astype(np.int64)
    bits = (cell[:, :, None] >> np.arange(10)) & 1
    return np.asarray((bits << (3 * np.arange(10) + np.arange(3)[:, None])).sum(axis=(1, 2)))


def _shared_m(
    first_m: Float[FloatArray, "p 3 3"], second_m: Float[FloatArray, "p 3 3"], normal: Float[FloatArray, "p 3"]
) -> Float[FloatArray, "p"]:
    """Least width that two triangles of one plane share, seen along their edges; 0 or less where an edge separates."""
    shared_m = np.full(len(normal), np.inf)
    for corners_m in (first_m, second_m):
        for edge in np.moveaxis(np.roll(corners_m, -1, axis=1) - corners_m, 1, 0):
            across = np.cross(normal, edge)
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            along = [np.einsum("pkc,pc->pk", each_m, across) for each_m in (first_m, second_m)]
            most, least = (side([places.T for places in along], axis=1) for side in (np.max, np.min))
            shared_m = np.minimum(shared_m, most.min(axis=0) - least.max(axis=0))
    return shared_m
