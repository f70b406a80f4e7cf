from __future__ import annotations

import pytest

import xfreqbench as xb
from xfreqbench.errors import MaterialBandError, UnknownNameError
from xfreqbench.scene.materials import check_dispersion, complex_permittivity, materials_defined_at


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
