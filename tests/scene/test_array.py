"""Steering vectors of large arrays."""

from __future__ import annotations

import numpy as np

from xfreqbench.scene.array import planar_array, steering_vector
from xfreqbench.units import SPEED_OF_LIGHT_M_S


def test_steering_vectors_of_4096_elements_at_94_ghz_are_those_of_extended_precision() -> None:
    element_m = planar_array(64, 64, 0.5) * SPEED_OF_LIGHT_M_S / 94e9
    directions = np.random.default_rng(0).normal(size=(50, 3))
    arrival = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    length_m = (arrival.astype(np.longdouble)[:, None] * element_m).sum(axis=-1)
    turns = np.longdouble(94e9) * length_m / np.longdouble(SPEED_OF_LIGHT_M_S)
    angle_rad = 8 * np.arctan(np.longdouble(1)) * (turns - np.floor(turns))
    expected = np.cos(angle_rad) + 1j * np.sin(angle_rad)
    # the corners lie 22 wavelengths from the centre: 140 rad times five roundings
    assert np.abs(steering_vector(element_m, arrival, 94e9) - expected).max() < 1e-13
