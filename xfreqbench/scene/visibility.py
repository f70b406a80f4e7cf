"""Whether points of a room see each other, how far they are from a surface, and what encloses them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from xfreqbench.scene.meshes import SurfaceMesh, triangle_corners_m
from xfreqbench.scene.patches import components
from xfreqbench.types import FloatArray, IntArray, NDArray


def distance_to_surfaces(meshes: Sequence[SurfaceMesh], points_m: Float[FloatArray, "N 3"]) -> Float[FloatArray, "N"]:
    """Distance in metres from each of N points to the nearest triangle; infinite if there are no triangles."""
    from xfreqbench.scene import visibility_kernels

    corners_m = np.ascontiguousarray(triangle_corners_m(meshes))
    return visibility_kernels.nearest_distances(corners_m, np.ascontiguousarray(points_m, dtype=np.float64))


def enclosing_mesh(meshes: Sequence[SurfaceMesh], points_m: Float[FloatArray, "N 3"]) -> Int[IntArray, "N"]:
    """Index of a closed mesh that encloses each of N points, or −1.

    A mesh encloses a point where its winding number is above one half, whichever way its faces are turned and however
    often they are given. A rectangle or any other open mesh encloses nothing.
    """
    enclosing = np.full(len(points_m), -1)
    for index, mesh in enumerate(meshes):
        low_m, high_m = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
        near = np.flatnonzero(((points_m >= low_m) & (points_m <= high_m)).all(axis=1))
        if len(near) and (shell := _shell(mesh)).is_watertight:
            corners_m = np.asarray(shell.triangles)
            if not shell.is_winding_consistent:
                corners_m = shell.vertices[_turned_alike(np.asarray(shell.faces), shell.area_faces)]
            enclosing[near[np.abs(_winding_number(corners_m, points_m[near])) > 0.5]] = index
    return enclosing


def is_closed(mesh: SurfaceMesh) -> bool:
    """Whether a mesh, or a part of it, has two triangles at every edge, so that it has an inside."""
    return bool(_shell(mesh).is_watertight)


def _shell(mesh: SurfaceMesh) -> Any:
    """A mesh of trimesh with each vertex and each triangle once; those given may be there several times, in any order.

    Connected parts with an edge that does not belong to exactly two triangles, such as flaps and shelves, are left out.
    """
    import trimesh

    shell = trimesh.Trimesh(mesh.vertices_m, mesh.triangles)
    if not shell.is_watertight:
        shell.update_faces(shell.unique_faces())
    if not shell.is_watertight:
        number, edge = len(shell.faces), shell.edges_unique_inverse
        is_open = (np.bincount(edge) != 2)[edge].reshape(-1, 3).any(axis=1)
        if not is_open.all():
            ends = np.repeat(np.arange(number), 3), number + edge
            part = components(*ends, number + int(edge.max()) + 1)[:number]
            shell.update_faces(~np.isin(part, part[is_open]))
    return shell


def _turned_alike(triangles: Int[IntArray, "K 3"], area_m2: Float[FloatArray, "K"]) -> Int[IntArray, "K 3"]:
    """Triangles of a closed mesh; those of a connected part that face the other way than most of its area are turned.

    Two triangles of one edge face the same way where they run along it in opposite directions. The graph has two nodes
    for each triangle, as it is and turned round, and links the nodes of neighbours that face the same way.
    """
    edge, number = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), len(triangles)
    is_ascending = edge[:, 0] < edge[:, 1]
    pair = np.lexsort(np.sort(edge, axis=1).T).reshape(-1, 2)  # every edge belongs to two
    first, second = pair.T // 3
    other = number * (is_ascending[pair[:, 0]] == is_ascending[pair[:, 1]])
    ends = np.concatenate([first, first + number]), np.concatenate([second + other, second + number - other])
    as_it_is, turned = components(*ends, 2 * number).reshape(2, number)
    area_of_part_m2 = np.bincount(as_it_is, weights=area_m2, minlength=2 * number)
    more_m2 = area_of_part_m2[turned] - area_of_part_m2[as_it_is]
    is_turned = (more_m2 > 0) | ((more_m2 == 0) & (turned < as_it_is))
    return np.where(is_turned[:, None], triangles[:, ::-1], triangles)


def _winding_number(
    corners_m: Float[FloatArray, "K 3 3"], points_m: Float[FloatArray, "N 3"]
) -> Float[FloatArray, "N"]:
    """Solid angle that the triangles subtend at each point, over 4π (van Oosterom and Strackee, 1983)."""
    numbers = list[float]()
    for point_m in points_m:
        a, b, c = np.moveaxis(corners_m - point_m, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        ab, bc, ca = (np.einsum("ki,ki->k", *pair) for pair in ((a, b), (b, c), (c, a)))
        triple, denominator = np.einsum("ki,ki->k", a, np.cross(b, c)), la * lb * lc + ab * lc + bc * la + ca * lb
        numbers.append(np.arctan2(triple, denominator).sum())
    return np.array(numbers) / (2 * np.pi)


def sees(
    meshes: Sequence[SurfaceMesh], start_m: Float[FloatArray, "N 3"], end_m: Float[FloatArray, "3"]
) -> Bool[NDArray[np.bool_], "N"]:
    """Whether the straight segment from each of N starts to the one end meets no triangle (Möller–Trumbore)."""
    from xfreqbench.scene import visibility_kernels

    points_m = (np.ascontiguousarray(points, dtype=np.float64) for points in (start_m, end_m))
    return visibility_kernels.free_segments(np.ascontiguousarray(triangle_corners_m(meshes)), *points_m)


def fibonacci_sphere(num_points: int) -> Float[FloatArray, "N 3"]:
    """Directions spread evenly over the sphere, by the golden angle."""
    index = np.arange(num_points)
    z = 1 - (2 * index + 1) / num_points
    azimuth_rad = 2 * np.pi * ((index * (np.sqrt(5) - 1) / 2) % 1.0)
    horizontal = np.sqrt(1 - z**2)
    return np.stack([horizontal * np.cos(azimuth_rad), horizontal * np.sin(azimuth_rad), z], axis=-1)
