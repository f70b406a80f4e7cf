"""Solver `image`: the exact image method in float64, for scenes of planar facets.

Rays that branch at every facet are shot from the receiver once, and find the sequences of reflecting planes
that can matter. Of these, each transmitter uses the ones whose path reaches the array. Whether it does is
decided at the four corners of the array for all elements between them; where the corners disagree, or a
stretch of a path is shorter than 2 cm, each element is traced by itself.

Specular reflection and refraction are modelled, and on request first-order diffraction. As in Sionna RT, depth
counts them together, and a path with a stretch shorter than 1 cm is dropped; slabs (ITU-R P.2040) and antenna
conventions are Sionna's too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.errors import SceneError
from xfreqbench.scene.facets import Geometry, PlanarFacet
from xfreqbench.scene.materials import MaterialPolicy, complex_permittivity
from xfreqbench.scene.meshes import SurfaceMesh, slabs_of, surface_meshes
from xfreqbench.scene.model import ReceiverArray, Scene
from xfreqbench.system.arguments import Position, Positions, checked
from xfreqbench.tracing.image import kernels
from xfreqbench.tracing.image.diffraction import Diffraction, PathsToCentre, Shortcuts
from xfreqbench.tracing.paths import REFRACTION, SPECULAR, Paths
from xfreqbench.tracing.tracer import Channel, TraceSettings
from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

SUPPORTED_INTERACTIONS = frozenset({"specular", "refraction", "diffraction"})
MAX_FACETS = (
    400  # every ray is tested against every plane; for more facets the trees of `furnished` are faster
)
MAX_MIRRORS = 1000  # with more, most sequences of mirrors are met by a single ray or by none
OPAQUE_TRANSMISSION = 1e-6  # −120 dB through a slab at normal incidence, at every carrier
UNPRUNED_M = 1e30  # radius of an aperture of which every candidate passes the rough test
MAX_INTERPOLATED_WAVELENGTHS = (
    1.5  # of a 4×4 array: maps of 68 dB or better at the 5th percentile; 8×8: 40 dB
)

Along = tuple[Int[NDArray[np.int64], "D"], Int[NDArray[np.int64], "D"], Float[FloatArray, "D 3"]]


@dataclass(frozen=True)
class ImageSavings:
    """What the solver skips to be faster; each can be turned off to measure what it saves.

    `prune` tests candidate paths roughly before it traces them. `share_visibility` decides at the four corners
    of the array which paths reach its elements. Both change the answer by rounding only. The field along a
    path (not its phase) is computed at `field_nodes_per_axis`² points of the array and interpolated between
    them, which changes the answer; 4 on a 4×4 array computes it at every element. With diffraction, paths with
    more than `diffraction_planes` reflections (up to 3) on either side of the edge are left out, and those that a
    bound shows to be weaker than `diffraction_floor` times a transmitter's strongest element without edges.
    """

    prune: bool = True
    share_visibility: bool = True
    field_nodes_per_axis: int = 2
    max_reflections: int | None = None
    diffraction_planes: int = 1
    diffraction_floor: float = 0.003


def can_solve(geometry: Geometry, settings: TraceSettings) -> bool:
    """Whether this solver takes the interactions that are asked for, and a smooth scene of as many mirrors."""
    is_supported = SUPPORTED_INTERACTIONS.issuperset(settings.interactions)
    if not is_supported or geometry.scattering or geometry.num_mirrors > MAX_MIRRORS:
        return False
    return "diffraction" not in settings.interactions or not is_furnished(geometry, settings)


def is_furnished(geometry: Geometry, settings: TraceSettings) -> bool:
    """Whether a scene is one for `furnished`: some of its triangles do not mirror, or it has many, or many planes."""
    if geometry.num_triangles > 2 * MAX_FACETS or not geometry.mirrors.all():
        return True
    planes, _ = geometry.planes
    return (
        _bits_per_plane(len(planes)) * settings.max_depth > 64
    )  # `kernels` keep a sequence in a key of 64 bits


def _bits_per_plane(num_planes: int) -> int:
    """Bits of a key of a plane sequence that number one plane, or none."""
    return max(1, num_planes.bit_length())


def require_solvable(scene: Scene, geometry: Geometry, settings: TraceSettings) -> None:
    """Raise `SceneError` for interactions or scenes that `can_solve` declines."""
    if not can_solve(geometry, settings):
        raise SceneError(
            f"The image solver takes {' and '.join(sorted(SUPPORTED_INTERACTIONS))} among at most {MAX_MIRRORS:,} "
            f"mirrors that are smooth, but scene {scene.name!r} has {geometry.num_mirrors:,}"
            f"{', rough ones too,' if geometry.scattering else ''} and is asked for "
            f"{', '.join(settings.interactions)}; diffraction it takes among at most {MAX_FACETS} facets that all "
            f"mirror. Use --solver sionna, or let fewer mirror: mirrors = 'patches', or "
            "a larger least_patch_area_m2, in the scene's TOML."
        )


class ImageTracer:
    """The image method on one scene of few facets that all mirror, ready for any transmitter: a `Tracer`.

    `geometry` is that of the scene where it is known already. Raises `SceneError` for interactions or scenes
    that `can_solve` declines.
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
        media, kind = media_of(geometry.meshes, ascending, settings.materials, scene.receiver)
        can_refract = "refraction" in settings.interactions
        facets = _facets(geometry, kind, are_opaque(media) | (not can_refract))
        aperture = aperture_of(scene.receiver, SPEED_OF_LIGHT_M_S / ascending, savings)
        receiver_m = np.asarray(scene.receiver.position_m, dtype=np.float64)
        origins_m = np.vstack([receiver_m, receiver_m + aperture.corner_m[0]])  # of the widest aperture
        candidates = _images(
            _plane_sequences(facets, origins_m, settings, savings.max_reflections), facets, receiver_m
        )
        self.compiled = facets, media, candidates, aperture
        self._surface = geometry.surfaces_by_plane
        self.diffraction = None
        if "diffraction" in settings.interactions:
            self.diffraction = Diffraction(
                geometry,
                kind,
                facets,
                media,
                aperture,
                receiver_m,
                settings,
                Shortcuts(savings.share_visibility, savings.diffraction_planes, savings.diffraction_floor),
            )

    @checked
    def channel(self, tx_position_m: Positions) -> Channel:
        """Channel (T, F, M) of T transmitters at the array's elements, and the number of paths (T, F)."""
        real, imag, num_paths = kernels.channels(
            *self.compiled,
            np.ascontiguousarray(tx_position_m, dtype=np.float64),
            self.savings.share_visibility,
        )
        cfr = np.empty(real.shape, dtype=np.complex128)
        cfr.real, cfr.imag = real, imag
        channel = Channel(cfr, num_paths)
        if self.diffraction is not None:
            over_edges = self.diffraction.channel(np.ascontiguousarray(tx_position_m, np.float64), channel)
            channel = Channel(cfr + over_edges.cfr, num_paths + over_edges.num_paths)
        original = np.argsort(self._order)
        return Channel(channel.cfr[:, original], channel.num_paths[:, original])

    @checked
    def paths(self, tx_position_m: Position) -> Paths:
        """Paths of one transmitter to the array centre, the earliest first."""
        tx = np.asarray(tx_position_m, dtype=np.float64)
        facets, _, candidates, _ = self.compiled
        depth = self.settings.max_depth
        found = kernels.reaching(facets, candidates, tx)
        distance_m = np.linalg.norm(tx - candidates.image[found], axis=1)
        found, distance_m = (values[np.argsort(distance_m, kind="stable")] for values in (found, distance_m))
        scratch = kernels.new_scratch(len(facets.offset), depth, 1, tx)
        details = [self._path(int(c), scratch) for c in found]
        paths = PathsToCentre(
            gain=np.array([gain for gain, *_ in details], np.complex128).reshape(-1, len(self.carrier_hz)),
            distance_m=np.asarray(distance_m, dtype=np.float64),
            arrival=np.array([arrival for _, arrival, *_ in details]).reshape(-1, 3),
            interactions=np.array([codes for *_, codes, _, _ in details], np.int64).reshape(
                len(found), depth
            ),
            surfaces=np.array([met for *_, met, _ in details], np.int64).reshape(len(found), depth),
            vertices_m=np.array([points for *_, points in details]).reshape(len(found), depth, 3),
        )
        if self.diffraction is not None:
            paths = paths.merged(self.diffraction.paths(tx))
        spreading = SPEED_OF_LIGHT_M_S / self.carrier_hz[:, None] / (4 * np.pi * paths.distance_m)
        return Paths(
            carrier_hz=self.carrier_hz,
            gain=paths.gain.T[np.argsort(self._order)] * spreading,
            delay_s=paths.distance_m / SPEED_OF_LIGHT_M_S,
            arrival=paths.arrival,
            interactions=paths.interactions,
            surfaces=paths.surfaces,
            vertices_m=paths.vertices_m,
        )

    def _path(
        self, c: int, scratch: kernels.Scratch
    ) -> tuple[
        Complex[NDArray[np.complex128], "F"],
        Float[FloatArray, "3"],
        *Along,
    ]:
        """Gain at each carrier, ascending, arrival, and what candidate c, which reaches the centre, meets along it."""
        facets, media, candidates, _ = self.compiled
        path, centre = kernels.Path(*(column[c] for column in candidates)), np.zeros((1, 3))
        kernels.trace(facets, path, centre, kernels.LONE, scratch)
        gain = np.zeros(len(self.carrier_hz), dtype=np.complex128)
        for f in range(len(gain)):
            gain[f] = kernels.gains(facets, media, path, centre, f, scratch)[0]
        along = interactions_along(scratch, int(path.length), self.settings.max_depth, self._surface)
        return gain, -scratch.direction.copy(), *along


