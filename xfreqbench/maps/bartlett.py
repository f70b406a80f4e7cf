"""Power angular spectra (PAS) of channels by Bartlett beams (paper Eqs. 1–3)."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any, Literal, cast, get_args

import numpy as np
from jaxtyping import Complex, Float

from xfreqbench.errors import ArgumentError, UnknownNameError
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.array import steering_vector
from xfreqbench.system.machine import one_blas_thread
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

PasKind = Literal["power", "amplitude", "phase-only"]
PAS_KINDS: tuple[str, ...] = get_args(PasKind)
RANGE_TOLERANCE = 1e-4  # single-precision rounding of a map that was divided by its own maximum


def pas_kind_named(name: str) -> PasKind:
    """The name as a kind of map; raises `UnknownNameError` for one that is none."""
    if name not in PAS_KINDS:
        raise UnknownNameError("PAS kind", name, PAS_KINDS)
    return cast(PasKind, name)


def cfr_of_plane_waves(
    gain: Complex[NDArray[np.complex128], "P"],
    delay_s: Float[FloatArray, "P"],
    arrival: Float[FloatArray, "P 3"],
    element_position_m: Float[FloatArray, "M 3"],
    carrier_hz: float,
) -> Complex[NDArray[np.complex128], "M"]:
    """Channel of P plane waves at M array elements (Eq. 1): h_n = Σ_l a_l exp(−j2πf(τ_l − r_n·d_l/c)).

    `gain` is a_l without travel phase, which enters here, once. `delay_s` is τ_l at the array centre. `arrival` is
    d_l, unit vectors towards the sources, and `element_position_m` r_n from the centre, both in the same axes.
    """
    travel = np.exp(-2j * np.pi * ((carrier_hz * delay_s) % 1.0))
    return (gain * travel) @ steering_vector(element_position_m, arrival, carrier_hz)


class BartlettBeam:
    """Bartlett beams of an array of M elements towards every direction of a grid (Eq. 2).

    `element_position_wavelengths` (M, 3) is in the receiver's frame. Positions in wavelengths are the same at
    every carrier, so one object serves all of them.
    """

    def __init__(self, element_position_wavelengths: Float[FloatArray, "M 3"], grid: AngularGrid) -> None:
        self.element_position_wavelengths = element_position_wavelengths
        self.grid = grid

    @cached_property
    def conjugate_steering(self) -> Complex[NDArray[np.complex64], "M EA"]:
        """a(d)* / M of every direction d; the directions are those of the grid, row by row."""
        angles = (self.element_position_wavelengths, self.grid.elevation_rad, self.grid.azimuth_rad)
        return _conjugate_steering(*(np.asarray(values, np.float64).tobytes() for values in angles))

    def maps(
        self, cfr: Complex[NDArray[np.complexfloating], "B M"], kind: PasKind = "power"
    ) -> tuple[Float[NDArray[np.float32], "B E A"], Float[FloatArray, "B"]]:
        """Maps with peak 1 of B channels, and the peak power by which each was divided.

        `power` is P/max P with P(d) = `|a(d)ᴴ h|²/M²` (Eqs. 2–3), and `amplitude` its square root; the peak power of
        both is max P, as a share of the transmitted power. `phase-only` is the power map of `h_n/|h_n|`, and its
        peak a pure number. A channel of zeros gives a map of zeros with peak 0, never NaN. Raises `ArgumentError` for
        channels of another shape, and `UnknownNameError`.
        """
        cfr, kind, num_elements = (np.asarray(cfr), pas_kind_named(kind), len(self.element_position_wavelengths))
        if cfr.ndim != 2 or cfr.shape[1] != num_elements:
            raise ArgumentError(f"Channels of shape (B, {num_elements}) become maps, but these have shape {cfr.shape}.")
        if kind == "phase-only":
            cfr = _divided_unless_zero(cfr, np.abs(cfr))
        scale = np.abs(cfr).max(axis=1, keepdims=True)  # without it |h|² ~ 1e-18 would underflow in float32
        power = self._powers(_divided_unless_zero(cfr, scale).astype(np.complex64))
        peak = power.max(axis=1, keepdims=True)
        maps = _divided_unless_zero(power, peak)
        if kind == "amplitude":
            maps = np.sqrt(maps)
        return maps.reshape(-1, *self.grid.shape), peak[:, 0].astype(np.float64) * scale[:, 0].astype(np.float64) ** 2

    def _powers(self, cfr: Complex[NDArray[np.complex64], "B M"]) -> Float[NDArray[np.float32], "B K"]:
        """Powers of the beams towards all directions, one channel after another in one thread.

        Some processors round the rows of one product by their number and place, and by the number of threads. So the
        map of a channel is the same, to the last bit, in every batch.
        """
        beam = np.empty(self.conjugate_steering.shape[1], np.complex64)
        powers = np.empty((len(cfr), len(beam)), np.float32)
        with one_blas_thread():
            for channel, power in zip(cfr, powers, strict=True):
                np.matmul(channel, self.conjugate_steering, out=beam)
                np.add(beam.real**2, beam.imag**2, out=power)
        return powers


@lru_cache(maxsize=8)  # 4 MB each, which the data sets of many rooms share
def _conjugate_steering(
    element_position_wavelengths: bytes, elevation_rad: bytes, azimuth_rad: bytes
) -> Complex[NDArray[np.complex64], "M EA"]:
    """`BartlettBeam.conjugate_steering` of arrays of float64, by their bytes."""
    position_wavelengths = np.frombuffer(element_position_wavelengths).reshape(-1, 3)
    directions = AngularGrid(np.frombuffer(elevation_rad), np.frombuffer(azimuth_rad)).directions.reshape(-1, 3)
    one_metre_wave = steering_vector(position_wavelengths, directions, SPEED_OF_LIGHT_M_S)
    steering = np.ascontiguousarray(one_metre_wave.conj().T / len(position_wavelengths)).astype(np.complex64)
    steering.setflags(write=False)
    return steering


def power_of(maps: Float[NDArray[np.float32], "N E A"], kind: PasKind) -> Float[NDArray[np.float32], "N E A"]:
    """Maps of linear power from maps of a kind; those of `amplitude` are squared."""
    return maps**2 if kind == "amplitude" else maps


def _divided_unless_zero(numerator: NDArray[Any], denominator: NDArray[Any]) -> NDArray[Any]:
    """Quotient, with the numerator where the denominator is 0."""
    divisor = np.where(denominator == 0, denominator.dtype.type(1), denominator)
    if np.iscomplexobj(numerator):  # NumPy would multiply by the inverse, which overflows for a denormal number
        return numerator.real / divisor + 1j * (numerator.imag / divisor)
    return numerator / divisor
