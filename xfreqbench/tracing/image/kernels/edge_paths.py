"""Kernels of the way of a path over one edge, with planes that reflect it before and after, and of its field.

Each end of a path sees the edge directly or over some planes: that is a side, the image of the end mirrored in one
plane after another. Unfolded, a path is the shortest way from one image over the edge to the other. Turned about the
edge into one half-plane it is a straight line, which gives the point of the edge in closed form. From there on both of
its halves are paths as any other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from xfreqbench.tracing.image.kernels.arrays import (
    BLOCK,
    C128,
    EVERYWHERE,
    F64,
    I64,
    MIXED,
    NOWHERE,
    Aperture,
    Bundle,
    Facets,
    Media,
    Path,
    Walk,
    new_walk,
)
from xfreqbench.tracing.image.kernels.bundles import decide, fold, gather_mirrors, gather_slabs, reaches
from xfreqbench.tracing.image.kernels.compiled import bare, whole
from xfreqbench.tracing.image.kernels.edge_sides import MAX_SIDE_PLANES, Reflectors
from xfreqbench.tracing.image.kernels.fields import antenna_field
from xfreqbench.tracing.image.kernels.slabs import reflect, transmit
from xfreqbench.tracing.image.kernels.wedges import Polar, Wedges, diffract, edge_point, place, polar
from xfreqbench.tracing.paths import DIFFRACTION, REFRACTION, SPECULAR

Pair = tuple[Path, Path]  # how the two ends see an edge: the planes of a path are those of its end's side

# Of the field over the array, roughly: the change up to which it is computed at the centre alone, and up to which it
# is interpolated.
MAX_CENTRED_CHANGE = 0.01
MAX_INTERPOLATED_CHANGE = 0.15


class Room(NamedTuple):
    """What is the same for all paths."""

    facets: Facets
    media: Media
    wedges: Wedges
    mirrors: Reflectors
    aperture: Aperture


class Work(NamedTuple):
    """Work space of one thread: the halves of a path, each from the edge to its end, and what is at the edge."""

    near: Walk
    far: Walk
    near_end: F64  # (3,) image of the transmitter
    far_end: F64  # (3,) image of an element
    point: F64  # (3,) of the edge
    waves: F64  # (2, 3): unit vectors from the ends to the point
    fields: C128  # (2, 3): that they bring there
    gains: C128  # (M,)
    vectors: F64  # (6, 3)
    zeros: F64  # (4, 3)
    own: F64  # (1, 3): an element


@whole
def new_work(num_elements: int) -> Work:
    """Work space for paths to an array."""
    return Work(
        new_walk(MAX_SIDE_PLANES, 1, 1, np.zeros(3)),
        new_walk(MAX_SIDE_PLANES, 1, 1, np.zeros(3)),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        np.zeros((2, 3)),
        np.zeros((2, 3), np.complex128),
        np.zeros(num_elements, np.complex128),
        np.zeros((6, 3)),
        np.zeros((4, 3)),
        np.zeros((1, 3)),
    )


@bare
def begin_at(wedges: Wedges, e: int, work: Work) -> None:
    """Let the halves of paths begin at edge e."""
    for c in range(3):
        work.near.edge[0, c] = work.far.edge[0, c] = wedges.start[e, c]
        work.near.edge[1, c] = work.far.edge[1, c] = wedges.start[e, c] + wedges.length[e] * wedges.along[e, c]


@bare
def end_at(side: Path, x: float, y: float, z: float, out: F64) -> None:
    """Image of an end's point at an offset from its centre."""
    for c in range(3):
        out[c] = side.image[c] + side.mirror[c, 0] * x + side.mirror[c, 1] * y + side.mirror[c, 2] * z


@bare
def _meets(wedges: Wedges, e: int, near: Polar, far_end: F64) -> tuple[int, float]:
    """0 where the shortest way over edge e to an end meets the edge, else the bit of the reason why it does not.

    Also returned is where along the edge it does, in metres.
    """
    far = polar(wedges, e, far_end)
    if far[0] <= 1e-9 or far[2] <= 0.0 or far[2] >= wedges.angle[e]:  # not in the free space around the edge
        return 1, 0.0
    z = edge_point(near, far)
    if z < 0.0:
        return 2, z
    return (0 if z < wedges.length[e] else 4), z


@bare
def _follow(facets: Facets, side: Path, offset_m: F64, bundle: Bundle, walk: Walk) -> int:
    """Whether halves of paths from `walk.start` on reach all, none or some of the ends at `offset_m` (K, 3)."""
    if len(bundle) == 1:
        return EVERYWHERE if reaches(facets, side, offset_m, False, walk) else NOWHERE
    verdict = fold(facets, side, offset_m, bundle, walk)
    if verdict == EVERYWHERE:
        verdict = gather_mirrors(facets, side, bundle, walk)
    if verdict == EVERYWHERE:
        verdict = gather_slabs(facets, side, bundle, walk)
    return decide(facets, side, bundle, walk) if verdict == EVERYWHERE else verdict


