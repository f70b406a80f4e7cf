"""Planar facets of triangle meshes: what the image method reflects at."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.mesh import SurfaceMesh

PLANE_TOLERANCE = 1e-6  # metres, and radians: facets closer than this share a plane


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
    is_parallelogram = np.allclose(a + c, b + d, rtol=0, atol=PLANE_TOLERANCE * size)
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
    """The distinct planes (normal, offset), and the plane of each facet."""
    planes = np.array([np.append(*plane_of(facet.corners_m)) for facet in facets]).reshape(-1, 4)
    _, first, plane = np.unique(
        np.round(planes / PLANE_TOLERANCE), axis=0, return_index=True, return_inverse=True
    )
    return planes[first], plane.ravel().astype(np.int64)
