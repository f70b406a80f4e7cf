"""First-order diffraction at the edges of a scene, for the image solver.

A path may be reflected before and after the edge and pass through slabs, within the depth limit. How the receiver
sees the edges is found once, how a transmitter does for each.
"""

from __future__ import annotations

from copy import copy
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import triangle_corners_m
from xfreqbench.tracing.image.edges import Edge, find_edges
from xfreqbench.tracing.image.kernels.arrays import NUM_CHUNKS, CentrePath, Facets, Media, SceneArrays, Sums
from xfreqbench.tracing.image.kernels.compiled import on_threads
from xfreqbench.tracing.image.kernels.edge_paths import (
    ARRAY_REACH,
    EdgeContext,
    Limits,
    add_over_edges,
    paths_over_edges,
)
from xfreqbench.tracing.image.kernels.edge_sides import Reflectors, Sides, find_sides, open_spans
from xfreqbench.tracing.image.kernels.slabs import stack_coefficients
from xfreqbench.tracing.image.kernels.wedges import SCREEN_RAD, Wedges
from xfreqbench.tracing.image.surfaces import MirrorPlanes
from xfreqbench.types import FloatArray, IntArray, NDArray

COSINES = 65  # at which reflection is tabulated


class Diffraction:
    """Edges of one scene and how its receiver sees them, ready for any transmitter.

    `kind` is the slab of each mesh, as it is and with its back to the front; `surface` and `corners_m` are the mesh and
    the corners of the kernels' facets.
    `points_m` are the array's centre and corners.
    """

    def __init__(
        self,
        geometry: Geometry,
        mirrors: MirrorPlanes,
        kind: Int[IntArray, "2 S"],
        scene: SceneArrays,
        surface: Int[IntArray, "Q"],
        corners_m: Float[FloatArray, "Q 4 3"],
        points_m: Float[FloatArray, "O 3"],
        limits: Limits,
    ) -> None:
        facets = scene.facets
        blocks = ~geometry.mirrors
        triangles_m = triangle_corners_m(geometry.meshes)[blocks]
        edges = find_edges(mirrors.facets, triangles_m, geometry.mesh_of_triangle[blocks])
        faces = np.array([edge.surfaces for edge in edges], np.int64).reshape(-1, 2)
        is_opaque = np.zeros(len(geometry.meshes), bool)
        is_opaque[surface] = facets.is_opaque
        are_turned = np.array([edge.are_turned for edge in edges], np.int64).reshape(-1, 2)
        slab = np.stack([kind[are_turned, faces], kind[1 - are_turned, faces]], axis=2)
        wedges = _wedges(edges, slab, is_opaque[faces], limits.max_depth)
        reflectors = _reflectors(mirrors, facets, corners_m, scene.media)
        sides = find_sides(facets, reflectors, wedges, 1 + wedges.has_inside, points_m, limits.max_planes)
        wedges, sides, is_seen = _seen(facets, wedges, sides, points_m - points_m[0], limits.max_depth)
        self._surfaces = surface, faces[is_seen, 0].copy()
        ends = _ends_for(sides, wedges, scene.aperture.radius_m)
        self.room, self._sought = EdgeContext(scene, wedges, reflectors, ends), (sides, limits)

    def in_scene(self, scene: SceneArrays) -> Diffraction:
        """The same edges for a scene that differs in its antennas alone."""
        other = copy(self)
        other.room = self.room._replace(scene=scene)
        return other

    def add_channel(self, tx_m: Float[FloatArray, "3"], floor: float, sums: Sums, num_paths: NDArray[np.int32]) -> None:
        """Add the channel (F, M) over edges to that of all other paths of a transmitter, carriers ascending.

        Paths that a bound shows to be weaker than `floor`, amplitude over wavelength in 1/m, are skipped.
        """
        add_over_edges(self.room, *self._sought, tx_m[None], floor, sums, num_paths)

    def paths(self, tx_m: Float[FloatArray, "3"], floor: float) -> list[CentrePath]:
        """The paths to the array centre that `add_channel` adds; carriers ascend."""
        return paths_over_edges(self.room, *self._sought, *self._surfaces, tx_m[None], floor)


def _wedges(
    edges: list[Edge], slab: Int[IntArray, "E 2 2"], is_opaque: Bool[NDArray[np.bool_], "E 2"], max_depth: int
) -> Wedges:
    """Edges as the kernels take them."""
    angle_rad = np.array([edge.angle_rad for edge in edges])
    start_m, along, tangent, normal = (np.array([edge[i] for edge in edges]).reshape(-1, 3) for i in range(4))
    length_m = np.array([edge.length_m for edge in edges])
    inside_rad = 2 * np.pi - angle_rad
    num_turns = np.minimum(np.ceil(np.pi / np.maximum(inside_rad, SCREEN_RAD) - 1e-6) - 1, max_depth).astype(np.int64)
    num_turns[inside_rad < SCREEN_RAD] = 1
    num_turns[is_opaque.all(axis=1)] = 0
    has_inside = (inside_rad > SCREEN_RAD) & (~is_opaque.all(axis=1) | (inside_rad > np.pi / 2 + SCREEN_RAD))
    return Wedges(
        start_m, along, tangent, normal, length_m, angle_rad, slab, np.asarray(is_opaque), num_turns, has_inside
    )


