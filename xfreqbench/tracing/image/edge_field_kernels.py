"""Compiled kernels: the gain of a path over an edge, where it is needed over the array, and a bound of it.

These kernels are not cached: they become part of those of `diffraction_kernels`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from xfreqbench.tracing.image.edge_path_kernels import Leg, Polar, Side, edge_point, new_leg, place, polar
from xfreqbench.tracing.image.edge_side_kernels import Reflectors
from xfreqbench.tracing.image.kernels import (
    C128,
    F64,
    I64,
    Aperture,
    Facets,
    Media,
    Scratch,
    _antenna_field,
    _dot,
    _interact,
    new_scratch,
)
from xfreqbench.tracing.image.wedge_kernels import Wedges, diffract, inner
from xfreqbench.tracing.paths import DIFFRACTION, REFRACTION, SPECULAR

MAX_CENTRED_CHANGE = (
    0.01  # of the field over the array, roughly, up to which it is computed at the centre alone
)
MAX_INTERPOLATED_CHANGE = 0.15  # and up to which it is interpolated


class Room(NamedTuple):
    """What is the same for all paths."""

    facets: Facets
    media: Media
    wedges: Wedges
    mirrors: Reflectors
    aperture: Aperture


class Work(NamedTuple):
    """Work space of one thread."""

    scratch: Scratch
    near: Leg
    far: Leg
    vectors: F64  # (9, 3)
    fields: C128  # (2, 3)
    gains: C128  # (M,)
    near_end: F64  # (3,)
    far_end: F64  # (3,)


@inner
def new_work(facets: Facets, num_elements: int) -> Work:
    """Work space for paths to an array."""
    return Work(
        new_scratch(facets.offset.shape[0], 1, 1, np.zeros(3)),
        new_leg(),
        new_leg(),
        np.zeros((9, 3)),
        np.zeros((2, 3), np.complex128),
        np.zeros(num_elements, np.complex128),
        np.zeros(3),
        np.zeros(3),
    )


@inner
def end_at(side: Side, offset_m: F64, out: F64) -> None:
    """Image of an end's point at an offset from its centre."""
    for c in range(3):
        out[c] = side.image[c]
        for b in range(3):
            out[c] += side.mirror[c, b] * offset_m[b]


@inner
def _carry(
    room: Room, side: Side, leg: Leg, end: F64, point: F64, f: int, scratch: Scratch, wave: F64, field: C128
) -> None:
    """Carry the field of an antenna at one end to the point of the edge, over a leg that was traced.

    The direction of the wave at the end is left in `scratch`, pointing from the end, and that at the edge in `wave`.
    """
    facets, media, k = room.facets, room.media, scratch.direction
    norm = 0.0
    for c in range(3):
        wave[c] = point[c] - end[c]
        norm += wave[c] * wave[c]
    norm = math.sqrt(norm)
    for c in range(3):
        wave[c] /= norm
    for c in range(3):
        k[c] = side.mirror[0, c] * wave[0] + side.mirror[1, c] * wave[1] + side.mirror[2, c] * wave[2]
    ex, ey, ez = _antenna_field(media, k[0], k[1], k[2])
    scratch.field[0], scratch.field[1], scratch.field[2] = ex, ey, ez
    x, y, z = k[0], k[1], k[2]
    for s in range(side.length, -1, -1):
        for i in range(leg.num_crossed[s] - 1, -1, -1):
            _interact(facets, media, leg.crossed[s, i], f, False, scratch)
        if s > 0:
            _interact(facets, media, leg.hit[s - 1], f, True, scratch)
    k[0], k[1], k[2] = x, y, z
    for c in range(3):
        field[c] = scratch.field[c]


@inner
def gain(room: Room, e: int, pair: tuple[Side, Side], f: int, work: Work) -> complex:
    """Gain at carrier f of the path that was traced last, between the two ends in `work`.

    Spreading and travel phase are left out, as if the path were straight. The direction in `work` is then that from
    the second end.
    """
    wedges, wavelength_m, point = room.wedges, room.aperture.wavelength_m[f], work.vectors[6]
    near, far = polar(wedges, e, work.near_end), polar(wedges, e, work.far_end)
    z = edge_point(near, far)
    before, after = math.hypot(near[0], z - near[1]), math.hypot(far[0], z - far[1])
    for c in range(3):
        point[c] = wedges.start[e, c] + z * wedges.along[e, c]
    waves, fields = (work.vectors[7], work.vectors[8]), (work.fields[0], work.fields[1])
    _carry(room, pair[0], work.near, work.near_end, point, f, work.scratch, waves[0], fields[0])
    _carry(room, pair[1], work.far, work.far_end, point, f, work.scratch, waves[1], fields[1])
    root = math.sqrt(4.0 * math.pi / wavelength_m * before * after / (before + after)) * near[0] / before
    return diffract(wedges, room.media, e, f, waves, fields, (near[2], far[2]), root, work.vectors)


