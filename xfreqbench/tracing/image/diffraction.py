"""First-order diffraction at the edges of a scene, for the image solver.

A path may be reflected before and after the edge and pass through slabs, within the depth limit. How the receiver
sees the edges is found once, how a transmitter does for each.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import triangle_corners_m
from xfreqbench.tracing.image.edges import Edge, find_edges
from xfreqbench.tracing.image.kernels import edge_channels
from xfreqbench.tracing.image.kernels.arrays import Aperture, Facets, Media, Sums
from xfreqbench.tracing.image.kernels.edge_channels import Limits
from xfreqbench.tracing.image.kernels.edge_paths import Room
from xfreqbench.tracing.image.kernels.edge_sides import Reflectors, find_sides
from xfreqbench.tracing.image.kernels.slabs import slab_coefficients
from xfreqbench.tracing.image.kernels.wedges import Wedges
from xfreqbench.tracing.image.surfaces import MirrorPlanes
from xfreqbench.tracing.paths import DIFFRACTION, NO_INTERACTION
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, IntArray

COSINES = 65  # at which reflection is tabulated


@dataclass(frozen=True)
class PathsToCentre:
    """Paths to the array centre; carriers ascend, and spreading and travel phase are left out of gains."""

    gain: Complex[NDArray[np.complex128], "P F"]
    distance_m: Float[FloatArray, "P"]
    arrival: Float[FloatArray, "P 3"]
    interactions: Int[NDArray[np.int64], "P D"]
    surfaces: Int[NDArray[np.int64], "P D"]
    vertices_m: Float[FloatArray, "P D 3"]

    def merged(self, *others: PathsToCentre) -> PathsToCentre:
        """These paths and others, the shortest first."""
        fields = [np.concatenate(parts) for parts in zip(*map(astuple, (self, *others)), strict=True)]
        order = np.argsort(fields[1], kind="stable")
        return PathsToCentre(*(field[order] for field in fields))


class Diffraction:
    """Edges of one scene and how its receiver sees them, ready for any transmitter.

    `kind` is the slab of each mesh, `surface` and `corners_m` are the mesh and the corners of the
    kernels' facets. `points_m` are the array's
    centre and corners. `limits` are those of `Limits`, but for the depth.
    """

    def __init__(
        self,
        geometry: Geometry,
        mirrors: MirrorPlanes,
        kind: Int[IntArray, "S"],
        facets: Facets,
        surface: Int[IntArray, "Q"],
        corners_m: Float[FloatArray, "Q 4 3"],
        media: Media,
        aperture: Aperture,
        points_m: Float[FloatArray, "O 3"],
        settings: TraceSettings,
        limits: tuple[int, bool, float],
    ) -> None:
        mesh = np.repeat(np.arange(len(geometry.meshes)), [len(mesh.triangles) for mesh in geometry.meshes])
        blocks = ~geometry.mirrors
        edges = find_edges(mirrors.facets, triangle_corners_m(geometry.meshes)[blocks], mesh[blocks])
        faces = np.array([edge.surfaces for edge in edges], np.int64).reshape(-1, 2)
        self._surface, self._edge_surface = surface, faces[:, 0]
        is_opaque = np.zeros(len(geometry.meshes), bool)
        is_opaque[surface] = facets.is_opaque
        reflectors = _reflectors(len(mirrors.planes), facets, corners_m, media)
        wedges = _wedges(edges, kind[faces], np.asarray(is_opaque[faces].any(axis=1)))
        self.room = Room(facets, media, wedges, reflectors, aperture)
        can_reflect = "specular" in settings.named_interactions
        max_planes, share, floor = limits
        max_planes = min(max_planes, settings.max_depth - 1) if can_reflect else 0
        self._limits = Limits(settings.max_depth, max_planes, share, floor)
        self._sides = find_sides(facets, self.room.mirrors, wedges, points_m, max_planes)

    def add_channel(self, tx_position_m: Float[FloatArray, "3"], sums: Sums, num_paths: NDArray[np.int32]) -> None:
        """Add the channel (F, M) over edges to that of all other paths of a transmitter, carriers ascending."""
        tx = tx_position_m[None]
        edge_channels.add_over_edges(self.room, self._sides, self._limits, tx, sums, num_paths)

    def paths(self, tx_position_m: Float[FloatArray, "3"]) -> PathsToCentre:
        """All paths of one transmitter over edges to the array centre, none of them skipped."""
        gain, distance_m, arrival, code, met, point_m = edge_channels.paths_over_edges(
            self.room, self._sides, self._limits, tx_position_m[None]
        )
        surface = np.full(met.shape, -1)
        at_edge, at_facet = code == DIFFRACTION, (code != NO_INTERACTION) & (code != DIFFRACTION)
        surface[at_edge] = self._edge_surface[-1 - met[at_edge]]
        surface[at_facet] = self._surface[met[at_facet]]
        return PathsToCentre(gain, distance_m, arrival, code, surface, point_m)


def _wedges(edges: list[Edge], slab: Int[IntArray, "E 2"], is_opaque: Bool[NDArray[np.bool_], "E"]) -> Wedges:
    """Edges as the kernels take them."""
    angle_rad = np.array([edge.angle_rad for edge in edges])
    start_m, along, tangent, normal = (np.array([edge[i] for edge in edges]).reshape(-1, 3) for i in range(4))
    return Wedges(
        start_m,
        along,
        tangent,
        normal,
        np.sin(angle_rad)[:, None] * tangent - np.cos(angle_rad)[:, None] * normal,
        np.array([edge.length_m for edge in edges]),
        angle_rad,
        slab,
        is_opaque,
    )


def _reflectors(num_planes: int, facets: Facets, corners_m: Float[FloatArray, "Q 4 3"], media: Media) -> Reflectors:
    """The facets of each plane that mirrors, and bounds of what the planes reflect at each carrier."""
    facet = np.argsort(facets.plane, kind="stable")
    first = np.searchsorted(facets.plane[facet], np.arange(num_planes + 1))
    facet = facet[: first[-1]]
    cosines = np.linspace(0, 1, COSINES)
    most = np.empty((*media.permittivity.shape, COSINES))  # (F, K, L)
    for place in np.ndindex(media.permittivity.shape):
        eta, phase = complex(media.permittivity[place]), float(media.phase_thickness[place])
        largest = [np.abs(slab_coefficients(c, eta, phase)[:2]).max() for c in cosines]
        most[place] = np.maximum.accumulate(largest[::-1])[::-1]
    by_facet = most[:, facets.slab[facet]]
    of_plane = [by_facet[:, a:b].max(axis=1) for a, b in pairwise(first)]
    by_plane = np.array(of_plane).reshape(-1, len(most), COSINES).swapaxes(0, 1).copy()
    return Reflectors(first, facet, corners_m[facet], by_plane)
