"""Solver `image`: the exact image method in float64, for scenes of planar facets.

Rays that branch at every facet are shot from the receiver once, and find the sequences of mirror planes that can
matter. Of these, each transmitter uses the ones whose path reaches the array. Whether it does is decided at the four
corners of the array for all elements between them; where the corners disagree, or a stretch of a path is as short as
some nanometres, each element is traced by itself. What a segment meets is looked up in a tree of boxes, so a room of
boxes and one furnished with meshes, of whose triangles only large patches mirror, are solved alike.

Specular reflection and refraction are modelled, and on request first-order diffraction at the edges of mirrors. Depth
counts them together, and slabs (ITU-R P.2040) and antenna conventions are those of Sionna RT, which drops paths with a
stretch under 1 cm; here two surfaces may be as near to each other as a nanometre.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from xfreqbench.errors import SceneError
from xfreqbench.scene.array import frame_rotation
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import MaterialPolicy, complex_permittivity
from xfreqbench.scene.meshes import SurfaceMesh, slabs_of
from xfreqbench.scene.model import Antenna, ReceiverArray, Scene
from xfreqbench.system.arguments import Position, Positions, checked
from xfreqbench.tracing.image.diffraction import Diffraction
from xfreqbench.tracing.image.diffuse import DiffuseReflection
from xfreqbench.tracing.image.kernels.arrays import SIMD_WIDTH, AntennaArrays, Aperture, Media, SceneArrays
from xfreqbench.tracing.image.kernels.channels import add_channel, paths_to_centre
from xfreqbench.tracing.image.kernels.compiled import on_threads
from xfreqbench.tracing.image.kernels.edge_paths import Limits
from xfreqbench.tracing.image.kernels.edge_sides import MAX_SIDE_PLANES
from xfreqbench.tracing.image.kernels.slabs import stack_coefficients
from xfreqbench.tracing.image.sequences import sequences_of, trie_of
from xfreqbench.tracing.image.surfaces import MirrorPlanes, facets_of
from xfreqbench.tracing.paths import Paths
from xfreqbench.tracing.tracer import INTERACTIONS, Channel, TraceSettings
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

MAX_MIRRORS = 1000  # with more, most sequences of mirrors are met by a single ray or by none


@dataclass(frozen=True)
class ImageSavings:
    """What the solver skips to be faster; each can be turned off to measure what it saves.

    `prune` tests candidate paths roughly before it traces them. `share_visibility` decides at the four corners
    of the array which paths reach its elements. Both change the answer by rounding only. The field along a
    path (not its phase) is computed at `field_nodes_per_axis`² points of the array and interpolated between
    them, which changes the answer; 4 on a 4×4 array computes it at every element. With diffraction, paths with
    more than `diffraction_planes` reflections (up to 3) on either side of the edge are left out, and those that a
    bound shows to be weaker than `diffraction_floor` times free space; up to twice that they fade in. With diffuse
    reflection, paths with more than `diffuse_mirrors` specular reflections (up to 1) are left out. Tiles are at most
    `diffuse_tile_m` long, and `diffuse_tile_rad` as the array sees them; four times that with a mirror.
    """

    prune: bool = True
    share_visibility: bool = True
    field_nodes_per_axis: int = 2
    max_reflections: int | None = None
    diffraction_planes: int = 1
    diffraction_floor: float = 0.003
    diffuse_mirrors: int = 1
    diffuse_tile_m: float = 0.25
    diffuse_tile_rad: float = 0.15


def can_solve(geometry: Geometry, settings: TraceSettings) -> bool:
    """Whether this solver takes as many mirrors, and, if diffuse reflection is asked for, a material scatters."""
    can_scatter = "diffuse" not in settings.named_interactions or bool(geometry.scattering)
    return can_scatter and geometry.num_mirrors <= MAX_MIRRORS


class ImageTracer:
    """The image method on one scene, ready for any transmitter; raises `SceneError` for what `can_solve` declines."""

    def __init__(
        self,
        scene: Scene,
        carrier_hz: Sequence[float] | Float[FloatArray, "F"],
        settings: TraceSettings,
        savings: ImageSavings = ImageSavings(),
        geometry: Geometry | None = None,
    ) -> None:
        settings, geometry = settings.by("image"), geometry or Geometry.of(scene)
        if not can_solve(geometry, settings):
            raise SceneError(
                f"The image solver takes {' and '.join(sorted(INTERACTIONS))} among at most {MAX_MIRRORS:,} "
                f"mirrors, diffuse where a material scatters, but scene {scene.name!r} has {geometry.num_mirrors:,}"
                f"{'' if geometry.scattering else ', none of them rough,'} and is asked for "
                f"{', '.join(settings.named_interactions)}. Use --solver sionna, or let fewer mirror: "
                "mirrors = 'patches', or a larger least_patch_area_m2, in the scene's TOML."
            )
        self.settings, self.savings, self._meshes = settings, savings, geometry.meshes
        self.carrier_hz = np.asarray(carrier_hz, dtype=np.float64)
        self._order = np.argsort(self.carrier_hz, kind="stable")
        ascending = self.carrier_hz[self._order]
        aperture = _aperture_of(scene.receiver, SPEED_OF_LIGHT_M_S / ascending, savings)
        self._media_at_centre, kind = _media_of(geometry.meshes, ascending, settings.materials, scene)
        media = self._media_at_centre.in_lanes(*aperture.weight.shape)
        # Paths are sought from the array as wide as it is at 1 GHz, and through slabs that pass waves of 1 GHz, or of
        # the lowest carrier where that is lower: what follows must not depend on what other carriers are asked for.
        lowest_hz = min(ascending[0], 1e9)
        passing, _ = _media_of(geometry.meshes, np.array([lowest_hz]), "extrapolate", scene)
        is_opaque = _are_opaque(passing) | ("refraction" not in settings.named_interactions)
        mirrors = MirrorPlanes(geometry)
        self.facets, self._surface, corners_m = facets_of(geometry, mirrors, kind, is_opaque)
        quads = _quads(scene.receiver.rows, scene.receiver.cols)
        if not savings.share_visibility:
            quads = np.repeat(np.unique(quads)[:, None], 4, axis=1)
        self._scene = SceneArrays(self.facets, media, aperture, quads)
        ends = scene.transmitter_antenna, scene.receiver.antenna
        amplitude = {"iso": 1.0, "dipole": math.sqrt(1.5), "tr38901": 10**0.4}  # the most in any direction
        self._most_antennas = math.prod(amplitude[antenna.pattern] for antenna in ends)
        receiver_m = np.asarray(scene.receiver.position_m, dtype=np.float64)
        points_m = np.vstack([receiver_m, receiver_m + ascending[0] / lowest_hz * aperture.corner_m[0]])
        origins_m, most = np.unique(points_m, axis=0), savings.max_reflections
        sequences = sequences_of(self.facets, len(mirrors.planes), origins_m, settings, most)
        self._trie = trie_of(*sequences, mirrors, receiver_m, aperture)
        self._receiver_m = receiver_m
        self.diffraction = None
        if "diffraction" in settings.named_interactions:
            can_reflect = "specular" in settings.named_interactions
            max_planes = min(savings.diffraction_planes, settings.max_depth - 1, MAX_SIDE_PLANES) if can_reflect else 0
            limits = Limits(settings.max_depth, max_planes, savings.share_visibility)
            self.diffraction = Diffraction(
                geometry, mirrors, kind, self._scene, self._surface, corners_m, points_m, limits
            )
        self.diffuse = None
        if "diffuse" in settings.named_interactions and settings.max_depth:
            self.diffuse = DiffuseReflection(
                self._scene,
                self._media_at_centre,
                _kinds_of(geometry.meshes),
                mirrors,
                self._surface,
                corners_m,
                scene.receiver,
                settings,
                savings.diffuse_mirrors if "specular" in settings.named_interactions else 0,
                savings.diffuse_tile_m,
                savings.diffuse_tile_rad,
            )

    def with_antennas(self, scene: Scene) -> ImageTracer:
        """A tracer of a scene that differs in its antennas alone, which shares the sequences that were found."""
        other = copy(self)
        ascending, shape = self.carrier_hz[self._order], self._scene.aperture.weight.shape
        other._media_at_centre, _ = _media_of(self._meshes, ascending, self.settings.materials, scene)
        other._scene = self._scene._replace(media=other._media_at_centre.in_lanes(*shape))
        if self.diffraction is not None:
            other.diffraction = self.diffraction.in_scene(other._scene)
        if self.diffuse is not None:
            other.diffuse = self.diffuse.in_scene(other._scene, other._media_at_centre)
        return other

    @checked
    def channel(self, tx_position_m: Positions) -> Channel:
        """Channel (T, F, M) of T transmitters at the array's elements, and the number of paths (T, F)."""
        tx = np.array(tx_position_m, np.float64, order="C")  # a copy: for read-only arrays kernels are compiled anew
        shape = len(tx), len(self.carrier_hz), self._scene.aperture.element_m.shape[2]
        real, imag, num_paths = np.zeros(shape), np.zeros(shape), np.zeros(shape[:2], np.int32)

        def add(i: int) -> None:
            sums = real[i], imag[i]
            limits = self.settings.max_depth, self.savings.share_visibility
            add_channel(self._scene, self._trie, tx[i], *limits, sums, num_paths[i])
            if self.diffraction is not None:
                self.diffraction.add_channel(tx[i], self._floor(tx[i]), sums, num_paths[i])
            if self.diffuse is not None:
                self.diffuse.add_channel(tx[i], sums, num_paths[i])

        on_threads(add, len(tx), "transmitters")
        cfr, original = real + 1j * imag, np.argsort(self._order)
        return Channel(cfr[:, original], num_paths[:, original])

    def _floor(self, tx_m: Float[FloatArray, "3"]) -> float:
        """The least amplitude over wavelength, in 1/m, of a path over an edge, the antennas left out."""
        distance_m = max(float(np.linalg.norm(tx_m - self._receiver_m)), 1e-3)
        return self.savings.diffraction_floor / (4 * np.pi * distance_m * self._most_antennas)

    @checked
    def paths(self, tx_position_m: Position) -> Paths:
        """Paths of one transmitter to the array centre, the earliest first."""
        tx, depth = np.array(tx_position_m, np.float64, order="C"), self.settings.max_depth
        found = paths_to_centre(self.facets, self._media_at_centre, self._trie, self._surface, tx, depth)
        if self.diffraction is not None:
            found += self.diffraction.paths(tx, self._floor(tx))
        if self.diffuse is not None:
            found += self.diffuse.paths(tx)
        found.sort(key=lambda path: path[1])

        def column(i: int, dtype: type, *shape: int) -> Any:
            return np.array([path[i] for path in found], dtype).reshape(len(found), *shape)

        distance_m = column(1, float)
        spreading = SPEED_OF_LIGHT_M_S / self.carrier_hz[:, None] / (4 * np.pi * distance_m)
        return Paths(
            carrier_hz=self.carrier_hz,
            gain=column(0, complex, len(self.carrier_hz)).T[np.argsort(self._order)] * spreading,
            delay_s=distance_m / SPEED_OF_LIGHT_M_S,
            arrival=column(2, float, 3),
            interactions=column(3, int, depth),
            surfaces=column(4, int, depth),
            vertices_m=column(5, float, depth, 3),
        )


