"""Cross terms of reflections with the line of sight, extracted from power maps, and the evidence for a plane.

The map of a small array determines the sums of h hᴴ over pairs of elements with the same lag. For a line of sight
and a reflection, these sums hold the cross term g a_p a₀ᴴ exp(−j2πf(d_p − d₀)/c): the channel of the reflection,
referred to the line of sight. If a plane is there, its cross terms add up over all transmitters once their phases
are turned back by the lengths that the plane predicts. With the lengths of any other plane they do not add up.

A map determines only the cosine of the term's phase, because the beams of an array that is its own mirror image
are real. A phase of opposite sign has the same maps and supports the same planes, so half of the power of the
terms never adds up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from jaxtyping import Complex, Float, Int

from xfreqbench.data.dataset import PasDataset
from xfreqbench.maps.bartlett import power_of
from xfreqbench.maps.lags import element_lags
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

from .planes import Vector, mirrored

ComplexArray = NDArray[np.complex128]
PhasorArray = NDArray[np.complex64]
BoolArray = NDArray[np.bool_]
Lags = Complex[ComplexArray, "B L"]  # L lag averages of each of B maps
Explained = Callable[[IntArray], Complex[ComplexArray, "Q B M"]]
IsOver = Callable[[], bool]
Item = TypeVar("Item")

_MAPS_AT_ONCE = 64
_MAX_DIRECTIONS = 8192  # of a map that are used; a map of 4×4 elements has 49 degrees of freedom
_SMALLEST_RESIDUAL = 0.002  # of an element's power; a line of sight without reflections leaves none
_SMALLEST_SINGULAR = 3e-3  # of the largest; maps of a vertical array do not determine all lag averages
_LEAST_M = 1e-9  # of a length: a transmitter may stand just where a plane puts the receiver's image
MIN_EXCESS_CYCLES = 0.5  # with shorter detours the power of the line of sight itself adds up


class SearchOverError(Exception):
    """The time that a search may take is over; whoever began the search catches it."""


def never() -> bool:
    """The `is_over` of a search that may take as long as it needs."""
    return False


def until_over(found: Iterable[Item]) -> Iterator[Item]:
    """What is found, until the time of the search is over."""
    with suppress(SearchOverError):
        yield from found


@dataclass(frozen=True, eq=False)
class CrossTerms:
    """Maps of T transmitters at F carriers, referred to the line of sight.

    `offset_m` are the transmitters relative to the array centre, in world axes. `referred` is the product of the
    matrix of lag averages of a map, less those of the line of sight, with the steering vector of the line of
    sight: Σ g_p a_p exp(−j2πf(d_p − d₀)/c) over reflections p. Each vector is scaled by the share of the line of
    sight in the map, divided by what it leaves unexplained, and is zero where there is no map. `amplitude` is
    the amplitude of a reflection as strong and as long as the line of sight. `is_over` tells whether the time of the
    search that uses the reference is over.
    """

    offset_m: Float[FloatArray, "T 3"]
    carrier_hz: Float[FloatArray, "F"]
    rotation: Float[FloatArray, "3 3"]
    element_position_wavelengths: Float[FloatArray, "M 3"]
    referred: Complex[PhasorArray, "T F M"]
    amplitude: Float[FloatArray, "T F"]
    is_over: IsOver = never

    @classmethod
    def of(cls, train: PasDataset, explained: Explained | None = None, is_over: IsOver = never) -> CrossTerms:
        """The reference from all rows of a data set that have a path; there may be none.

        `explained`, if given, returns the channels known so far of rows of the data set: Q that do not
        interfere. They are subtracted in place of the line of sight alone. Raises `SearchOverError`.
        """
        rows = np.flatnonzero(train.has_path)
        _, first, tx = np.unique(train.tx_index[rows], return_index=True, return_inverse=True)
        carrier_hz, carrier = np.unique(train.carrier_hz[rows], return_inverse=True)
        receiver = train.header.receiver
        offset_m = train.tx_position_m[rows[first]] - np.asarray(receiver.position_m)
        element = train.beam.element_position_wavelengths
        referred = np.zeros((len(first), len(carrier_hz), len(element)), np.complex64)
        amplitude = np.zeros(referred.shape[:2])
        lags = LagAverages(train, is_over)
        for column, wavelength_m in enumerate(SPEED_OF_LIGHT_M_S / carrier_hz):
            here = np.flatnonzero(carrier == column)
            waves = spherical_waves(offset_m[tx[here]] @ receiver.rotation / wavelength_m, element)
            cell = tx[here], column
            referred[cell], amplitude[cell] = lags.referred(
                rows[here], waves, explained, phasor(np.linalg.norm(offset_m[tx[here]], axis=1) / wavelength_m)
            )
        return cls(offset_m, carrier_hz, receiver.rotation, element, referred, amplitude, is_over)

    def require_time(self) -> None:
        """Raise `SearchOverError` if the time of the search is over."""
        _require_time(self.is_over)

    @cached_property
    def distance_m(self) -> Float[FloatArray, "T"]:
        """Lengths of the lines of sight in metres."""
        return np.linalg.norm(self.offset_m, axis=1)

    @cached_property
    def wavenumber(self) -> Float[FloatArray, "F"]:
        """2πf/c in radians per metre."""
        return 2 * np.pi * self.carrier_hz / SPEED_OF_LIGHT_M_S


def _require_time(is_over: IsOver) -> None:
    if is_over():
        raise SearchOverError


class LagAverages:
    """Averages of h hᴴ over pairs of elements with equal lags, as the maps of a data set determine them."""

    def __init__(self, train: PasDataset, is_over: IsOver) -> None:
        element = train.beam.element_position_wavelengths
        lag = element_lags(element)
        self._lag, of_pair, count = np.unique(lag, axis=0, return_inverse=True, return_counts=True)
        self._train, self._of_pair, self._count = train, of_pair.reshape(-1), count
        self._is_over = is_over
        self._mean = np.zeros((len(lag), len(count)))
        self._mean[np.arange(len(lag)), self._of_pair] = 1 / count[self._of_pair]

    def referred(
        self,
        rows: Int[IntArray, "B"],
        waves: Complex[ComplexArray, "B M"],
        explained: Explained | None,
        travel: Complex[PhasorArray, "B"],
    ) -> tuple[Complex[ComplexArray, "B M"], Float[FloatArray, "B"]]:
        """`CrossTerms.referred` and `amplitude` of rows; `waves` are the channels of their lines of sight.

        `travel` holds exp(+j2πfd₀/c) of each row, by which explained channels are referred to the line of sight.
        """
        _require_time(self._is_over)
        measured, direct = self.measured(rows), self._told(self._of_channels(waves[None]))
        share = self._share(measured, direct).clip(0)
        known, known_share = direct, share
        if explained is not None:
            channels = explained(rows)
            known = self._told(self._of_channels(channels))
            known_share = self._share(measured, known)
            waves = channels[0] * travel[:, None]
            waves /= np.sqrt((abs(waves) ** 2).mean(axis=1, keepdims=True)).clip(1e-30)
        averages = measured - known_share[:, None] * known
        matrix = averages[:, self._of_pair].reshape(-1, waves.shape[1], waves.shape[1])
        left = np.matmul(matrix, waves[:, :, None])[..., 0]
        weight = share / (np.linalg.norm(left, axis=1) + _SMALLEST_RESIDUAL * waves.shape[1])
        return weight[:, None] * left, weight * share

    def _share(self, measured: Lags, known: Lags) -> Float[FloatArray, "B"]:
        """Factor of the known lag averages that fits the measured ones best in least squares."""
        norm = np.einsum("bl,l,bl->b", known, self._count, known.conj()).real.clip(1e-30)
        return np.einsum("bl,l,bl->b", measured, self._count, known.conj()).real / norm

    def _of_channels(self, cfr: Complex[ComplexArray, "Q B M"]) -> Lags:
        """Lag averages of Q channels that do not interfere, scaled to a mean power of 1 at an element."""
        products = np.einsum("qbm,qbn->bmn", cfr, cfr.conj()).reshape(cfr.shape[1], len(self._mean))
        averages = products.real @ self._mean + 1j * (products.imag @ self._mean)
        return averages / abs(averages).max(axis=1, keepdims=True).clip(1e-30)

    def measured(self, rows: Int[IntArray, "B"]) -> Lags:
        """Lag averages of rows, from their channels where the data set stores them, otherwise from their maps."""
        train = self._train
        return self.of_channels(train.cfr[rows].astype(complex)) if train.header.channels else self._of_maps(rows)

    def of_channels(self, cfr: Complex[ComplexArray, "B M"]) -> Lags:
        """Lag averages of channels, as maps of the data set's kind determine them."""
        cfr = cfr / abs(cfr).max(axis=1, keepdims=True).clip(1e-30)
        if self._train.header.pas_kind == "phase-only":
            cfr /= np.where(cfr == 0, 1, abs(cfr))
        return self._told(self._of_channels(cfr[None]))

    def likeness(self, measured: Lags, known: Lags) -> Float[FloatArray, "B"]:
        """Share of the power of measured lag averages that known ones explain: 1 where they are proportional."""
        power = np.einsum("bl,l,bl->b", measured, self._count, measured.conj()).real.clip(1e-30)
        share = self._share(measured, known)
        return share**2 * np.einsum("bl,l,bl->b", known, self._count, known.conj()).real / power

    def left(self, measured: Lags, known: Lags) -> Lags:
        """What known lag averages leave of measured ones; the power of each row of it is 1 less its likeness."""
        weighted, share = np.sqrt(self._count) * measured, self._share(measured, known)
        norm = np.linalg.norm(weighted, axis=1, keepdims=True).clip(1e-15)
        return (weighted - share[:, None] * np.sqrt(self._count) * known) / norm

    def _of_maps(self, rows: Int[IntArray, "B"]) -> Lags:
        """Lag averages r_l by least squares from maps P(d) = Σ_l r_l exp(−j2π l·d), scaled to a mean power of 1."""
        kind, seen = self._train.header.pas_kind, self._directions
        parts = []
        for some in np.split(rows, range(_MAPS_AT_ONCE, len(rows), _MAPS_AT_ONCE)):
            _require_time(self._is_over)
            power = power_of(self._train.pas(some), kind).reshape(len(some), -1)
            parts.append(power[:, seen] @ self._inverse_waves.T)
        averages = self._complex(np.concatenate(parts))
        return averages / abs(averages).max(axis=1, keepdims=True).clip(1e-12)

    def _told(self, averages: Lags) -> Lags:
        """The part of lag averages that maps determine; only for a vertical array it is less than all."""
        if self._train.header.channels:
            return averages
        parts = np.concatenate([averages.real, averages.imag], axis=1)
        return self._complex(parts @ self._determined)

    @cached_property
    def _determined(self) -> Float[FloatArray, "R R"]:
        return (self._inverse_waves @ self._waves).T

    def _complex(self, parts: Float[FloatArray, "B R"]) -> Lags:
        """Complex numbers from their real parts followed by their imaginary parts."""
        real, imaginary = np.split(parts, 2, axis=1)
        return real + 1j * imaginary

    @cached_property
    def _directions(self) -> Int[IntArray, "D"]:
        """Indices of evenly spaced directions of the grid, at most `_MAX_DIRECTIONS`."""
        num_directions = math.prod(self._train.grid.shape)
        stride = -(-num_directions // _MAX_DIRECTIONS)
        return np.arange(0, num_directions, stride + (stride % 2 == 0))  # odd, so that no azimuth is left out

    @cached_property
    def _waves(self) -> Float[FloatArray, "D R"]:
        """Power towards D directions for real and imaginary parts of the lag averages, R = 2 L."""
        phase = 2 * np.pi * self._train.grid.directions.reshape(-1, 3)[self._directions] @ self._lag.T
        return np.concatenate([np.cos(phase), np.sin(phase)], axis=1) * np.tile(self._count, 2)

    @cached_property
    def _inverse_waves(self) -> Float[FloatArray, "R D"]:
        """Pseudoinverse of `_waves`, which takes maps to lag averages."""
        return np.linalg.pinv(self._waves.T @ self._waves, _SMALLEST_SINGULAR**2) @ self._waves.T


def spherical_waves(
    source_wavelengths: Float[FloatArray, "B 3"], element_position_wavelengths: Float[FloatArray, "M 3"]
) -> Complex[ComplexArray, "B M"]:
    """Field at the elements, relative to the centre, of spherical waves from sources in the receiver's frame."""
    length = np.linalg.norm(source_wavelengths[:, None] - element_position_wavelengths, axis=-1)
    centre = np.linalg.norm(source_wavelengths, axis=-1, keepdims=True)
    return np.exp(-2j * np.pi * (length - centre)) * centre / length


# The evidence for a plane


@dataclass(frozen=True, eq=False)
class Aligned:
    """Cross terms of K carriers, their phases turned back by the lengths that a mirrored receiver predicts.

    `gradient` is that of each length by the mirrored receiver's position, a unit vector.
    """

    term: Complex[PhasorArray, "T K"]
    length_m: Float[FloatArray, "T"]
    gradient: Float[FloatArray, "T 3"]

    @property
    def sum(self) -> Complex[ComplexArray, "K"]:
        """Sum of the terms over transmitters."""
        return self.term.sum(axis=0, dtype=complex)

    @cached_property
    def power(self) -> Float[FloatArray, "K"]:
        """Sum of the squared magnitudes of the terms over transmitters."""
        return np.einsum("tk,tk->k", self.term, self.term.conj()).real.astype(float).clip(1e-30)

    @cached_property
    def evidence(self) -> Float[FloatArray, "K"]:
        """|Σ x|² / Σ|x|² of the terms x: exponential with mean 1 where there is no plane, at most their number."""
        return (abs(self.sum) ** 2 / self.power).astype(float)

    @cached_property
    def spread(self) -> Float[FloatArray, "3 3"]:
        """Covariance of the gradients, weighted with the powers of the terms."""
        weight = np.einsum("tk,tk->t", self.term, self.term.conj()).real / self.power.sum()
        mean = weight @ self.gradient
        return (self.gradient * weight[:, None]).T @ self.gradient - np.outer(mean, mean)


def aligned(
    reference: CrossTerms,
    mirrored_receiver_m: Vector,
    carriers: slice = slice(None),
    min_excess_cycles: float = MIN_EXCESS_CYCLES,
    source_m: Float[FloatArray, "T 3"] | None = None,
    less_mean: bool = True,
) -> Aligned:
    """Cross terms aligned for the plane that puts the receiver's image at `mirrored_receiver_m`.

    Terms are 0 for transmitters behind the plane, and where the detour is `min_excess_cycles` or shorter. Waves
    come from the transmitters' images in the plane, if `source_m` gives no other sources. With `less_mean` the
    mean of the terms is subtracted before they are turned: the line of sight leaves it, and it adds up where all
    detours are about as long. References with explained channels have no such mean. Raises `SearchOverError`.
    """
    reference.require_time()
    to_image_m = mirrored_receiver_m - reference.offset_m
    length_m = np.linalg.norm(to_image_m, axis=1).clip(_LEAST_M)
    cycles = (length_m - reference.distance_m)[:, None] * reference.carrier_hz[carriers] / SPEED_OF_LIGHT_M_S
    is_in_front = 2 * reference.offset_m @ mirrored_receiver_m < mirrored_receiver_m @ mirrored_receiver_m
    counts = (cycles > min_excess_cycles) & is_in_front[:, None]
    seen = steering(reference, mirrored(reference.offset_m, mirrored_receiver_m) if source_m is None else source_m)
    term = np.matmul(reference.referred[:, carriers], seen.conj()[:, :, None])[..., 0] * counts
    if less_mean:
        term -= term.sum(axis=0) / counts.sum(axis=0).clip(1) * counts
    return Aligned(term * phasor(cycles), length_m, to_image_m / length_m[:, None])


def steering(reference: CrossTerms, source_m: Float[FloatArray, "T 3"]) -> Complex[PhasorArray, "T M"]:
    """Steering vectors of plane waves from the directions of sources, positions relative to the array centre."""
    arrival = source_m @ reference.rotation / np.linalg.norm(source_m, axis=1, keepdims=True).clip(_LEAST_M)
    return phasor(arrival @ reference.element_position_wavelengths.T)


def phasor(cycles: Float[FloatArray, "*shape"]) -> Complex[PhasorArray, "*shape"]:
    """exp(+j2π cycles) in single precision, whole cycles subtracted before rounding."""
    phase = (2 * np.pi * (cycles - np.floor(cycles))).astype(np.float32)
    phasor = np.empty(phase.shape, np.complex64)
    np.cos(phase, out=phasor.real)
    np.sin(phase, out=phasor.imag)
    return phasor