@bare
def reach(
    facets: Facets,
    wedges: Wedges,
    e: int,
    pair: Pair,
    near: Polar,
    offset_m: F64,
    most: int,
    bundle: Bundle,
    work: Work,
) -> int:
    """Whether paths of at most `most` interactions besides edge e reach EVERYWHERE, NOWHERE or, MIXED, only some ends.

    `near` is where the image of the transmitter is, `offset_m` (K, 3) are offsets of the elements. `begin_at` was
    called for the edge. What the paths meet is left in `work`.
    """
    if near[0] <= 1e-9 or near[2] <= 0.0 or near[2] >= wedges.angle[e]:
        return NOWHERE
    num_met, common = 0, 7
    for k in range(len(bundle)):
        end_at(pair[1], offset_m[k, 0], offset_m[k, 1], offset_m[k, 2], work.far_end)
        reason, z = _meets(wedges, e, near, work.far_end)
        num_met += reason == 0
        common &= reason
        for c in range(3):
            work.near.start[k, c] = work.far.start[k, c] = wedges.start[e, c] + z * wedges.along[e, c]
    if num_met < len(bundle):
        return NOWHERE if common != 0 else MIXED
    work.near.limit[0] = most - pair[0].length - pair[1].length
    verdict = _follow(facets, pair[0], work.zeros, bundle, work.near)
    if verdict != EVERYWHERE:
        return verdict
    num_crossed = 0
    for s in range(pair[0].length + 1):
        num_crossed += work.near.num_crossed[s]
    work.far.limit[0] = work.near.limit[0] - num_crossed
    return _follow(facets, pair[1], offset_m, bundle, work.far)


@bare
def _carry(facets: Facets, media: Media, side: Path, walk: Walk, end: F64, lane: int, half: int, work: Work) -> None:
    """Carry the field of the antenna at one end to the point of the edge, backwards over a half that was traced.

    `end` is the image of that end. The wave's direction at the edge is left in `work.waves`.
    """
    wave, way, mirror, field = walk.wave, work.waves[half], side.mirror, work.fields[half]
    norm = 0.0
    for c in range(3):
        way[c] = work.point[c] - end[c]
        norm += way[c] * way[c]
    for c in range(3):
        way[c] /= math.sqrt(norm)
    for c in range(3):
        wave[c * BLOCK] = mirror[0, c] * way[0] + mirror[1, c] * way[1] + mirror[2, c] * way[2]
        wave[(6 + c) * BLOCK] = 0.0
    wave[3 * BLOCK], wave[4 * BLOCK], wave[5 * BLOCK] = antenna_field(media, wave[0], wave[BLOCK], wave[2 * BLOCK])
    for s in range(side.length, -1, -1):
        for i in range(walk.num_crossed[s] - 1, -1, -1):
            q = walk.crossed[s, i]
            transmit(media.lanes[facets.slab[q], :, lane : lane + 1], facets.face[q], wave, 1)
        if s > 0:
            q = walk.hit[s - 1]
            reflect(media.lanes[facets.slab[q], :, lane : lane + 1], facets.face[q], wave, 1)
    for c in range(3):
        field[c] = complex(wave[(3 + c) * BLOCK], wave[(6 + c) * BLOCK])


@bare
def gain(room: Room, e: int, pair: Pair, near: Polar, f: int, work: Work) -> complex:
    """Gain at carrier f of the path that was traced last, to the end in `work.far_end`.

    Spreading and travel phase are left out, as if the path were straight.
    """
    wedges, media, lane = room.wedges, room.media, f * room.aperture.weight.shape[0]
    far = polar(wedges, e, work.far_end)
    z = edge_point(near, far)
    before, after = math.hypot(near[0], z - near[1]), math.hypot(far[0], z - far[1])
    for c in range(3):
        work.point[c] = wedges.start[e, c] + z * wedges.along[e, c]
    _carry(room.facets, media, pair[0], work.near, work.near_end, lane, 0, work)
    _carry(room.facets, media, pair[1], work.far, work.far_end, lane, 1, work)
    size = 4.0 * math.pi / room.aperture.wavelength_m[f] * before * after / (before + after)
    waves, fields = (work.waves[0], work.waves[1]), (work.fields[0], work.fields[1])
    root = math.sqrt(size) * near[0] / before
    return diffract(wedges, media, e, f, waves, fields, (near[2], far[2]), root, work.vectors)


@bare
def length_over(wedges: Wedges, e: int, near: Polar, x: F64) -> float:
    """Length of the shortest way over the edge from a point in polar coordinates to another."""
    a, b, z = place(wedges, e, x)
    return math.sqrt((near[0] + math.sqrt(a * a + b * b)) ** 2 + (near[1] - z) ** 2)


