"""Edges at which waves diffract: sides of mirrors around which facets leave more than half of the space free.

A box has twelve, a screen has one along each free side of its rim. Facets that go on in one plane, a wall that
stands on the floor and the corner of a room as seen from inside leave half of the space or less. Triangles that do not
mirror, small parts of curved meshes, have no edges of their own; where they meet a mirror they are faces of its edges.
Neither has a groove, a gap of less than 1 cm in a plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.scene.facets import PlanarFacet
from xfreqbench.scene.patches import PLANE_TOLERANCE
from xfreqbench.system.bars import report
from xfreqbench.tracing.image.kernels.edges import BESIDE_M, MIN_TURN_RAD, Flat, pieces, wedge_around
from xfreqbench.tracing.image.surfaces import grow
from xfreqbench.types import FloatArray, IntArray


class Edge(NamedTuple):
    """A straight edge and the wedge around it: the angle from its face 0 to its face n, through free space.

    A point is at the angle φ with tan φ = (x·normal) / (x·tangent), x from the edge, so face 0 is at φ = 0 and
    face n at `angle_rad`. A screen's rim has both faces in one facet, and the angle 2π.
    """

    start_m: Float[FloatArray, "3"]
    along: Float[FloatArray, "3"]
    tangent: Float[FloatArray, "3"]
    normal: Float[FloatArray, "3"]
    length_m: float
    angle_rad: float
    surfaces: tuple[int, int]  # indices of the meshes that faces 0 and n are of
    are_turned: tuple[bool, bool]  # whether they show their backs to the free space


def _flat(mirrors: Sequence[PlanarFacet], triangles_m: Float[FloatArray, "K 3 3"]) -> Flat:
    """Facets as the kernels take them."""
    mirrors_m = [facet.corners_m[[0, 1, 2, -1]] for facet in mirrors]
    corners_m = np.concatenate([mirrors_m, triangles_m[:, [0, 1, 2, 2]]])
    low_m, high_m = corners_m.min(axis=1) - 2 * BESIDE_M, corners_m.max(axis=1) + 2 * BESIDE_M
    order, box, child, first, last = grow(low_m, high_m)
    sides_m = corners_m[order][:, [1, 3]] - corners_m[order, :1]
    normal = np.cross(sides_m[:, 0], sides_m[:, 1])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    dual = np.ascontiguousarray(np.linalg.pinv(sides_m).transpose(0, 2, 1))
    is_triangle = np.array([len(facet.corners_m) == 3 for facet in mirrors] + [True] * len(triangles_m))
    return Flat(order, normal, corners_m[order, 0], dual, is_triangle[order], box, child, first, last)


def find_edges(
    mirrors: Sequence[PlanarFacet], triangles_m: Float[FloatArray, "K 3 3"], surface: Int[IntArray, "K"]
) -> list[Edge]:
    """Edges of mirrors at which waves diffract, in the order of the mirrors.

    `triangles_m` are those that do not mirror, and `surface` their meshes. Pieces of a line around which the same
    surfaces leave the same angle are one edge.
    """
    if not mirrors:
        return []
    flat = _flat(mirrors, triangles_m)
    surface = np.concatenate([[facet.surface for facet in mirrors], surface])
    fronts = np.array([facet.front for facet in mirrors])
    corners_m = [facet.corners_m for facet in mirrors]
    ends_m = [np.roll(facet, -1, axis=0) for facet in corners_m]
    edges: list[Edge] = []
    lines = pieces(np.concatenate(corners_m), np.concatenate(ends_m))
    for number, (start_m, along, length_m) in enumerate(lines):
        if number % 1000 == 0:
            report("looking for edges", number, len(lines))
        angle_rad, towards, face = wedge_around(flat, start_m, along, length_m)
        if not angle_rad:
            continue
        normals = np.cross(along, towards[0]), np.cross(towards[1], along)
        of_face = flat.number[face]
        turned, turned_n = (
            bool((fronts[i] if i < len(fronts) else flat.normal[q]) @ normal < 0)
            for i, q, normal in zip(of_face, face, normals, strict=True)
        )
        faces = int(surface[of_face[0]]), int(surface[of_face[1]])
        edge = Edge(start_m, along, towards[0], normals[0], length_m, angle_rad, faces, (turned, turned_n))
        if edges and _goes_on(edges[-1], edge):
            edges[-1] = edges[-1]._replace(length_m=edges[-1].length_m + length_m)
        else:
            edges.append(edge)
    return edges


def _goes_on(before: Edge, after: Edge) -> bool:
    """Whether an edge begins where another ends, with the same wedge around it."""
    end_m = before.start_m + before.length_m * before.along
    return bool(
        before.surfaces == after.surfaces
        and abs(before.angle_rad - after.angle_rad) < MIN_TURN_RAD
        and np.linalg.norm(after.start_m - end_m) < PLANE_TOLERANCE
        and before.along @ after.along > 1 - PLANE_TOLERANCE
        and before.tangent @ after.tangent > 1 - PLANE_TOLERANCE
    )
