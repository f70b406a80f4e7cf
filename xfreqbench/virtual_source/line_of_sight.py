"""Power maps referred to the line of sight.

The map of a small array tells the sums of h hᴴ over pairs of elements that lie equally far apart. Of a line of
sight and a reflection they hold the cross term g a_p a₀ᴴ exp(−j2πf(d_p − d₀)/c): the channel of the reflection,
referred to the line of sight. Turned back by the lengths of a plane that is there, these terms add up over all
transmitters; by those of any other plane they do not.

Of the term's phase a map tells the cosine: beams of an array that is its own mirror image are real. A phase that
runs the other way has the same maps, and speaks for the same planes; half of the terms' power never adds up.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.array import steering_vector
from xfreqbench.dataset import IntArray, PasDataset
from xfreqbench.pas import power_of
from xfreqbench.units import SPEED_OF_LIGHT_M_S
from xfreqbench.virtual_source.planes import mirrored

ComplexArray = NDArray[np.complex128]
PhasorArray = NDArray[np.complex64]
BoolArray = NDArray[np.bool_]
Explained = Callable[[IntArray], Complex[ComplexArray, "Q B M"]]

_MAPS_AT_ONCE = 64
_MAX_DIRECTIONS = 8192  # of a map, which holds 49 numbers
_SMALLEST_RESIDUAL = 0.002  # of an element's power: a line of sight that stands alone leaves nothing
_SMALLEST_SINGULAR = 3e-3  # of the largest: a map of a vertical array tells less than its lag averages
MIN_EXCESS_CYCLES = 0.5  # shorter detours leave the line of sight's own power in phase


@dataclass(frozen=True, eq=False)
class LineOfSightReference:
    """Maps of T transmitters at F carriers, referred to the line of sight.

    `offset_m` are the transmitters from the array centre, in the world's axes. `referred` is what the lag
    averages of a map, less the line of sight's own, make of the line of sight's steering vector: Σ g_p a_p
    exp(−j2πf(d_p − d₀)/c) over reflections p. Rows are scaled by the share of the line of sight in the map,
    over what it leaves unexplained; they are zero where there is no map. `amplitude` is that of a reflection
    as strong as the line of sight at equal length.
    """

    offset_m: Float[FloatArray, "T 3"]
    carrier_hz: Float[FloatArray, "F"]
    rotation: Float[FloatArray, "3 3"]
    element_position_wavelengths: Float[FloatArray, "M 3"]
    referred: Complex[ComplexArray, "T F M"]
    amplitude: Float[FloatArray, "T F"]

    @classmethod
    def of(cls, train: PasDataset, explained: Explained | None = None) -> LineOfSightReference:
        """The reference of all rows of a data set that have a path; there may be none.

        What is known of the channels already, Q that do not interfere for rows of the data set, is taken off
        in place of the line of sight alone.
        """
        rows = np.flatnonzero(train.has_path)
        _, first, tx = np.unique(train.tx_index[rows], return_index=True, return_inverse=True)
        carrier_hz, carrier = np.unique(train.carrier_hz[rows], return_inverse=True)
        receiver = train.header.receiver
        offset_m = train.tx_position_m[rows[first]] - np.asarray(receiver.position_m)
        element = train.beam.element_position_wavelengths
        referred = np.zeros((len(first), len(carrier_hz), len(element)), complex)
        amplitude = np.zeros(referred.shape[:2])
        lags = _Lags(train)
        for column, wavelength_m in enumerate(SPEED_OF_LIGHT_M_S / carrier_hz):
            here = np.flatnonzero(carrier == column)
            waves = _spherical_waves(offset_m[tx[here]] @ receiver.rotation / wavelength_m, element)
            cell = tx[here], column
            referred[cell], amplitude[cell] = lags.referred(
                rows[here],
                waves,
                explained,
                phasor(np.linalg.norm(offset_m[tx[here]], axis=1) / wavelength_m),
            )
        return cls(offset_m, carrier_hz, receiver.rotation, element, referred, amplitude)

    @cached_property
    def distance_m(self) -> Float[FloatArray, "T"]:
        """Lengths of the lines of sight."""
        return np.linalg.norm(self.offset_m, axis=1)

    @cached_property
    def wavenumber(self) -> Float[FloatArray, "F"]:
        """2πf/c in radians per metre."""
        return 2 * np.pi * self.carrier_hz / SPEED_OF_LIGHT_M_S


class _Lags:
    """Averages of h hᴴ over pairs of elements at equal lags, as the maps of a data set tell them."""

    def __init__(self, train: PasDataset) -> None:
        element = train.beam.element_position_wavelengths
        lag = (element[:, None] - element[None]).reshape(-1, 3).round(6)
        self._lag, of_pair, count = np.unique(lag, axis=0, return_inverse=True, return_counts=True)
        self._train, self._of_pair, self._count = train, of_pair.reshape(-1), count
        self._mean = np.zeros((len(lag), len(count)))
        self._mean[np.arange(len(lag)), self._of_pair] = 1 / count[self._of_pair]

    def referred(
        self,
        rows: Int[IntArray, "B"],
        waves: Complex[ComplexArray, "B M"],
        explained: Explained | None,
        travel: Complex[PhasorArray, "B"],
    ) -> tuple[Complex[ComplexArray, "B M"], Float[FloatArray, "B"]]:
        """`LineOfSightReference.referred` and `amplitude` of rows whose lines of sight are `waves`."""
        measured, direct = self._measured(rows), self._told(self._of_channels(waves[None]))
        share = self._share(measured, direct).clip(0)
        known, known_share = direct, share
        if explained is not None:
            channels = explained(rows)
            known = self._told(self._of_channels(channels))
            known_share = self._share(measured, known)
            waves = channels[0] * travel[:, None]
            waves /= np.sqrt((abs(waves) ** 2).mean(axis=1, keepdims=True)).clip(1e-30)
        left = self._referred_to(measured - known_share[:, None] * known, waves)
        weight = share / (np.linalg.norm(left, axis=1) + _SMALLEST_RESIDUAL * waves.shape[1])
        return weight[:, None] * left, weight * share

    def _share(
        self, measured: Complex[ComplexArray, "B L"], known: Complex[ComplexArray, "B L"]
    ) -> Float[FloatArray, "B"]:
        """Of what is known in what was measured, least squares."""
        norm = np.einsum("bl,l,bl->b", known, self._count, known.conj()).real
        return np.einsum("bl,l,bl->b", measured, self._count, known.conj()).real / norm

    def _referred_to(
        self, averages: Complex[ComplexArray, "B L"], waves: Complex[ComplexArray, "B M"]
    ) -> Complex[ComplexArray, "B M"]:
        num_elements = waves.shape[1]
        matrix = averages[:, self._of_pair].reshape(-1, num_elements, num_elements)
        return np.matmul(matrix, waves[:, :, None])[..., 0]

    def _of_channels(self, cfr: Complex[ComplexArray, "Q B M"]) -> Complex[ComplexArray, "B L"]:
        """Of the sum of their powers, scaled to a mean power of 1."""
        products = np.einsum("qbm,qbn->bmn", cfr, cfr.conj()).reshape(cfr.shape[1], len(self._mean))
        averages = products.real @ self._mean + 1j * (products.imag @ self._mean)
        return averages / abs(averages).max(axis=1, keepdims=True).clip(1e-30)

    def _measured(self, rows: Int[IntArray, "B"]) -> Complex[ComplexArray, "B L"]:
        train = self._train
        if not train.header.channels:
            return self._of_maps(rows)
        cfr = train.cfr[rows].astype(complex)
        cfr /= abs(cfr).max(axis=1, keepdims=True)
        if train.header.pas_kind == "phase-only":
            cfr /= np.where(cfr == 0, 1, abs(cfr))
        return self._of_channels(cfr[None])

    def _of_maps(self, rows: Int[IntArray, "B"]) -> Complex[ComplexArray, "B L"]:
        """Least squares: P(d) = Σ_l r_l exp(−j2π l·d), scaled to a mean power of 1 at an element."""
        kind, seen = self._train.header.pas_kind, self._directions
        parts = [
            power_of(self._train.pas(some), kind).reshape(len(some), -1)[:, seen] @ self._inverse_waves.T
            for some in np.split(rows, range(_MAPS_AT_ONCE, len(rows), _MAPS_AT_ONCE))
        ]
        averages = self._complex(np.concatenate(parts))
        return averages / abs(averages).max(axis=1, keepdims=True).clip(1e-12)

    def _told(self, averages: Complex[ComplexArray, "B L"]) -> Complex[ComplexArray, "B L"]:
        """What maps would tell of them: all, but for a vertical array."""
        if self._train.header.channels:
            return averages
        parts = np.concatenate([averages.real, averages.imag], axis=1)
        return self._complex(parts @ (self._inverse_waves @ self._waves).T)

    def _complex(self, parts: Float[FloatArray, "B R"]) -> Complex[ComplexArray, "B L"]:
        real, imaginary = np.split(parts, 2, axis=1)
        return real + 1j * imaginary

    @cached_property
    def _directions(self) -> Int[IntArray, "D"]:
        num_directions = math.prod(self._train.grid.shape)
        stride = -(-num_directions // _MAX_DIRECTIONS)
        return np.arange(0, num_directions, stride + (stride % 2 == 0))  # odd, so that no azimuth is left out

    @cached_property
    def _waves(self) -> Float[FloatArray, "D R"]:
        """Power towards directions of the real and imaginary parts of lag averages."""
        phase = 2 * np.pi * self._train.grid.directions.reshape(-1, 3)[self._directions] @ self._lag.T
        return np.concatenate([np.cos(phase), np.sin(phase)], axis=1) * np.tile(self._count, 2)

    @cached_property
    def _inverse_waves(self) -> Float[FloatArray, "R D"]:
        return np.linalg.pinv(self._waves.T @ self._waves, _SMALLEST_SINGULAR**2) @ self._waves.T


def _spherical_waves(
    source_wavelengths: Float[FloatArray, "B 3"], element_position_wavelengths: Float[FloatArray, "M 3"]
) -> Complex[ComplexArray, "B M"]:
    """Field at the elements of waves from sources in the receiver's frame, over that at the centre."""
    length = np.linalg.norm(source_wavelengths[:, None] - element_position_wavelengths, axis=-1)
    centre = np.linalg.norm(source_wavelengths, axis=-1, keepdims=True)
    return np.exp(-2j * np.pi * (length - centre)) * centre / length


