"""Solver `image` among many facets: furnished rooms as meshes, of whose triangles only large patches mirror.

It is the method of `tracer` on other data structures: what segments meet is looked up in a tree of boxes, and
candidates are nodes of a trie (`trie_kernels`), for any number of planes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from xfreqbench.scene.facets import PLANE_TOLERANCE, Geometry, PlanarFacet, group_by_plane, planar_facets
from xfreqbench.scene.meshes import surface_meshes, triangle_corners_m
from xfreqbench.scene.model import Scene
from xfreqbench.system.arguments import Position, Positions, checked
from xfreqbench.tracing.image import furnished_kernels
from xfreqbench.tracing.image.box_tree import BoxTree, grow
from xfreqbench.tracing.image.kernels import Aperture, Facets
from xfreqbench.tracing.image.tracer import (
    UNPRUNED_M,
    ImageSavings,
    ImageTracer,
    aperture_of,
    are_opaque,
    interactions_along,
    is_furnished,
    media_of,
    require_solvable,
)
from xfreqbench.tracing.image.trie_kernels import Shots, Trie
from xfreqbench.tracing.paths import Paths
from xfreqbench.tracing.tracer import Channel, TraceSettings
from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S


def image_tracer(
    scene: Scene,
    carrier_hz: Sequence[float],
    settings: TraceSettings,
    savings: ImageSavings = ImageSavings(),
    geometry: Geometry | None = None,
) -> ImageTracer | FurnishedTracer:
    """The image method on one scene, on the data structures that suit it; raises `SceneError` as both do."""
    geometry = geometry or Geometry(surface_meshes(scene))
    tracer = FurnishedTracer if is_furnished(geometry, settings) else ImageTracer
    return tracer(scene, carrier_hz, settings, savings, geometry)


class FurnishedTracer:
    """The image method on one scene of many facets, ready for any transmitter: a `Tracer`.

    Raises `SceneError` for interactions or scenes that `can_solve` declines.
    """

    def __init__(
        self,
        scene: Scene,
        carrier_hz: Sequence[float],
        settings: TraceSettings,
        savings: ImageSavings = ImageSavings(),
        geometry: Geometry | None = None,
    ) -> None:
        geometry = geometry or Geometry(surface_meshes(scene))
        require_solvable(scene, geometry, settings)
        self.settings = settings
        self.savings = savings
        self.carrier_hz = np.asarray(carrier_hz, dtype=np.float64)
        self._order = np.argsort(self.carrier_hz, kind="stable")
        ascending = self.carrier_hz[self._order]
        self._media, kind = media_of(geometry.meshes, ascending, settings.materials, scene.receiver)
        is_opaque = are_opaque(self._media) | ("refraction" not in settings.interactions)
        mirrors = MirrorPlanes(geometry)
        self._facets, self._tree, self._surface = planted(geometry, mirrors, kind, is_opaque)
        self._aperture = aperture_of(scene.receiver, SPEED_OF_LIGHT_M_S / ascending, savings)
        quads = _quads(scene.receiver.rows, scene.receiver.cols)
        alone = np.repeat(np.unique(quads)[:, None], 4, axis=1)
        self._quads = quads if savings.share_visibility else alone
        receiver_m = np.asarray(scene.receiver.position_m, dtype=np.float64)
        origins_m = np.unique(np.vstack([receiver_m, receiver_m + self._aperture.corner_m[0]]), axis=0)
        parent, plane = self._sequences(origins_m, len(mirrors.planes))
        self._trie = trie_of(parent, plane, mirrors, receiver_m, self._aperture)

    def _sequences(
        self, origins_m: Float[FloatArray, "O 3"], num_planes: int
    ) -> tuple[Int[IntArray, "N"], Int[IntArray, "N"]]:
        """Parent and last plane of the sequences that rays find, parents first; the empty one, −1, is first."""
        keys = np.array([-1])
        if num_planes and self.settings.max_depth and "specular" in self.settings.interactions:
            rng = np.random.default_rng(self.settings.seed)
            turn_rad = rng.uniform(0, 2 * np.pi, len(origins_m))
            num_rays = max(1, self.settings.rays // len(origins_m))
            shots = Shots(origins_m, turn_rad, num_rays, self.settings.max_depth, num_planes)
            keys = furnished_kernels.launch(self._facets, self._tree, shots)
        parent, plane = np.divmod(keys, max(1, num_planes))
        parent[0] = plane[0] = -1
        return parent, plane

    @checked
    def channel(self, tx_position_m: Positions) -> Channel:
        """Channel (T, F, M) of T transmitters at the array's elements, and the number of paths (T, F)."""
        real, imag, num_paths = furnished_kernels.channels(
            self._facets,
            self._tree,
            self._media,
            self._trie,
            self._aperture,
            self._quads,
            np.ascontiguousarray(tx_position_m, dtype=np.float64),
            self.settings.max_depth,
            self.savings.share_visibility,
        )
        cfr = np.empty(real.shape, dtype=np.complex128)
        cfr.real, cfr.imag = real, imag
        original = np.argsort(self._order)
        return Channel(cfr[:, original], num_paths[:, original])

    @checked
    def paths(self, tx_position_m: Position) -> Paths:
        """Paths of one transmitter to the array centre, the earliest first."""
        tx, depth = np.asarray(tx_position_m, dtype=np.float64), self.settings.max_depth
        reached = furnished_kernels.reaching(self._facets, self._tree, self._media, self._trie, tx, depth)
        node = np.array([node for node, *_ in reached], dtype=np.int64)
        distance_m = np.linalg.norm(tx - self._trie.image_m[node], axis=1)
        earliest = np.argsort(distance_m, kind="stable")
        distance_m = distance_m[earliest]
        reached = [reached[row] for row in earliest]
        spreading = SPEED_OF_LIGHT_M_S / self.carrier_hz[:, None] / (4 * np.pi * distance_m)
        gain = np.array([gain for _, gain, _ in reached], dtype=np.complex128).reshape(-1, len(spreading)).T
        along = [
            interactions_along(walk.scratch, int(self._trie.length[node]), depth, self._surface)
            for node, _, walk in reached
        ]
        return Paths(
            carrier_hz=self.carrier_hz,
            gain=gain[np.argsort(self._order)] * spreading,
            delay_s=distance_m / SPEED_OF_LIGHT_M_S,
            arrival=-np.array([walk.scratch.direction for *_, walk in reached]).reshape(-1, 3),
            interactions=np.array([codes for codes, *_ in along], np.int64).reshape(len(along), depth),
            surfaces=np.array([met for _, met, _ in along], np.int64).reshape(len(along), depth),
            vertices_m=np.array([points for *_, points in along]).reshape(len(along), depth, 3),
        )