@bare
def gains(room: Room, e: int, pair: Pair, near: Polar, f: int, shift: float, work: Work) -> None:
    """Gains at carrier f at all elements, of a path that reaches all of them, to work.gains (M,).

    Where the field hardly changes over the array it is computed at its centre, where it changes a little at the
    nodes between which it is interpolated, else at every element. `shift` is its change by the metre.
    """
    aperture, gains, corner = room.aperture, work.gains, room.aperture.corner_m[f, 0]
    changes = shift * math.sqrt(corner[0] ** 2 + corner[1] ** 2 + corner[2] ** 2)
    num_nodes, num_elements = aperture.weight.shape
    if num_nodes == num_elements or changes > MAX_INTERPOLATED_CHANGE:
        for m in range(num_elements):
            x, y, z = aperture.element_m[f, 0, m], aperture.element_m[f, 1, m], aperture.element_m[f, 2, m]
            end_at(pair[1], x, y, z, work.far_end)
            gains[m] = gain(room, e, pair, near, f, work)
    elif changes < MAX_CENTRED_CHANGE:
        end_at(pair[1], 0.0, 0.0, 0.0, work.far_end)
        at_centre = gain(room, e, pair, near, f, work)
        for m in range(num_elements):
            gains[m] = at_centre
    else:
        for m in range(num_elements):
            gains[m] = 0.0
        for node in range(num_nodes):
            i = f * num_nodes + node
            end_at(pair[1], aperture.node_m[0, i], aperture.node_m[1, i], aperture.node_m[2, i], work.far_end)
            at_node = gain(room, e, pair, near, f, work)
            for m in range(num_elements):
                gains[m] += aperture.weight[node, m] * at_node


@bare
def _off_boundary(turn: float, n: float) -> float:
    """How far off its boundary, in half turns over n, the term that belongs to an angle is."""
    off = turn / (2.0 * n)
    return off - math.pi * math.floor(off / math.pi + 0.5)


@bare
def bounds(angle: float, near: Polar, far: Polar, wavelength_m: F64, out: F64) -> None:
    """Write bounds (F,) of a diffracted path's amplitude over its wavelength, in 1/m, reflections left out.

    Each of the four terms is at most 1, and at most its value by geometrical optics far off its boundary.
    """
    n, together = angle / math.pi, near[0] + far[0]
    length_m = math.hypot(together, near[1] - far[1])
    root = math.sqrt(4.0 * math.pi * math.pi * near[0] * far[0] / length_m)
    for f in range(out.shape[0]):
        out[f] = 0.0
    for i in range(4):
        apart = far[2] - near[2] if i < 2 else far[2] + near[2]
        off = _off_boundary(math.pi + (apart if i % 2 == 0 else -apart), n)
        sine = abs(math.sin(n * off))
        share = min(1.0, sine / (n * abs(math.tan(off)) + 1e-30)) / (8.0 * math.pi * length_m)
        share *= 1.0 if i > 1 else 2.0  # straight on, up to 1 − T, where faces let T through
        far_off = 1.0 / (root * sine + 1e-30)
        for f in range(out.shape[0]):
            out[f] += share * min(1.0, far_off * math.sqrt(wavelength_m[f]))


@bare
def change(angle: float, near: Polar, far: Polar) -> float:
    """By how much, relative to its size, the field changes where the far end moves by a metre; roughly."""
    n, least = angle / math.pi, 1.0
    for i in range(4):
        apart = far[2] - near[2] if i < 2 else far[2] + near[2]
        least = min(least, 2.0 * n * abs(_off_boundary(math.pi + (apart if i % 2 == 0 else -apart), n)))
    return 1.0 / (far[0] * least + 1e-30)


@whole
def list_interactions(work: Work, pair: Pair, e: int, code: I64, met: I64, point: F64) -> None:
    """Write the interactions (D,) of the path traced last over edge e, from the first end on, and where they happen.

    `met` (D,) gets the facet of each, and −1 − e at the edge; `point` is (D, 3).
    """
    at = 0
    for half in range(2):
        walk, n = (work.near, pair[0].length) if half == 0 else (work.far, pair[1].length)
        for step in range(n + 1):
            s = n - step if half == 0 else step
            for i in range(walk.num_crossed[s]):
                which = walk.num_crossed[s] - 1 - i if half == 0 else i
                code[at], met[at] = REFRACTION, walk.crossed[s, which]
                start, end = walk.vertex[0, s], walk.vertex[0, s + 1]
                point[at] = start + walk.crossed_at[s, which] * (end - start)
                at += 1
            turn = s if half == 0 else s + 1
            if step < n:
                code[at], met[at], point[at] = SPECULAR, walk.hit[turn - 1], walk.vertex[0, turn]
                at += 1
        if half == 0:
            code[at], met[at], point[at] = DIFFRACTION, -1 - e, walk.vertex[0, 0]
            at += 1
