"""The planes and facets of a scene, as kernels take them: mirrors first, and all facets in a tree of boxes.

A wall and a leaf of a plant stand in one tree: boxes are divided where the sum of number × area of their parts, what a
segment has to look into in the mean, is least (the surface-area heuristic).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull

from xfreqbench.scene.array import frame_rotation
from xfreqbench.scene.facets import Geometry, PlanarFacet, group_by_plane, planar_facets
from xfreqbench.scene.meshes import SurfaceMesh, triangle_corners_m
from xfreqbench.scene.patches import PLANE_TOLERANCE, rounding_m
from xfreqbench.tracing.image.kernels.arrays import Facets
from xfreqbench.tracing.image.kernels.tree import divide
from xfreqbench.types import FloatArray, IntArray, NDArray


class MirrorPlanes:
    """The facets of a scene that mirror, their P planes, and the rectangle in each plane that holds its facets."""

    def __init__(self, geometry: Geometry) -> None:
        self.facets: list[PlanarFacet] = []
        wholes, whole = list[PlanarFacet](), list[int]()
        for facets in _by_patch(geometry):
            own, largest = _in_planes_of_the_largest(facets)
            self.facets += facets
            whole += (own + len(wholes)).tolist()
            wholes += largest
        self.planes, plane = group_by_plane(wholes)
        self.plane = plane[whole]
        normal = self.planes[:, :3]
        corners_m = np.array([facet.corners_m[[0, 1, -1, 2]] for facet in self.facets]).reshape(-1, 4, 3)
        off_m = np.einsum("qkc,qc->qk", corners_m, normal[self.plane]) - self.planes[self.plane, 3, None]
        self.corners_m = corners_m - off_m[:, :, None] * normal[self.plane, None]  # in the planes themselves
        along = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        self.axis = np.stack([along, np.cross(normal, along), normal], axis=1)
        self.low_m, self.high_m = np.full((len(normal), 2), np.inf), np.full((len(normal), 2), -np.inf)
        for facet, number in zip(self.facets, self.plane, strict=True):
            place_m = facet.corners_m @ self.axis[number, :2].T
            self.low_m[number] = np.minimum(self.low_m[number], place_m.min(axis=0))
            self.high_m[number] = np.maximum(self.high_m[number], place_m.max(axis=0))


def _by_patch(geometry: Geometry) -> Iterator[list[PlanarFacet]]:
    """Facets of each patch that mirrors, as few as they can be where it is convex.

    In other patches two triangles that form a parallelogram are one facet.
    """
    number = [len(mesh.triangles) for mesh in geometry.meshes]
    mesh, first = geometry.mesh_of_triangle, np.cumsum([0, *number])
    order = np.argsort(geometry.mirror_patch, kind="stable")
    order = order[np.searchsorted(geometry.mirror_patch[order], 0) :]
    for rows in np.split(order, np.flatnonzero(np.diff(geometry.mirror_patch[order])) + 1):
        patch: list[PlanarFacet] = []
        for m in np.unique(mesh[rows]):
            triangles = geometry.meshes[m].triangles[rows[mesh[rows] == m] - first[m]]
            piece = replace(geometry.meshes[m], triangles=triangles)
            facets = (_convex_facets(piece) if piece.least_patch else []) or planar_facets([piece])
            patch += [facet._replace(surface=int(m)) for facet in facets]
        yield patch


def _convex_facets(patch: SurfaceMesh) -> list[PlanarFacet]:
    """One parallelogram or triangle, or a fan of triangles, that is all of a coplanar patch; [] if it is not convex."""
    corners_m = patch.corners_m
    doubled_m2 = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    normal, slack_m = doubled_m2.sum(axis=0), 2 * rounding_m(corners_m)
    if (doubled_m2 @ normal <= 0).any():
        return []  # parts of it face the other way
    points_m = corners_m.reshape(-1, 3)
    axes = frame_rotation(tuple(normal / np.linalg.norm(normal)))[:, :2]
    hull = ConvexHull(points_m @ axes)  # in the plane its volume is an area, and its area a length
    if abs(np.linalg.norm(doubled_m2, axis=1).sum() / 2 - hull.volume) > slack_m * hull.area:
        return []
    ring_m = points_m[hull.vertices]
    while len(ring_m) > 3:  # leave out the corner that is nearest to the line between its neighbours
        before_m, after_m = np.roll(ring_m, 1, axis=0), np.roll(ring_m, -1, axis=0)
        chord_m = after_m - before_m
        off_m = np.linalg.norm(np.cross(ring_m - before_m, chord_m), axis=1) / np.linalg.norm(chord_m, axis=1)
        if off_m.min() > slack_m:
            break
        ring_m = np.delete(ring_m, off_m.argmin(), axis=0)
    if len(ring_m) == 4 and np.abs(ring_m[0] + ring_m[2] - ring_m[1] - ring_m[3]).max() < 2 * slack_m:
        return [PlanarFacet(ring_m, 0, normal)]
    return [PlanarFacet(ring_m[[0, k, k + 1]], 0, normal) for k in range(1, len(ring_m) - 1)]


def _in_planes_of_the_largest(facets: list[PlanarFacet]) -> tuple[Int[IntArray, "n"], list[PlanarFacet]]:
    """The largest facets, and for each facet the one in whose plane it lies.

    Only corners are compared: the normal of a facet as narrow as a needle means nothing.
    """
    corners_m = np.array([facet.corners_m[[0, 1, 2, -1]] for facet in facets]).reshape(-1, 4, 3)
    diagonal_m = np.linalg.norm(np.ptp(corners_m, axis=1), axis=1)
    own, largest = np.full(len(facets), -1), list[PlanarFacet]()
    for index in np.argsort(-diagonal_m, kind="stable"):
        if own[index] < 0:
            origin_m, along_m, *_, across_m = facets[index].corners_m
            normal = np.cross(along_m - origin_m, across_m - origin_m)
            height_m = np.abs((corners_m - origin_m) @ (normal / np.linalg.norm(normal))).max(axis=1)
            own[(own < 0) & (height_m < PLANE_TOLERANCE)] = len(largest)
            own[index] = len(largest)
            largest.append(facets[index])
    return own, largest


def facets_of(
    geometry: Geometry, mirrors: MirrorPlanes, kind: Int[IntArray, "2 S"], is_opaque: Bool[NDArray[np.bool_], "K"]
) -> tuple[Facets, Int[IntArray, "Q"], Float[FloatArray, "Q 4 3"]]:
    """The facets of a scene as the kernels take them, the mesh of each, and its corners, a triangle's last twice.

    `kind` is the slab of each mesh, as it is and with its back to the front, and `is_opaque` says whether a slab lets
    nothing through. The slab of a facet has its front at the side to which the normal of its plane points.

    Planes of mirrors come first; each triangle that does not mirror has a plane of its own.
    """
    blocks = triangle_corners_m(geometry.meshes)[~geometry.mirrors]
    normal = np.cross(blocks[:, 1] - blocks[:, 0], blocks[:, 2] - blocks[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normals = np.concatenate([mirrors.planes[:, :3], normal])
    offset_m = np.concatenate([mirrors.planes[:, 3], np.einsum("kc,kc->k", normal, blocks[:, 0])])
    plane = np.concatenate([mirrors.plane, len(mirrors.planes) + np.arange(len(blocks))])
    corners_m = np.concatenate([mirrors.corners_m, blocks[:, [0, 1, 2, 2]]])
    is_triangle = np.array([len(facet.corners_m) == 3 for facet in mirrors.facets] + [True] * len(blocks), bool)
    surface = np.array([facet.surface for facet in mirrors.facets], np.int64)
    surface = np.concatenate([surface, geometry.mesh_of_triangle[~geometry.mirrors]])
    front = np.concatenate([np.array([facet.front for facet in mirrors.facets]).reshape(-1, 3), normal])
    is_turned = np.einsum("qc,qc->q", front, normals[plane]) < 0
    order, box, child, first, last = grow(corners_m.min(axis=1), corners_m.max(axis=1))
    plane, surface, corners_m = plane[order], surface[order], corners_m[order]
    slab = kind[is_turned[order].astype(np.int64), surface]
    face = np.hstack([normals[plane], offset_m[plane, None], _duals(corners_m)])
    triangle, opaque, normal = is_triangle[order], is_opaque[slab], np.ascontiguousarray(normals.T)
    facets = Facets(normal, offset_m, face, triangle, plane, slab, opaque, box, child, first, last)
    return facets, surface, corners_m


def grow(
    low_m: Float[FloatArray, "Q 3"], high_m: Float[FloatArray, "Q 3"]
) -> tuple[Int[IntArray, "Q"], FloatArray, IntArray, IntArray, IntArray]:
    """Order of facets by leaves, and `box` to `last` of `Facets`, from the bounding box of each facet."""
    if not len(low_m):
        nothing = np.zeros(0, np.int64)
        return nothing, np.zeros((0, 6)), nothing, nothing, nothing
    return divide(np.hstack([low_m, high_m]))


def _duals(corners_m: Float[FloatArray, "Q 4 3"]) -> Float[FloatArray, "Q 8"]:
    """Vectors u* and v*, each with its offset: u = x·u* − offset runs 0…1 from corner 0 to 1, v from 0 to 2."""
    origin_m = corners_m[:, 0]
    edge_u, edge_v = corners_m[:, 1] - origin_m, corners_m[:, 2] - origin_m
    normal = np.cross(edge_u, edge_v)
    normal /= np.einsum("qc,qc->q", normal, normal)[:, None]
    dual_u, dual_v = np.cross(edge_v, normal), np.cross(normal, edge_u)
    offset_u, offset_v = (np.einsum("qc,qc->q", origin_m, dual)[:, None] for dual in (dual_u, dual_v))
    return np.hstack([dual_u, offset_u, dual_v, offset_v])
