"""The choice of the solver that traces a scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import cast, get_args

from pydantic import InstanceOf

from xfreqbench.errors import SceneError, UnknownNameError, XFreqBenchError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Scene
from xfreqbench.system.arguments import Numbers, checked
from xfreqbench.tracing.tracer import (
    INTERACTIONS,
    MAX_DEPTH,
    MAX_DIFFUSE_PATHS,
    MAX_RAYS,
    MAX_SEED,
    Interaction,
    SolverName,
    Tracer,
    TraceSettings,
)


def interactions_named(names: Iterable[str]) -> tuple[Interaction, ...]:
    """The names, in their order, as interactions; raises `UnknownNameError` for one that is none."""
    given = tuple(names)
    for name in given:
        if name not in INTERACTIONS:
            raise UnknownNameError("interaction", name, INTERACTIONS)
    return cast("tuple[Interaction, ...]", given)


def with_interactions(
    scene: Scene,
    settings: TraceSettings = TraceSettings(),
    names: Iterable[str] | None = None,
    geometry: Geometry | None = None,
) -> TraceSettings:
    """The settings with the interactions of these names, or with those of ground truth where none are given.

    Ground truth has specular reflection, refraction and diffraction, where solver `image` traces them in the scene
    and solver `sionna` is not named; elsewhere it has the first two, because Sionna RT's diffraction is not
    reciprocal, is not continuous, and takes a hundred times as long. `geometry` is that of the scene, where it is
    known already. Raises `UnknownNameError`.
    """
    if names is not None:
        return replace(settings, interactions=interactions_named(names))
    from xfreqbench.tracing.image.tracer import can_solve

    whole = replace(settings, interactions=("specular", "refraction", "diffraction"))
    is_exact = settings.solver != "sionna" and can_solve(geometry or Geometry(surface_meshes(scene)), whole)
    return whole if is_exact else replace(settings, interactions=("specular", "refraction"))


def check_settings(settings: TraceSettings) -> None:
    """Raise `XFreqBenchError` for settings that no solver takes."""
    if settings.solver not in get_args(SolverName):
        raise UnknownNameError("solver", settings.solver, get_args(SolverName))
    interactions_named(settings.interactions)
    for name, value, least, most in (
        ("depth", settings.max_depth, 0, MAX_DEPTH),
        ("number of rays", settings.rays, 1, MAX_RAYS),
        ("seed", settings.seed, 0, MAX_SEED),
    ):
        if not least <= value <= most:
            raise XFreqBenchError(f"The {name} is {value:,}; give a number from {least} to {most:,}.")


def _check_diffuse(geometry: Geometry, settings: TraceSettings) -> None:
    """Raise `XFreqBenchError` for diffuse reflection in a scene without any, or with more paths than memory holds."""
    if "diffuse" not in settings.interactions:
        return
    if not geometry.scattering:
        raise SceneError(
            "Diffuse reflection is asked for, but no material of the scene scatters: ITU-R P.2040 gives no scattering "
            "coefficient. State one in the scene's TOML, as in [[material]] name = 'concrete', "
            "scattering = {coefficient = 0.3}, or leave out the interaction."
        )
    most_rays = MAX_DIFFUSE_PATHS // max(1, settings.max_depth)
    if settings.rays > most_rays:
        raise XFreqBenchError(
            f"With diffuse reflection every ray may leave a path at each of {settings.max_depth} depths, and "
            f"{MAX_DIFFUSE_PATHS:,} of them fit into memory. Ask for --rays {most_rays:,} at most, or for less depth."
        )


def resolve_solver(geometry: Geometry, settings: TraceSettings) -> TraceSettings:
    """Settings that name a solver: `auto` is `image` where scene and interactions allow it, else `sionna`.

    Interactions are put in one order. Raises `XFreqBenchError` for settings that no solver takes.
    """
    from xfreqbench.tracing.image.tracer import can_solve

    check_settings(settings)
    _check_diffuse(geometry, settings)
    canonical = tuple(name for name in INTERACTIONS if name in settings.interactions)
    settings = replace(settings, interactions=canonical)
    if settings.solver != "auto":
        return settings
    return replace(settings, solver="image" if can_solve(geometry, settings) else "sionna")


@checked
def make_tracer(
    scene: InstanceOf[Scene],
    carrier_hz: Numbers,
    settings: TraceSettings = TraceSettings(),
    geometry: InstanceOf[Geometry] | None = None,
) -> Tracer:
    """Load a scene into the solver that `settings` names, and shoot its rays.

    `auto` is the solver that `resolve_solver` names. `geometry` is that of the scene, where it is known already;
    else it is built here. Raises `SceneError`, of which `MaterialBandError` is one.
    """
    check_settings(settings)
    geometry = geometry or Geometry(surface_meshes(scene))
    if settings.solver == "auto":
        settings = resolve_solver(geometry, settings)
    _check_diffuse(geometry, settings)
    if settings.solver == "image":
        from xfreqbench.tracing.image.tracer import ImageTracer

        return ImageTracer(scene, carrier_hz, settings, geometry=geometry)
    from xfreqbench.tracing.sionna.tracer import SionnaTracer

    return SionnaTracer(scene, carrier_hz, settings, geometry)
