"""Solver `image`: the exact image method in float64, for scenes of planar facets.

Branching rays from the receiver find the sequences of reflecting planes that can matter, once. Each
transmitter keeps the sequences it can reach; four corners of the aperture decide visibility for every
element between them, and where they disagree, or a stretch is under 2 cm, each element is traced by
itself. Specular reflection and refraction only. Depth counts both, and a path with a stretch shorter
than 1 cm is dropped, as in Sionna RT, whose ITU-R P.2040 slabs and antenna conventions it shares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench import image_kernels as kernels
from xfreqbench.angles import FloatArray
from xfreqbench.errors import SceneError
from xfreqbench.facets import PlanarFacet, group_by_plane, planar_facets
from xfreqbench.materials import MaterialPolicy, complex_permittivity
from xfreqbench.mesh import SurfaceMesh, surface_meshes
from xfreqbench.paths import REFRACTION, SPECULAR, Paths
from xfreqbench.scene import ReceiverArray, Scene
from xfreqbench.tracing import Channel, TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

SUPPORTED_INTERACTIONS = frozenset({"specular", "refraction"})
MAX_FACETS = 400  # every ray is tested against every plane: beyond, Sionna's tree is the better tool
OPAQUE_TRANSMISSION = 1e-6  # −120 dB through a slab at normal incidence, at every carrier
NUM_CHUNKS = 64
MAX_INTERPOLATED_WAVELENGTHS = 1.5  # a 4×4 array: 68 dB or better at the 5th percentile; 8×8: 40 dB


@dataclass(frozen=True)
class ImageSavings:
    """What the solver skips; each can be turned off to price it. Only the last one moves the answer.

    The others move roundings: elements are traced one by one where the four corners of the aperture meet
    other facets, or any of them meets two within 2 cm. The field (not its phase) is computed at
    `field_nodes_per_axis`² points of the aperture and interpolated between them; 4 on a 4×4 array
    computes it at every element.
    """

    prune: bool = True
    share_visibility: bool = True
    field_nodes_per_axis: int = 2


def can_solve(meshes: Sequence[SurfaceMesh], settings: TraceSettings) -> bool:
    """Whether this solver takes the scene and the interactions."""
    is_supported = SUPPORTED_INTERACTIONS.issuperset(settings.interactions)
    return (
        is_supported
        and sum(len(mesh.triangles) for mesh in meshes) <= 2 * MAX_FACETS
        and _fits_a_key(meshes, settings.max_depth)
    )


def _fits_a_key(meshes: Sequence[SurfaceMesh], max_depth: int) -> bool:
    num_planes = len(group_by_plane(planar_facets(meshes))[0]) if meshes else 0
    return _bits_per_plane(num_planes) * max_depth <= 64


def _bits_per_plane(num_planes: int) -> int:
    return max(1, num_planes.bit_length())


class ImageTracer:
    """A scene whose plane sequences are known; see `xfreqbench.tracing.Tracer`.

    Raises `SceneError` for interactions or scenes that `can_solve` declines.
    """

    def __init__(
        self,
        scene: Scene,
        carrier_hz: Sequence[float],
        settings: TraceSettings,
        savings: ImageSavings = ImageSavings(),
    ) -> None:
        meshes = surface_meshes(scene)
        if not can_solve(meshes, settings):
            raise SceneError(
                f"The image solver takes {' and '.join(sorted(SUPPORTED_INTERACTIONS))} among at most "
                f"{MAX_FACETS} planar facets, but scene {scene.name!r} is asked for "
                f"{', '.join(settings.interactions)} to depth {settings.max_depth}. Use --solver sionna."
            )
        self.settings = settings
        self.savings = savings
        self.carrier_hz = np.asarray(carrier_hz, dtype=np.float64)
        self._order = np.argsort(self.carrier_hz, kind="stable")
        ascending = self.carrier_hz[self._order]
        self.slabs, kind = _slabs(meshes, ascending, settings.materials)
        opaque = _opaque_kinds(self.slabs, "refraction" in settings.interactions)
        self.facets = _compile_facets(planar_facets(meshes), kind, opaque)
        self.antenna = kernels.Antenna(scene.receiver.polarization == "H", scene.receiver.pattern == "dipole")
        self.aperture = _aperture(
            scene.receiver, SPEED_OF_LIGHT_M_S / ascending, savings.field_nodes_per_axis
        )
        self.receiver_m = np.asarray(scene.receiver.position_m, dtype=np.float64)
        self.candidates = self._find_candidates()

    def channel(self, tx_position_m: Float[FloatArray, "T 3"]) -> Channel:
        """Channel of transmitters at the array's elements."""
        cfr, num_paths = kernels.channels(
            self.facets,
            self.slabs,
            self.candidates,
            self.aperture,
            self.antenna,
            np.ascontiguousarray(tx_position_m, dtype=np.float64),
            self.settings.max_depth,
            self.savings.prune,
            self.savings.share_visibility,
        )
        original = np.argsort(self._order)
        return Channel(cfr[:, original], num_paths[:, original])

    def paths(self, tx_position_m: Float[FloatArray, "3"]) -> Paths:
        """Paths of one transmitter to the array centre, by ascending delay."""
        tx = np.asarray(tx_position_m, dtype=np.float64)
        depth = self.settings.max_depth
        found = kernels.reaching(self.facets, self.candidates, tx, depth)
        distance_m = np.linalg.norm(tx - self.candidates.image[found], axis=1)
        found, distance_m = (values[np.argsort(distance_m, kind="stable")] for values in (found, distance_m))
        scratch = kernels.new_scratch(depth, len(self.facets.offset))
        details = [self._path(int(c), tx, scratch) for c in found]
        spreading = SPEED_OF_LIGHT_M_S / self.carrier_hz[:, None] / (4 * np.pi * distance_m)
        gain = (
            np.array([gain for gain, *_ in details], dtype=np.complex128).reshape(-1, len(self.carrier_hz)).T
        )
        return Paths(
            self.carrier_hz,
            gain * spreading,
            distance_m / SPEED_OF_LIGHT_M_S,
            np.array([arrival for _, arrival, *_ in details]).reshape(-1, 3),
            np.array([codes for *_, codes, _ in details], dtype=np.int64).reshape(len(found), depth),
            np.array([points for *_, points in details]).reshape(len(found), depth, 3),
        )

    def _path(
        self, c: int, tx: Float[FloatArray, "3"], scratch: kernels.Scratch
    ) -> tuple[
        Complex[NDArray[np.complex128], "F"],
        Float[FloatArray, "3"],
        Int[NDArray[np.int64], "D"],
        Float[FloatArray, "D 3"],
    ]:
        """Gain per carrier, arrival, interaction codes and points of one path that reaches the centre."""
        centre, depth = np.zeros(3), self.settings.max_depth
        kernels.trace(self.facets, self.candidates, c, tx, centre, depth, scratch)
        gain = np.array(
            [
                kernels.path_gain(
                    self.facets, self.slabs, self.candidates, c, tx, centre, f, self.antenna, scratch
                )
                for f in np.argsort(self._order)
            ]
        )
        codes, points = _interactions(scratch, int(self.candidates.length[c]), depth)
        return gain, -scratch.direction.copy(), codes, points

    def _find_candidates(self) -> kernels.Candidates:
        """Launch rays from the array centre and from the corners of its widest aperture."""
        depth, num_planes = self.settings.max_depth, len(self.facets.offset)
        if num_planes == 0 or depth == 0 or "specular" not in self.settings.interactions:
            return _images(np.zeros((1, depth), np.int16) - 1, self.facets, self.receiver_m)
        bits = _bits_per_plane(num_planes)
        origins = self.receiver_m + np.vstack([np.zeros(3), self.aperture.corner_m[0]])
        rng = np.random.default_rng(self.settings.seed)
        found = [
            keys
            for origin in np.unique(origins, axis=0)
            for keys in kernels.launch(
                self.facets,
                origin,
                max(1, self.settings.rays // len(origins)),
                float(rng.uniform(0, 2 * np.pi)),
                depth,
                bits,
                NUM_CHUNKS,
            )
        ]
        planes = _planes_of_keys(np.unique(np.concatenate(found)), bits, depth)
        return _images(planes, self.facets, self.receiver_m)


def _interactions(
    scratch: kernels.Scratch, num_reflections: int, depth: int
) -> tuple[Int[NDArray[np.int64], "D"], Float[FloatArray, "D 3"]]:
    codes, points = np.zeros(depth, dtype=np.int64), np.full((depth, 3), np.nan)
    at = 0
    for segment in range(num_reflections + 1):
        start, end = scratch.vertex[0, segment], scratch.vertex[0, segment + 1]
        for fraction in scratch.crossed_at[segment, : scratch.num_crossed[segment]]:
            codes[at], points[at] = REFRACTION, start + fraction * (end - start)
            at += 1
        if segment < num_reflections:
            codes[at], points[at] = SPECULAR, end
            at += 1
    return codes, points


def _slabs(
    meshes: Sequence[SurfaceMesh], carrier_hz: Float[FloatArray, "F"], policy: MaterialPolicy
) -> tuple[kernels.Slabs, Int[NDArray[np.int64], "S"]]:
    """Slabs of every (material, thickness), and which of them each mesh is made of."""
    kinds = sorted({(mesh.material, mesh.thickness_m) for mesh in meshes})
    permittivity = [[complex_permittivity(name, float(f), policy) for name, _ in kinds] for f in carrier_hz]
    thickness_m = np.array([thickness for _, thickness in kinds])
    slabs = kernels.Slabs(
        np.array(permittivity, dtype=np.complex128).reshape(len(carrier_hz), len(kinds)),
        2 * np.pi * carrier_hz[:, None] / SPEED_OF_LIGHT_M_S * thickness_m,
    )
    kind = [kinds.index((mesh.material, mesh.thickness_m)) for mesh in meshes]
    return slabs, np.array(kind, dtype=np.int64)


def _compile_facets(
    facets: Sequence[PlanarFacet], kind: Int[NDArray[np.int64], "S"], opaque: Bool[NDArray[np.bool_], "K"]
) -> kernels.Facets:
    planes, plane = group_by_plane(facets)
    by_plane = np.argsort(plane, kind="stable")
    ordered = [facets[i] for i in by_plane]
    slab = kind[[facet.surface for facet in ordered]] if ordered else np.zeros(0, np.int64)
    return kernels.Facets(
        normal=np.ascontiguousarray(planes[:, :3].T),
        offset=planes[:, 3].copy(),
        first=np.searchsorted(plane[by_plane], np.arange(len(planes) + 1)),
        origin=np.array([facet.corners_m[0] for facet in ordered]).reshape(-1, 3),
        along_u=np.array([_dual(facet)[0] for facet in ordered]).reshape(-1, 3),
        along_v=np.array([_dual(facet)[1] for facet in ordered]).reshape(-1, 3),
        is_triangle=np.array([len(facet.corners_m) == 3 for facet in ordered], dtype=bool),
        slab=slab,
        is_opaque=opaque[slab],
    )


def _opaque_kinds(slabs: kernels.Slabs, refraction: bool) -> Bool[NDArray[np.bool_], "K"]:
    """Which slabs no ray passes: those that pass nothing worth tracing, or all without refraction."""
    num_kinds = slabs.permittivity.shape[1]
    return np.array([not refraction or _is_opaque(slabs, kind) for kind in range(num_kinds)], dtype=bool)


def _is_opaque(slabs: kernels.Slabs, kind: int) -> bool:
    """Whether the slab passes less than `OPAQUE_TRANSMISSION` at every carrier."""
    transmission = [
        abs(kernels.slab_coefficients(1.0, eta, phase)[2])
        for eta, phase in zip(slabs.permittivity[:, kind], slabs.phase_thickness[:, kind], strict=True)
    ]
    return max(transmission) < OPAQUE_TRANSMISSION


def _dual(facet: PlanarFacet) -> Float[FloatArray, "2 3"]:
    """Vectors u*, v* with u = (x − origin)·u* for x = origin + u·edge_u + v·edge_v."""
    edges = np.stack([facet.corners_m[1] - facet.corners_m[0], facet.corners_m[-1] - facet.corners_m[0]])
    return np.linalg.solve(edges @ edges.T, edges)


def _aperture(
    receiver: ReceiverArray, wavelength_m: Float[FloatArray, "F"], nodes_per_axis: int
) -> kernels.Aperture:
    element = receiver.element_position_wavelengths
    half = np.abs(element).max(axis=0)
    corner = np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]]) * half
    along_x, weight_x = _nodes(element[: receiver.cols, 0], nodes_per_axis)
    along_y, weight_y = _nodes(element[:: receiver.cols, 1], nodes_per_axis)
    node = np.array([[x, y, 0.0] for y in along_y for x in along_x])

    def in_metres(wavelengths: Float[FloatArray, "n 3"]) -> Float[FloatArray, "F n 3"]:
        return np.ascontiguousarray(wavelength_m[:, None, None] * (wavelengths @ receiver.rotation.T))

    return kernels.Aperture(
        wavelength_m=wavelength_m,
        element_m=in_metres(element),
        corner_m=in_metres(corner),
        node_m=in_metres(node),
        weight=np.kron(weight_y, weight_x).astype(np.float64),
        radius_m=float(np.linalg.norm(half) * wavelength_m[0]),
    )