# The evidence for a plane


@dataclass(frozen=True, eq=False)
class Aligned:
    """Cross terms of K carriers, turned back by the lengths that a mirrored receiver predicts.

    `gradient` is that of each length by the mirrored receiver's position, a unit vector.
    """

    term: Complex[PhasorArray, "T K"]
    length_m: Float[FloatArray, "T"]
    gradient: Float[FloatArray, "T 3"]

    @property
    def sum(self) -> Complex[PhasorArray, "K"]:
        """Of the terms of all transmitters."""
        return self.term.sum(axis=0)

    @cached_property
    def power(self) -> Float[FloatArray, "K"]:
        """Of all terms, as if they did not add up."""
        return np.einsum("tk,tk->k", self.term, self.term.conj()).real.astype(float).clip(1e-30)

    @cached_property
    def evidence(self) -> Float[FloatArray, "K"]:
        """|Σ x|² / Σ|x|²: exponential of mean 1 where there is no plane, never more than the terms are."""
        return (abs(self.sum) ** 2 / self.power).astype(float)

    @cached_property
    def spread(self) -> Float[FloatArray, "3 3"]:
        """Covariance of the gradients of the terms that count."""
        weight = np.einsum("tk,tk->t", self.term, self.term.conj()).real / self.power.sum()
        mean = weight @ self.gradient
        return (self.gradient * weight[:, None]).T @ self.gradient - np.outer(mean, mean)


