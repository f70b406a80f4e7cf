from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_limits

from xfreqbench.maps.bartlett import PAS_KINDS, BartlettBeam, cfr_of_plane_waves, pas_kind_named
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.array import frame_rotation, planar_array, steering_vector
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

GRID = AngularGrid.hemisphere()
RECEIVER = ReceiverArray(position_m=(0.0, 0.0, 2.5))
BEAM = BartlettBeam(RECEIVER.element_position_wavelengths, GRID)


def plane_wave_cfr(row: int, column: int, carrier_hz: float) -> np.ndarray:
    element_m = RECEIVER.element_position_wavelengths * SPEED_OF_LIGHT_M_S / carrier_hz
    arrival = GRID.directions[row, column][None]
    return cfr_of_plane_waves(np.array([3e-5 + 1e-5j]), np.array([2.7e-8]), arrival, element_m, carrier_hz)


@pytest.mark.parametrize("carrier_ghz", [1.0, 94.0])
@given(row=st.integers(5, 89), column=st.integers(0, 359))
def test_a_lone_plane_wave_peaks_at_its_angle_of_arrival(carrier_ghz: float, row: int, column: int) -> None:
    cfr = plane_wave_cfr(row, column, carrier_ghz * 1e9)
    maps, _ = BEAM.maps(cfr[None])
    peak = GRID.directions[np.unravel_index(maps[0].argmax(), GRID.shape)]
    # float32 beams are flat to 1e-7 about the peak, which is a fraction of a degree wide
    assert np.degrees(np.arccos(min(1.0, float(peak @ GRID.directions[row, column])))) < 1.01


def test_the_peak_power_of_a_plane_wave_is_its_own_power() -> None:
    _, peak = BEAM.maps(plane_wave_cfr(40, 77, 94e9)[None])
    assert peak[0] == pytest.approx(1e-9, rel=1e-5)


def test_the_kinds_are_power_its_root_and_phase_alone() -> None:
    rng = np.random.default_rng(0)
    cfr = rng.normal(size=(3, 16)) + 1j * rng.normal(size=(3, 16))
    power, _ = BEAM.maps(cfr)
    amplitude, _ = BEAM.maps(cfr, "amplitude")
    phase_only, _ = BEAM.maps(cfr, "phase-only")
    unit_modulus, _ = BEAM.maps(cfr / np.abs(cfr))
    np.testing.assert_allclose(amplitude**2, power, atol=1e-6)
    np.testing.assert_allclose(phase_only, unit_modulus, atol=1e-6)


def test_channels_too_weak_for_float32_powers_keep_their_map() -> None:
    cfr = plane_wave_cfr(40, 77, 10e9)[None]
    np.testing.assert_allclose(BEAM.maps(cfr * 1e-25)[0], BEAM.maps(cfr)[0], atol=1e-6)
    assert BEAM.maps((cfr * 1e-25).astype(np.complex64))[1][0] > 0


def test_maps_are_the_same_bytes_alone_and_among_others_in_one_thread_and_in_two() -> None:
    rng = np.random.default_rng(0)
    cfr = rng.normal(size=(20, 16)) + 1j * rng.normal(size=(20, 16))
    together, peaks = BEAM.maps(cfr)
    for size in (1, 3, 8, 13):
        np.testing.assert_array_equal(BEAM.maps(cfr[5 : 5 + size])[0], together[5 : 5 + size])
    for threads in (1, 2):
        with threadpool_limits(threads, "blas"):
            maps, peak = BEAM.maps(cfr)
        np.testing.assert_array_equal(maps, together)
        np.testing.assert_array_equal(peak, peaks)


def test_a_channel_of_zeros_is_a_map_of_zeros() -> None:
    for kind in PAS_KINDS:
        maps, peak = BEAM.maps(np.zeros((1, 16), complex), pas_kind_named(kind))
        assert not maps.any()
        assert peak[0] == 0


@pytest.mark.parametrize(("precision", "faintest"), [(np.complex64, 2.0**-140), (np.complex128, 2.0**-1040)])
def test_a_channel_of_denormal_numbers_has_the_map_of_any_other(precision: type, faintest: float) -> None:
    levels = np.array([[1, 2j, -3, 4, -5j, 6, 7, 8] * 2], dtype=precision)  # exact times a power of two
    for kind in ("power", "amplitude"):
        np.testing.assert_array_equal(
            BEAM.maps((levels * faintest).astype(precision), kind)[0], BEAM.maps(levels, kind)[0]
        )


def test_a_half_wavelength_four_by_four_array_has_49_degrees_of_freedom() -> None:
    rng = np.random.default_rng(0)
    cfr = rng.normal(size=(80, 16)) + 1j * rng.normal(size=(80, 16))
    power = np.abs(cfr @ BEAM.conjugate_steering.astype(complex)) ** 2
    singular = np.linalg.svd(power, compute_uv=False)
    assert singular[48] > 1e-3 * singular[0]
    assert singular[49] < 1e-5 * singular[0]


def test_the_phase_of_a_steering_vector_leads_towards_the_source() -> None:
    element = np.array([[0.25, 0.0, 0.0]])
    phase = np.angle(steering_vector(element, np.array([1.0, 0.0, 0.0]), SPEED_OF_LIGHT_M_S))
    np.testing.assert_allclose(phase, np.pi / 2)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda b: np.linalg.norm(b) > 0.1))
def test_the_receivers_frame_is_a_rotation_onto_its_boresight(boresight: tuple[float, float, float]) -> None:
    rotation = frame_rotation(boresight)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation[:, 2], boresight / np.linalg.norm(boresight), atol=1e-12)


def test_the_array_is_centred_and_lies_in_the_equator() -> None:
    element = planar_array(4, 4, 0.5)
    np.testing.assert_allclose(element.mean(axis=0), 0)
    assert not element[:, 2].any()
    assert element[1, 0] - element[0, 0] == pytest.approx(0.5)
    assert element[4, 1] - element[0, 1] == pytest.approx(0.5)
