"""Planar facets of triangle meshes, and the planes that they lie in.

The image method reflects at facets and mirrors in planes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from xfreqbench.scene.materials import Scattering
from xfreqbench.scene.meshes import SurfaceMesh, surface_meshes
from xfreqbench.scene.model import Scene
from xfreqbench.scene.patches import PLANE_TOLERANCE, mirror_patches
from xfreqbench.types import FloatArray, IntArray, NDArray


class PlanarFacet(NamedTuple):
    """A parallelogram or triangle of one surface, its corners in turn (n = 4 or 3)."""

    corners_m: Float[FloatArray, "n 3"]
    surface: int  # index of its mesh
    front: Float[FloatArray, "3"]  # towards its front, of any length


class Geometry:
    """What rays can meet in a scene: its meshes, and their facets and mirrors, which are computed once."""

    def __init__(self, meshes: Sequence[SurfaceMesh]) -> None:
        self.meshes = list(meshes)

    @classmethod
    def of(cls, scene: Scene) -> Geometry:
        """That of a scene; raises `SceneError` for meshes that cannot be read."""
        return cls(surface_meshes(scene))

    @property
    def num_triangles(self) -> int:
        """Triangles of all meshes."""
        return sum(len(mesh.triangles) for mesh in self.meshes)

    @property
    def mesh_of_triangle(self) -> Int[IntArray, "K"]:
        """Index of each triangle's mesh."""
        return np.repeat(np.arange(len(self.meshes)), [len(mesh.triangles) for mesh in self.meshes])

    @property
    def scattering(self) -> list[tuple[str, Scattering]]:
        """Every rough material by name, and how it scatters."""
        rough = {(str(mesh.material), mesh.scattering) for mesh in self.meshes if mesh.scattering}
        return sorted(rough, key=repr)

    @cached_property
    def mirrors(self) -> Bool[NDArray[np.bool_], "K"]:
        """Whether each triangle mirrors, meshes in order."""
        return np.asarray(self.mirror_patch >= 0)

    @cached_property
    def mirror_patch(self) -> Int[IntArray, "K"]:
        """Number of the patch in which each triangle mirrors, or −1, as `mirror_patches` returns them."""
        return mirror_patches(self.meshes)

    @property
    def num_mirrors(self) -> int:
        """Patches that mirror, and triangles of the meshes of which every triangle does."""
        free = sum(len(mesh.triangles) - 1 for mesh in self.meshes if mesh.least_patch is None)
        return len(np.unique(self.mirror_patch[self.mirrors])) + free

    @cached_property
    def facets(self) -> list[PlanarFacet]:
        """Facets of all meshes, as `planar_facets` returns them."""
        return planar_facets(self.meshes)


def planar_facets(meshes: Sequence[SurfaceMesh]) -> list[PlanarFacet]:
    """Facets of all meshes, in their order: two triangles that form a parallelogram are one facet."""
    return [
        PlanarFacet(corners_m, surface, front)
        for surface, mesh in enumerate(meshes)
        for corners_m, front in mesh.outlines_m
    ]


def group_by_plane(facets: Sequence[PlanarFacet]) -> tuple[Float[FloatArray, "P 4"], Int[IntArray, "Q"]]:
    """The P distinct planes of Q facets, each as unit normal n and offset n·x, and each facet's plane.

    Facets are taken in turn, the largest first, since its plane is known best. One that has no plane yet makes a new
    plane, for itself and for all others without one whose normals and corners are within `PLANE_TOLERANCE` of it.
    Planes come in lexicographic order.
    """
    if not facets:
        return np.zeros((0, 4)), np.zeros(0, dtype=np.int64)
    corners_m = np.array([facet.corners_m[[0, 1, 2, -1]] for facet in facets])  # a triangle's last twice
    planes = _planes(corners_m)
    diagonal_m = np.linalg.norm(np.ptp(corners_m, axis=1), axis=1)
    plane = np.full(len(facets), -1)
    claimants: list[int] = []
    for facet in np.argsort(-diagonal_m, kind="stable"):
        if plane[facet] < 0:
            normal, offset_m = planes[facet, :3], planes[facet, 3]
            tilt_rad = np.minimum(*(np.linalg.norm(planes[:, :3] + side, axis=1) for side in (normal, -normal)))
            distance_m = np.abs(corners_m @ normal - offset_m).max(axis=1)
            is_within = (tilt_rad < PLANE_TOLERANCE) & (distance_m < PLANE_TOLERANCE)
            plane[(plane < 0) & is_within] = len(claimants)
            plane[facet] = len(claimants)  # though its fourth corner may stand a little off its own plane
            claimants.append(int(facet))
    distinct = planes[claimants]
    order = np.lexsort(np.round(distinct / PLANE_TOLERANCE).T[::-1])
    return distinct[order], np.argsort(order)[plane].astype(np.int64)


def _planes(corners_m: Float[FloatArray, "Q 4 3"]) -> Float[FloatArray, "Q 4"]:
    """Unit normal, its first component beyond ±0.1 positive, and offset of each facet's plane."""
    normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, -1] - corners_m[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    leading = (np.abs(normal) > 0.1).argmax(axis=1)
    normal *= np.sign(np.take_along_axis(normal, leading[:, None], axis=1))
    return np.hstack([normal, np.einsum("qc,qc->q", normal, corners_m[:, 0])[:, None]])
