"""Triangles of polygons, of mesh files and of scenes: concave ones, and those with holes that a slit joins."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import format_point

MAX_CORNERS = 1000  # of a concave face: its time grows with the square of the number
OVERLAP = 1e-6  # by how much of its size squared triangles of a polygon may overlap: corners are rounded
OFF_PLANE_M = 1e-3  # by which corners of a scene's polygon may


@np.errstate(all="ignore")  # of numbers that no float holds, which are refused later
def triangulated(
    vertices_m: Float[FloatArray, "V 3"], faces: Sequence[Sequence[int]]
) -> tuple[Int[IntArray, "K 3"], bool]:
    """Triangles of plane faces, each given by its corners in turn, in their order, and whether all are fans.

    A face is a fan about its first corner where the fan covers it once, and is cut into ears where it does not. Raises
    `ValueError` for a flat face that crosses itself; of others, which no triangles are right for, it makes fans.
    """
    sizes = np.fromiter(map(len, faces), np.int64, len(faces))
    corner = np.fromiter(chain.from_iterable(faces), np.int64, int(sizes.sum()))
    first, num_triangles = np.cumsum(sizes) - sizes, np.maximum(sizes - 2, 0)
    face = np.repeat(np.arange(len(faces)), num_triangles)
    second = first[face] + 1 + np.arange(len(face)) - (np.cumsum(num_triangles) - num_triangles)[face]
    triangles = np.stack([corner[first[face]], corner[second], corner[second + 1]], axis=1)
    of_polygon = np.flatnonzero(num_triangles[face] > 1)
    owner, start, polygon = np.unique(face[of_polygon], return_index=True, return_inverse=True)
    if not len(owner):
        return triangles, True
    corners_m = vertices_m[triangles[of_polygon]]
    area_m2 = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])  # doubled, as a vector
    whole_m2 = np.stack([np.bincount(polygon, axis_m2) for axis_m2 in area_m2.T], axis=1)
    size_m2 = np.linalg.norm(whole_m2, axis=1)
    extent_m = np.maximum.reduceat(np.linalg.norm(np.ptp(corners_m, axis=1), axis=1), start)
    least_m2 = OVERLAP * extent_m**2
    normal = whole_m2 / np.maximum(size_m2, least_m2)[:, None]
    turned_m2 = np.bincount(polygon, np.maximum(-np.einsum("kc,kc->k", area_m2, normal[polygon]), 0))
    folded_m2 = np.bincount(polygon, np.linalg.norm(area_m2, axis=1)) - size_m2
    rounding_m = 16 * np.spacing(np.float32(np.abs(corners_m).max()))
    are_fans = True
    for index in np.flatnonzero((turned_m2 > least_m2) | (size_m2 <= least_m2)):
        ring = np.array(faces[owner[index]], np.int64)
        ears = _ears(vertices_m[ring], normal[index]) if size_m2[index] > least_m2[index] else None
        if ears is not None:
            triangles[of_polygon[start[index]] + np.arange(len(ears))], are_fans = ring[ears], False
        elif folded_m2[index] > 2 * least_m2[index] + extent_m[index] * rounding_m and is_flat(vertices_m[ring]):
            raise ValueError(
                f"the face with a corner at {format_point(vertices_m[ring[0]])} crosses itself; "
                "export the mesh as triangles"
            )
    return triangles, are_fans


def flat_polygon(corners_m: Float[FloatArray, "n 3"]) -> tuple[Float[FloatArray, "n 3"], Int[IntArray, "k 3"]]:
    """Corners of a polygon, moved into its plane, and its triangles, which turn as its corners do.

    Raises `ValueError` for one without an area, that crosses itself, or with a corner more than `OFF_PLANE_M` off.
    """
    away_m = corners_m - corners_m[0]
    normal = np.cross(away_m, np.roll(away_m, -1, axis=0)).sum(axis=0)  # as long as twice the area
    size_m2, extent_m = np.linalg.norm(normal), extents_m(corners_m)
    if size_m2 <= OVERLAP * extent_m.max() ** 2:
        raise ValueError("crosses itself" if extent_m[1] > OVERLAP * extent_m.max() else "has no area")
    normal /= size_m2
    height_m = away_m @ normal
    height_m -= (height_m.min() + height_m.max()) / 2
    if height_m.max() > OFF_PLANE_M:
        raise ValueError(
            f"is not flat: a corner is {height_m.max() * 1e3:.3g} mm off its plane, and at most "
            f"{OFF_PLANE_M * 1e3:g} mm are allowed; cut it into triangles"
        )
    flat_m = corners_m - height_m[:, None] * normal
    ears = None if _crosses_itself(np.delete(away_m, np.abs(normal).argmax(), axis=1)) else _ears(flat_m, normal)
    if ears is None:
        raise ValueError("crosses itself")
    return flat_m, ears


def _crosses_itself(ring_m: Float[FloatArray, "n 2"]) -> bool:
    """Whether two sides of a polygon in the plane cross within both; where they touch they do not."""
    along_m = np.roll(ring_m, -1, axis=0) - ring_m
    x_m, y_m = np.moveaxis(ring_m - ring_m[:, None], -1, 0)  # from the start of each side to each corner
    side = along_m[:, :1] * y_m - along_m[:, 1:] * x_m
    side[np.abs(side) <= OVERLAP**2 * np.ptp(ring_m, axis=0).max() ** 2] = 0
    is_across = side * np.roll(side, -1, axis=1) < 0
    return bool((is_across & is_across.T).any())


def extents_m(points_m: Float[FloatArray, "n 3"]) -> Float[FloatArray, "3"]:
    """Extents of points along their principal axes, however they are turned, the least about first."""
    away_m = points_m - points_m.mean(axis=0)
    return np.ptp(away_m @ np.linalg.eigh(away_m.T @ away_m)[1], axis=0)


def is_flat(points_m: Float[FloatArray, "n 3"], share: float = 1e-3) -> bool:
    """Whether points are within a share of their extent of one plane, of any orientation."""
    extent_m = extents_m(points_m)
    return bool(extent_m[0] <= share * extent_m.max())


def _ears(ring_m: Float[FloatArray, "n 3"], normal: Float[FloatArray, "3"]) -> Int[IntArray, "t 3"] | None:
    """Corners of the n − 2 triangles of a polygon, which may touch itself as slits do, or None if it crosses itself.

    Triangles that use each side once, and all face the same way, cover any polygon once.
    """
    if len(ring_m) > MAX_CORNERS:
        raise ValueError(f"a concave face has {len(ring_m):,} corners; export the mesh as triangles")
    axis = int(np.abs(normal).argmax())
    x, y = np.delete(ring_m, axis, axis=1).T  # not turned, so that corners on one line remain on it
    if (normal[axis] > 0) == (axis == 1):
        x, y = y, x
    flat_m2 = OVERLAP**2 * float(np.ptp(ring_m, axis=0).max()) ** 2
    left, ears = np.arange(len(ring_m)), list[IntArray]()
    while len(left) > 2:
        ear = np.stack([np.roll(left, 1), left, np.roll(left, -1)], axis=1)
        u, v = x[ear], y[ear]
        area_m2 = (u[:, 1] - u[:, 0]) * (v[:, 2] - v[:, 0]) - (v[:, 1] - v[:, 0]) * (u[:, 2] - u[:, 0])
        candidates = np.flatnonzero(area_m2 > flat_m2)
        empty = (k for depth_m2 in (-flat_m2, flat_m2) for k in candidates if _is_empty(x, y, ear[k], left, depth_m2))
        chosen = next(empty, None)
        if chosen is None:  # except for corners on straight sides and at the ends of slits
            chosen = np.abs(area_m2).argmin()
            if abs(area_m2[chosen]) > flat_m2:
                return None
        ears.append(ear[chosen])
        left = np.delete(left, chosen)
    found, corner = np.array(ears), x + 1j * y
    away = corner - corner[found].mean(axis=1)[:, None]  # from triangles to corners
    turns = np.angle(np.roll(away, -1, axis=1) / away).sum(axis=1) / (2 * np.pi)
    u, v = x[found], y[found]
    area_m2 = (u[:, 1] - u[:, 0]) * (v[:, 2] - v[:, 0]) - (v[:, 1] - v[:, 0]) * (u[:, 2] - u[:, 0])
    return None if (turns[area_m2 > flat_m2] > 1.5).any() else found  # it covers places twice


def _is_empty(
    x: Float[FloatArray, "n"],
    y: Float[FloatArray, "n"],
    ear: Int[IntArray, "3"],
    left: Int[IntArray, "r"],
    depth_m2: float,
) -> bool:
    """Whether no remaining corner is deeper in a triangle; below 0, none is on its sides either."""
    inside = np.ones(len(left), bool)
    for here, there in zip(ear, np.roll(ear, -1), strict=True):
        side = (x[there] - x[here]) * (y[left] - y[here]) - (y[there] - y[here]) * (x[left] - x[here])
        inside &= (side > depth_m2) & ((x[left] != x[here]) | (y[left] != y[here]))
    return not inside.any()
