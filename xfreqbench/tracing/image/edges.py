"""Edges at which waves diffract: sides of mirrors around which facets leave more than half of the space free.

A box has twelve, a screen has one along each free side of its rim. Facets that go on in one plane, a wall that
stands on the floor and the corner of a room as seen from inside leave half of the space or less. Triangles that do not
mirror, small parts of curved meshes, have no edges of their own; where they meet a mirror they are faces of its edges.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.scene.facets import PlanarFacet
from xfreqbench.scene.patches import PLANE_TOLERANCE
from xfreqbench.types import FloatArray, IntArray

BESIDE_M = 1e-3  # how far beside an edge a facet must reach to count as one of its faces; shorter edges are none
MIN_TURN_RAD = 1e-3  # by which the angle that is left free exceeds a half turn


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


class _Flat:
    """Facets as arrays (Q, …): normal, corner, dual vectors of two sides, bounding box, mesh, and whether it is turned.

    One is turned where its unit normal points to its back.
    """

    def __init__(
        self, mirrors: Sequence[PlanarFacet], triangles_m: Float[FloatArray, "K 3 3"], surface: IntArray
    ) -> None:
        mirrors_m = [facet.corners_m[[0, 1, 2, -1]] for facet in mirrors]
        corners_m = np.concatenate([mirrors_m, triangles_m[:, [0, 1, 2, 2]]])
        sides_m = corners_m[:, [1, 3]] - corners_m[:, :1]
        normal = np.cross(sides_m[:, 0], sides_m[:, 1])
        self.normal = normal / np.linalg.norm(normal, axis=1)[:, None]
        self.corner_m = corners_m[:, 0]
        self.dual = np.linalg.pinv(sides_m).transpose(0, 2, 1)
        is_triangle = [len(facet.corners_m) == 3 for facet in mirrors]
        self.is_triangle = np.array(is_triangle + [True] * len(triangles_m))
        self.low_m, self.high_m = corners_m.min(axis=1) - 2 * BESIDE_M, corners_m.max(axis=1) + 2 * BESIDE_M
        self.surface = np.concatenate([[facet.surface for facet in mirrors], surface])
        fronts = np.array([facet.front for facet in mirrors])
        self.is_turned = np.einsum("qc,qc->q", fronts, self.normal[: len(mirrors)]) < 0
        self.is_turned = np.concatenate([self.is_turned, np.zeros(len(triangles_m), bool)])


def find_edges(
    mirrors: Sequence[PlanarFacet], triangles_m: Float[FloatArray, "K 3 3"], surface: Int[IntArray, "K"]
) -> list[Edge]:
    """Edges of mirrors at which waves diffract, in the order of the mirrors.

    `triangles_m` are those that do not mirror, and `surface` their meshes. Pieces of a line around which the same
    surfaces leave the same angle are one edge.
    """
    if not mirrors:
        return []
    flat = _Flat(mirrors, triangles_m, surface)
    edges: list[Edge] = []
    for start_m, along, length_m in _pieces(mirrors):
        edge = _wedge(flat, start_m, along, length_m)
        if edge is not None and edges and _goes_on(edges[-1], edge):
            edges[-1] = edges[-1]._replace(length_m=edges[-1].length_m + length_m)
        elif edge is not None:
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


def _pieces(mirrors: Sequence[PlanarFacet]) -> Iterator[tuple[FloatArray, FloatArray, float]]:
    """Start, direction and length of the pieces into which corners of facets divide the lines of their sides."""
    start_m = np.concatenate([facet.corners_m for facet in mirrors])
    end_m = np.concatenate([np.roll(facet.corners_m, -1, axis=0) for facet in mirrors])
    left = np.linalg.norm(end_m - start_m, axis=1) > BESIDE_M
    while left.any():
        first = int(left.argmax())
        origin_m, along = start_m[first], end_m[first] - start_m[first]
        along = along / np.linalg.norm(along)
        is_on_line = left & (_distance_m(start_m, origin_m, along) < PLANE_TOLERANCE)
        is_on_line &= _distance_m(end_m, origin_m, along) < PLANE_TOLERANCE
        is_on_line[first] = True
        left &= ~is_on_line
        ends_m = (np.concatenate([start_m[is_on_line], end_m[is_on_line]]) - origin_m) @ along
        corner_m = (start_m[_distance_m(start_m, origin_m, along) < PLANE_TOLERANCE] - origin_m) @ along
        at_m = np.sort(corner_m[(corner_m >= ends_m.min()) & (corner_m <= ends_m.max())])
        at_m = at_m[np.diff(at_m, prepend=-np.inf) > BESIDE_M]
        for low_m, high_m in pairwise(at_m):
            yield origin_m + low_m * along, along, float(high_m - low_m)


def _distance_m(
    points_m: Float[FloatArray, "n 3"], origin_m: Float[FloatArray, "3"], along: Float[FloatArray, "3"]
) -> Float[FloatArray, "n"]:
    """Distances of points from a line."""
    return np.asarray(np.linalg.norm(np.cross(points_m - origin_m, along), axis=1))


def _wedge(flat: _Flat, start_m: Float[FloatArray, "3"], along: Float[FloatArray, "3"], length_m: float) -> Edge | None:
    """The wedge around a piece of a line, or None where its facets leave no more than half of the space free."""
    middle_m = start_m + length_m / 2 * along
    facets = np.flatnonzero(((flat.low_m < middle_m) & (middle_m < flat.high_m)).all(axis=1))
    gap_m = np.einsum("qi,qi->q", middle_m - flat.corner_m[facets], flat.normal[facets])
    is_along = np.abs(flat.normal[facets] @ along) < PLANE_TOLERANCE
    facets = facets[(np.abs(gap_m) < PLANE_TOLERANCE) & is_along]
    beside = np.cross(flat.normal[facets], along)
    facets, towards = np.tile(facets, 2), np.concatenate([beside, -beside])
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    point_m = middle_m + BESIDE_M * towards - flat.corner_m[facets]
    u, v = np.einsum("nci,ni->cn", flat.dual[facets], point_m)
    is_face = (u > 0) & (v > 0) & np.where(flat.is_triangle[facets], u + v < 1, (u < 1) & (v < 1))
    face, towards = facets[is_face], towards[is_face]
    if len(face) == 0:
        return None
    across = np.cross(along, towards[0])
    angle_rad = np.arctan2(towards @ across, towards @ towards[0]) % (2 * np.pi)
    angle_rad[angle_rad > 2 * np.pi - MIN_TURN_RAD] = 0.0  # the first facet again, rounded
    order = np.argsort(angle_rad, kind="stable")
    free_rad = np.diff(angle_rad[order], append=angle_rad[order[0]] + 2 * np.pi)
    widest = int(free_rad.argmax())
    if free_rad[widest] < np.pi + MIN_TURN_RAD:
        return None
    zero, n = order[widest], order[(widest + 1) % len(order)]
    normal, normal_n = np.cross(along, towards[zero]), np.cross(towards[n], along)
    surfaces = int(flat.surface[face[zero]]), int(flat.surface[face[n]])
    turned, turned_n = (
        bool((flat.normal[face[i]] @ free < 0) != flat.is_turned[face[i]])
        for i, free in ((zero, normal), (n, normal_n))
    )
    return Edge(start_m, along, towards[zero], normal, length_m, float(free_rad[widest]), surfaces, (turned, turned_n))
