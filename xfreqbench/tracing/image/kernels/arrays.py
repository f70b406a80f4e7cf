"""What kernels are given: the scene, its media, the array, a path, and the work space of a thread.

A tuple that is passed on costs time for each array in it, so kernels take the tuples that they need and no more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from xfreqbench.types import NDArray

from .compiled import whole

F64 = NDArray[np.float64]
I16 = NDArray[np.int16]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
C128 = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Sums = tuple[F64, F64]  # real and imaginary
Vector = tuple[float, float, float]
# A path to the array centre at F carriers: gain (F,) without spreading and travel phase, length in metres, unit vector
# to where it comes from (3,), and its D interactions from the transmitter on: codes (D,), the mesh that is met at each
# (D,), padded with −1, and where they happen (D, 3), padded with NaN.
CentrePath = tuple[C128, float, F64, I64, I64, F64]

MIN_SEGMENT_M = 1e-9  # a path with a shorter stretch is an artefact of rounding, at an edge or in a corner
FAR = 1e30  # where a ray meets nothing
MAX_CROSSED = 16  # slabs on one segment; a path that crosses more is dropped, but is deeper than the limit
MAX_BOXES = 256  # on the stack of boxes still to look into
MAX_NEAR = 32  # facets that a bundle may meet on one segment; of more, each path is followed by itself
BLOCK = 64  # lanes that waves are carried in at once, a multiple of `SIMD_WIDTH`
SIMD_WIDTH = 8  # of a vector register of AVX-512: with fewer, the compiled loops work in single numbers
NUM_CHUNKS = 64  # that the rays are divided into, for the threads


class Facets(NamedTuple):
    """Planes, and convex planar facets in the order of a tree's leaves. (P planes, Q facets, N boxes)

    Planes of mirrors come first; of later planes each holds one triangle that does not mirror.
    """

    normal: F64  # (3, P)
    offset: F64  # (P,): normal · x = offset
    face: F64  # (Q, 12): its plane's normal and offset, u* and its offset, v* and its offset: u = x·u* − offset
    is_triangle: Bools  # (Q,): u + v ≤ 1 holds too, beside 0 ≤ u, v ≤ 1
    plane: I64  # (Q,)
    slab: I64  # (Q,): its kind, an index into Media
    is_opaque: Bools  # (Q,)
    box: F64  # (N, 6): lowest corner, highest corner; the first box holds all facets
    child: I64  # (N,): the first of a box's two parts, or −1 for a leaf
    first: I64  # (N,): a leaf holds facets first:last
    last: I64  # (N,)


class AntennaArrays(NamedTuple):
    """What the antennas at one end of a path send or take, with unit vectors in world axes."""

    is_horizontal: bool
    is_dipole: bool
    is_directive: bool
    axis: Vector  # about which polar angle and azimuth are counted
    aside: Vector  # at right angles to it: the azimuth of the axis itself, opposite at the two ends of a path
    ahead: Vector  # at right angles to it: where the antenna looks


class Media(NamedTuple):
    """Kinds of slabs at each carrier, and the antennas at both ends. (F carriers, K kinds of N layers, L lanes)

    A lane is one of the N nodes of the array at one carrier, or one of its M elements. The nodes of all carriers come
    first, those of one carrier side by side: L = F·N + F·M.
    """

    permittivity: C128  # (F, N) relative
    phase_thickness: F64  # (F, N): 2π d / λ
    lanes: F64  # (N, 3, L + SIMD_WIDTH): real and imaginary part of the permittivity, phase thickness
    first: I64  # (K + 1,): layers first[k] to first[k + 1] are of kind k, the first at the front
    specular: F64  # (K,): share of the reflected field that the slab does not scatter, √(1 − S²); 1 where it is smooth
    antennas: F64  # (2, 12): `AntennaArrays` of the transmitter and of the receiver, in one array, for tuples cost time

    def in_lanes(self, num_nodes: int, num_elements: int) -> Media:
        """The media of an array of so many nodes and elements, from those with one lane for each carrier."""
        of_carrier = self.lanes[:, :, :-SIMD_WIDTH]
        lanes = np.concatenate([np.repeat(of_carrier, n, axis=2) for n in (num_nodes, num_elements)], axis=2)
        return self._replace(lanes=np.pad(lanes, [(0, 0), (0, 0), (0, SIMD_WIDTH)], mode="edge"))


class Aperture(NamedTuple):
    """The array at each carrier, carriers ascending: world offsets from its centre. (M elements, N field nodes)"""

    wavelength_m: F64  # (F,)
    element_m: F64  # (F, 3, M)
    corner_m: F64  # (F, 4, 3)
    node_m: F64  # (3, F·N)
    weight: F64  # (N, M): field at the elements from the field at the nodes
    radius_m: float  # of the widest aperture; 1e30 lets every candidate pass the first rough test


class SceneArrays(NamedTuple):
    """What is the same for all paths."""

    facets: Facets
    media: Media
    aperture: Aperture
    quads: I64  # (B, 4): neighbours for which is decided at once; one element four times is decided by itself


class Path(NamedTuple):
    """A sequence of planes, and what describes its path completely: the path is the straight line to the element's
    image, folded back at every plane. (D planes at most)
    """

    length: int
    plane: I16  # (D,): in the order in which a wave from the receiver meets them
    image: F64  # (3,) of the array centre, mirrored in one plane after another
    mirror: F64  # (3, 3): what the planes make of an element's offset from the centre


class Walk(NamedTuple):
    """Work space of one thread, for up to four paths side by side. (D planes at most)"""

    start: F64  # (4, 3): where each path begins
    edge: F64  # (2, 3): ends of the edge that the paths begin at; far away where they begin at none
    limit: I64  # (1,): slabs that each path may cross
    vertex: F64  # (4, D + 2, 3): from the start to the element
    hit: I64  # (D + 1,) facet of each reflection, from the start
    crossed: I64  # (D + 1, MAX_CROSSED) facets crossed on each segment, from the start
    crossed_at: F64  # (D + 1, MAX_CROSSED): where, as a share of the first path's segment
    num_crossed: I64  # (D + 1,)
    mirrors: I64  # (D, MAX_NEAR) facets of each plane where some path may turn
    num_mirrors: I64  # (D,)
    slabs: I64  # (D + 1, MAX_NEAR) facets that some path may cross, by segment
    num_slabs: I64  # (D + 1,)
    box: I64  # boxes still to look into
    box_at: F64  # where the paths enter them
    plane: I16  # (D,) of the path at hand
    image: F64  # (3,)
    mirror: F64  # (3, 3)
    wave: F64  # (9·BLOCK,): direction, real and imaginary part of the field, each x, y, z in turn
    gain: F64  # (2, F·N) at the nodes: real and imaginary
    own: F64  # (2, M) at the elements
    four: F64  # (4, 3): offsets of elements


@whole
def new_walk(max_depth: int, num_nodes: int, num_elements: int, start: F64) -> Walk:
    """Work space for paths from `start` (3,) that turn at most `max_depth` times.

    `num_nodes` are those at all carriers.
    """
    starts = np.empty((4, 3))
    starts[:] = start
    return Walk(
        starts,
        np.full((2, 3), FAR),
        np.full(1, max_depth),
        np.zeros((4, max_depth + 2, 3)),
        np.zeros(max_depth + 1, np.int64),
        np.zeros((max_depth + 1, MAX_CROSSED), np.int64),
        np.zeros((max_depth + 1, MAX_CROSSED)),
        np.zeros(max_depth + 1, np.int64),
        np.zeros((max_depth + 1, MAX_NEAR), np.int64),
        np.zeros(max_depth + 1, np.int64),
        np.zeros((max_depth + 1, MAX_NEAR), np.int64),
        np.zeros(max_depth + 1, np.int64),
        np.zeros(MAX_BOXES, np.int64),
        np.zeros(MAX_BOXES),
        np.zeros(max_depth + 1, np.int16),
        np.zeros(3),
        np.zeros((3, 3)),
        np.zeros(9 * BLOCK),
        np.zeros((2, num_nodes)),
        np.zeros((2, num_elements)),
        np.zeros((4, 3)),
    )