@inner
def length_over(wedges: Wedges, e: int, near: Polar, x: F64) -> float:
    """Length of the shortest way over the edge from a point in polar coordinates to another."""
    a, b, z = place(wedges, e, x)
    return math.sqrt((near[0] + math.sqrt(a * a + b * b)) ** 2 + (near[1] - z) ** 2)


@inner
def gains(room: Room, e: int, pair: tuple[Side, Side], f: int, shift: float, work: Work) -> None:
    """Gains at carrier f at all elements, of a path that reaches all of them, to work.gains (M,).

    Where the field hardly changes over the array it is computed at its centre, where it changes a little at the
    nodes between which it is interpolated, else at every element.
    """
    aperture, gains = room.aperture, work.gains
    changes = shift * math.sqrt(_dot(aperture.corner_m[f, 0], aperture.corner_m[f, 0]))
    num_nodes, num_elements = aperture.node_m.shape[1], aperture.element_m.shape[1]
    if num_nodes == num_elements or changes > MAX_INTERPOLATED_CHANGE:
        for m in range(num_elements):
            end_at(pair[1], aperture.element_m[f, m], work.far_end)
            gains[m] = gain(room, e, pair, f, work)
    elif changes < MAX_CENTRED_CHANGE:
        for c in range(3):
            work.far_end[c] = pair[1].image[c]
        at_centre = gain(room, e, pair, f, work)
        for m in range(num_elements):
            gains[m] = at_centre
    else:
        for m in range(num_elements):
            gains[m] = 0j
        for node in range(num_nodes):
            end_at(pair[1], aperture.node_m[f, node], work.far_end)
            at_node = gain(room, e, pair, f, work)
            for m in range(num_elements):
                gains[m] += aperture.weight[node, m] * at_node


@inner
def _off_boundary(turn: float, n: float) -> float:
    """How far off its boundary, in half turns over n, the term that belongs to an angle is."""
    off = turn / (2.0 * n)
    return off - math.pi * math.floor(off / math.pi + 0.5)


@inner
def bounds(angle: float, near: Polar, far: Polar, wavelength_m: F64, out: F64) -> None:
    """Write bounds (F,) of a diffracted path's amplitude over its wavelength, in 1/m, reflections left out.

    Each of the four terms is at most 1, and at most its value by geometrical optics far off its boundary.
    """
    n, together = angle / math.pi, near[0] + far[0]
    length_m = math.hypot(together, near[1] - far[1])
    root = math.sqrt(4.0 * math.pi * math.pi * near[0] * far[0] / length_m)
    out[:] = 0.0
    for i in range(4):
        apart = far[2] - near[2] if i < 2 else far[2] + near[2]
        off = _off_boundary(math.pi + (apart if i % 2 == 0 else -apart), n)
        sine = abs(math.sin(n * off))
        share = min(1.0, sine / (n * abs(math.tan(off)) + 1e-30)) / (8.0 * math.pi * length_m)
        share *= 1.0 if i > 1 else 2.0  # straight on, up to 1 − T, where faces let T through
        far_off = 1.0 / (root * sine + 1e-30)
        for f in range(out.shape[0]):
            out[f] += share * min(1.0, far_off * math.sqrt(wavelength_m[f]))


@inner
def change(angle: float, near: Polar, far: Polar) -> float:
    """By how much, relative to its size, the field changes where the far end moves by a metre; roughly."""
    n, least = angle / math.pi, 1.0
    for i in range(4):
        apart = far[2] - near[2] if i < 2 else far[2] + near[2]
        least = min(least, 2.0 * n * abs(_off_boundary(math.pi + (apart if i % 2 == 0 else -apart), n)))
    return 1.0 / (far[0] * least + 1e-30)


@inner
def list_interactions(work: Work, pair: tuple[Side, Side], e: int, code: I64, met: I64, point: F64) -> None:
    """Write the interactions (D,) of the path traced last over edge e, from the first end on, and where they happen.

    `met` (D,) gets the facet of each, and −1 − e at the edge; `point` is (D, 3).
    """
    at = 0
    for half in range(2):
        leg, n = (work.near, pair[0].length) if half == 0 else (work.far, pair[1].length)
        for step in range(n + 1):
            s = n - step if half == 0 else step
            for i in range(leg.num_crossed[s]):
                which = leg.num_crossed[s] - 1 - i if half == 0 else i
                share = leg.crossed_at[s, which]
                code[at], met[at] = REFRACTION, leg.crossed[s, which]
                point[at] = leg.vertex[s] + share * (leg.vertex[s + 1] - leg.vertex[s])
                at += 1
            turn = s if half == 0 else s + 1
            if step < n:
                code[at], met[at], point[at] = SPECULAR, leg.hit[turn - 1], leg.vertex[turn]
                at += 1
        if half == 0:
            code[at], met[at], point[at] = DIFFRACTION, -1 - e, leg.vertex[0]
            at += 1
