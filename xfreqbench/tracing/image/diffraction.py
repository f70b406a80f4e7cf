"""First-order diffraction at the edges of a scene, for the image solver.

A path may be reflected before and after the edge and pass through slabs, within the depth limit. How the receiver
sees the edges is found once, how a transmitter does for each.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.scene.facets import PLANE_TOLERANCE, Geometry
from xfreqbench.tracing.image import diffraction_kernels, kernels
from xfreqbench.tracing.image.diffraction_kernels import Limits
from xfreqbench.tracing.image.edge_field_kernels import Room
from xfreqbench.tracing.image.edge_side_kernels import Reflectors, Sides
from xfreqbench.tracing.image.edges import Edge, find_edges
from xfreqbench.tracing.image.wedge_kernels import Wedges
from xfreqbench.tracing.paths import DIFFRACTION, NO_INTERACTION
from xfreqbench.tracing.tracer import Channel, TraceSettings
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

    def merged(self, other: PathsToCentre) -> PathsToCentre:
        """These paths and others, the shortest first."""
        fields = zip(astuple(self), astuple(other), strict=True)
        order = np.argsort(np.concatenate([self.distance_m, other.distance_m]), kind="stable")
        return PathsToCentre(*(np.concatenate(pair)[order] for pair in fields))


class Shortcuts(NamedTuple):
    """What is skipped to be faster.

    `share` decides at the array's corners which paths reach its elements. On either side of an edge are at most
    `max_planes` reflections, which may be 3. A path that a bound shows to be weaker than `floor` times the strongest
    element of a transmitter's channel without edges is skipped at that carrier before it is traced.
    """

    share: bool
    max_planes: int
    floor: float


class Diffraction:
    """Edges of one scene and how its receiver sees them, ready for any transmitter."""

    def __init__(
        self,
        geometry: Geometry,
        kind: Int[IntArray, "S"],
        facets: kernels.Facets,
        media: kernels.Media,
        aperture: kernels.Aperture,
        receiver_m: Float[FloatArray, "3"],
        settings: TraceSettings,
        shortcuts: Shortcuts,
    ) -> None:
        edges = find_edges(geometry)
        self._surface = geometry.surfaces_by_plane
        self._edge_surface = np.array([geometry.facets[edge.faces[0]].surface for edge in edges], np.int64)
        wedges = _wedges(edges, geometry, kind, facets)
        self.room = Room(facets, media, wedges, _mirrors(geometry, facets, media), aperture)
        self._max_depth, self._shortcuts = settings.max_depth, shortcuts
        can_reflect = "specular" in settings.interactions
        self._max_planes = min(shortcuts.max_planes, settings.max_depth - 1) if can_reflect else 0
        points_m = receiver_m + np.vstack([np.zeros(3), aperture.corner_m[0]])
        self._sides = diffraction_kernels.sides(facets, self.room.mirrors, wedges, points_m, self._max_planes)

    def channel(self, tx_position_m: Float[FloatArray, "T 3"], without: Channel) -> Channel:
        """Channel (T, F, M) over edges alone, carriers ascending; `without` is that of all other paths."""
        wavelength_m = self.room.aperture.wavelength_m
        amplitude = np.abs(without.cfr).max(axis=2, initial=0.0) / wavelength_m
        limits = self._limits(self._shortcuts.floor * amplitude)
        real, imag, num_paths = diffraction_kernels.channels(*self.room, self._sides, limits, tx_position_m)
        return Channel(real + 1j * imag, num_paths)

    def paths(self, tx_position_m: Float[FloatArray, "3"]) -> PathsToCentre:
        """All paths of one transmitter over edges to the array centre, none of them skipped."""
        limits = self._limits(np.zeros((1, len(self.room.aperture.wavelength_m))))
        near = self._seen_from(tx_position_m[None])
        gain, distance_m, arrival, code, met, point_m = diffraction_kernels.paths(
            self.room, near, self._sides, limits
        )
        surface = np.full(met.shape, -1)
        at_edge, at_facet = code == DIFFRACTION, (code != NO_INTERACTION) & (code != DIFFRACTION)
        surface[at_edge] = self._edge_surface[-1 - met[at_edge]]
        surface[at_facet] = self._surface[met[at_facet]]
        return PathsToCentre(gain, distance_m, arrival, code, surface, point_m)

    def _seen_from(self, points_m: Float[FloatArray, "O 3"]) -> Sides:
        """How points that are close together see the edges."""
        room = self.room
        return diffraction_kernels.sides(
            room.facets, room.mirrors, room.wedges, np.ascontiguousarray(points_m), self._max_planes
        )

    def _limits(self, floor: Float[FloatArray, "T F"]) -> Limits:
        return Limits(self._max_depth, self._max_planes, self._shortcuts.share, floor)


def _wedges(
    edges: list[Edge], geometry: Geometry, kind: Int[IntArray, "S"], facets: kernels.Facets
) -> Wedges:
    """Edges as the kernels take them; `facets` are those of the kernels, which are sorted by plane."""
    start_m, along = (np.array([edge[i] for edge in edges]).reshape(-1, 3) for i in (0, 1))
    length_m = np.array([edge.length_m for edge in edges])
    end_m = start_m + length_m[:, None] * along
    gap_m = np.abs(np.stack([start_m, end_m]) @ facets.normal - facets.offset).max(axis=0)
    faces = np.array([edge.faces for edge in edges], dtype=np.int64).reshape(-1, 2)
    by_plane = np.argsort(geometry.planes[1], kind="stable")
    is_opaque = np.zeros(len(by_plane), dtype=bool)
    is_opaque[by_plane] = facets.is_opaque
    angle_rad = np.array([edge.angle_rad for edge in edges])
    tangent, normal = (np.array([edge[i] for edge in edges]).reshape(-1, 3) for i in (2, 3))
    return Wedges(
        start_m,
        along,
        tangent,
        normal,
        np.sin(angle_rad)[:, None] * tangent - np.cos(angle_rad)[:, None] * normal,
        length_m,
        angle_rad,
        kind[np.array([facet.surface for facet in geometry.facets], dtype=np.int64)[faces]],
        np.asarray(is_opaque[faces].any(axis=1)),
        gap_m < PLANE_TOLERANCE,
    )


def _mirrors(geometry: Geometry, facets: kernels.Facets, media: kernels.Media) -> Reflectors:
    """Corners of the facets, sorted by plane, and bounds of what their planes reflect at each carrier."""
    by_plane = np.argsort(geometry.planes[1], kind="stable")
    corner_m = np.array([geometry.facets[i].corners_m[[0, 1, 2, -1]] for i in by_plane]).reshape(-1, 4, 3)
    cosines = np.linspace(0, 1, COSINES)
    most = np.empty((*media.permittivity.shape, COSINES))  # (F, K, L)
    for place in np.ndindex(media.permittivity.shape):
        eta, phase = complex(media.permittivity[place]), float(media.phase_thickness[place])
        largest = [np.abs(kernels.slab_coefficients(c, eta, phase)[:2]).max() for c in cosines]
        most[place] = np.maximum.accumulate(largest[::-1])[::-1]
    by_facet = most[:, facets.slab]
    of_plane = [
        by_facet[:, a:b].max(axis=1) for a, b in zip(facets.first[:-1], facets.first[1:], strict=True)
    ]
    return Reflectors(corner_m, np.array(of_plane).reshape(-1, len(most), COSINES).swapaxes(0, 1).copy())
