"""Versions of the software that the answer of a solver depends on."""

from __future__ import annotations

from importlib import metadata

from xfreqbench.tracing.tracer import SolverName

# Of what a channel is, whichever solver traces it; raised where channels change by more than 1e-3. Version 1 dropped
# paths with a stretch under 1 cm, and interpolated near ones over the array. In version 2 the field jumped at corners
# of walls that are seen from inside and outside.
PHYSICS_VERSION = "3"


def software_versions(solver: SolverName) -> dict[str, str]:
    """Versions of the packages that a solver's channels depend on; for `sionna` that of LLVM too."""
    packages = {"image": ("numba", "llvmlite", "numpy"), "sionna": ("sionna-rt", "mitsuba", "drjit")}
    versions = {name: metadata.version(name) for name in ("xfreqbench", *packages[solver])}
    if solver == "sionna":
        from xfreqbench.tracing.sionna.llvm import llvm_version

        # of chains; version 1 lost paths that only some elements of the array see
        versions |= {"llvm": llvm_version(), "selection": "2"}
    return versions