def _plane_sequences(
    facets: kernels.Facets,
    origins_m: Float[FloatArray, "O 3"],
    settings: TraceSettings,
    max_reflections: int | None,
) -> Int[NDArray[np.int16], "C D"]:
    """Sequences of planes that rays from the origins are reflected at, padded with −1.

    The empty sequence, the line of sight, is one of them. Where few reflections are asked for, they are all sequences.
    """
    depth, num_planes = settings.max_depth, len(facets.offset)
    most = depth if max_reflections is None else min(depth, max_reflections)
    if num_planes == 0 or most == 0 or "specular" not in settings.interactions:
        return np.full((1, depth), -1, dtype=np.int16)
    if most < depth and num_planes**most <= settings.rays:
        return _all_sequences(num_planes, most, depth)
    bits = _bits_per_plane(num_planes)
    num_rays = max(1, settings.rays // len(origins_m))
    rng = np.random.default_rng(settings.seed)
    found: list[NDArray[np.uint64]] = []
    for origin in np.unique(origins_m, axis=0):
        turn_rad = float(rng.uniform(0, 2 * np.pi))
        found += kernels.launch(facets, origin, kernels.Launch(num_rays, turn_rad, depth, bits))
    keys = np.unique(np.concatenate(found))
    shift = np.uint64(bits) * np.arange(depth, dtype=np.uint64)
    group = (keys[:, None] >> shift) & np.uint64(2**bits - 1)
    planes = group.astype(np.int16) - np.int16(1)
    return planes[(planes >= 0).sum(axis=1) <= most]


def _all_sequences(num_planes: int, most: int, depth: int) -> Int[NDArray[np.int16], "C D"]:
    """Every sequence of at most so many planes, none of them twice in a row, padded with −1."""
    found = np.full((1, depth), -1, dtype=np.int16)
    longest = found
    for order in range(most):
        longest = np.repeat(longest, num_planes, axis=0)
        longest[:, order] = np.tile(np.arange(num_planes), len(longest) // num_planes)
        if order:
            longest = longest[longest[:, order] != longest[:, order - 1]]
        found = np.concatenate([found, longest])
    return found


def interactions_along(
    scratch: kernels.Scratch, num_reflections: int, depth: int, surface: Int[IntArray, "Q"]
) -> Along:
    """What a traced path meets from the transmitter on; `surface` is the mesh of each of the kernels' facets.

    Codes of the interactions, the surfaces met, padded with −1, and where, padded with NaN.
    """
    codes, met, points = np.zeros(depth, np.int64), np.full(depth, -1), np.full((depth, 3), np.nan)
    at = 0
    for segment in range(num_reflections + 1):
        start, end = scratch.vertex[0, segment], scratch.vertex[0, segment + 1]
        for i in range(scratch.num_crossed[segment]):
            codes[at], met[at] = REFRACTION, surface[scratch.crossed[segment, i]]
            points[at] = start + scratch.crossed_at[segment, i] * (end - start)
            at += 1
        if segment < num_reflections:
            codes[at], met[at], points[at] = SPECULAR, surface[scratch.hit[segment]], end
            at += 1
    return codes, met, points


def media_of(
    meshes: Sequence[SurfaceMesh],
    carrier_hz: Float[FloatArray, "F"],
    policy: MaterialPolicy,
    receiver: ReceiverArray,
) -> tuple[kernels.Media, Int[IntArray, "S"]]:
    """Slabs of every material and thickness, with the antenna, and which slab each mesh is made of."""
    kinds = slabs_of(meshes)
    permittivity = [[complex_permittivity(name, float(f), policy) for name, *_ in kinds] for f in carrier_hz]
    thickness_m = np.array([slab.thickness_m for slab in kinds])
    media = kernels.Media(
        np.array(permittivity, dtype=np.complex128).reshape(len(carrier_hz), len(kinds)),
        2 * np.pi * carrier_hz[:, None] / SPEED_OF_LIGHT_M_S * thickness_m,
        is_horizontal=receiver.polarization == "H",
        is_dipole=receiver.pattern == "dipole",
    )
    kind = [kinds.index(mesh.slab) for mesh in meshes]
    return media, np.array(kind, dtype=np.int64)


def are_opaque(media: kernels.Media) -> Bool[NDArray[np.bool_], "K"]:
    """Whether each kind of slab passes less than `OPAQUE_TRANSMISSION` at every carrier."""
    transmission = [
        [abs(kernels.slab_coefficients(1.0, eta, phase)[2]) for eta, phase in zip(*slabs, strict=True)]
        for slabs in zip(media.permittivity, media.phase_thickness, strict=True)
    ]
    return np.max(transmission, axis=0, initial=0.0) < OPAQUE_TRANSMISSION


def _facets(
    geometry: Geometry, kind: Int[IntArray, "S"], is_opaque: Bool[NDArray[np.bool_], "K"]
) -> kernels.Facets:
    """Planes and facets as the kernels take them, from the kind of slab that each mesh is made of."""
    facets, (planes, plane) = geometry.facets, geometry.planes
    by_plane = np.argsort(plane, kind="stable")
    ordered = [facets[i] for i in by_plane]
    dual = _duals(ordered)
    slab = kind[[facet.surface for facet in ordered]] if ordered else np.zeros(0, np.int64)
    return kernels.Facets(
        normal=np.ascontiguousarray(planes[:, :3].T),
        offset=planes[:, 3].copy(),
        first=np.searchsorted(plane[by_plane], np.arange(len(planes) + 1)),
        plane=plane[by_plane],
        origin=np.array([facet.corners_m[0] for facet in ordered]).reshape(-1, 3),
        along_u=dual[:, 0].copy(),
        along_v=dual[:, 1].copy(),
        is_triangle=np.array([len(facet.corners_m) == 3 for facet in ordered], dtype=bool),
        slab=slab,
        is_opaque=is_opaque[slab],
    )


def _duals(facets: Sequence[PlanarFacet]) -> Float[FloatArray, "Q 2 3"]:
    """Vectors u*, v* with u = (x − origin)·u* and v = (x − origin)·v* where x = origin + u·edge_u + v·edge_v."""
    corners_m = np.array([facet.corners_m[[0, 1, -1]] for facet in facets]).reshape(-1, 3, 3)
    edges = corners_m[:, 1:] - corners_m[:, :1]
    return np.linalg.pinv(edges).transpose(0, 2, 1)


def aperture_of(
    receiver: ReceiverArray, wavelength_m: Float[FloatArray, "F"], savings: ImageSavings
) -> kernels.Aperture:
    """The array at each wavelength as the kernels take it, offsets from its centre in world axes."""
    element = receiver.element_position_wavelengths
    half = np.abs(element).max(axis=0)
    corner = np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]]) * half
    along_x, weight_x = _nodes(element[: receiver.cols, 0], savings.field_nodes_per_axis)
    along_y, weight_y = _nodes(element[:: receiver.cols, 1], savings.field_nodes_per_axis)
    node = np.array([[x, y, 0.0] for y in along_y for x in along_x])

    def in_metres(wavelengths: Float[FloatArray, "n 3"]) -> Float[FloatArray, "F n 3"]:
        return np.ascontiguousarray(wavelength_m[:, None, None] * (wavelengths @ receiver.rotation.T))

    return kernels.Aperture(
        wavelength_m=wavelength_m,
        element_m=in_metres(element),
        corner_m=in_metres(corner),
        node_m=in_metres(node),
        weight=np.kron(weight_y, weight_x).astype(np.float64),
        radius_m=float(np.linalg.norm(half) * wavelength_m[0]) if savings.prune else UNPRUNED_M,
    )


