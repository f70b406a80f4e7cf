"""Surfaces of different materials that lie in one plane and overlap: what a ray meets there is undefined."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from xfreqbench.angles import FloatArray
from xfreqbench.errors import SceneError
from xfreqbench.facets import group_by_plane, planar_facets
from xfreqbench.mesh import SurfaceMesh

MIN_OVERLAP_M = 1e-4  # edges may touch, and PLY files hold float32
MAX_FACETS = 2000  # pairs of more would take longer than the tracing


def check_overlaps(meshes: Sequence[SurfaceMesh]) -> None:
    """Raise `SceneError` naming the first two surfaces of different slabs that overlap in one plane."""
    if sum(len(mesh.triangles) for mesh in meshes) > MAX_FACETS:
        return
    facets = planar_facets(meshes)
    _, plane = group_by_plane(facets)
    for index in np.unique(plane):
        for first, second in combinations(np.flatnonzero(plane == index), 2):
            a, b = meshes[facets[first].surface], meshes[facets[second].surface]
            is_same_slab = (a.material, a.thickness_m) == (b.material, b.thickness_m)
            if not is_same_slab and _overlap(facets[first].corners_m, facets[second].corners_m):
                raise SceneError(
                    f"{a.name!r} ({a.material}) and {b.name!r} ({b.material}) overlap in one plane: a ray could "
                    "meet either. Cut the one out of the other, or set them at least 1 cm apart."
                )


def _overlap(first_m: Float[FloatArray, "m 3"], second_m: Float[FloatArray, "n 3"]) -> bool:
    """Whether two convex facets of one plane share an area: no edge separates them."""
    normal = np.cross(first_m[1] - first_m[0], first_m[-1] - first_m[0])
    for corners in (first_m, second_m):
        for edge in np.roll(corners, -1, axis=0) - corners:
            axis = np.cross(normal, edge)
            axis = axis / np.linalg.norm(axis)
            along_first, along_second = first_m @ axis, second_m @ axis
            shared_m = min(along_first.max(), along_second.max()) - max(along_first.min(), along_second.min())
            if shared_m < MIN_OVERLAP_M:
                return False
    return True
