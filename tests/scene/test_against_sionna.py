"""Materials against those of Sionna RT."""

from __future__ import annotations

import re

import pytest

from xfreqbench.scene.materials import ITU_MATERIALS, P2040_EDITION


@pytest.mark.sionna
def test_the_table_and_its_edition_are_those_of_sionna_rt() -> None:
    from xfreqbench.tracing.sionna.llvm import ensure_llvm

    ensure_llvm()
    from sionna.rt import ITURadioMaterial
    from sionna.rt.radio_materials.itu import ITU_MATERIALS_PROPERTIES

    ours = {
        name: {(band.low_ghz, band.high_ghz): (band.a, band.b, band.c, band.d) for band in bands}
        for name, bands in ITU_MATERIALS.items()
    }
    assert ours == ITU_MATERIALS_PROPERTIES
    assert set(re.findall(r"P\.2040-\d", ITURadioMaterial.__doc__)) == {P2040_EDITION}
