"""Propagation paths at the array centre: what the tests compare and a viewer draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray

NO_INTERACTION, SPECULAR, DIFFUSE, REFRACTION, DIFFRACTION = 0, 1, 2, 4, 8  # Sionna RT's codes


@dataclass(frozen=True)
class Paths:
    """P paths from one transmitter to the array centre, the earliest first.

    `gain` holds the antenna patterns, interactions and spreading (λ/4πd included) but **no** travel
    phase; `delay_s` is the travel time to the array centre; `arrival` points from the receiver towards
    the last interaction, in world axes. `interactions` are codes along the path from the transmitter,
    padded with `NO_INTERACTION`; `vertices_m` the points where they happen, padded with NaN.
    """

    carrier_hz: Float[FloatArray, "F"]
    gain: Complex[NDArray[np.complex128], "F P"]
    delay_s: Float[FloatArray, "P"]
    arrival: Float[FloatArray, "P 3"]
    interactions: Int[NDArray[np.int64], "P D"]
    vertices_m: Float[FloatArray, "P D 3"]

    def cfr_at_centre(self) -> Complex[NDArray[np.complex128], "F"]:
        """Σ_l a_l(f)·exp(−j2πf τ_l): the channel of an element at the array centre (Eq. 1)."""
        turns = self.carrier_hz[:, None] * self.delay_s
        return (self.gain * np.exp(-2j * np.pi * (turns % 1.0))).sum(axis=1)
