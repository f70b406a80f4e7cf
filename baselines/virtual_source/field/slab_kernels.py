"""Compiled kernels in float32: gains of paths by the slabs that they meet, with slopes, and where they cross planes.

A touch is a plane (−1: none), a point along its axes in metres, and the cosine to its normal. Tables of coefficients
are (2, Q, A, C): slabs, planes, A even steps of the cosine, and V polarisations' complex numbers at F carriers as
C = 2VF real ones. `plain` (C,) are the numbers of what has no slab: of an opening, or of metal, as `kind` says.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from xfreqbench.system.kernels import entry
from xfreqbench.types import FloatArray, NDArray

NOTHING, THICK, THIN, METAL = range(4)  # what cells hold
METAL_REFLECTION = (-1.0, 1.0)  # TE, TM: the limit of high conductivity
_ONE = np.float32(1)
_FAST = {"contract", "reassoc"}

F32 = NDArray[np.float32]
C64 = NDArray[np.complex64]
I64 = NDArray[np.int64]
Touches = tuple[I64, F32, F32]  # plane (N, K), point (N, K, 2), cosine (N, K)
Cells = tuple[F32, F32, np.float32]  # logits (Q, I, J, 4), lowest corners (Q, 2) and side in metres


@njit(error_model="numpy")
def _between(place: np.float32, number: int) -> tuple[int, np.floating[Any]]:
    """The last of `number` points before a place, and the share of the step to the next one; ends continue."""
    place = min(max(place, np.float32(0)), np.float32(number - 1))
    below = min(int(place), number - 2)
    return below, place - np.float32(below)


@njit(error_model="numpy")
def _fill(cells: Cells, plane: int, point_m: F32, share: F32) -> None:
    """Write what is held at a point of a plane to `share` (4,): the softmax of logits interpolated between cells."""
    logits, low_m, cell_m = cells
    i, along = _between((point_m[0] - low_m[plane, 0]) / cell_m, logits.shape[1])
    j, across = _between((point_m[1] - low_m[plane, 1]) / cell_m, logits.shape[2])
    near, far = logits[plane, i], logits[plane, i + 1]
    for kind in range(4):
        first = (_ONE - across) * near[j, kind] + across * near[j + 1, kind]
        second = (_ONE - across) * far[j, kind] + across * far[j + 1, kind]
        share[kind] = (_ONE - along) * first + along * second
    most, total = max(max(share[0], share[1]), max(share[2], share[3])), np.float32(0)
    for kind in range(4):
        share[kind] = np.exp(share[kind] - most)
        total += share[kind]
    for kind in range(4):
        share[kind] /= total


@entry(error_model="numpy", fastmath=_FAST)
def shares(cells: Cells, plane: I64, point_m: F32) -> F32:
    """What the cells at points (n, 2) hold: shares (n, 4); where there is no plane, nothing."""
    share = np.zeros((len(plane), 4), np.float32)
    for n in range(len(plane)):
        if plane[n] < 0:
            share[n, NOTHING] = 1
        else:
            _fill(cells, plane[n], point_m[n], share[n])
    return share


@njit(error_model="numpy", fastmath=_FAST)
def _factors(touches: Touches, n: int, table: F32, cells: Cells, kind: int, plain: F32, share: F32, value: F32) -> None:
    """Write factors where path `n` meets planes to `value` (K, C), and what is there to `share` (K, 4).

    Where there is no plane, factors are 1.
    """
    plane, point_m, cosine = touches
    for k in range(plane.shape[1]):
        q = plane[n, k]
        if q < 0:
            value[k, ::2], value[k, 1::2] = 1, 0
            continue
        _fill(cells, q, point_m[n, k], share[k])
        a, weight = _between(cosine[n, k] * np.float32(table.shape[2] - 1), table.shape[2])
        held, thick, thin = share[k, kind], share[k, THICK], share[k, THIN]
        thick_next, thin_next = thick * weight, thin * weight
        thick, thin = thick - thick_next, thin - thin_next
        for c in range(len(plain)):
            of_thick = thick * table[0, q, a, c] + thick_next * table[0, q, a + 1, c]
            of_thin = thin * table[1, q, a, c] + thin_next * table[1, q, a + 1, c]
            value[k, c] = held * plain[c] + of_thick + of_thin


@njit(error_model="numpy", fastmath=_FAST)
def _add_slopes(
    touches: Touches,
    n: int,
    table: F32,
    cells: Cells,
    kind: int,
    plain: F32,
    share: F32,
    slope: F32,
    of_table: F32,
    of_logits: F32,
) -> None:
    """Add the slopes by table and logits from those by the values of `_factors`, `slope` (K, C)."""
    plane, point_m, cosine = touches
    logits, low_m, cell_m = cells
    of_share = np.empty(4, np.float32)
    for k in range(plane.shape[1]):
        q = plane[n, k]
        if q < 0:
            continue
        a, weight = _between(cosine[n, k] * np.float32(table.shape[2] - 1), table.shape[2])
        of_share[:] = 0
        for slab, held in enumerate((THICK, THIN)):
            here, after = np.float32(0), np.float32(0)
            of_here, of_after = share[k, held] * (_ONE - weight), share[k, held] * weight
            for c in range(len(plain)):
                here += slope[k, c] * table[slab, q, a, c]
                after += slope[k, c] * table[slab, q, a + 1, c]
                of_table[slab, q, a, c] += of_here * slope[k, c]
                of_table[slab, q, a + 1, c] += of_after * slope[k, c]
            of_share[held] = here + weight * (after - here)
        for c in range(len(plain)):
            of_share[kind] += slope[k, c] * plain[c]
        mean = np.float32(0)
        for held in range(4):
            mean += share[k, held] * of_share[held]
        i, along = _between((point_m[n, k, 0] - low_m[q, 0]) / cell_m, logits.shape[1])
        j, across = _between((point_m[n, k, 1] - low_m[q, 1]) / cell_m, logits.shape[2])
        for held in range(4):
            of_logit = share[k, held] * (of_share[held] - mean)
            of_logits[q, i, j, held] += (_ONE - along) * (_ONE - across) * of_logit
            of_logits[q, i, j + 1, held] += (_ONE - along) * across * of_logit
            of_logits[q, i + 1, j, held] += along * (_ONE - across) * of_logit
            of_logits[q, i + 1, j + 1, held] += along * across * of_logit


@njit(error_model="numpy", fastmath=_FAST)
def _combine(polarised: F32, bounce: C64, term: C64) -> None:
    """Write Σ_c polarised_c Π_o R_{o, c_o} over the last bounces to `term` (O + 1, 2^O, F); its first is over all.

    What follows bounce o depends on the choices before it alone, so pairs of terms share it.
    """
    for c in range(len(polarised)):
        term[len(bounce), c] = polarised[c]
    for o in range(len(bounce) - 1, -1, -1):
        for c in range(1 << o):
            for f in range(term.shape[2]):
                term[o, c, f] = term[o + 1, 2 * c, f] * bounce[o, 0, f] + term[o + 1, 2 * c + 1, f] * bounce[o, 1, f]


@njit(error_model="numpy")
def _plain(num_carriers: int) -> tuple[F32, F32]:
    """What metal reflects, TE and then TM, and what an opening lets through, as real numbers."""
    metal, opening = np.zeros(4 * num_carriers, np.float32), np.zeros(2 * num_carriers, np.float32)
    metal[: 2 * num_carriers : 2], metal[2 * num_carriers :: 2] = METAL_REFLECTION
    opening[::2] = 1
    return metal, opening


@entry(error_model="numpy", fastmath=_FAST)
def gains(
    polarised: F32, spread: F32, bounces: Touches, crossings: Touches, reflecting: F32, transmitting: F32, cells: Cells
) -> tuple[C64, tuple[F32, F32], tuple[F32, F32]]:
    """Gains of N paths at F carriers, (N, F): `spread` times what `polarised` (N, 2^O) and all factors make.

    Also returned are what `_factors` writes for bounces and for crossings: factors (N, K, C), and shares (N, K, 4).
    """
    num_paths, num_carriers = len(spread), transmitting.shape[3] // 2
    num_bounces, num_crossings = bounces[0].shape[1], crossings[0].shape[1]
    metal, opening = _plain(num_carriers)
    gain = np.zeros((num_paths, num_carriers), np.complex64)
    reflected = np.empty((num_paths, num_bounces, 4 * num_carriers), np.float32)
    passed = np.empty((num_paths, num_crossings, 2 * num_carriers), np.float32)
    bounce_share = np.empty((num_paths, num_bounces, 4), np.float32)
    crossing_share = np.empty((num_paths, num_crossings, 4), np.float32)
    bounce = reflected.view(np.complex64).reshape(num_paths, num_bounces, 2, num_carriers)
    through = passed.view(np.complex64)
    term = np.empty((num_bounces + 1, polarised.shape[1], num_carriers), np.complex64)
    for n in range(num_paths):
        if spread[n] == 0:
            continue
        _factors(bounces, n, reflecting, cells, METAL, metal, bounce_share[n], reflected[n])
        _factors(crossings, n, transmitting, cells, NOTHING, opening, crossing_share[n], passed[n])
        _combine(polarised[n], bounce[n], term)
        for f in range(num_carriers):
            gain[n, f] = term[0, 0, f] * spread[n]
            for k in range(num_crossings):
                gain[n, f] *= through[n, k, f]
    return gain, (reflected, passed), (bounce_share, crossing_share)


@entry(error_model="numpy", fastmath=_FAST)
def slopes_of_gains(
    polarised: F32,
    spread: F32,
    bounces: Touches,
    crossings: Touches,
    reflecting: F32,
    transmitting: F32,
    cells: Cells,
    factors: tuple[F32, F32],
    shares: tuple[F32, F32],
    slope: C64,
) -> tuple[F32, F32, F32]:
    """The slopes by `reflecting`, `transmitting` and the cells' logits, from those by `gains`, `slope` (N, F)."""
    num_paths, num_carriers = slope.shape
    num_bounces, num_crossings = bounces[0].shape[1], crossings[0].shape[1]
    metal, opening = _plain(num_carriers)
    of_reflecting, of_transmitting = np.zeros_like(reflecting), np.zeros_like(transmitting)
    of_logits = np.zeros_like(cells[0])
    bounce = factors[0].view(np.complex64).reshape(num_paths, num_bounces, 2, num_carriers)
    through = factors[1].view(np.complex64)
    of_reflected, of_passed = np.empty_like(factors[0][0]), np.empty_like(factors[1][0])
    of_bounce = of_reflected.view(np.complex64).reshape(num_bounces, 2, num_carriers)
    of_through = of_passed.view(np.complex64)
    term = np.empty((num_bounces + 1, polarised.shape[1], num_carriers), np.complex64)
    of_term = np.empty_like(term)
    for n in range(num_paths):
        if spread[n] == 0:
            continue
        _combine(polarised[n], bounce[n], term)
        of_bounce[:] = 0
        for f in range(num_carriers):
            before, after = slope[n, f] * spread[n], term[0, 0, f].conjugate()
            for k in range(num_crossings):
                of_through[k, f] = before
                before *= through[n, k, f].conjugate()
            for k in range(num_crossings - 1, -1, -1):
                of_through[k, f] *= after
                after *= through[n, k, f].conjugate()
            of_term[0, 0, f] = before
            for o in range(num_bounces):
                for c in range(1 << o):
                    for v in range(2):
                        of_bounce[o, v, f] += of_term[o, c, f] * term[o + 1, 2 * c + v, f].conjugate()
                        of_term[o + 1, 2 * c + v, f] = of_term[o, c, f] * bounce[n, o, v, f].conjugate()
        _add_slopes(bounces, n, reflecting, cells, METAL, metal, shares[0][n], of_reflected, of_reflecting, of_logits)
        of_both = of_transmitting, of_logits
        _add_slopes(crossings, n, transmitting, cells, NOTHING, opening, shares[1][n], of_passed, *of_both)
    return of_reflecting, of_transmitting, of_logits


