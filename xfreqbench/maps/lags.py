"""Maps as an array measures them: the correlations of its elements, summed over pairs with the same lag.

The power of a beam, aᴴ C a / M², depends on the covariance C = E[h hᴴ] of the channel only through its sums over pairs
of elements with the same lag. For a 4×4 array these are 49 real numbers, for any number of directions and of channels
that add up in C. They are stored as 25 complex sums; the sum of lag zero is real.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.maps.bartlett import BartlettBeam, PasKind, power_of
from xfreqbench.types import FloatArray, IntArray, Maps, NDArray


def element_lags(element_position_wavelengths: Float[FloatArray, "M 3"]) -> Float[FloatArray, "M*M 3"]:
    """Differences r_m − r_n of the positions of all pairs of elements, rounded so that equal ones compare equal."""
    element = element_position_wavelengths
    return (element[:, None] - element[None]).reshape(-1, 3).round(6)


class LagFunctions:
    """The lags of an array's pairs of elements, and the real functions of direction that belong to them.

    `lag` (U, 3) are the distinct lags in wavelengths, one of each and its opposite, whose sums are conjugates. `pairs`
    are the numbers m·M + n of the pairs that have them, and `of_pair` says which lag each has. `count` (U,) is the
    number of pairs of a lag, and `weight` (U,) what its sum counts in the power of a beam. Real parts of the U sums
    come first, then the imaginary ones: L = 2U numbers.
    """

    def __init__(self, beam: BartlettBeam) -> None:
        self.beam = beam
        lag = element_lags(beam.element_position_wavelengths)
        x, y, z = lag.T
        # of each lag and its opposite the one whose first nonzero coordinate is positive
        is_forward = (x > 0) | ((x == 0) & ((y > 0) | ((y == 0) & (z >= 0))))
        self.pairs: Int[IntArray, "P"] = np.flatnonzero(is_forward)
        self.lag, of_pair = np.unique(lag[self.pairs], axis=0, return_inverse=True)
        self.of_pair: Int[IntArray, "P"] = of_pair.reshape(-1)
        num_elements = len(beam.element_position_wavelengths)
        self.count = np.bincount(self.of_pair)
        self.weight = np.where((self.lag == 0).all(axis=1), 1.0, 2.0) / num_elements**2

    @cached_property
    def waves(self) -> Float[FloatArray, "L E A"]:
        """The function of direction that each number of the sums is multiplied by; the power of a map is their sum."""
        phase = 2 * np.pi * self.beam.grid.directions @ self.lag.T
        return np.moveaxis(self.weight * np.stack([np.cos(phase), np.sin(phase)]), -1, 1).reshape(-1, *phase.shape[:2])

    @cached_property
    def _projection(self) -> Float[FloatArray, "EA L"]:
        waves = self.waves.reshape(len(self.waves), -1)
        gram = waves @ waves.T
        # some lag functions almost vanish on the visible half of the sphere
        gram += 1e-6 * gram.diagonal().max() * np.eye(len(gram))
        return np.asarray(np.linalg.solve(gram, waves).T, np.float64)

    def of_maps(self, maps: Float[Maps, "B E A"], kind: PasKind) -> Float[NDArray[np.float32], "B L"]:
        """The sums of the power map, of any that the array can give, that is nearest to each map by least squares."""
        return (power_of(maps, kind).reshape(-1, len(self._projection)) @ self._projection).astype(np.float32)

    def maps(self, sums: Float[NDArray[np.float32], "B L"], kind: PasKind) -> Float[Maps, "B E A"]:
        """Maps with peak 1 of given sums; zero where no power is above zero."""
        power = np.maximum(sums.astype(np.float64) @ self.waves.reshape(len(self.waves), -1), 0)
        peak = power.max(axis=1, keepdims=True)
        maps = np.divide(power, peak, out=np.zeros_like(power), where=peak > 0).astype(np.float32)
        return (np.sqrt(maps) if kind == "amplitude" else maps).reshape(-1, *self.beam.grid.shape)
