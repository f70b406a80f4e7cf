"""Which solver serves a scene."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import cast, get_args

from xfreqbench.errors import UnknownNameError, XFreqBenchError
from xfreqbench.mesh import SurfaceMesh
from xfreqbench.scene import Scene
from xfreqbench.tracing import INTERACTIONS, Interaction, SolverName, Tracer, TraceSettings


def interactions_named(names: Iterable[str]) -> tuple[Interaction, ...]:
    """The interactions of those names, in their order; raises `UnknownNameError`."""
    given = tuple(names)
    for name in given:
        if name not in INTERACTIONS:
            raise UnknownNameError("interaction", name, INTERACTIONS)
    return cast("tuple[Interaction, ...]", given)


def check_settings(settings: TraceSettings) -> None:
    """Raise a clear error for settings that no solver takes."""
    if settings.solver not in get_args(SolverName):
        raise UnknownNameError("solver", settings.solver, get_args(SolverName))
    interactions_named(settings.interactions)
    for name, value, least in (
        ("depth", settings.max_depth, 0),
        ("number of rays", settings.rays, 1),
        ("seed", settings.seed, 0),
    ):
        if value < least:
            raise XFreqBenchError(f"The {name} is {value}; give at least {least}.")


def resolve_solver(meshes: Sequence[SurfaceMesh], settings: TraceSettings) -> TraceSettings:
    """Settings with `auto` replaced: `image` where scene and interactions allow it, else `sionna`."""
    from xfreqbench.image_method import can_solve

    check_settings(settings)
    canonical = tuple(name for name in INTERACTIONS if name in settings.interactions)
    settings = replace(settings, interactions=canonical)
    if settings.solver != "auto":
        return settings
    return replace(settings, solver="image" if can_solve(meshes, settings) else "sionna")


def make_tracer(scene: Scene, carrier_hz: Sequence[float], settings: TraceSettings) -> Tracer:
    """Load a scene into the solver that `settings` names and shoot its rays."""
    if settings.solver == "image":
        from xfreqbench.image_method import ImageTracer

        return ImageTracer(scene, carrier_hz, settings)
    from xfreqbench.sionna_solver import SionnaTracer

    return SionnaTracer(scene, carrier_hz, settings)