def _ends_for(sides: Sides, wedges: Wedges, radius_m: float) -> Int[IntArray, "E"]:
    """Which other ends count at each edge, for `Search`: none where the array does not see it, those outside of its
    wedge where the whole array is inside, with no term for two ends inside.
    """
    free_rad = wedges.angle[sides.edge]
    distance_m, _, phi_rad = sides.polar.T
    is_inside = np.minimum(phi_rad - free_rad, 2 * np.pi - phi_rad) * distance_m > ARRAY_REACH * radius_m
    counts_inside = wedges.has_inside[sides.edge] & ~(is_inside & (free_rad > 1.5 * np.pi - SCREEN_RAD))
    ends = np.zeros(len(wedges.length), np.int64)
    np.maximum.at(ends, sides.edge, 1 + counts_inside)
    return ends


def _seen(
    facets: Facets, wedges: Wedges, sides: Sides, offset_m: Float[FloatArray, "O 3"], max_depth: int
) -> tuple[Wedges, Sides, Bool[NDArray[np.bool_], "E"]]:
    """The parts of edges that sides see past all facets, the sides that see any, and which of the edges these are."""
    bounds = np.linspace(0, len(sides.edge), NUM_CHUNKS + 1).astype(int)

    def look(chunk: int) -> FloatArray:
        return open_spans(facets, wedges, sides, offset_m, max_depth, *bounds[chunk : chunk + 2])

    span_m = np.concatenate(on_threads(look, NUM_CHUNKS, "looking along edges"))
    is_open = span_m[:, 0] < span_m[:, 1]
    edge, span_m = sides.edge[is_open], span_m[is_open]
    low_m, high_m = np.full(len(wedges.length), np.inf), np.full(len(wedges.length), -np.inf)
    np.minimum.at(low_m, edge, span_m[:, 0])
    np.maximum.at(high_m, edge, span_m[:, 1])
    is_seen = low_m < high_m
    kept = Wedges._make(column[is_seen] for column in wedges)
    low_m, high_m = np.maximum(low_m, 0.0), np.minimum(high_m, wedges.length)
    start_m = kept.start + low_m[is_seen, None] * kept.along
    sides = Sides._make([sides.first, *(column[is_open] for column in sides[1:])])
    polar = sides.polar.copy()
    polar[:, 1] -= low_m[edge]
    number = np.cumsum(is_seen)[edge] - 1
    sides = sides._replace(
        first=np.searchsorted(number, np.arange(is_seen.sum() + 1)),
        edge=number,
        polar=polar,
        span=span_m - low_m[edge, None],
    )
    return kept._replace(start=start_m, length=(high_m - low_m)[is_seen]), sides, is_seen


def _reflectors(
    mirrors: MirrorPlanes, facets: Facets, corners_m: Float[FloatArray, "Q 4 3"], media: Media
) -> Reflectors:
    """The facets of each plane that mirrors, and bounds of what the planes reflect at each carrier."""
    facet = np.argsort(facets.plane, kind="stable")
    first = np.searchsorted(facets.plane[facet], np.arange(len(mirrors.planes) + 1))
    facet = facet[: first[-1]]
    cosines = np.linspace(0, 1, COSINES)
    most = np.empty((len(media.permittivity), len(media.first) - 1, COSINES))  # (F, K, L)
    for f, kind in np.ndindex(most.shape[:2]):
        layers = slice(*media.first[kind : kind + 2])
        eta, phase = media.permittivity[f, layers], media.phase_thickness[f, layers]
        sides = [(eta, phase), (eta[::-1], phase[::-1])][: len(eta)]
        largest = [max(np.abs(stack_coefficients(c, *side)[:2]).max() for side in sides) for c in cosines]
        most[f, kind] = np.maximum.accumulate(largest[::-1])[::-1]
    by_facet = most[:, facets.slab[facet]]
    of_plane = [by_facet[:, a:b].max(axis=1) for a, b in pairwise(first)]
    by_plane = np.array(of_plane).reshape(-1, len(most), COSINES).swapaxes(0, 1).copy()
    axis = np.ascontiguousarray(mirrors.axis[:, :2])
    place_m = np.einsum("qkc,qac->qak", corners_m[facet], axis[facets.plane[facet]])
    box = np.stack([place_m.min(axis=2), place_m.max(axis=2)], axis=2).reshape(-1, 4)
    return Reflectors(first, facet, corners_m[facet], axis, box, by_plane)