def _quads(rows: int, cols: int) -> Int[IntArray, "B 4"]:
    """The elements of an array in squares of two by two; at the rim of an odd number they repeat, not in ascent."""
    row = np.minimum(np.add.outer(np.arange(0, rows, 2), [0, 0, 1, 1]), rows - 1)
    col = np.minimum(np.add.outer(np.arange(0, cols, 2), [0, 1, 0, 1]), cols - 1)
    return (row[:, None] * cols + col[None]).reshape(-1, 4)


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
        low_m, high_m = np.full((len(normal), 2), np.inf), np.full((len(normal), 2), -np.inf)
        for facet, number in zip(self.facets, self.plane, strict=True):
            place_m = facet.corners_m @ self.axis[number, :2].T
            low_m[number] = np.minimum(low_m[number], place_m.min(axis=0))
            high_m[number] = np.maximum(high_m[number], place_m.max(axis=0))
        self.low_m, self.high_m = low_m, high_m


def _by_patch(geometry: Geometry) -> Iterator[list[PlanarFacet]]:
    """Facets of each patch that mirrors; two triangles that form a parallelogram are one facet."""
    number = [len(mesh.triangles) for mesh in geometry.meshes]
    mesh, first = np.repeat(np.arange(len(number)), number), np.cumsum([0, *number])
    order = np.argsort(geometry.mirror_patch, kind="stable")
    order = order[np.searchsorted(geometry.mirror_patch[order], 0) :]
    for rows in np.split(order, np.flatnonzero(np.diff(geometry.mirror_patch[order])) + 1):
        yield [
            PlanarFacet(facet.corners_m, int(m))
            for m in np.unique(mesh[rows])
            for facet in planar_facets(
                [
                    replace(
                        geometry.meshes[m],
                        triangles=geometry.meshes[m].triangles[rows[mesh[rows] == m] - first[m]],
                    )
                ]
            )
        ]


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