def _quads(rows: int, cols: int) -> Int[IntArray, "B 4"]:
    """The elements of an array in squares of two by two; at the rim of an odd number they repeat, not in ascent."""
    row = np.minimum(np.add.outer(np.arange(0, rows, 2), [0, 0, 1, 1]), rows - 1)
    col = np.minimum(np.add.outer(np.arange(0, cols, 2), [0, 1, 0, 1]), cols - 1)
    return (row[:, None] * cols + col[None]).reshape(-1, 4)


def _kinds_of(meshes: Iterable[SurfaceMesh]) -> list[Slab]:
    """The distinct slabs of some meshes, then those that differ from all of them with their back to the front."""
    kinds = slabs_of(meshes)
    return list(dict.fromkeys([*kinds, *(slab.turned for slab in kinds)]))


def _media_of(
    meshes: Sequence[SurfaceMesh], carrier_hz: Float[FloatArray, "F"], policy: MaterialPolicy, scene: Scene
) -> tuple[Media, Int[IntArray, "2 S"]]:
    """Slabs of every material and thickness, one lane a carrier, with the antennas; and the slab of each mesh.

    The slab of a mesh stands as it is, and with its back to the front.
    """
    kinds = _kinds_of(meshes)
    layers = [layer for slab in kinds for layer in slab.layers]
    first = np.cumsum([0, *(len(slab.layers) for slab in kinds)])
    eta = [[complex_permittivity(layer.material, float(f), policy) for layer in layers] for f in carrier_hz]
    permittivity = np.array(eta, dtype=np.complex128).reshape(len(carrier_hz), len(layers))
    thickness_m = np.array([layer.thickness_m for layer in layers])
    phase_thickness = 2 * np.pi * carrier_hz[:, None] / SPEED_OF_LIGHT_M_S * thickness_m
    lanes = np.stack([permittivity.real, permittivity.imag, phase_thickness]).transpose(2, 0, 1)
    lanes = np.ascontiguousarray(lanes)  # of one carrier too: kernels are compiled for each order of axes
    lanes = np.pad(lanes, [(0, 0), (0, 0), (0, SIMD_WIDTH)], mode="edge")
    specular = np.array([np.sqrt(1 - (slab.scattering.coefficient if slab.scattering else 0) ** 2) for slab in kinds])
    transmitter, receiver = (_antenna(antenna) for antenna in (scene.transmitter_antenna, scene.receiver.antenna))
    if abs(np.dot(transmitter.axis, receiver.axis)) > 1 - 1e-12:
        # The ends of a ray beside both axes have opposite azimuths, however often floor and ceiling reflect it.
        x, y, z = transmitter.aside
        receiver = receiver._replace(aside=(-x, -y, -z))
    antennas = np.array([np.hstack(antenna) for antenna in (transmitter, receiver)], dtype=np.float64)
    media = Media(permittivity, phase_thickness, lanes, first, specular, antennas)
    kind = [[kinds.index(slab) for slab in (mesh.slab, mesh.slab.turned)] for mesh in meshes]
    return media, np.array(kind, dtype=np.int64).reshape(-1, 2).T


