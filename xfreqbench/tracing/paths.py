"""Propagation paths from one transmitter to the array centre, as tests compare them and a view draws them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.types import FloatArray

NO_INTERACTION, SPECULAR, DIFFUSE, REFRACTION, DIFFRACTION = 0, 1, 2, 4, 8  # Sionna RT's codes


@dataclass(frozen=True)
class Paths:
    """P paths from one transmitter to the array centre at F carriers, the earliest first.

    `gain` holds the antenna patterns, interactions and spreading (λ/4πd included) but **no** travel phase: the
    channel at the centre is Σ gain·exp(−j2πf·delay_s) over the paths (Eq. 1). `delay_s` is the travel time to
    the array centre. `arrival` is a unit vector from the receiver towards the last interaction, in world axes.
    `interactions` are the codes of at most D interactions along the path from the transmitter, padded with
    `NO_INTERACTION`, and `vertices_m` the points where they happen, padded with NaN.
    """

    carrier_hz: Float[FloatArray, "F"]
    gain: Complex[NDArray[np.complex128], "F P"]
    delay_s: Float[FloatArray, "P"]
    arrival: Float[FloatArray, "P 3"]
    interactions: Int[NDArray[np.int64], "P D"]
    vertices_m: Float[FloatArray, "P D 3"]