def planted(
    geometry: Geometry,
    mirrors: MirrorPlanes,
    kind: Int[IntArray, "S"],
    is_opaque: Bool[NDArray[np.bool_], "K"],
) -> tuple[Facets, BoxTree, Int[IntArray, "Q"]]:
    """The facets of a scene in the order of a tree's leaves, the tree, and the mesh of each facet.

    Planes of mirrors come first; each triangle that does not mirror has a plane of its own.
    """
    blocks = triangle_corners_m(geometry.meshes)[~geometry.mirrors]
    mesh = np.repeat(np.arange(len(geometry.meshes)), [len(mesh.triangles) for mesh in geometry.meshes])
    normal = np.cross(blocks[:, 1] - blocks[:, 0], blocks[:, 2] - blocks[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normals = np.concatenate([mirrors.planes[:, :3], normal])
    offset_m = np.concatenate([mirrors.planes[:, 3], np.einsum("kc,kc->k", normal, blocks[:, 0])])
    own_plane = len(mirrors.planes) + np.arange(len(blocks))
    corners_m = np.concatenate([mirrors.corners_m, blocks[:, [0, 1, 2, 2]]])
    is_triangle = np.array(
        [len(facet.corners_m) == 3 for facet in mirrors.facets] + [True] * len(blocks), bool
    )
    surface = np.concatenate(
        [np.array([facet.surface for facet in mirrors.facets], np.int64), mesh[~geometry.mirrors]]
    )
    order, boxes = grow(corners_m.min(axis=1), corners_m.max(axis=1))
    plane, slab = np.concatenate([mirrors.plane, own_plane])[order], kind[surface][order]
    corners_m, is_triangle = corners_m[order], is_triangle[order]
    face = np.hstack([normals[plane], offset_m[plane, None], *_duals(corners_m)])
    nothing = np.zeros((0, 3))
    facets = Facets(
        normal=np.ascontiguousarray(normals.T),
        offset=offset_m,
        first=np.zeros(0, np.int64),
        plane=plane,
        origin=nothing,
        along_u=nothing,
        along_v=nothing,
        is_triangle=is_triangle,
        slab=slab,
        is_opaque=is_opaque[slab],
    )
    tree = BoxTree(np.ascontiguousarray(face), is_triangle, is_opaque[slab], plane, *boxes)
    return facets, tree, surface[order]


def _duals(
    corners_m: Float[FloatArray, "Q 4 3"],
) -> tuple[Float[FloatArray, "Q 4"], Float[FloatArray, "Q 4"]]:
    """Vectors u* and v*, each with its offset: u = x·u* − offset runs 0…1 from corner 0 to 1, v from 0 to 2."""
    origin_m = corners_m[:, 0]
    edge_u, edge_v = corners_m[:, 1] - origin_m, corners_m[:, 2] - origin_m
    normal = np.cross(edge_u, edge_v)
    normal /= np.einsum("qc,qc->q", normal, normal)[:, None]
    dual_u, dual_v = np.cross(edge_v, normal), np.cross(normal, edge_u)
    offset_u, offset_v = (np.einsum("qc,qc->q", origin_m, dual)[:, None] for dual in (dual_u, dual_v))
    return np.hstack([dual_u, offset_u]), np.hstack([dual_v, offset_v])


def trie_of(
    parent: Int[IntArray, "N"],
    plane: Int[IntArray, "N"],
    mirrors: MirrorPlanes,
    receiver_m: Float[FloatArray, "3"],
    aperture: Aperture,
) -> Trie:
    """The trie of sequences of mirrors that are given by parent and last plane, parents first."""
    num_planes, radius_m = len(mirrors.planes), aperture.radius_m
    length, image_m = np.zeros(len(parent), np.int64), np.tile(receiver_m, (len(parent), 1))
    corner_m = np.tile(aperture.corner_m[0], (len(parent), 1, 1))  # of the widest aperture, from the image
    place_m = np.zeros((len(parent), 8))
    rows = np.flatnonzero(parent == 0)
    while len(rows):
        length[rows] = length[parent[rows]] + 1
        normal, offset_m = mirrors.planes[plane[rows], :3], mirrors.planes[plane[rows], 3]
        apex_m = image_m[parent[rows]]
        height_m = np.einsum("nc,nc->n", apex_m, normal) - offset_m
        image_m[rows] = apex_m - 2 * height_m[:, None] * normal
        place_m[rows, :3] = np.einsum("nac,nc->na", mirrors.axis[plane[rows]], image_m[rows])
        place_m[rows, 2] -= offset_m
        along_normal = np.einsum("nkc,nc->nk", corner_m[parent[rows]], normal)
        corner_m[rows] = corner_m[parent[rows]] - 2 * along_normal[:, :, None] * normal[:, None]
        place_m[rows, 7] = np.abs(along_normal).max(axis=1) + 1e-9 if radius_m < UNPRUNED_M else UNPRUNED_M
        place_m[rows, 3:7] = _shone_on(
            place_m, parent[rows], plane[parent[rows]], plane[rows], apex_m, mirrors, radius_m
        )
        is_parent = np.zeros(len(parent), dtype=bool)
        is_parent[rows] = True
        rows = np.flatnonzero((parent > 0) & is_parent[parent])
    order = np.lexsort((np.arange(len(plane)), plane))
    renumbered = np.argsort(order)
    return Trie(
        parent=np.where(parent < 0, -1, renumbered[parent])[order],
        plane=plane[order],
        length=length[order],
        image_m=image_m[order],
        place_m=place_m[order],
        first=np.searchsorted(plane[order], np.arange(num_planes + 1)),
        axis=mirrors.axis,
        offset_m=mirrors.planes[:, 3].copy(),
        radius_m=radius_m,
    )


def _shone_on(
    place_m: Float[FloatArray, "N 8"],
    parent: Int[IntArray, "n"],
    parent_plane: Int[IntArray, "n"],
    plane: Int[IntArray, "n"],
    apex_m: Float[FloatArray, "n 3"],
    mirrors: MirrorPlanes,
    radius_m: float,
) -> Float[FloatArray, "n 4"]:
    """Lowest and highest u, lowest and highest v on each plane that its parent's image shines on through its window.

    The window is what the parent is shone on itself. Where it does not lie between image and plane as a whole, it is
    the whole rectangle of mirrors. Images of elements within `radius_m` of the array centre are allowed for.
    """
    whole = np.stack([mirrors.low_m[plane], mirrors.high_m[plane]], axis=2).reshape(-1, 4)
    if not len(parent) or parent[0] == 0 or radius_m > 1e6:
        return whole
    window = place_m[parent][:, [[3, 5], [4, 5], [3, 6], [4, 6]]]
    axis = mirrors.axis[parent_plane]
    corner_m = np.einsum("nka,nac->nkc", window, axis[:, :2])
    corner_m += (mirrors.planes[parent_plane, 3, None] * axis[:, 2])[:, None]
    normal, offset_m = mirrors.planes[plane, :3], mirrors.planes[plane, 3]
    here = np.einsum("nc,nc->n", apex_m, normal) - offset_m
    there = np.einsum("nkc,nc->nk", corner_m, normal) - offset_m[:, None]
    is_between = (here[:, None] * there > 0) & (np.abs(there) < np.abs(here)[:, None])
    apart_m, below_m = np.abs(here)[:, None] - np.abs(there), np.abs(there)
    is_between &= apart_m > 2 * radius_m
    with np.errstate(divide="ignore", invalid="ignore"):
        stretch = here[:, None] / (here[:, None] - there)
        point_m = apex_m[:, None] + stretch[:, :, None] * (corner_m - apex_m[:, None])
        way_m = np.linalg.norm(corner_m - apex_m[:, None], axis=2)
        along_m = np.sqrt(np.clip(way_m**2 - apart_m**2, 0, None))
        most = below_m / (
            apart_m - radius_m
        )  # of stretch − 1, for an element whose image is lower by the radius
        margin_m = ((most - below_m / apart_m) * along_m + most * radius_m).max(axis=1) + 1e-6
        spot_m = np.einsum("nkc,nac->nka", point_m, mirrors.axis[plane][:, :2])
        low_m = np.maximum(whole[:, [0, 2]], spot_m.min(axis=1) - margin_m[:, None])
        high_m = np.minimum(whole[:, [1, 3]], spot_m.max(axis=1) + margin_m[:, None])
    lit = np.stack([low_m, high_m], axis=2).reshape(-1, 4)
    return np.where(is_between.all(axis=1)[:, None], lit, whole)
