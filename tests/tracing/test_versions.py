from __future__ import annotations

import pytest

from xfreqbench.tracing.versions import software_versions


@pytest.mark.sionna
def test_provenance_names_every_library_an_answer_depends_on() -> None:
    assert set(software_versions("image")) == {"xfreqbench", "numba", "llvmlite", "numpy"}
    assert set(software_versions("sionna")) == {"xfreqbench", "sionna-rt", "mitsuba", "drjit", "llvm", "selection"}
