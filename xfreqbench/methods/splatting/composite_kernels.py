"""Compiled kernels of complex accumulation, Eq. (11): float32, the minibatch in the SIMD lanes, pixel by pixel.

`LANES` samples of the minibatch form a block. A row holds the attributes of one Gaussian for a block: `FIELDS` runs
of `LANES` numbers. Loops over lanes take their length at run time, because LLVM unrolls loops of constant length
and vectorises them less. Each thread has its own pixels, about as many pairs as every other thread, and its own
gradients, so results depend on the number of threads but not on their timing.

All kernels are in this file because Numba's cache notices only changes of a kernel's own file.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import get_num_threads, njit, prange, set_num_threads
from numba.core.config import NUMBA_NUM_THREADS  # type: ignore[attr-defined]

from xfreqbench.system.kernels import entry
from xfreqbench.types import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U32 = NDArray[np.uint32]
I64 = NDArray[np.int64]

LANES = 32  # with 16, backward takes a sixth longer, since it reads indices and distances twice as often
LANE_STEP = 16  # one AVX-512 register of float32, two of AVX2
FIELDS = 5  # inverse spread, Re S, Im S, Re(1 − δ), Im(1 − δ)
FAST = {"nnan", "ninf", "nsz", "arcp", "contract", "afn", "reassoc"}
IN_ORDER = FAST - {"reassoc"}  # sums over short loops in order: LLVM would spread them over lanes that stay empty

SPREAD, S_RE, S_IM, E_RE, E_IM = (field * LANES for field in range(FIELDS))  # where the runs of a row start
T_RE, T_IM, R_RE, R_IM = (field * LANES for field in range(4))  # the same for the state of the forward sweep
G = R_RE  # the stash holds T_RE, T_IM and G
V_RE, V_IM, Y_RE, Y_IM = (field * LANES for field in range(4))  # for the state of the backward sweep

TURN_RAD = 2 * math.pi
HALF = np.float32(0.5)
LOG2_E = np.float32(math.log2(math.e))
LEAST_LOG2 = np.float32(-124)  # keeps G a normal number
LEAST_BELL = np.float32(2**-40)  # a smaller bell is 0: products of two would be denormal, and slow on some processors
TAYLOR_2 = tuple(np.float32(math.log(2) ** power / math.factorial(power)) for power in range(7))


def use_threads(number: int) -> int:
    """Let kernels use `number` threads, or fewer where Numba has not so many; return how many they used before."""
    before = get_num_threads()
    set_num_threads(min(number, NUMBA_NUM_THREADS))
    return before


@njit(inline="always", fastmath=FAST)
def _exponential(x: np.float32) -> np.floating[Any]:
    """exp(x) for x ≤ 0 to 1e-7, at least 2^-124: 2^whole by the bits of the exponent, 2^rest by its Taylor series."""
    y = max(x * LOG2_E, LEAST_LOG2)
    whole = np.floor(y + HALF)
    rest = y - whole
    series = TAYLOR_2[6] * rest + TAYLOR_2[5]
    series = series * rest + TAYLOR_2[4]
    series = series * rest + TAYLOR_2[3]
    series = series * rest + TAYLOR_2[2]
    series = series * rest + TAYLOR_2[1]
    series = series * rest + TAYLOR_2[0]
    return series * np.int32((np.int32(whole) + 127) << 23).view(np.float32)


@njit()
def _samples(block: int, batch: int) -> tuple[int, int, int]:
    """First and end index of a block's samples, and the number of lanes for them, a multiple of a register."""
    first, end = block * LANES, min((block + 1) * LANES, batch)
    return first, end, -(-(end - first) // LANE_STEP) * LANE_STEP


@njit()
def _shares(start: I64, num_threads: int) -> I64:
    """First pixel of each thread, and the end of the last; threads have about equal numbers of pairs."""
    bounds = np.searchsorted(start, start[-1] * np.arange(num_threads + 1) // num_threads)
    bounds[0], bounds[-1] = 0, len(start) - 1
    return bounds


@njit(inline="always", fastmath=FAST)
def _fill(state: F32, run: int, value: float, lanes: int) -> None:
    for lane in range(lanes):
        state[run + lane] = value


@njit(inline="always")
def _store(state: F32, field: F32, pixel: int, first: int, end: int) -> None:
    """Write R of the samples first…end to field (B, K, 2)."""
    for sample in range(first, end):
        field[sample, pixel, 0] = state[R_RE + sample - first]
        field[sample, pixel, 1] = state[R_IM + sample - first]


@njit(inline="always")
def _load(field: F32, state: F32, pixel: int, first: int, end: int) -> None:
    """Read Y of the samples first…end from field (B, K, 2)."""
    for sample in range(first, end):
        state[Y_RE + sample - first] = field[sample, pixel, 0]
        state[Y_IM + sample - first] = field[sample, pixel, 1]


@njit(inline="always", fastmath=FAST)
def _add(row: F32, minus_half: np.float32, state: F32, lanes: int) -> None:
    """Add one Gaussian to the state: R += G T S, then T −= G T (1 − δ)."""
    for lane in range(lanes):
        g = _exponential(minus_half * row[SPREAD + lane])
        w_re, w_im = g * state[T_RE + lane], g * state[T_IM + lane]
        s_re, s_im = row[S_RE + lane], row[S_IM + lane]
        e_re, e_im = row[E_RE + lane], row[E_IM + lane]
        state[R_RE + lane] += w_re * s_re - w_im * s_im
        state[R_IM + lane] += w_re * s_im + w_im * s_re
        state[T_RE + lane] -= w_re * e_re - w_im * e_im
        state[T_IM + lane] -= w_re * e_im + w_im * e_re


@njit(inline="always", fastmath=FAST)
def _advance(row: F32, minus_half: np.float32, here: F32, after: F32, lanes: int) -> None:
    """Write G to this Gaussian's stash, and T behind it to the next one's."""
    for lane in range(lanes):
        g = _exponential(minus_half * row[SPREAD + lane])
        t_re, t_im = here[T_RE + lane], here[T_IM + lane]
        e_re, e_im = row[E_RE + lane], row[E_IM + lane]
        w_re, w_im = g * t_re, g * t_im
        here[G + lane] = g
        after[T_RE + lane] = t_re - (w_re * e_re - w_im * e_im)
        after[T_IM + lane] = t_im - (w_re * e_im + w_im * e_re)


@njit(fastmath=FAST)  # not inline: LLVM would not vectorise it, and backward would take twice as long
def _retreat(row: F32, minus_half: np.float32, here: F32, state: F32, grad: F32, lanes: int) -> np.floating[Any]:
    """Add one pair's gradients to its row and move V in front of this Gaussian; return d loss / d distance."""
    total = np.float32(0)
    for lane in range(lanes):
        t_re, t_im, g = here[T_RE + lane], here[T_IM + lane], here[G + lane]
        v_re, v_im = state[V_RE + lane], state[V_IM + lane]
        y_re, y_im = state[Y_RE + lane], state[Y_IM + lane]
        e_re, e_im = row[E_RE + lane], row[E_IM + lane]
        w_re = g * (t_re * y_re + t_im * y_im)
        w_im = g * (t_re * y_im - t_im * y_re)
        z_re = row[S_RE + lane] - (e_re * v_re - e_im * v_im)
        z_im = row[S_IM + lane] - (e_re * v_im + e_im * v_re)
        slope = w_re * z_re + w_im * z_im
        total += slope * row[SPREAD + lane]
        grad[SPREAD + lane] += slope * minus_half
        grad[S_RE + lane] += w_re
        grad[S_IM + lane] += w_im
        grad[E_RE + lane] -= w_re * v_re + w_im * v_im
        grad[E_IM + lane] -= w_im * v_re - w_re * v_im
        state[V_RE + lane] = v_re + g * z_re
        state[V_IM + lane] = v_im + g * z_im
    return -HALF * total


@entry(parallel=True, fastmath=FAST, error_model="numpy")
def forward(num_threads: int, start: I64, gaussian: I64, distance: F32, rows: F32, field: F32) -> None:
    """Write R of every pixel to `field` (B, K, 2), from `rows` (blocks, N, FIELDS·LANES)."""
    bounds = _shares(start, num_threads)
    for thread in prange(num_threads):
        state = np.empty(4 * LANES, np.float32)
        for block in range(len(rows)):
            block_rows = rows[block]
            first, end, lanes = _samples(block, len(field))
            for pixel in range(bounds[thread], bounds[thread + 1]):
                _fill(state, T_RE, 1, lanes)
                _fill(state, T_IM, 0, lanes)
                _fill(state, R_RE, 0, lanes)
                _fill(state, R_IM, 0, lanes)
                for pair in range(start[pixel], start[pixel + 1]):
                    _add(block_rows[gaussian[pair]], -HALF * distance[pair], state, lanes)
                _store(state, field, pixel, first, end)


@entry(parallel=True, fastmath=FAST, error_model="numpy")
def backward(
    longest: int,
    start: I64,
    gaussian: I64,
    distance: F32,
    rows: F32,
    grad_field: F32,
    grad_distance: F32,
    grad_rows: F32,
) -> None:
    """Add to grad_distance (P,) and to each thread's part of grad_rows (threads, blocks, N, FIELDS·LANES).

    A forward sweep stores T in a stash, which has room for the `longest` list. Nothing is divided by δ, which may
    be zero. With V the field from behind per unit of T: dR/dG = T (S − (1 − δ) V), dR/dS = T G, dR/dδ = T G V.
    """
    bounds = _shares(start, len(grad_rows))
    for thread in prange(len(grad_rows)):
        stash = np.empty((longest + 1, 3 * LANES), np.float32)
        state = np.empty(4 * LANES, np.float32)
        for block in range(len(rows)):
            _fill(state, Y_RE, 0, LANES)  # lanes without a sample
            _fill(state, Y_IM, 0, LANES)
            block_rows, block_grads = rows[block], grad_rows[thread, block]
            first, end, lanes = _samples(block, len(grad_field))
            for pixel in range(bounds[thread], bounds[thread + 1]):
                nearest, length = start[pixel], start[pixel + 1] - start[pixel]
                _fill(stash[0], T_RE, 1, lanes)
                _fill(stash[0], T_IM, 0, lanes)
                for depth in range(length):
                    row = block_rows[gaussian[nearest + depth]]
                    _advance(row, -HALF * distance[nearest + depth], stash[depth], stash[depth + 1], lanes)
                _fill(state, V_RE, 0, lanes)
                _fill(state, V_IM, 0, lanes)
                _load(grad_field, state, pixel, first, end)
                for depth in range(length - 1, -1, -1):
                    index, minus_half = gaussian[nearest + depth], -HALF * distance[nearest + depth]
                    row, grad = block_rows[index], block_grads[index]
                    grad_distance[nearest + depth] += _retreat(row, minus_half, stash[depth], state, grad, lanes)


@entry(parallel=True, fastmath=IN_ORDER, error_model="numpy")
def forward_of_maps(
    order: I64,
    before: I64,
    runs: U32,
    angles: F64,
    footprint: F64,
    step: float,
    signal: F32,
    opacity: F32,
    field: F32,
    stash: F32,
) -> None:
    """Write R of B maps, each with N footprints of its own, to `field` (B, E·A); all is real, and λ is 1.

    `order` (B, N) has the nearest Gaussian first. `before`, `runs` and `angles` are those of `footprint_runs` for B·N
    Gaussians, `footprint` (B·N, 5) their centres and inverse covariances, `signal` and `opacity` (B, N) are S and
    1 − δ, and columns are `step` apart. `stash` (P, 2) keeps T in front of each Gaussian and G, which along a run is a
    product: its ratio from column to column has itself a ratio that does not change.
    """
    num_maps, num_gaussians = order.shape
    for nth in prange(num_maps):
        transmittance, response = np.ones(field.shape[1], np.float32), field[nth]
        response[:] = 0
        for place in range(num_gaussians):
            i = order[nth, place]
            here = nth * num_gaussians + i
            a, b, c, pair = footprint[here, 2], footprint[here, 3], footprint[here, 4], before[here, 1]
            s, o, bend = signal[nth, i], opacity[nth, i], math.exp(-a * step * step)
            for run in range(before[here, 0], before[here + 1, 0]):
                u, v = angles[run, 0], angles[run, 1]
                value = math.exp(-0.5 * (a * u * u + 2 * b * u * v + c * v * v))
                ratio = math.exp(-step * (a * (u + 0.5 * step) + b * v))
                for pixel in range(runs[run, 0], runs[run, 0] + runs[run, 1]):
                    t, g = transmittance[pixel], np.float32(value)
                    stash[pair, 0], stash[pair, 1] = t, g
                    response[pixel] += g * t * s
                    transmittance[pixel] = t - g * t * o
                    value, ratio, pair = value * ratio, ratio * bend, pair + 1


@entry(parallel=True, fastmath=IN_ORDER, error_model="numpy")
def backward_of_maps(
    order: I64,
    before: I64,
    runs: U32,
    angles: F64,
    footprint: F64,
    step: float,
    signal: F32,
    opacity: F32,
    stash: F32,
    grad_field: F32,
    grad_footprint: F64,
    grad_signal: F32,
    grad_opacity: F32,
) -> None:
    """Write gradients by centres and covariances to grad_footprint (B·N, 5), and those by signals and opacities.

    As in `backward`, V is the field from behind per unit of T, and nothing is divided.
    """
    num_maps, num_gaussians = order.shape
    step_f32 = np.float32(step)
    for nth in prange(num_maps):
        behind = np.zeros(grad_field.shape[1], np.float32)
        for place in range(num_gaussians - 1, -1, -1):
            i = order[nth, place]
            here = nth * num_gaussians + i
            s, o, pair, zero = signal[nth, i], opacity[nth, i], before[here, 1], np.float32(0)
            of_s, of_o, of_u, of_v, uu, uv, vv = zero, zero, zero, zero, zero, zero, zero
            for run in range(before[here, 0], before[here + 1, 0]):
                u, v = np.float32(angles[run, 0]), angles[run, 1]
                total, first, second = zero, zero, zero
                for pixel in range(runs[run, 0], runs[run, 0] + runs[run, 1]):
                    t, g, field = stash[pair, 0], stash[pair, 1], behind[pixel]
                    weight, z = g * t * grad_field[nth, pixel], s - o * field
                    slope = weight * z
                    of_s += weight
                    of_o -= weight * field
                    total, first, second = total + slope, first + slope * u, second + slope * u * u
                    behind[pixel] = field + g * z
                    u, pair = u + step_f32, pair + 1
                of_u, of_v = of_u + first, of_v + v * total
                uu, uv, vv = uu + second, uv + v * first, vv + v * v * total
            a, b, c = footprint[here, 2], footprint[here, 3], footprint[here, 4]
            grad_footprint[here, 0], grad_footprint[here, 1] = a * of_u + b * of_v, b * of_u + c * of_v
            left_u, left_v = a * uu + b * uv, a * uv + b * vv  # rows of the inverse covariance by the sums
            right_u, right_v = b * uu + c * uv, b * uv + c * vv
            grad_footprint[here, 2] = 0.5 * (left_u * a + left_v * b)
            grad_footprint[here, 3] = left_u * b + left_v * c
            grad_footprint[here, 4] = 0.5 * (right_u * b + right_v * c)
            grad_signal[nth, i], grad_opacity[nth, i] = of_s, of_o


@njit(inline="always", fastmath=FAST)
def _from_centre(angle: np.float32, centre: np.float32, turns: np.float32) -> np.floating[Any]:
    """An angle from a centre, taken the short way round where `turns` is 1 / 2π; as it is where it is 0."""
    return angle - centre - np.float32(TURN_RAD) * np.floor((angle - centre) * turns + HALF)


@entry(parallel=True, fastmath=FAST, error_model="numpy")
def bells(angle: F32, centre: F32, deviation: F32, turns: np.float32, bell: F32) -> None:
    """Write exp(−½ (angle − centre)² / deviation²) at K angles around each of M centres to `bell` (M, K).

    Far tails, below 2^-40, are zero.
    """
    for nth in prange(len(centre)):
        sharpness = np.float32(1) / deviation[nth]
        for k in range(len(angle)):
            u = _from_centre(angle[k], centre[nth], turns) * sharpness
            height = _exponential(-HALF * u * u)
            bell[nth, k] = height if height >= LEAST_BELL else np.float32(0)


@entry(parallel=True, fastmath=FAST, error_model="numpy")
def bells_backward(
    angle: F32, centre: F32, deviation: F32, turns: np.float32, bell: F32, slope: F32, of_centre: F32, of_deviation: F32
) -> None:
    """Write gradients (M,) by centres and deviations from those by `bell`, which are `slope` (M, K)."""
    for nth in prange(len(centre)):
        sharpness, first, second = np.float32(1) / deviation[nth], np.float32(0), np.float32(0)
        for k in range(len(angle)):
            u = _from_centre(angle[k], centre[nth], turns) * sharpness
            weight = slope[nth, k] * bell[nth, k] * u
            first += weight
            second += weight * u
        of_centre[nth], of_deviation[nth] = first * sharpness, second * sharpness