def _nodes(
    position: Float[FloatArray, "n"], num_nodes: int
) -> tuple[Float[FloatArray, "k"], Float[FloatArray, "k n"]]:
    """Evenly spread nodes along one axis of the array, in wavelengths, and their Lagrange weights at its elements.

    Arrays wider than the interpolation was measured for have a node at every element.
    """
    span_wavelengths = position[-1] - position[0]
    if num_nodes >= len(position) or span_wavelengths > MAX_INTERPOLATED_WAVELENGTHS:
        return position, np.eye(len(position))
    nodes = np.linspace(position[0], position[-1], num_nodes) if num_nodes > 1 else np.zeros(1)
    weight = np.ones((num_nodes, len(position)))
    for k in range(num_nodes):
        for other in range(num_nodes):
            if other != k:
                weight[k] *= (position - nodes[other]) / (nodes[k] - nodes[other])
    return nodes, weight


def _images(
    planes: Int[NDArray[np.int16], "C D"], facets: kernels.Facets, receiver_m: Float[FloatArray, "3"]
) -> kernels.Candidates:
    """Mirror the array centre, and the axes of its offsets, in one plane of each sequence after another."""
    image = np.tile(receiver_m, (len(planes), 1))
    mirror = np.tile(np.eye(3), (len(planes), 1, 1))
    for step in range(planes.shape[1]):
        rows = np.flatnonzero(planes[:, step] >= 0)
        plane = planes[rows, step]
        normal, offset = facets.normal.T[plane], facets.offset[plane]
        gap = np.einsum("ci,ci->c", image[rows], normal) - offset
        image[rows] -= 2 * gap[:, None] * normal
        along_normal = np.einsum("ci,cij->cj", normal, mirror[rows])
        mirror[rows] -= 2 * normal[:, :, None] * along_normal[:, None, :]
    return kernels.Candidates((planes >= 0).sum(axis=1), np.ascontiguousarray(planes), image, mirror)
