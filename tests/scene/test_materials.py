from __future__ import annotations

from collections.abc import Iterator

import pytest

import xfreqbench as xb
from xfreqbench.errors import MaterialBandError, UnknownNameError
from xfreqbench.scene.materials import ITU_MATERIALS, Band, check_dispersion, complex_permittivity, materials_defined_at
from xfreqbench.units import SPEED_OF_LIGHT_M_S

SIDES = "lower", "upper"


def edges(side: str, outward_hz: float) -> Iterator[tuple[str, Band, float]]:
    """Material, band and a carrier `outward_hz` outside one edge of every band, unless another band contains it."""
    for name, bands in ITU_MATERIALS.items():
        for band in bands:
            low_hz, high_hz = round(band.low_ghz * 1e9), round(band.high_ghz * 1e9)
            carrier_hz = low_hz - outward_hz if side == "lower" else high_hz + outward_hz
            if not any(other.contains(carrier_hz) for other in bands if other != band):
                yield name, band, carrier_hz


def power_law(band: Band, carrier_hz: float) -> complex:
    """η = ε' − jσ/(2πfε₀) with ε₀ = 1/(μ₀c²)."""
    vacuum_f_m = 1 / (1.25663706212e-6 * SPEED_OF_LIGHT_M_S**2)  # μ₀ of CODATA 2018
    carrier_ghz = carrier_hz / 1e9
    conductivity_s_m = band.c * carrier_ghz**band.d
    return complex(
        band.a * carrier_ghz**band.b - 1j * conductivity_s_m / (2 * 3.141592653589793 * carrier_hz * vacuum_f_m)
    )


@pytest.mark.parametrize("side", SIDES)
def test_every_band_has_its_power_law_up_to_its_edges(side: str) -> None:
    for name, band, carrier_hz in [*edges(side, 0.0), *edges(side, -1.0)]:
        # the constants of CODATA agree to 1e-10
        assert complex_permittivity(name, carrier_hz) == pytest.approx(power_law(band, carrier_hz), rel=1e-9)


@pytest.mark.parametrize("side", SIDES)
def test_a_carrier_1_hz_outside_of_a_band_is_refused_and_extrapolation_starts_there(side: str) -> None:
    outside = list(edges(side, 1.0))
    assert len(outside) >= len(ITU_MATERIALS)
    for name, band, carrier_hz in outside:
        with pytest.raises(MaterialBandError):
            complex_permittivity(name, carrier_hz)
        edge = power_law(band, 1e9 * (band.low_ghz if side == "lower" else band.high_ghz))
        # 1 Hz is 1e-6 of 1 MHz, where a twentieth of wood's permittivity goes as f^0.07
        assert complex_permittivity(name, carrier_hz, "extrapolate") == pytest.approx(edge, rel=1e-8)


def test_concrete_at_10_ghz_has_the_permittivity_of_p2040() -> None:
    eta = complex_permittivity("concrete", 10e9)
    assert eta.real == pytest.approx(5.24)
    # σ = 0.0462·10^0.7822 = 0.27984 S/m; ε'' = 17.98·σ/f with f in GHz (P.2040's own constant)
    assert eta.imag == pytest.approx(-17.98 * 0.0462 * 10**0.7822 / 10, rel=1e-3)


def test_a_carrier_outside_the_band_names_band_carriers_and_alternatives() -> None:
    with pytest.raises(MaterialBandError) as caught:
        check_dispersion(["concrete", "brick"], [1e9, 60e9, 94e9])
    message = str(caught.value)
    assert "'brick' from 1 to 40 GHz" in message
    assert "60, 94 GHz" in message
    assert "glass" in message
    assert "plywood" not in message
    assert "--materials extrapolate" in message


def test_carriers_in_megahertz_are_told_the_unit_and_no_empty_list_of_alternatives() -> None:
    with pytest.raises(MaterialBandError, match=r"2400 GHz\. Drop .* in GHz, use others \(none is defined"):
        check_dispersion(["concrete"], [2400e9])


def test_extrapolation_continues_the_nearest_power_law_and_is_reported() -> None:
    assert check_dispersion(["concrete", "brick"], [1e9, 60e9], "extrapolate") == ["brick"]
    assert complex_permittivity("brick", 60e9, "extrapolate").real == pytest.approx(3.91)
    inside, outside = (complex_permittivity("marble", f, "extrapolate") for f in (60e9, 60.001e9))
    assert outside == pytest.approx(inside, rel=1e-3)


def test_eight_materials_serve_from_1_to_94_ghz() -> None:
    serving = set(materials_defined_at([1e9, 94e9]))
    assert serving == {
        "vacuum", "concrete", "plasterboard", "ceiling_board", "chipboard", "metal", "wood", "glass",
    }  # fmt: skip


def test_a_permittivity_is_asked_for_in_ghz() -> None:
    found = xb.permittivity("concrete", [2.4, 24.25])
    assert found.tolist() == [complex_permittivity("concrete", hz) for hz in (2.4e9, 24.25e9)]
    assert xb.permittivity("brick", 60, "extrapolate").shape == (1,)
    with pytest.raises(UnknownNameError, match="Did you mean 'concrete'"):
        xb.permittivity("concret", 1)
