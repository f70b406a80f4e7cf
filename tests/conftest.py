"""Shapes and types of every annotated function are checked while tests run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

UNCHECKED = {  # Numba compiles what it is given, and checks types itself
    "xfreqbench.tracing.image.kernels",
    "xfreqbench.methods.splatting.composite_kernels",
    "xfreqbench.methods.splatting.footprint_kernels",
}
PACKAGE = Path(__file__).parents[1] / "xfreqbench"
SOURCES = [path.relative_to(PACKAGE.parent).with_suffix("") for path in PACKAGE.rglob("*.py")]
MODULES = {".".join(source.parts) for source in SOURCES if source.name != "__init__"} - UNCHECKED
install_import_hook([*sorted(MODULES), "xfreqbench.baselines"], "typechecking.typechecker")


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Sums in the same order at every run, and no waiting for a second thread, which small tensors mostly do."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
