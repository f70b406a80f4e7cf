"""Whether points of a room see each other, how far they are from a surface, and what encloses them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from xfreqbench.scene.meshes import SurfaceMesh, triangle_corners_m
from xfreqbench.types import FloatArray, IntArray


def distance_to_surfaces(
    meshes: Sequence[SurfaceMesh], points_m: Float[FloatArray, "N 3"]
) -> Float[FloatArray, "N"]:
    """Distance in metres from each of N points to the nearest triangle; infinite where there are no triangles."""
    nearest = np.full(len(points_m), np.inf)
    for corners in triangle_corners_m(meshes):
        repeated = np.broadcast_to(corners, (len(points_m), 3, 3))
        closest: FloatArray = trimesh.triangles.closest_point(repeated, points_m)  # type: ignore[no-untyped-call]
        nearest = np.minimum(nearest, np.linalg.norm(closest - points_m, axis=1))
    return nearest


def enclosing_mesh(meshes: Sequence[SurfaceMesh], points_m: Float[FloatArray, "N 3"]) -> Int[IntArray, "N"]:
    """Index of a closed mesh that encloses each of N points, or −1.

    A mesh encloses a point where its winding number is above one half. A rectangle or any other open mesh encloses
    nothing.
    """
    enclosing = np.full(len(points_m), -1)
    for index, mesh in enumerate(meshes):
        if trimesh.Trimesh(mesh.vertices_m, mesh.triangles).is_watertight:
            enclosing[np.abs(_winding_number(mesh.corners_m, points_m)) > 0.5] = index
    return enclosing


def _winding_number(
    corners_m: Float[FloatArray, "K 3 3"], points_m: Float[FloatArray, "N 3"]
) -> Float[FloatArray, "N"]:
    """Solid angle that the triangles subtend at each point, over 4π (van Oosterom and Strackee, 1983)."""
    total = np.zeros(len(points_m))
    for corners in corners_m:
        a, b, c = corners[:, None, :] - points_m
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        triple = np.einsum("ni,ni->n", a, np.cross(b, c))
        denominator = (
            la * lb * lc
            + np.einsum("ni,ni->n", a, b) * lc
            + np.einsum("ni,ni->n", b, c) * la
            + np.einsum("ni,ni->n", c, a) * lb
        )
        total += np.arctan2(triple, denominator)
    return total / (2 * np.pi)


def sees(
    meshes: Sequence[SurfaceMesh], start_m: Float[FloatArray, "N 3"], end_m: Float[FloatArray, "3"]
) -> Bool[NDArray[np.bool_], "N"]:
    """Whether the straight segment from each of N starts to the one end meets no triangle (Möller–Trumbore)."""
    free = np.ones(len(start_m), dtype=bool)
    direction = np.asarray(end_m) - start_m
    for corner, second, third in triangle_corners_m(meshes):
        edge_u, edge_v = second - corner, third - corner
        normal = np.cross(edge_u, edge_v)
        along = direction @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            to_corner = start_m - corner
            turned = np.cross(to_corner, direction)
            u = -(turned @ edge_v) / along
            v = (turned @ edge_u) / along
            t = -(to_corner @ normal) / along
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)
        free &= ~hit
    return free
