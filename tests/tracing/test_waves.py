from __future__ import annotations

import numpy as np

from tests.support.found_box import SCENE, SETTINGS
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.waves import spherical_waves

TX_M = np.array([1.1, 2.9, 0.9])


def test_a_spherical_wave_reaches_each_element_after_its_own_distance() -> None:
    direct = spherical_waves(ImageTracer(SCENE, [2.4e9], SETTINGS).paths(TX_M), 0, SCENE.receiver)[0]
    wavelength_m = 299_792_458.0 / 2.4e9
    distance_m = np.linalg.norm(TX_M - SCENE.receiver.element_position_m(wavelength_m), axis=1)
    turned_back = direct * np.exp(2j * np.pi * distance_m / wavelength_m)
    assert np.abs(np.angle(turned_back / turned_back[0])).max() < 1e-9  # some 20 turns in double precision
    np.testing.assert_allclose(np.abs(direct), np.abs(direct[0]))
