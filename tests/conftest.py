"""Shapes and types of every annotated function are checked while tests run."""

from __future__ import annotations

import sys
from pathlib import Path

from jaxtyping import install_import_hook

sys.path.insert(0, str(Path(__file__).parent))  # `typechecking` and `reference` are modules of the tests
UNCHECKED = {  # Numba compiles what it is given, and checks types itself
    "xfreqbench.image_kernels",
    "xfreqbench.splatting.composite_kernels",
    "xfreqbench.splatting.footprint_kernels",
}
PACKAGE = Path(__file__).parents[1] / "xfreqbench"
SOURCES = [path.relative_to(PACKAGE.parent).with_suffix("") for path in PACKAGE.rglob("*.py")]
MODULES = {".".join(source.parts) for source in SOURCES if source.name != "__init__"} - UNCHECKED
install_import_hook([*sorted(MODULES), "xfreqbench.baselines"], "typechecking.typechecker")
