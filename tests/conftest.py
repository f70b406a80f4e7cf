"""Shapes and types of every annotated function are checked while tests run."""

from __future__ import annotations

import sys
from pathlib import Path

from jaxtyping import install_import_hook

sys.path.insert(0, str(Path(__file__).parent))  # `typechecking` and `reference` are modules of the tests
UNCHECKED = {"xfreqbench.image_kernels"}  # Numba compiles what it is given, and checks types itself
PACKAGE = Path(__file__).parents[1] / "xfreqbench"
MODULES = {f"xfreqbench.{path.stem}" for path in PACKAGE.glob("*.py") if path.stem != "__init__"} - UNCHECKED
install_import_hook([*sorted(MODULES), "xfreqbench.baselines"], "typechecking.typechecker")
