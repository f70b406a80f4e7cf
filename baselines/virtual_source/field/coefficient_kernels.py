"""Compiled kernels of the coefficients of slabs, ITU-R P.2040, Eqs. 37, 43 and 44, and their slopes, in float32.

Slabs (4, S) are ln(ε' − 1), ln c, d and ln thickness (m), with σ = c f^d and f in GHz. Complex numbers are pairs, and
what all angles of incidence need stands in rows, so that LLVM computes several angles at once.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from xfreqbench.system.kernels import entry
from xfreqbench.types import NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, VACUUM_PERMITTIVITY_F_M

F32 = NDArray[np.float32]
Number = tuple[Any, Any]  # real and imaginary part, float32

_FAST = {"contract", "reassoc", "nsz", "arcp"}
_HALF, _ONE, _TWO = np.float32(0.5), np.float32(1), np.float32(2)
_WAVENUMBER = np.float32(2 * math.pi * 1e9 / SPEED_OF_LIGHT_M_S)  # at 1 GHz, rad/m
_LOSS = np.float32(1 / (2 * math.pi * 1e9 * VACUUM_PERMITTIVITY_F_M))  # σ / (2π f ε₀) at 1 GHz, of 1 S/m


@njit(inline="always", fastmath=_FAST)
def _times(x: Number, y: Number) -> Number:
    return x[0] * y[0] - x[1] * y[1], x[0] * y[1] + x[1] * y[0]


@njit(inline="always", fastmath=_FAST)
def _over(x: Number, y: Number) -> Number:
    scale = _ONE / (y[0] * y[0] + y[1] * y[1])
    return (x[0] * y[0] + x[1] * y[1]) * scale, (x[1] * y[0] - x[0] * y[1]) * scale


@njit(inline="always", fastmath=_FAST)
def _less(x: Number) -> Number:
    """1 − x."""
    return _ONE - x[0], -x[1]


@njit(error_model="numpy", fastmath=_FAST)
def _medium(slabs: F32, n: int, ghz: np.float32) -> tuple[Any, Any, Any]:
    """ε', −Im ε, and the slab's thickness in radians of free space, at a carrier."""
    loss = np.exp(slabs[1, n]) * ghz ** slabs[2, n] * _LOSS / ghz
    return _ONE + np.exp(slabs[0, n]), loss, _WAVENUMBER * ghz * np.exp(slabs[3, n])


@njit(error_model="numpy", fastmath=_FAST)
def _rows(real: np.float32, loss: np.float32, depth: np.float32, cosine: F32, rows: F32) -> None:
    """Write the root of ε − sin², and the factor e^{−j depth root} of one way through the slab, to `rows` (4, A)."""
    for a in range(len(cosine)):
        square = real - _ONE + cosine[a] * cosine[a]
        rows[0, a] = np.sqrt((np.sqrt(square * square + loss * loss) + square) * _HALF)
        rows[1, a] = -loss / (rows[0, a] + rows[0, a])
    for a in range(len(cosine)):
        decay, angle = np.exp(depth * rows[1, a]), depth * rows[0, a]
        rows[2, a], rows[3, a] = decay * np.cos(angle), -decay * np.sin(angle)


@entry(error_model="numpy", fastmath=_FAST)
def coefficients(slabs: F32, carrier_ghz: F32, cosine: F32) -> tuple[F32, F32, F32]:
    """Reflection (S, A, 2, F, 2), TE and TM, and the mean of both transmissions (S, A, F, 2), and rows (S, F, 4, A)."""
    num_slabs, num_angles, num_carriers = slabs.shape[1], len(cosine), len(carrier_ghz)
    reflected = np.empty((num_slabs, num_angles, 2, num_carriers, 2), np.float32)
    transmitted = np.empty((num_slabs, num_angles, num_carriers, 2), np.float32)
    rows = np.empty((num_slabs, num_carriers, 4, num_angles), np.float32)
    for n in range(num_slabs):
        for f in range(num_carriers):
            real, loss, depth = _medium(slabs, n, carrier_ghz[f])
            _rows(real, loss, depth, cosine, rows[n, f])
            for a in range(num_angles):
                c, root, once = cosine[a], (rows[n, f, 0, a], rows[n, f, 1, a]), (rows[n, f, 2, a], rows[n, f, 3, a])
                x, y = real * c, -loss * c
                te = _over((c - root[0], -root[1]), (c + root[0], root[1]))
                tm = _over((x - root[0], y - root[1]), (x + root[0], y + root[1]))
                twice = _times(once, once)
                te_square, tm_square = _times(te, te), _times(tm, tm)
                te_loop, tm_loop = _less(_times(te_square, twice)), _less(_times(tm_square, twice))
                te_back, tm_back = _times(te, _less(twice)), _times(tm, _less(twice))
                te_through, tm_through = _times(_less(te_square), once), _times(_less(tm_square), once)
                reflected[n, a, 0, f, 0], reflected[n, a, 0, f, 1] = _over(te_back, te_loop)
                reflected[n, a, 1, f, 0], reflected[n, a, 1, f, 1] = _over(tm_back, tm_loop)
                of_te, of_tm = _over(te_through, te_loop), _over(tm_through, tm_loop)
                transmitted[n, a, f, 0] = _HALF * (of_te[0] + of_tm[0])
                transmitted[n, a, f, 1] = _HALF * (of_te[1] + of_tm[1])
    return reflected, transmitted, rows


@njit(inline="always", fastmath=_FAST)
def _of_face(face: Number, once: Number, of_back: Number, of_through: Number) -> tuple[Number, Number]:
    """Slopes by a face's coefficient r and by e = `once`, from those by r (1 − e²) / D and (1 − r²) e / D.

    D is 1 − r²e². Slopes here are ∂L/∂Re − j ∂L/∂Im, so that the chain rule has no conjugates.
    """
    square, twice = _times(face, face), _times(once, once)
    round_trip = _times(square, twice)
    loop = _less(round_trip)
    inverse = _over((_ONE, np.float32(0)), _times(loop, loop))
    of_back, of_through = _times(of_back, inverse), _times(of_through, inverse)
    more, both = (_ONE + round_trip[0], round_trip[1]), _times(face, once)
    lost, left, both = _less(twice), _less(square), (-_TWO * both[0], -_TWO * both[1])
    back, through = _times(of_back, more), _times(of_through, more)
    of_face, more_of_face = _times(back, lost), _times(_times(of_through, both), lost)
    of_once, more_of_once = _times(through, left), _times(_times(of_back, both), left)
    return (of_face[0] + more_of_face[0], of_face[1] + more_of_face[1]), (
        of_once[0] + more_of_once[0],
        of_once[1] + more_of_once[1],
    )


@entry(error_model="numpy", fastmath=_FAST)
def slopes_of_coefficients(
    slabs: F32, carrier_ghz: F32, cosine: F32, rows: F32, of_reflected: F32, of_transmitted: F32
) -> F32:
    """The slopes by `slabs` from those by what `coefficients` returns."""
    of_slabs = np.zeros_like(slabs)
    for n in range(slabs.shape[1]):
        for f in range(len(carrier_ghz)):
            real, loss, depth = _medium(slabs, n, carrier_ghz[f])
            of_real, of_loss, of_depth = np.float32(0), np.float32(0), np.float32(0)
            for a in range(len(cosine)):
                c, root, once = cosine[a], (rows[n, f, 0, a], rows[n, f, 1, a]), (rows[n, f, 2, a], rows[n, f, 3, a])
                scaled = real * c, -loss * c
                te_sum, tm_sum = (c + root[0], root[1]), (scaled[0] + root[0], scaled[1] + root[1])
                te = _over((c - root[0], -root[1]), te_sum)
                tm = _over((scaled[0] - root[0], scaled[1] - root[1]), tm_sum)
                of_mean = _HALF * of_transmitted[n, a, f, 0], -_HALF * of_transmitted[n, a, f, 1]
                of_te, by_te = _of_face(te, once, (of_reflected[n, a, 0, f, 0], -of_reflected[n, a, 0, f, 1]), of_mean)
                of_tm, by_tm = _of_face(tm, once, (of_reflected[n, a, 1, f, 0], -of_reflected[n, a, 1, f, 1]), of_mean)
                of_once = _times((by_te[0] + by_tm[0], by_te[1] + by_tm[1]), once)
                of_way = of_once[1], -of_once[0]  # by depth · root
                of_te = _over((_TWO * of_te[0], _TWO * of_te[1]), _times(te_sum, te_sum))
                of_tm = _over((_TWO * of_tm[0], _TWO * of_tm[1]), _times(tm_sum, tm_sum))
                by_tm = _times(of_tm, scaled)
                of_root = depth * of_way[0] - c * of_te[0] - by_tm[0], depth * of_way[1] - c * of_te[1] - by_tm[1]
                bent, straight = _over(of_root, (root[0] + root[0], root[1] + root[1])), _times(of_tm, root)
                of_real += bent[0] + c * straight[0]
                of_loss += bent[1] + c * straight[1]
                of_depth += _times(of_way, root)[0]
            of_slabs[0, n] += of_real * (real - _ONE)
            of_slabs[1, n] += of_loss * loss
            of_slabs[2, n] += of_loss * loss * np.log(carrier_ghz[f])
            of_slabs[3, n] += of_depth * depth
    return of_slabs