def _nodes(
    position: Float[FloatArray, "n"], num_nodes: int
) -> tuple[Float[FloatArray, "k"], Float[FloatArray, "k n"]]:
    """Evenly spread nodes along one axis and their Lagrange weights at the positions.

    Arrays wider than the interpolation was measured for have a node at every element.
    """
    span_wavelengths = position[-1] - position[0]
    if num_nodes >= len(position) or span_wavelengths > MAX_INTERPOLATED_WAVELENGTHS:
        return position, np.eye(len(position))
    count = num_nodes
    nodes = np.linspace(position[0], position[-1], count) if count > 1 else np.zeros(1)
    weight = np.ones((count, len(position)))
    for k in range(count):
        for other in range(count):
            if other != k:
                weight[k] *= (position - nodes[other]) / (nodes[k] - nodes[other])
    return nodes, weight


def _planes_of_keys(keys: NDArray[np.uint64], bits: int, depth: int) -> Int[NDArray[np.int16], "C D"]:
    """Plane sequences behind the keys of `kernels.launch`, padded with −1."""
    shift = np.uint64(bits) * np.arange(depth, dtype=np.uint64)
    group = (keys[:, None] >> shift) & np.uint64(2**bits - 1)
    return group.astype(np.int16) - np.int16(1)


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
