"""Kernels that sum the paths of a transmitter over edges, and list those that reach the array centre."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from xfreqbench.tracing.image.kernels.arrays import (
    C128,
    CORNERS,
    EVERYWHERE,
    F64,
    I32,
    I64,
    LONE,
    MIXED,
    NOWHERE,
    Bools,
    Path,
    Sums,
)
from xfreqbench.tracing.image.kernels.compiled import bare, entry, lane, part, whole
from xfreqbench.tracing.image.kernels.edge_paths import (
    Pair,
    Room,
    Work,
    begin_at,
    bounds,
    change,
    end_at,
    gain,
    gains,
    length_over,
    list_interactions,
    new_work,
    reach,
)
from xfreqbench.tracing.image.kernels.edge_sides import Sides, find_sides
from xfreqbench.tracing.image.kernels.slabs import cosine_and_sine
from xfreqbench.tracing.image.kernels.wedges import Polar, edge_point

CentrePaths = tuple[C128, F64, F64, I64, I64, F64]


class Limits(NamedTuple):
    """Which paths are sought, and which of them are skipped."""

    max_depth: int  # interactions in all
    max_planes: int  # reflections on either side of the edge
    share: bool  # decide at the array's corners which paths reach its elements
    floor: float  # paths weaker than this, relative to the strongest element without edges, are skipped


@lane
def _side(sides: Sides, s: int) -> Path:
    return Path(sides.length[s], sides.plane[s], sides.image[s], sides.mirror[s])


@bare
def _add_path(
    room: Room,
    e: int,
    pair: Pair,
    polars: tuple[Polar, Polar],
    limits: Limits,
    is_kept: Bools,
    work: Work,
    sums: Sums,
    num_paths: I32,
) -> None:
    """Add a path to `sums` (F, M) each at the carriers where `is_kept` (F,).

    A carrier at which the corners agree decides for all narrower apertures.
    """
    (real, imag), aperture, reached, most = sums, room.aperture, MIXED, limits.max_depth - 1
    shift, own = change(room.wedges.angle[e], polars[0], polars[1]), work.own
    for f in range(num_paths.shape[0]):
        if not is_kept[f]:
            continue
        if limits.share and reached == MIXED:
            corner_m = aperture.corner_m[f]
            reached = reach(room.facets, room.wedges, e, pair, polars[0], corner_m, most, CORNERS, work)
        if reached == NOWHERE:
            break
        is_heard, wavelength_m = False, aperture.wavelength_m[f]
        if reached == EVERYWHERE:
            gains(room, e, pair, polars[0], f, shift, work)
        for m in range(real.shape[1]):
            for c in range(3):
                own[0, c] = aperture.element_m[f, c, m]
            if reached == MIXED:
                if reach(room.facets, room.wedges, e, pair, polars[0], own, most, LONE, work) != EVERYWHERE:
                    continue
                work.gains[m] = gain(room, e, pair, polars[0], f, work)
            end_at(pair[1], own[0, 0], own[0, 1], own[0, 2], work.far_end)
            length_m = length_over(room.wedges, e, polars[0], work.far_end)
            cosine, sine = cosine_and_sine(length_m / wavelength_m)
            factor = wavelength_m / (4.0 * math.pi * length_m) * complex(cosine, -sine) * work.gains[m]
            real[f, m] += factor.real
            imag[f, m] += factor.imag
            is_heard |= factor != 0
        num_paths[f] += is_heard


@part
def _row(rows: F64, s: int) -> Polar:
    return rows[s, 0], rows[s, 1], rows[s, 2]


@bare
def _meet(near: Sides, a: int, far: Sides, b: int, radius_m: float) -> bool:
    """Whether the path over two sides meets the edge in the parts that they see, for ends within a radius."""
    near_m, far_m = near.polar[a, 0], far.polar[b, 0]
    z_m = edge_point((near_m, near.polar[a, 1], 0.0), (far_m, far.polar[b, 1], 0.0))
    lean = abs(far.polar[b, 1] - near.polar[a, 1]) / (near_m + far_m)
    slack_m = 1.2 * radius_m * (1.0 + lean) + 1e-9
    low_m = max(near.span[a, 0], far.span[b, 0]) - slack_m
    return low_m <= z_m <= min(near.span[a, 1], far.span[b, 1]) + slack_m


@bare
def _add_all(
    room: Room,
    near: Sides,
    far: Sides,
    limits: Limits,
    floor: F64,
    most: F64,
    is_kept: Bools,
    work: Work,
    sums: Sums,
    num_paths: I32,
) -> None:
    """Add all paths over edges to `sums` (F, M) each; `floor` (F,) is the least amplitude over wavelength of a path."""
    wedges, wavelength_m, radius_m = room.wedges, room.aperture.wavelength_m, room.aperture.radius_m
    for e in range(wedges.length.shape[0]):
        begin_at(wedges, e, work)
        for a in range(near.first[e], near.first[e + 1]):
            for c in range(3):
                work.near_end[c] = near.image[a, c]
            for b in range(far.first[e], far.first[e + 1]):
                if near.length[a] + far.length[b] >= limits.max_depth or not _meet(near, a, far, b, radius_m):
                    continue
                polars = _row(near.polar, a), _row(far.polar, b)
                bounds(wedges.angle[e], polars[0], polars[1], wavelength_m, most)
                is_any = False
                for f in range(len(most)):
                    is_kept[f] = near.most[a, f] * far.most[b, f] * most[f] >= floor[f]
                    is_any |= is_kept[f]
                if is_any:
                    pair = _side(near, a), _side(far, b)
                    _add_path(room, e, pair, polars, limits, is_kept, work, sums, num_paths)


@entry
def add_over_edges(room: Room, far: Sides, limits: Limits, tx: F64, sums: Sums, num_paths: I32) -> None:
    """Add the channel (F, M) over edges of the transmitter at `tx` (1, 3) to `sums`, which hold that of other paths.

    The numbers of its paths are added to `num_paths` (F,). `far` is how the array sees the edges.
    """
    (real, imag), wavelength_m, wedges = sums, room.aperture.wavelength_m, room.wedges
    near = find_sides(room.facets, room.mirrors, wedges, tx, limits.max_planes)
    work = new_work(real.shape[1])
    floor = np.zeros(len(wavelength_m))  # of a path's amplitude over its wavelength, in 1/m
    most, is_kept = np.empty(len(wavelength_m)), np.ones(len(wavelength_m), np.bool_)
    for f in range(len(floor)):
        for m in range(real.shape[1]):
            floor[f] = max(floor[f], limits.floor * math.hypot(real[f, m], imag[f, m]) / wavelength_m[f])
    _add_all(room, near, far, limits, floor, most, is_kept, work, sums, num_paths)


@whole
def _centre_paths(room: Room, near: Sides, far: Sides, limits: Limits, work: Work, out: CentrePaths) -> int:
    """Write the paths to the array centre to the first rows of `out`, as many as it has; how many there are."""
    gains, length_m, arrival, code, met, point = out
    num, centre, facets, wedges, most = 0, np.zeros((1, 3)), room.facets, room.wedges, limits.max_depth - 1
    for e in range(wedges.length.shape[0]):
        begin_at(wedges, e, work)
        for a in range(near.first[e], near.first[e + 1]):
            work.near_end[:] = near.image[a]
            polar = _row(near.polar, a)
            for b in range(far.first[e], far.first[e + 1]):
                is_deep = near.length[a] + far.length[b] >= limits.max_depth
                if is_deep or not _meet(near, a, far, b, 0.0):
                    continue
                pair = _side(near, a), _side(far, b)
                if reach(facets, wedges, e, pair, polar, centre, most, LONE, work) != EVERYWHERE:
                    continue
                if num < len(length_m):
                    list_interactions(work, pair, e, code[num], met[num], point[num])
                    for f in range(gains.shape[1]):
                        gains[num, f] = gain(room, e, pair, polar, f, work)
                    length_m[num] = length_over(wedges, e, polar, work.far_end)
                    way = work.far.vertex[0, pair[1].length] - work.far.vertex[0, pair[1].length + 1]
                    arrival[num] = way / np.linalg.norm(way)
                num += 1
    return num


@entry
def paths_over_edges(room: Room, far: Sides, limits: Limits, tx: F64) -> CentrePaths:
    """Paths over edges from the transmitter at `tx` (1, 3) to the array centre.

    Returned are gains (N, F) without spreading and travel phase, lengths (N,) in metres, unit vectors from the
    centre to where they come from (N, 3), codes of the interactions (N, D), the facet of each, or −1 − e at edge
    e (N, D), and where they happen (N, D, 3).
    """
    near = find_sides(room.facets, room.mirrors, room.wedges, tx, limits.max_planes)
    work, num, depth = new_work(1), 0, limits.max_depth
    for _ in range(2):
        out = (
            np.zeros((num, room.aperture.wavelength_m.shape[0]), np.complex128),
            np.zeros(num),
            np.zeros((num, 3)),
            np.zeros((num, depth), np.int64),
            np.zeros((num, depth), np.int64),
            np.full((num, depth, 3), np.nan),
        )
        num = _centre_paths(room, near, far, limits, work, out)
    return out