def _antenna(antenna: Antenna) -> AntennaArrays:
    """An antenna as kernels take it."""
    antenna = antenna.as_vertical
    ahead, _, axis = ((x, y, z) for x, y, z in antenna.rotation.T.tolist())
    x, y, z = frame_rotation(axis)[:, 0].tolist()
    is_dipole, is_directive = antenna.pattern == "dipole", antenna.pattern == "tr38901"
    return AntennaArrays(antenna.polarization == "H", is_dipole, is_directive, axis, (x, y, z), ahead)


def _are_opaque(media: Media) -> Bool[NDArray[np.bool_], "K"]:
    """Whether each kind of slab passes less than −120 dB at the lowest carrier, where it passes most."""
    kinds = [slice(*pair) for pair in pairwise(media.first)]
    layers = [(media.permittivity[0, kind], media.phase_thickness[0, kind]) for kind in kinds]
    return np.array([abs(stack_coefficients(1.0, *stack)[2]) < 1e-6 for stack in layers], bool)


def _aperture_of(receiver: ReceiverArray, wavelength_m: Float[FloatArray, "F"], savings: ImageSavings) -> Aperture:
    """The array at each wavelength as the kernels take it, offsets from its centre in world axes."""
    element = receiver.element_position_wavelengths
    half = np.abs(element).max(axis=0)
    corner = np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]]) * half
    along_x, weight_x = _nodes(element[: receiver.cols, 0], savings.field_nodes_per_axis)
    along_y, weight_y = _nodes(element[:: receiver.cols, 1], savings.field_nodes_per_axis)
    node = np.array([[x, y, 0.0] for y in along_y for x in along_x])

    def in_metres(wavelengths: Float[FloatArray, "n 3"]) -> Float[FloatArray, "F n 3"]:
        return np.ascontiguousarray(wavelength_m[:, None, None] * (wavelengths @ receiver.rotation.T))

    return Aperture(
        wavelength_m=wavelength_m,
        element_m=np.ascontiguousarray(in_metres(element).swapaxes(1, 2)),
        corner_m=in_metres(corner),
        node_m=np.ascontiguousarray(in_metres(node).reshape(-1, 3).T),
        weight=np.kron(weight_y, weight_x).astype(np.float64),
        # by that of 1e30 every candidate passes the rough test
        radius_m=float(np.linalg.norm(half) * wavelength_m[0]) if savings.prune else 1e30,
    )


def _nodes(position: Float[FloatArray, "n"], num_nodes: int) -> tuple[Float[FloatArray, "k"], Float[FloatArray, "k n"]]:
    """Evenly spread nodes along one axis of the array, in wavelengths, and their Lagrange weights at its elements."""
    # 1.5 wavelengths: of a 4×4 array maps of 68 dB or better at the 5th percentile; 8×8: 40 dB
    if num_nodes >= len(position) or position[-1] - position[0] > 1.5:
        return position, np.eye(len(position))  # wider arrays have a node at every element
    nodes = np.linspace(position[0], position[-1], num_nodes) if num_nodes > 1 else np.zeros(1)
    weight = np.ones((num_nodes, len(position)))
    for k, node in enumerate(nodes):
        for other in np.delete(nodes, k):
            weight[k] *= (position - other) / (node - other)
    return nodes, weight
