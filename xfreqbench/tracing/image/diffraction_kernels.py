"""Compiled entries of first-order diffraction: channels and paths over edges, in float64.

Numba's cache notices only changes of the file that a cached kernel is in. The kernels here call those of other
files, so each cached one is made by a function that closes over a hash of them all, which is part of its key.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from xfreqbench.tracing.image import (
    edge_field_kernels,
    edge_path_kernels,
    edge_side_kernels,
    kernels,
    wedge_kernels,
)
from xfreqbench.tracing.image.edge_field_kernels import (
    Room,
    Work,
    bounds,
    change,
    end_at,
    gain,
    gains,
    length_over,
    list_interactions,
    new_work,
)
from xfreqbench.tracing.image.edge_path_kernels import Polar, Side, edge_point, reach
from xfreqbench.tracing.image.edge_side_kernels import Reflectors, Sides, find_sides
from xfreqbench.tracing.image.kernels import (
    C128,
    EVERYWHERE,
    F64,
    FAST,
    I32,
    I64,
    MIN_SEGMENT_M,
    MIXED,
    NOWHERE,
    Aperture,
    Facets,
    Media,
)
from xfreqbench.tracing.image.wedge_kernels import Wedges, inner

Sums = tuple[F64, F64]
CentrePaths = tuple[C128, F64, F64, I64, I64, F64]

SOURCES = b"".join(
    Path(str(module.__file__)).read_bytes()
    for module in (kernels, wedge_kernels, edge_path_kernels, edge_side_kernels, edge_field_kernels)
)
DIGEST = hashlib.sha256(SOURCES).hexdigest()


class Limits(NamedTuple):
    """Which paths are sought, and which of them are skipped."""

    max_depth: int  # interactions in all
    max_planes: int  # reflections on either side of the edge
    share: bool  # decide at the array's corners which paths reach its elements
    floor: F64  # (T, F): amplitude over wavelength, in 1/m, below which a path is skipped at a carrier


@inner
def _side(sides: Sides, s: int) -> Side:
    return Side(sides.length[s], sides.plane[s], sides.image[s], sides.mirror[s])


@inner
def _decide(room: Room, e: int, pair: tuple[Side, Side], corner_m: F64, most: int, work: Work) -> int:
    """At which elements between the corners (4, 3) a path arrives, as `kernels.trace` decides it.

    EVERYWHERE and NOWHERE where all corners meet, or fail at, the same.
    """
    reached, met = False, 0
    for i in range(4):
        end_at(pair[1], corner_m[i], work.far_end)
        ends, legs = (work.near_end, work.far_end), (work.near, work.far)
        reaches, meets, shortest = reach(room.facets, room.wedges, e, pair, ends, most, legs)
        is_sure = shortest >= 2.0 * MIN_SEGMENT_M if reaches else shortest == 0.0
        if not is_sure or (i > 0 and (reaches != reached or meets != met)):
            return MIXED
        reached, met = reaches, meets
    return EVERYWHERE if reached else NOWHERE


@inner
def _add_path(
    room: Room,
    e: int,
    pair: tuple[Side, Side],
    polars: tuple[Polar, Polar],
    limits: Limits,
    is_kept: NDArray[np.bool_],
    work: Work,
    sums: Sums,
    num_paths: I32,
) -> None:
    """Add a path to `sums` (F, M) each at the carriers where `is_kept` (F,).

    At the first of them, the widest aperture, it is decided for all which elements are reached.
    """
    (real, imag), aperture, reached = sums, room.aperture, MIXED
    legs, ends, most = (work.near, work.far), (work.near_end, work.far_end), limits.max_depth - 1
    shift = change(room.wedges.angle[e], polars[0], polars[1])
    for f in range(num_paths.shape[0]):
        if not is_kept[f]:
            continue
        if limits.share and reached == MIXED:
            reached = _decide(room, e, pair, aperture.corner_m[f], most, work)
        if reached == NOWHERE:
            break
        is_heard, wavelength_m = False, aperture.wavelength_m[f]
        if reached == EVERYWHERE:
            gains(room, e, pair, f, shift, work)
        for m in range(real.shape[1]):
            end_at(pair[1], aperture.element_m[f, m], work.far_end)
            if reached == MIXED:
                if not reach(room.facets, room.wedges, e, pair, ends, most, legs)[0]:
                    continue
                work.gains[m] = gain(room, e, pair, f, work)
            length_m = length_over(room.wedges, e, polars[0], work.far_end)
            turns = length_m / wavelength_m
            phase = 2.0 * math.pi * (turns - math.floor(turns))
            factor = wavelength_m / (4.0 * math.pi * length_m) * complex(math.cos(phase), -math.sin(phase))
            factor *= work.gains[m]
            real[f, m] += factor.real
            imag[f, m] += factor.imag
            is_heard |= factor != 0
        num_paths[f] += is_heard


@inner
def _row(rows: F64, s: int) -> Polar:
    return rows[s, 0], rows[s, 1], rows[s, 2]


@inner
def _meet(near: Sides, a: int, far: Sides, b: int, radius_m: float) -> bool:
    """Whether the path over two sides meets the edge in the parts that they see, for ends within a radius."""
    near_m, far_m = near.polar[a, 0], far.polar[b, 0]
    z_m = edge_point((near_m, near.polar[a, 1], 0.0), (far_m, far.polar[b, 1], 0.0))
    lean = abs(far.polar[b, 1] - near.polar[a, 1]) / (near_m + far_m)
    slack_m = 1.2 * radius_m * (1.0 + lean) + 1e-9
    low_m = max(near.span[a, 0], far.span[b, 0]) - slack_m
    return low_m <= z_m <= min(near.span[a, 1], far.span[b, 1]) + slack_m


@inner
def _add_all(room: Room, near: Sides, far: Sides, limits: Limits, i: int, sums: Sums, num_paths: I32) -> None:
    """Add all paths of transmitter i to `sums` (F, M) each."""
    work, floor, radius_m = new_work(room.facets, sums[0].shape[1]), limits.floor[i], room.aperture.radius_m
    most, is_kept = np.empty(floor.shape[0]), np.ones(floor.shape[0], np.bool_)
    for e in range(room.wedges.length.shape[0]):
        for a in range(near.first[e], near.first[e + 1]):
            work.near_end[:] = near.image[a]
            for b in range(far.first[e], far.first[e + 1]):
                if near.length[a] + far.length[b] >= limits.max_depth or not _meet(near, a, far, b, radius_m):
                    continue
                polars = _row(near.polar, a), _row(far.polar, b)
                bounds(room.wedges.angle[e], polars[0], polars[1], room.aperture.wavelength_m, most)
                is_any = False
                for f in range(len(most)):
                    is_kept[f] = near.most[a, f] * far.most[b, f] * most[f] >= floor[f]
                    is_any |= is_kept[f]
                if is_any:
                    pair = _side(near, a), _side(far, b)
                    _add_path(room, e, pair, polars, limits, is_kept, work, sums, num_paths)


@inner
def _centre_paths(
    room: Room, near: Sides, far: Sides, limits: Limits, work: Work, out: CentrePaths, num: int
) -> int:
    """Write the paths to the array centre to the first rows of `out`, as many as it has; how many there are."""
    gains, length_m, arrival, code, met, point = out
    legs, ends = (work.near, work.far), (work.near_end, work.far_end)
    for e in range(room.wedges.length.shape[0]):
        for a in range(near.first[e], near.first[e + 1]):
            work.near_end[:] = near.image[a]
            for b in range(far.first[e], far.first[e + 1]):
                work.far_end[:] = far.image[b]
                is_deep = near.length[a] + far.length[b] >= limits.max_depth
                if is_deep or not _meet(near, a, far, b, 0.0):
                    continue
                pair = _side(near, a), _side(far, b)
                if not reach(room.facets, room.wedges, e, pair, ends, limits.max_depth - 1, legs)[0]:
                    continue
                if num < len(length_m):
                    list_interactions(work, pair, e, code[num], met[num], point[num])
                    for f in range(gains.shape[1]):
                        gains[num, f] = gain(room, e, pair, f, work)
                    length_m[num] = length_over(room.wedges, e, _row(near.polar, a), work.far_end)
                    arrival[num] = work.scratch.direction
                num += 1
    return num


def _made_channels(digest: str) -> Callable[..., tuple[F64, F64, I32]]:
    @njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
    def channels(
        facets: Facets,
        media: Media,
        wedges: Wedges,
        mirrors: Reflectors,
        aperture: Aperture,
        far: Sides,
        limits: Limits,
        tx_position_m: F64,
    ) -> tuple[F64, F64, I32]:
        """Channels (T, F, M) over edges, real and imaginary, and path counts (T, F), as `kernels.channels`."""
        assert len(digest) > 0
        shape = len(tx_position_m), aperture.element_m.shape[0], aperture.element_m.shape[1]
        real, imag, num_paths = np.zeros(shape), np.zeros(shape), np.zeros(shape[:2], np.int32)
        for i in prange(len(tx_position_m)):
            room = Room(facets, media, wedges, mirrors, aperture)
            near = find_sides(facets, mirrors, wedges, tx_position_m[i : i + 1], limits.max_planes)
            number: Any = np.int64(i)  # signed in prange too: compiled for one type
            if len(near.length) > 0:
                _add_all(room, near, far, limits, number, (real[i], imag[i]), num_paths[i])
        return real, imag, num_paths

    return channels


def _made_sides(digest: str) -> Callable[..., Sides]:
    @njit(cache=True, fastmath=FAST, error_model="numpy")
    def sides(facets: Facets, mirrors: Reflectors, wedges: Wedges, points: F64, max_planes: int) -> Sides:
        """How points (O, 3) see the edges; see `find_sides`."""
        assert len(digest) > 0
        return find_sides(facets, mirrors, wedges, points, max_planes)

    return sides


def _made_paths(digest: str) -> Callable[..., CentrePaths]:
    @njit(cache=True, fastmath=FAST, error_model="numpy")
    def paths(room: Room, near: Sides, far: Sides, limits: Limits) -> CentrePaths:
        """Paths of one transmitter, which sees the edges over `near`, to the array centre.

        Returned are gains (N, F) without spreading and travel phase, lengths (N,) in metres, unit vectors from the
        centre to where they come from (N, 3), codes of the interactions (N, D), the facet of each, or −1 − e at edge
        e (N, D), and where they happen (N, D, 3).
        """
        assert len(digest) > 0
        work, num, depth = new_work(room.facets, 1), 0, limits.max_depth
        for _ in range(2):
            out = (
                np.zeros((num, room.aperture.wavelength_m.shape[0]), np.complex128),
                np.zeros(num),
                np.zeros((num, 3)),
                np.zeros((num, depth), np.int64),
                np.zeros((num, depth), np.int64),
                np.full((num, depth, 3), np.nan),
            )
            num = _centre_paths(room, near, far, limits, work, out, 0)
        return out

    return paths


channels, paths, sides = _made_channels(DIGEST), _made_paths(DIGEST), _made_sides(DIGEST)
