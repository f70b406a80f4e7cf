"""Kernels of a slab of one or several layers: its coefficients, and what it does to a wave, for many waves in lanes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .arrays import BLOCK, C128, F64
from .compiled import bare, entry, lane, within

Four = tuple[complex, complex, complex, complex]
Pair = tuple[float, float]  # real and imaginary part

OPAQUE_NEPERS = 40.0  # of loss through a slab: nothing comes back from its far face, and nothing comes out


@lane
def cosine_and_sine(turns: float) -> tuple[float, float]:
    """cos and sin of 2π·turns: polynomials of half the angle within ±π/2, to 1e-14."""
    half = math.pi * (turns - np.floor(turns + 0.5))
    h2 = half * half
    sine = 1 / 6227020800 + h2 * (-1 / 1307674368000 + h2 * (1 / 355687428096000 - h2 / 121645100408832000))
    sine = -1 / 39916800 + h2 * sine
    sine = -1 / 6 + h2 * (1 / 120 + h2 * (-1 / 5040 + h2 * (1 / 362880 + h2 * sine)))
    sine = half * (1.0 + h2 * sine)
    cosine = 1 / 479001600 + h2 * (-1 / 87178291200 + h2 * (1 / 20922789888000 - h2 / 6402373705728000))
    cosine = -1 / 3628800 + h2 * cosine
    cosine = -1 / 2 + h2 * (1 / 24 + h2 * (-1 / 720 + h2 * (1 / 40320 + h2 * cosine)))
    cosine = 1.0 + h2 * cosine
    return 1.0 - 2.0 * sine * sine, 2.0 * sine * cosine


@lane
def _decay(nepers: float) -> float:
    """exp(−nepers), 0 from `OPAQUE_NEPERS` on: a polynomial of a 256th, squared eight times; its error is 1e-13."""
    x = -min(nepers, OPAQUE_NEPERS) / 256.0
    e = 1.0 + x / 6.0 * (1.0 + x / 7.0 * (1.0 + x / 8.0 * (1.0 + x / 9.0)))
    e = 1.0 + x * (1.0 + x / 2.0 * (1.0 + x / 3.0 * (1.0 + x / 4.0 * (1.0 + x / 5.0 * e))))
    e = (e * e) * (e * e)
    e = (e * e) * (e * e)
    e = (e * e) * (e * e)
    e = (e * e) * (e * e)
    return e if nepers < OPAQUE_NEPERS else 0.0


@lane
def _face(cosine: float, eta_real: float, eta_imag: float) -> tuple[float, float, Pair, Pair]:
    """√(η − sin²), its imaginary part not positive, and the reflection TE and TM of a half-space.

    ITU-R P.2040, Eqs. 37 and 38; the imaginary part of the relative permittivity η is not positive.
    """
    a, b = eta_real - (1.0 - cosine * cosine), eta_imag
    large = math.sqrt(0.5 * (math.sqrt(a * a + b * b) + abs(a)))
    small = 0.5 * b / (large + 1e-300)
    x, y = (large, small) if a >= 0.0 else (-small, -large)
    size2 = x * x + y * y
    inverse = 1.0 / ((cosine + x) ** 2 + y * y)
    te = (cosine * cosine - size2) * inverse, -2.0 * cosine * y * inverse
    u, v = eta_real * cosine, eta_imag * cosine
    inverse = 1.0 / ((u + x) ** 2 + (v + y) ** 2)
    tm = (u * u + v * v - size2) * inverse, 2.0 * (v * x - u * y) * inverse
    return x, y, te, tm


@lane
def _with_echoes(r: Pair, once: Pair) -> tuple[Pair, Pair]:
    """Reflection and transmission of a slab, from the reflection r of a half-space and the passage through it.

    ITU-R P.2040, Eqs. 43 and 44: r·(1 − once²) / (1 − r²·once²) and (1 − r²)·once / (1 − r²·once²).
    """
    twice = once[0] * once[0] - once[1] * once[1], 2.0 * once[0] * once[1]
    r2 = r[0] * r[0] - r[1] * r[1], 2.0 * r[0] * r[1]
    x = 1.0 - (r2[0] * twice[0] - r2[1] * twice[1])
    y = r2[0] * twice[1] + r2[1] * twice[0]
    inverse = 1.0 / (x * x + y * y)
    x, y = x * inverse, y * inverse
    u, v = r[0] * (1.0 - twice[0]) + r[1] * twice[1], r[1] * (1.0 - twice[0]) - r[0] * twice[1]
    reflected = u * x - v * y, u * y + v * x
    u, v = once[0] * (1.0 - r2[0]) + once[1] * r2[1], once[1] * (1.0 - r2[0]) - once[0] * r2[1]
    return reflected, (u * x - v * y, u * y + v * x)


@lane
def _slab(cosine: float, eta_real: float, eta_imag: float, phase_thickness: float) -> tuple[Pair, Pair, Pair, Pair]:
    """Reflection TE, TM and transmission TE, TM of a slab, as `slab_coefficients`, in real and imaginary parts."""
    x, y, te, tm = _face(cosine, eta_real, eta_imag)
    decay = _decay(-phase_thickness * y)
    turned = cosine_and_sine(phase_thickness * x * (0.5 / math.pi))
    once = decay * turned[0], -decay * turned[1]  # exp(−j·phase_thickness·(x + jy))
    (r_te, t_te), (r_tm, t_tm) = _with_echoes(te, once), _with_echoes(tm, once)
    return r_te, r_tm, t_te, t_tm


@entry
def slab_coefficients(cosine: float, permittivity: complex, phase_thickness: float) -> Four:
    """Reflection TE, TM and transmission TE, TM of a slab (ITU-R P.2040, Eqs. 37, 38, 43, 44).

    `cosine` is that of the angle of incidence, `permittivity` relative, with an imaginary part that is not positive,
    and `phase_thickness` 2π times the thickness over the wavelength in free space.
    """
    r_te, r_tm, t_te, t_tm = _slab(cosine, permittivity.real, permittivity.imag, phase_thickness)
    return complex(*r_te), complex(*r_tm), complex(*t_te), complex(*t_tm)


coefficients = within(slab_coefficients)


@bare
def _stack(cosine: float, real: F64, imag: F64, phase_thickness: F64, is_from_behind: bool) -> Four:
    """Reflection TE, TM and transmission TE, TM of n layers in contact, as `stack_coefficients`.

    Every layer is a slab in free space, at no distance from the next. 1/(1 − r·r') sums the echoes between a layer and
    those before it (Redheffer's star product). No exponential grows, however thick the layers are.
    """
    front_te, front_tm, back_te, back_tm, through_te, through_tm = 0j, 0j, 0j, 0j, 1.0 + 0j, 1.0 + 0j
    for i in range(len(real)):
        n = len(real) - 1 - i if is_from_behind else i
        # at a cosine of 0 the echoes between two layers have no finite sum
        own = _slab(max(cosine, 1e-6), real[n], imag[n], phase_thickness[n])
        r_te, r_tm, t_te, t_tm = complex(*own[0]), complex(*own[1]), complex(*own[2]), complex(*own[3])
        echo_te, echo_tm = 1.0 / (1.0 - back_te * r_te), 1.0 / (1.0 - back_tm * r_tm)
        front_te += through_te * through_te * r_te * echo_te
        front_tm += through_tm * through_tm * r_tm * echo_tm
        back_te, back_tm = r_te + t_te * t_te * back_te * echo_te, r_tm + t_tm * t_tm * back_tm * echo_tm
        through_te, through_tm = through_te * t_te * echo_te, through_tm * t_tm * echo_tm
    return front_te, front_tm, through_te, through_tm


@entry
def stack_coefficients(cosine: float, permittivity: C128, phase_thickness: F64) -> Four:
    """Reflection TE, TM and transmission TE, TM of a slab of n layers, whose first the wave meets first.

    Arguments are those of `slab_coefficients`, (n,) for n layers. Phases are those at the two faces of the whole slab.
    """
    if len(permittivity) == 1:
        return coefficients(cosine, permittivity[0], phase_thickness[0])
    return _stack(cosine, permittivity.real, permittivity.imag, phase_thickness, False)


stacked = within(stack_coefficients)


@lane
def _of_slab(lanes: F64, i: int, slope: float) -> tuple[Pair, Pair, Pair, Pair]:
    return _slab(abs(slope), lanes[0, i], lanes[1, i], lanes[2, i])


@bare
def _of_stack(layers: F64, i: int, slope: float) -> tuple[Pair, Pair, Pair, Pair]:
    r_te, r_tm, t_te, t_tm = _stack(abs(slope), layers[:, 0, i], layers[:, 1, i], layers[:, 2, i], slope > 0.0)
    return (r_te.real, r_te.imag), (r_tm.real, r_tm.imag), (t_te.real, t_te.imag), (t_tm.real, t_tm.imag)


def _reflecting(coefficients_at: Any) -> Any:
    """`reflect` for slabs of which a lane's coefficients are `coefficients_at(lanes, i, slope)`, slope being k·n."""

    @bare
    def reflect_all(lanes: F64, n: F64, wave: F64, number: int) -> None:
        nx, ny, nz = n[0], n[1], n[2]
        mx, my, mz = 2.0 * nx, 2.0 * ny, 2.0 * nz  # with the factor in the loop LLVM finds no vectors
        for i in range(number):
            kx, ky, kz = wave[i], wave[BLOCK + i], wave[2 * BLOCK + i]
            slope = kx * nx + ky * ny + kz * nz
            r_te, r_tm, _, _ = coefficients_at(lanes, i, slope)
            wave[i] = kx - slope * mx
            wave[BLOCK + i] = ky - slope * my
            wave[2 * BLOCK + i] = kz - slope * mz
            wx, wy, wz = ky * nz - kz * ny, kz * nx - kx * nz, kx * ny - ky * nx
            inverse = 1.0 / (wx * wx + wy * wy + wz * wz + 1e-30)
            ax, ay, az = wave[3 * BLOCK + i], wave[4 * BLOCK + i], wave[5 * BLOCK + i]
            bx, by, bz = wave[6 * BLOCK + i], wave[7 * BLOCK + i], wave[8 * BLOCK + i]
            te_a, te_b = (ax * wx + ay * wy + az * wz) * inverse, (bx * wx + by * wy + bz * wz) * inverse
            away_a, away_b = ax * nx + ay * ny + az * nz, bx * nx + by * ny + bz * nz
            x, y = r_te[0] + r_tm[0], r_te[1] + r_tm[1]
            te_a, te_b = x * te_a - y * te_b, x * te_b + y * te_a
            ax, ay, az = ax - away_a * mx, ay - away_a * my, az - away_a * mz
            bx, by, bz = bx - away_b * mx, by - away_b * my, bz - away_b * mz
            u, v = r_tm
            wave[3 * BLOCK + i] = te_a * wx - (u * ax - v * bx)
            wave[4 * BLOCK + i] = te_a * wy - (u * ay - v * by)
            wave[5 * BLOCK + i] = te_a * wz - (u * az - v * bz)
            wave[6 * BLOCK + i] = te_b * wx - (u * bx + v * ax)
            wave[7 * BLOCK + i] = te_b * wy - (u * by + v * ay)
            wave[8 * BLOCK + i] = te_b * wz - (u * bz + v * az)

    return reflect_all


def _transmitting(coefficients_at: Any) -> Any:
    """`transmit`, as `_reflecting` makes `reflect`."""

    @bare
    def transmit_all(lanes: F64, n: F64, wave: F64, number: int) -> None:
        nx, ny, nz = n[0], n[1], n[2]
        for i in range(number):
            kx, ky, kz = wave[i], wave[BLOCK + i], wave[2 * BLOCK + i]
            _, _, t_te, t_tm = coefficients_at(lanes, i, kx * nx + ky * ny + kz * nz)
            wx, wy, wz = ky * nz - kz * ny, kz * nx - kx * nz, kx * ny - ky * nx
            inverse = 1.0 / (wx * wx + wy * wy + wz * wz + 1e-30)
            ax, ay, az = wave[3 * BLOCK + i], wave[4 * BLOCK + i], wave[5 * BLOCK + i]
            bx, by, bz = wave[6 * BLOCK + i], wave[7 * BLOCK + i], wave[8 * BLOCK + i]
            te_a, te_b = (ax * wx + ay * wy + az * wz) * inverse, (bx * wx + by * wy + bz * wz) * inverse
            x, y = t_te[0] - t_tm[0], t_te[1] - t_tm[1]
            te_a, te_b = x * te_a - y * te_b, x * te_b + y * te_a
            u, v = t_tm
            wave[3 * BLOCK + i] = te_a * wx + u * ax - v * bx
            wave[4 * BLOCK + i] = te_a * wy + u * ay - v * by
            wave[5 * BLOCK + i] = te_a * wz + u * az - v * bz
            wave[6 * BLOCK + i] = te_b * wx + u * bx + v * ax
            wave[7 * BLOCK + i] = te_b * wy + u * by + v * ay
            wave[8 * BLOCK + i] = te_b * wz + u * bz + v * az

    return transmit_all


_reflect_slab, _reflect_stack = _reflecting(_of_slab), _reflecting(_of_stack)
_transmit_slab, _transmit_stack = _transmitting(_of_slab), _transmitting(_of_stack)


@bare
def reflect(layers: F64, n: F64, wave: F64, number: int) -> None:
    """Reflect the first so many lanes of `wave` at slabs with the unit normal n (3,) to their front; see `Walk.wave`.

    `layers` (n, 3, L) are permittivities and phase thicknesses, from the first lane on. With w = k×n the field along w
    is TE, and what is left of it TM: E' = (r_TE + r_TM)·(E·w)·w/|w|² − r_TM·(E − 2(E·n)n), and k' = k − 2(k·n)n.
    """
    if len(layers) == 1:
        _reflect_slab(layers[0], n, wave, number)
    else:
        _reflect_stack(layers, n, wave, number)


@bare
def transmit(layers: F64, n: F64, wave: F64, number: int) -> None:
    """Let lanes of `wave` pass slabs, as `reflect` has them reflected: E' = (t_TE − t_TM)·(E·w)·w/|w|² + t_TM·E."""
    if len(layers) == 1:
        _transmit_slab(layers[0], n, wave, number)
    else:
        _transmit_stack(layers, n, wave, number)
