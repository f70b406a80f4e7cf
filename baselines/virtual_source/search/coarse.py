"""Coarse search for the mirror images of the receiver: all places in reach are tried at the lowest carrier alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter

from xfreqbench.types import FloatArray, IntArray, NDArray

from .cross_terms import MIN_EXCESS_CYCLES, BoolArray, CrossTerms, phasor
from .planes import Vector

MAX_TILT = 0.1  # rad, by which ceilings and walls may lean

BEHIND_BOX_M = 2.0  # how far beyond transmitters and receiver a wall may stand
_CELL_WAVELENGTHS = 1 / 3
_CELLS_AT_ONCE = 96
_MAX_PAIRS = 8e7  # pairs of a cell and a transmitter, computed in two seconds
_MIN_TX = 100  # transmitters that are used at least, where there are so many
_TABLE_STEPS = 24  # of the table of arrivals, from boresight to the array's plane
_COUNTED_CELL_M = 0.1  # at least; cells of this size are counted to choose the final size
_NUM_UPRIGHT, _NUM_LEVEL = 300, 60  # candidates that are kept


@dataclass(frozen=True, eq=False)
class _Lattice:
    """A lattice of places for the mirrored receiver; `is_inside` says which of them are tried."""

    place_m: Float[FloatArray, "*shape 3"]
    is_inside: Bool[BoolArray, "*shape"]
    outside: float  # evidence at the other places; with infinity, no maximum lies next to them

    def maxima(self, evidence: Float[FloatArray, "Q"]) -> Float[FloatArray, "C 3"]:
        """Places of local maxima, given the evidence at `inside_m`."""
        field = np.full(self.is_inside.shape, self.outside)
        field[self.is_inside] = evidence
        return self.place_m[self.is_inside & (field == maximum_filter(field, size=3, mode="nearest"))]

    @property
    def inside_m(self) -> Float[FloatArray, "Q 3"]:
        """The places that are tried."""
        return self.place_m[self.is_inside]


def coarse_maxima_m(reference: CrossTerms, generator: np.random.Generator) -> Float[FloatArray, "C 3"]:
    """Places of the mirrored receiver where the evidence at the lowest carrier has its greatest local maxima.

    `generator` chooses transmitters where there are too many. The reference has at least one transmitter.
    """
    order = generator.permutation(len(reference.offset_m))
    uprights = _peaks_m(reference, order, _upright, 2)[:_NUM_UPRIGHT]
    return np.concatenate([uprights, _peaks_m(reference, order, _level, 3)[:_NUM_LEVEL]])


def _peaks_m(
    reference: CrossTerms, order: Int[IntArray, "T"], lattice_of: Callable[[CrossTerms, float], _Lattice], num_axes: int
) -> Float[FloatArray, "C 3"]:
    """Local maxima on a lattice, found with as many transmitters as `_MAX_PAIRS` allows and ranked with all of them."""
    # cells are a third of the longest wavelength, or larger where there would be too many of them
    finest_m = _CELL_WAVELENGTHS * 2 * np.pi / float(reference.wavenumber[0])
    coarse_m = max(finest_m, _COUNTED_CELL_M)
    num_coarse = np.count_nonzero(lattice_of(reference, coarse_m).is_inside)
    max_cells = _MAX_PAIRS / min(len(reference.offset_m), _MIN_TX)
    cell_m = max(finest_m, coarse_m * (num_coarse / max_cells) ** (1 / num_axes))
    lattice = lattice_of(reference, cell_m)
    chosen = order[: math.ceil(_MAX_PAIRS / max(int(lattice.is_inside.sum()), 1))]
    peaks_m = lattice.maxima(_table_evidence(reference, chosen, lattice.inside_m))
    return peaks_m[np.argsort(-_table_evidence(reference, order, peaks_m))]


def _upright(reference: CrossTerms, cell_m: float) -> _Lattice:
    """Lattice of upright planes of any azimuth, from close to the receiver to behind the transmitters."""
    x, y, _ = _axes(reference, cell_m)
    place_m = np.stack(np.meshgrid(x, y, 0.0, indexing="ij"), axis=-1)[:, :, 0]
    return _Lattice(place_m, is_within_reach(reference, place_m, cell_m), np.inf)


def _level(reference: CrossTerms, cell_m: float) -> _Lattice:
    """Lattice of ceilings and floors, which may lean a little."""
    *_, z = _axes(reference, cell_m)
    reach = math.ceil(MAX_TILT * abs(z).max() / cell_m)
    across = np.arange(-reach, reach + 1) * cell_m
    place_m = np.stack(np.meshgrid(across, across, z, indexing="ij"), axis=-1)
    limit_m = np.maximum(MAX_TILT * abs(place_m[..., 2:]), 1.01 * cell_m)
    is_level = (abs(place_m[..., :2]) <= limit_m).all(axis=-1)
    return _Lattice(place_m, is_level & is_within_reach(reference, place_m, cell_m), -np.inf)


def bounds_m(reference: CrossTerms) -> tuple[Vector, Vector]:
    """Lowest and highest corner of the box around receiver and transmitters, with a margin for walls behind them."""
    offset_m = reference.offset_m
    return offset_m.min(axis=0).clip(max=0) - BEHIND_BOX_M, offset_m.max(axis=0).clip(min=0) + BEHIND_BOX_M


def _axes(reference: CrossTerms, cell_m: float) -> list[Float[FloatArray, "_"]]:
    """Coordinates of the lattice along x, y and z: multiples of the cell size."""
    low_m, high_m = bounds_m(reference)
    return [
        np.arange(math.floor(2 * low / cell_m) - 1, math.ceil(2 * high / cell_m) + 2) * cell_m
        for low, high in zip(low_m, high_m, strict=True)
    ]


def is_within_reach(
    reference: CrossTerms, place_m: Float[FloatArray, "*shape 3"], cell_m: float
) -> Bool[BoolArray, "*shape"]:
    """Whether the plane of a mirrored receiver meets the box of `bounds_m`, and does not pass through the receiver."""
    low_m, high_m = bounds_m(reference)
    square_m2 = (place_m**2).sum(axis=-1)
    reach_m2 = 2 * np.maximum(place_m * low_m, place_m * high_m).sum(axis=-1)
    return (square_m2 <= reach_m2) & (square_m2 > (0.75 * cell_m) ** 2)


def _table_evidence(
    reference: CrossTerms, chosen: Int[IntArray, "C"], place_m: Float[FloatArray, "Q 3"]
) -> Float[FloatArray, "Q"]:
    """Evidence at the lowest carrier from the chosen transmitters, steering vectors rounded to those of a table."""
    table = _CrossTermTable(reference, chosen)
    parts = [np.zeros(0)]
    for start in range(0, len(place_m), _CELLS_AT_ONCE):
        reference.require_time()
        parts.append(table.evidence(place_m[start : start + _CELLS_AT_ONCE]))
    return np.concatenate(parts)


class _CrossTermTable:
    """Cross terms of the chosen transmitters at the lowest carrier, for arrivals on a lattice in the array's plane."""

    def __init__(self, reference: CrossTerms, chosen: Int[IntArray, "C"]) -> None:
        element = reference.element_position_wavelengths
        self._plane = reference.rotation @ np.linalg.svd(element, full_matrices=False)[2][:2].T
        cosine = np.arange(-_TABLE_STEPS, _TABLE_STEPS + 1) / _TABLE_STEPS
        along = np.stack(np.meshgrid(cosine, cosine, indexing="ij"), axis=-1).reshape(-1, 2)
        steering = np.exp(2j * np.pi * along @ (element @ reference.rotation.T @ self._plane).T)
        self._term = (reference.referred[chosen, 0] @ steering.conj().T).astype(np.complex64).ravel()
        self._row = (np.arange(len(chosen), dtype=np.int32) * len(along))[:, None]
        self._offset_m, self._distance_m = reference.offset_m[chosen], reference.distance_m[chosen, None]
        self._along_m = (self._offset_m @ self._plane).astype(np.float32)
        self._cycles_per_m = float(reference.wavenumber[0]) / (2 * np.pi)

    def evidence(self, place_m: Float[FloatArray, "Q 3"]) -> Float[FloatArray, "Q"]:
        """Evidence as `Aligned.evidence`, but the mean is kept and detours count down to a quarter of a wavelength."""
        square_m2, product_m2 = (place_m**2).sum(axis=1), self._offset_m @ place_m.T
        length_m = np.sqrt(self._distance_m**2 + square_m2 - 2 * product_m2)
        share = (1 - 2 * product_m2 / square_m2).astype(np.float32)
        cycles = (length_m - self._distance_m) * self._cycles_per_m
        term = self._term.take(self._index(place_m, share, (_TABLE_STEPS / length_m).astype(np.float32)))
        term *= (share > 0) & (cycles > MIN_EXCESS_CYCLES / 2)
        power = np.einsum("tq,tq->q", term.real, term.real) + np.einsum("tq,tq->q", term.imag, term.imag)
        return abs(np.einsum("tq,tq->q", term, phasor(cycles))).astype(float) ** 2 / power.clip(1e-30)

    def _index(
        self,
        place_m: Float[FloatArray, "Q 3"],
        share: Float[NDArray[np.float32], "C Q"],
        steps_per_m: Float[NDArray[np.float32], "C Q"],
    ) -> Int[NDArray[np.int32], "C Q"]:
        """Index into the table of the arrival from each transmitter's mirror image."""
        index = self._row
        stride = 2 * _TABLE_STEPS + 1
        for along_m, place, step in zip(
            self._along_m.T, (place_m @ self._plane).T.astype(np.float32), (stride, 1), strict=True
        ):
            coordinate = (along_m[:, None] + share * place) * steps_per_m + np.float32(_TABLE_STEPS + 0.5)
            index = index + step * coordinate.astype(np.int32)
        return index
