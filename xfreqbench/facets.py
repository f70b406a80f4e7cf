"""Planar facets of triangle meshes: what the image method reflects at."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.mesh import SurfaceMesh

PLANE_TOLERANCE = 1e-5  # metres, and radians: facets closer than this share a plane; float32 errs by less
PARALLELOGRAM_TOLERANCE = 1e-6  # of the diagonal


class PlanarFacet(NamedTuple):
    """A parallelogram (four corners in turn) or triangle of one surface."""

    corners_m: Float[FloatArray, "n 3"]
    surface: int  # index of its mesh


def planar_facets(meshes: Sequence[SurfaceMesh]) -> list[PlanarFacet]:
    """Facets of all meshes: pairs of triangles that form a parallelogram are one facet."""
    return [
        PlanarFacet(corners, surface)
        for surface, mesh in enumerate(meshes)
        for corners in _merged(mesh.vertices_m, mesh.triangles)
    ]


def _merged(
    vertices_m: Float[FloatArray, "V 3"], triangles: Int[NDArray[np.int64], "K 3"]
) -> list[FloatArray]:
    """Greedy pairing over shared edges, in the order of the triangles."""
    by_edge: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for index, triangle in enumerate(triangles):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            by_edge[tuple(sorted((int(triangle[a]), int(triangle[b]))))].append(index)
    merged: list[FloatArray] = []
    used: set[int] = set()
    for edge, pair in by_edge.items():
        if len(pair) == 2 and not used & set(pair):
            corners = _parallelogram(vertices_m, edge, triangles[pair[0]], triangles[pair[1]])
            if corners is not None:
                merged.append(corners)
                used |= set(pair)
    return merged + [
        vertices_m[t] for i, t in enumerate(triangles) if i not in used and _area(vertices_m[t]) > 0
    ]


def _area(corners_m: Float[FloatArray, "3 3"]) -> float:
    a, b, c = corners_m
    return float(np.linalg.norm(np.cross(b - a, c - a)) / 2)


def _parallelogram(
    vertices_m: Float[FloatArray, "V 3"],
    diagonal: tuple[int, ...],
    first: Int[NDArray[np.int64], "3"],
    second: Int[NDArray[np.int64], "3"],
) -> FloatArray | None:
    """Corners in turn, where two triangles about a diagonal make a parallelogram, else None."""
    (apex,) = set(first.tolist()) - set(diagonal) or {diagonal[0]}
    (opposite,) = set(second.tolist()) - set(diagonal) or {diagonal[0]}
    a, b, c, d = vertices_m[[apex, diagonal[0], opposite, diagonal[1]]]
    size = np.linalg.norm(c - a)
    is_parallelogram = np.allclose(a + c, b + d, rtol=0, atol=PARALLELOGRAM_TOLERANCE * size)
    return np.stack([a, b, c, d]) if is_parallelogram and _area(np.stack([a, b, c])) > 0 else None


def plane_of(corners_m: Float[FloatArray, "n 3"]) -> tuple[FloatArray, float]:
    """Unit normal, its first sizeable component positive, and offset of a facet's plane."""
    normal = np.cross(corners_m[1] - corners_m[0], corners_m[-1] - corners_m[0])
    normal = normal / np.linalg.norm(normal)
    leading = normal[np.flatnonzero(np.abs(normal) > 0.1)[0]]
    normal = normal * np.sign(leading)
    return normal, float(normal @ corners_m[0])


def group_by_plane(
    facets: Sequence[PlanarFacet],
) -> tuple[Float[FloatArray, "P 4"], Int[NDArray[np.int64], "Q"]]:
    """The distinct planes (normal, offset), and the plane of each facet.

    The largest facet left, whose plane is known best, claims every facet left whose normal and corners
    are within `PLANE_TOLERANCE` of its plane. Planes come in lexicographic order.
    """
    if not facets:
        return np.zeros((0, 4)), np.zeros(0, dtype=np.int64)
    planes = np.array([np.append(*plane_of(facet.corners_m)) for facet in facets])
    corners_m = np.array([facet.corners_m[[0, 1, 2, -1]] for facet in facets])  # a triangle's last twice
    diagonal_m = np.linalg.norm(np.ptp(corners_m, axis=1), axis=1)
    plane = np.full(len(facets), -1)
    claimants: list[int] = []
    for facet in np.argsort(-diagonal_m, kind="stable"):
        if plane[facet] < 0:
            plane[(plane < 0) & _in_plane(planes[facet], planes[:, :3], corners_m)] = len(claimants)
            plane[facet] = len(claimants)  # though its fourth corner may stand a little off its own plane
            claimants.append(int(facet))
    distinct = planes[claimants]
    order = np.lexsort(np.round(distinct / PLANE_TOLERANCE).T[::-1])
    return distinct[order], np.argsort(order)[plane].astype(np.int64)


def _in_plane(
    plane: Float[FloatArray, "4"], normals: Float[FloatArray, "Q 3"], corners_m: Float[FloatArray, "Q 4 3"]
) -> Bool[NDArray[np.bool_], "Q"]:
    """Whether each facet is parallel to a plane, whichever side its normal points to, and lies in it."""
    normal, offset_m = plane[:3], plane[3]
    tilt_rad = np.linalg.norm(np.cross(normals, normal), axis=1)
    distance_m = np.abs(corners_m @ normal - offset_m).max(axis=1)
    return np.asarray((tilt_rad < PLANE_TOLERANCE) & (distance_m < PLANE_TOLERANCE))
