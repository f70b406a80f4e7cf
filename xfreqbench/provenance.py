"""Versions of the software that an answer depends on."""

from __future__ import annotations

from importlib import metadata

from xfreqbench.tracing import SolverName

_PACKAGES: dict[SolverName, tuple[str, ...]] = {
    "image": ("numba", "llvmlite", "numpy"),
    "sionna": ("sionna-rt", "mitsuba", "drjit"),
}


def software_versions(solver: SolverName) -> dict[str, str]:
    """Package versions behind a solver's channels; for `sionna` that of the LLVM library too."""
    versions = {name: metadata.version(name) for name in ("xfreqbench", *_PACKAGES[solver])}
    if solver == "sionna":
        from xfreqbench.llvm import llvm_version

        versions["llvm"] = llvm_version()
    return versions