@entry(error_model="numpy")
def crossings(
    nodes_m: FloatArray, height_m: FloatArray, is_real: NDArray[np.bool_], axes: FloatArray, least_m: float
) -> tuple[I64, F32, F32]:
    """Where stretches of N real paths go through Q planes: planes (N, C), points (N, C, 2) and cosines (N, C).

    `nodes_m` (N, S + 1, 3) are the ends of the stretches, `height_m` (N, S + 1, Q) their distances from the planes; one
    that ends closer than `least_m` does not cross. C is the most crossings of a path; others have planes −1.
    """
    num_paths, num_nodes, num_planes = height_m.shape
    number = np.zeros(num_paths, np.int64)
    for is_counted in (True, False):
        width = 0 if is_counted else number.max() if num_paths else 0
        plane, cosine = np.full((num_paths, width), -1), np.zeros((num_paths, width), np.float32)
        point_m = np.zeros((num_paths, width, 2), np.float32)
        for n in range(num_paths):
            if not is_real[n]:
                continue
            k = 0
            for s in range(num_nodes - 1):
                way = nodes_m[n, s + 1] - nodes_m[n, s]
                length_m = np.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
                for q in range(num_planes):
                    before, after = height_m[n, s, q], height_m[n, s + 1, q]
                    if before * after >= 0 or abs(before) <= least_m or abs(after) <= least_m:
                        continue
                    if not is_counted:
                        plane[n, k], along = q, before / (before - after)
                        cosine[n, k] = abs(after - before) / length_m
                        for axis in range(2):
                            place_m = 0.0
                            for i in range(3):
                                place_m += axes[q, axis, i] * (nodes_m[n, s, i] + along * way[i])
                            point_m[n, k, axis] = place_m
                    k += 1
            number[n] = k
    return plane, point_m, cosine