def aligned(
    reference: LineOfSightReference,
    mirrored_receiver_m: Float[FloatArray, "3"],
    carriers: slice = slice(None),
    min_excess_cycles: float = MIN_EXCESS_CYCLES,
    source_m: Float[FloatArray, "T 3"] | None = None,
    less_mean: bool = True,
) -> Aligned:
    """Of transmitters on the receiver's side whose detour exceeds some cycles; the terms of others are 0.

    Waves come from the transmitters' images, if no other sources are given. With `less_mean` the terms' mean is
    taken off before they are turned: it is left by the line of sight, and adds up where all detours are about
    as long. What is left once other channels are explained has none.
    """
    to_image_m = mirrored_receiver_m - reference.offset_m
    length_m = np.linalg.norm(to_image_m, axis=1)
    cycles = (length_m - reference.distance_m)[:, None] * reference.carrier_hz[carriers] / SPEED_OF_LIGHT_M_S
    counts = (cycles > min_excess_cycles) & _is_in_front(reference, mirrored_receiver_m)[:, None]
    seen = steering(
        reference, mirrored(reference.offset_m, mirrored_receiver_m) if source_m is None else source_m
    )
    term = np.matmul(reference.referred[:, carriers], seen.conj()[:, :, None])[..., 0] * counts
    if less_mean:
        term -= term.sum(axis=0) / counts.sum(axis=0).clip(1) * counts
    return Aligned(term * phasor(cycles), length_m, to_image_m / length_m[:, None])


def _is_in_front(
    reference: LineOfSightReference, mirrored_receiver_m: Float[FloatArray, "3"]
) -> Bool[BoolArray, "T"]:
    """Of the plane that puts the receiver's image there."""
    return 2 * reference.offset_m @ mirrored_receiver_m < mirrored_receiver_m @ mirrored_receiver_m


def steering(
    reference: LineOfSightReference, source_m: Float[FloatArray, "T 3"]
) -> Complex[ComplexArray, "T M"]:
    """Of waves from sources far away."""
    arrival = source_m @ reference.rotation / np.linalg.norm(source_m, axis=1, keepdims=True)
    return steering_vector(reference.element_position_wavelengths, arrival, SPEED_OF_LIGHT_M_S)


def phasor(cycles: Float[FloatArray, "*shape"]) -> Complex[PhasorArray, "*shape"]:
    """exp(+j2π cycles), reduced before it is rounded to single precision."""
    phase = (2 * np.pi * (cycles - np.floor(cycles))).astype(np.float32)
    phasor = np.empty(phase.shape, np.complex64)
    np.cos(phase, out=phasor.real)
    np.sin(phase, out=phasor.imag)
    return phasor
