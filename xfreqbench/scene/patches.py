"""Which triangles of a scene mirror: of imported meshes only those in coplanar patches that are large enough.

A facet that is small compared with the wavelength scatters a wave and does not act as a mirror. Rays that treat it as a
mirror find glints: paths by facets of some square centimetres, which mean nothing and which no number of rays finds all
of.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.scene.meshes import SurfaceMesh, triangle_corners_m
from xfreqbench.scene.model import NEAR_M
from xfreqbench.types import FloatArray, IntArray, NDArray

PLANE_TOLERANCE = 1e-4  # metres, and radians: facets that differ by less share a plane; float32 errs by less


def mirror_patches(meshes: Sequence[SurfaceMesh]) -> Int[IntArray, "K"]:
    """Number of the patch in which each triangle mirrors, meshes in order, and −1 where it does not mirror.

    What mirrors is said at `SurfaceMesh.least_patch`. Patches may span such meshes. A mesh of which every triangle
    mirrors has one number, though it lies in several planes.
    """
    num_triangles = [len(mesh.triangles) for mesh in meshes]
    bound = [mesh for mesh in meshes if mesh.least_patch is not None]
    if not bound:
        return np.repeat(np.arange(len(meshes)), num_triangles)
    patches = Patches(triangle_corners_m(bound))
    least = [mesh.least_patch or (0.0, 0.0) for mesh in bound]
    least_area_m2, least_width_m = np.repeat(least, [len(mesh.triangles) for mesh in bound], axis=0).T
    is_large = patches.area_m2[patches.index] >= least_area_m2
    is_large &= patches.width_m[patches.index] >= least_width_m
    number = np.repeat(len(patches.area_m2) + np.arange(len(meshes)), num_triangles)
    is_bound = np.repeat([mesh.least_patch is not None for mesh in meshes], num_triangles)
    number[is_bound] = np.where(is_large, patches.index, -1)
    return number


class Patches:
    """The P coplanar patches of K triangles: those that share edges and lie in one plane are of one patch.

    `index` (K,) is the patch of each triangle, `area_m2` (P,) the area of each patch, and `width_m` (P,) its width:
    4·area / perimeter (the hydraulic diameter), which is the side of a square, the diameter of a disc, and twice the
    width of a long strip, straight or bent to a ring. A triangle that is given twice counts once; where nothing is
    at the border, the width is infinite.
    """

    def __init__(self, corners_m: Float[FloatArray, "K 3 3"]) -> None:
        vertex = _welded(corners_m)
        normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
        doubled_m2 = np.linalg.norm(normal, axis=1)
        normal /= doubled_m2[:, None]
        self.index = _coplanar(corners_m, normal, doubled_m2, *_neighbours(vertex))
        num_patches = int(self.index.max(initial=-1)) + 1
        distinct = np.unique(_numbered(*np.sort(vertex, axis=1).T), return_index=True)[1]
        patch = self.index[distinct]
        self.area_m2 = np.bincount(patch, weights=doubled_m2[distinct] / 2, minlength=num_patches)
        edge, length_m = _edges(vertex[distinct]), sides_m(corners_m[distinct]).T.reshape(-1)
        _, first, count = np.unique(_numbered(edge, np.tile(patch, 3)), return_index=True, return_counts=True)
        border = first[count == 1]
        perimeter_m = np.bincount(np.tile(patch, 3)[border], weights=length_m[border], minlength=num_patches)
        with np.errstate(divide="ignore"):
            self.width_m = 4 * self.area_m2 / perimeter_m


def _coplanar(
    corners_m: Float[FloatArray, "K 3 3"],
    normal: Float[FloatArray, "K 3"],
    doubled_m2: Float[FloatArray, "K"],
    near: Int[IntArray, "n"],
    far: Int[IntArray, "n"],
) -> Int[IntArray, "K"]:
    """Patch of each triangle, from its normal, twice its area, and all pairs of neighbours.

    Neighbours are parallel where their normals differ by no more than `PLANE_TOLERANCE`, or than what float32 leaves
    uncertain about the normal of a triangle as narrow as the narrower. So that a gently curved surface is not a patch,
    all triangles of a patch lie within `PLANE_TOLERANCE` of the plane through its largest along the mean normal; those
    beyond make others.
    """
    height_m = doubled_m2 / sides_m(corners_m).max(axis=1)
    uncertain_m = 2.0 * rounding_m(corners_m)
    tilt = np.linalg.norm(np.cross(normal[near], normal[far]), axis=1)
    joined = tilt <= PLANE_TOLERANCE + uncertain_m / np.minimum(height_m[near], height_m[far])
    by_area, largest = np.argsort(doubled_m2, kind="stable"), np.zeros(len(normal), dtype=np.int64)
    while True:
        near, far = near[joined], far[joined]
        patch = components(near, far, len(normal))
        largest[patch[by_area]] = by_area
        claimant = largest[patch]
        upwards = np.sign(np.einsum("kc,kc->k", normal, normal[claimant])) * doubled_m2
        mean = np.stack([np.bincount(patch, weights=upwards * normal[:, axis]) for axis in range(3)], axis=1)
        mean = mean / np.linalg.norm(mean, axis=1, keepdims=True)
        offset_m = np.einsum("kci,ki->kc", corners_m - corners_m[claimant, :1], mean[patch])
        is_beyond = np.abs(offset_m).max(axis=1, initial=0.0) > PLANE_TOLERANCE
        is_beyond[largest[: len(mean)]] = False
        if not is_beyond.any():
            return patch
        joined = is_beyond[near] == is_beyond[far]


def rounding_m(corners_m: Float[FloatArray, "K 3 3"]) -> float:
    """The step of float32 at the largest coordinate, or, far from the origin, at the extent of what is no float32."""
    reach_m = np.abs(corners_m).max(initial=1.0)
    if reach_m > NEAR_M and (corners_m.astype(np.float32) != corners_m).any():
        reach_m = min(reach_m, max(NEAR_M, np.ptp(corners_m, axis=(0, 1)).max()))
    return float(np.spacing(np.float32(reach_m)))


def sides_m(corners_m: Float[FloatArray, "K 3 3"]) -> Float[FloatArray, "K 3"]:
    """Lengths of the three sides of each triangle."""
    return np.linalg.norm(corners_m - np.roll(corners_m, -1, axis=1), axis=2)


def _numbered(*columns: NDArray[Any]) -> Int[IntArray, "n"]:
    """A number for each row of some columns, the same for equal rows."""
    number = np.zeros(len(columns[0]), dtype=np.int64)
    for column in columns:
        values, index = np.unique(column, return_inverse=True)
        number = np.unique(number * len(values) + index, return_inverse=True)[1]
    return number


def _welded(corners_m: Float[FloatArray, "K 3 3"]) -> Int[IntArray, "K 3"]:
    """Index of the vertex at each corner; corners that float32 can hardly distinguish share one.

    Formats like PLY and STL may repeat a vertex for each of its triangles, rounded each time.
    """
    from scipy.spatial import cKDTree

    place_m = corners_m.reshape(-1, 3)
    _, first, vertex = np.unique(_numbered(*place_m.T), return_index=True, return_inverse=True)
    if not len(first):
        return np.zeros((0, 3), dtype=np.int64)
    near = cKDTree(place_m[first]).query_pairs(2.0 * rounding_m(corners_m), output_type="ndarray")
    return components(near[:, 0], near[:, 1], len(first))[vertex].reshape(-1, 3)


def components(first: IntArray, second: IntArray, number: int) -> Int[IntArray, "n"]:
    """Index of the connected component of each of so many things, from pairs that are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(first)), (first, second)), shape=(number, number))
    return connected_components(links, directed=False)[1].astype(np.int64)


def _edges(vertex: Int[IntArray, "K 3"]) -> Int[IntArray, "e"]:
    """Number of each triangle's edges: of all first sides, then of all second, then of all third."""
    ends = np.sort(np.concatenate([vertex[:, [0, 1]], vertex[:, [1, 2]], vertex[:, [2, 0]]]), axis=1)
    return _numbered(*ends.T)


def _neighbours(vertex: Int[IntArray, "K 3"]) -> tuple[IntArray, IntArray]:
    """Pairs of triangles that share an edge; of many on one edge, each and the next 16."""
    edge, triangle = _edges(vertex), np.tile(np.arange(len(vertex)), 3)
    order = np.argsort(edge, kind="stable")
    edge, triangle = edge[order], triangle[order]
    most = int(np.bincount(edge).max(initial=1))
    pairs = [
        (triangle[:-apart][same], triangle[apart:][same])
        for apart in range(1, min(most, 16 + 1))
        for same in [edge[:-apart] == edge[apart:]]
    ]
    nothing = np.zeros(0, dtype=np.int64)
    first, second = zip((nothing, nothing), *pairs, strict=True)
    return np.concatenate(first), np.concatenate(second)
