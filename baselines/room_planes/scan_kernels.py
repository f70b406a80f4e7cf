"""Compiled kernel: how much better maps are explained if a plane of some slab reflects at some distance.

Distances are computed `_LANES` at once, in whose loops nothing is called, so that LLVM computes several together.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from xfreqbench.system.kernels import entry
from xfreqbench.tracing.image.kernels.slabs import cosine_and_sine
from xfreqbench.types import FloatArray, IntArray, NDArray

C128 = NDArray[np.complex128]
_FAST = {"contract", "reassoc", "nsz", "arcp"}
_LANES = 16
_NOISE = 0.01  # of a map, which no plane explains
_SMALL = 1e-9  # of the power of sums; waves may cancel


@njit(error_model="numpy", fastmath=_FAST)
def _waves(offset_m: FloatArray, size_m: float, wavenumber: float, wave: FloatArray) -> None:
    """Write the field of waves from images (3, Z), relative to that at distance `size_m`, to `wave` (2, Z)."""
    for z in range(_LANES):
        x, y, w = offset_m[0, z], offset_m[1, z], offset_m[2, z]
        length_m = math.sqrt(x * x + y * y + w * w)
        cosine, sine = cosine_and_sine(wavenumber * (length_m - size_m))
        wave[0, z], wave[1, z] = cosine * size_m / length_m, -sine * size_m / length_m


@njit(error_model="numpy", fastmath=_FAST)
def _sums(h: C128, wave: FloatArray, pairs: IntArray, sums: FloatArray) -> None:
    """Add sums over lags to `sums` (3, U, 2, Z): of field and wave, in phase and a quarter later, and of the wave."""
    for p in range(len(pairs)):
        i, j, u = pairs[p, 0], pairs[p, 1], pairs[p, 2]
        ar, ai, br, bi = h[i].real, h[i].imag, h[j].real, h[j].imag
        for z in range(_LANES):
            x, y, v, w = wave[i, 0, z], wave[i, 1, z], wave[j, 0, z], wave[j, 1, z]
            first, second = x * br + y * bi, y * br - x * bi  # the wave at one element, the field at the other
            third, fourth = ar * v + ai * w, ai * v - ar * w
            sums[0, u, 0, z] += first + third
            sums[0, u, 1, z] += second + fourth
            sums[1, u, 0, z] += fourth - second
            sums[1, u, 1, z] += first - third
            sums[2, u, 0, z] += x * v + y * w
            sums[2, u, 1, z] += y * v - x * w


@njit(error_model="numpy", fastmath=_FAST)
def _products(weight: FloatArray, one: FloatArray, other: FloatArray, product: FloatArray) -> None:
    """Write the inner products of sums over lags (U, 2, Z) to `product` (Z,)."""
    product[:] = 0
    for u in range(len(weight)):
        for z in range(_LANES):
            product[z] += weight[u] * (one[u, 0, z] * other[u, 0, z] + one[u, 1, z] * other[u, 1, z])


@entry(error_model="numpy", fastmath=_FAST)
def gains(
    distance_m: FloatArray,
    cell: IntArray,
    normal: FloatArray,
    tx_m: FloatArray,
    element_m: FloatArray,
    wavenumber: FloatArray,
    field: C128,
    data: FloatArray,
    pairs: IntArray,
    weight: FloatArray,
    reflection: FloatArray,
) -> FloatArray:
    """The factor (N, F, S), multiplied over T transmitters, by which a plane reduces what is left of their maps.

    `distance_m` (N,) are those of the plane from the array, and `tx_m` (T, 3) are seen from there. `element_m`
    (F, M, 3) are the elements, `wavenumber` is in cycles per metre, and `field` (F, T, M) are the channels of what is
    known already, in units of the direct wave. `data` (F, T, U, 2) are sums over lags of norm 1, `pairs` (P, 3) the
    two elements and the lag of each pair, and `weight` (U,) what a lag counts. `reflection` (F, T, Q, 2, S) has the
    coefficients of slabs, for the `cell` of a distance.
    """
    num_elements, num_lags, num_slabs = element_m.shape[1], len(weight), reflection.shape[4]
    factor = np.ones((len(distance_m), len(wavenumber), num_slabs))
    far_m, offset_m = np.empty(_LANES), np.empty((3, _LANES))
    wave, sums = np.empty((num_elements, 2, _LANES)), np.empty((3, num_lags, 2, _LANES))
    known, told = np.empty((2, num_lags, 2, _LANES)), np.empty((2, 4, _LANES))  # data and field; each with the sums
    gram = np.empty((3, 3, _LANES))
    for f in range(len(wavenumber)):
        for t in range(len(tx_m)):
            h = field[f, t]
            known[1] = 0
            for p in range(len(pairs)):
                product = h[pairs[p, 0]] * np.conj(h[pairs[p, 1]])
                known[1, pairs[p, 2], 0] += product.real
                known[1, pairs[p, 2], 1] += product.imag
            for u in range(num_lags):
                for part in range(2):
                    known[0, u, part] = data[f, t, u, part]
            for i in range(2):
                _products(weight, known[i], known[1], told[i, 0])
            before = 1 + _NOISE - told[0, 0, 0] ** 2 / told[1, 0, 0]
            height_m, size_m = (tx_m[t] * normal).sum(), math.sqrt((tx_m[t] ** 2).sum())
            for start in range(0, len(distance_m), _LANES):
                for z in range(_LANES):
                    far_m[z] = distance_m[min(start + z, len(distance_m) - 1)]
                if far_m.max() <= height_m:
                    continue
                for m in range(num_elements):
                    for axis in range(3):
                        at_m = tx_m[t, axis] - element_m[f, m, axis]
                        for z in range(_LANES):
                            offset_m[axis, z] = at_m + 2 * (far_m[z] - height_m) * normal[axis]
                    _waves(offset_m, size_m, wavenumber[f], wave[m])
                sums[:] = 0
                _sums(h, wave, pairs, sums)
                for i in range(3):
                    for k in range(2):
                        _products(weight, known[k], sums[i], told[k, i + 1])
                    for j in range(i + 1):
                        _products(weight, sums[i], sums[j], gram[i, j])
                for z in range(min(_LANES, len(distance_m) - start)):
                    if far_m[z] <= height_m:
                        continue
                    real, imaginary = reflection[f, t, cell[start + z], 0], reflection[f, t, cell[start + z], 1]
                    own = factor[start + z, f]
                    d0, d1, d2, d3 = told[0, 0, z], told[0, 1, z], told[0, 2, z], told[0, 3, z]
                    k0, k1, k2, k3 = told[1, 0, z], told[1, 1, z], told[1, 2, z], told[1, 3, z]
                    aa, ab, bb = gram[0, 0, z], gram[1, 0, z], gram[1, 1, z]
                    ac, bc, cc = gram[2, 0, z], gram[2, 1, z], gram[2, 2, z]
                    for s in range(num_slabs):
                        a, b = real[s], imaginary[s]
                        c = a * a + b * b
                        along = d0 + a * d1 + b * d2 + c * d3
                        power = k0 + 2 * (a * k1 + b * k2 + c * k3) + a * a * aa + b * b * bb + c * c * cc
                        power += 2 * (a * b * ab + a * c * ac + b * c * bc)
                        own[s] *= before / (1 + _NOISE - along * along / (power + _SMALL))
    return factor
