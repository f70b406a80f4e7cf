"""The choice of the solver that traces a scene."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import cast, get_args

from jaxtyping import Float
from pydantic import InstanceOf

from xfreqbench.errors import SceneError, UnknownNameError, XFreqBenchError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.model import Scene
from xfreqbench.scene.overlaps import check_overlaps
from xfreqbench.system.arguments import CarriersGhz, checked
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
from xfreqbench.types import FloatArray
from xfreqbench.units import ghz_to_hz


def interactions_named(names: Iterable[str] | None) -> tuple[Interaction, ...] | None:
    """The names, in their order, as interactions, or None; raises `UnknownNameError` for one that is none."""
    if names is None:
        return None
    given = tuple(names)
    for name in given:
        if name not in INTERACTIONS:
            raise UnknownNameError("interaction", name, INTERACTIONS)
    return cast("tuple[Interaction, ...]", given)


def check_settings(settings: TraceSettings) -> None:
    """Raise `XFreqBenchError` for settings that no solver takes."""
    if settings.solver not in get_args(SolverName):
        raise UnknownNameError("solver", settings.solver, get_args(SolverName))
    interactions_named(settings.named_interactions)
    for name, value, least, most in (
        ("depth", settings.max_depth, 0, MAX_DEPTH),
        ("number of rays", settings.rays, 1, MAX_RAYS),
        ("seed", settings.seed, 0, MAX_SEED),
    ):
        if not least <= value <= most:
            raise XFreqBenchError(f"The {name} is {value:,}; give a number from {least} to {most:,}.")


def _check_diffuse(geometry: Geometry, settings: TraceSettings) -> None:
    """Raise `XFreqBenchError` for diffuse reflection in a scene without any, or with more paths than memory holds."""
    if "diffuse" not in settings.named_interactions:
        return
    if not geometry.scattering:
        raise SceneError(
            "Diffuse reflection is asked for, but no material of the scene scatters: ITU-R P.2040 gives no scattering "
            "coefficient. State one in the scene's TOML, as in [[material]] name = 'concrete', "
            "scattering = {coefficient = 0.3}, or leave out the interaction."
        )
    most_rays = MAX_DIFFUSE_PATHS // max(1, settings.max_depth)
    if settings.solver == "sionna" and settings.rays > most_rays:
        raise XFreqBenchError(
            f"By solver sionna every ray may leave a diffuse path at each of {settings.max_depth} depths, and "
            f"{MAX_DIFFUSE_PATHS:,} of them fit into memory. Ask for --rays {most_rays:,} at most, or for less depth."
        )


def resolve_solver(geometry: Geometry, settings: TraceSettings) -> TraceSettings:
    """Settings that name a solver and interactions: `auto` is `image` where it takes the scene and them, else `sionna`.

    Interactions are put in one order. Raises `XFreqBenchError` for settings that no solver takes, and
    for layers that `sionna` would have to trace.
    """
    from xfreqbench.tracing.image.tracer import can_solve

    check_settings(settings)
    solver = settings.solver
    if solver == "auto":
        solver = "image" if can_solve(geometry, settings) else "sionna"
    settings = settings.by(solver)
    _check_diffuse(geometry, settings)
    if solver == "sionna":
        for mesh in geometry.meshes:
            mesh.slab.homogeneous  # noqa: B018 (it raises)
    canonical = tuple(name for name in INTERACTIONS if name in settings.named_interactions)
    return replace(settings, interactions=canonical)


@checked
def make_tracer(scene: InstanceOf[Scene], freqs_ghz: CarriersGhz, settings: TraceSettings = TraceSettings()) -> Tracer:
    """Load a scene into the solver that `settings` names, and shoot its rays.

    `auto` is the solver that `resolve_solver` names. Raises `SceneError`, of which `MaterialBandError` is one, and for
    surfaces of different slabs that overlap in one plane.
    """
    check_settings(settings)
    geometry = Geometry.of(scene)
    check_overlaps(geometry)
    return tracer_of(scene, [ghz_to_hz(carrier) for carrier in freqs_ghz], settings, geometry)


def tracer_of(
    scene: Scene,
    carrier_hz: Sequence[float] | Float[FloatArray, "F"],
    settings: TraceSettings,
    geometry: Geometry | None = None,
) -> Tracer:
    """As `make_tracer`, at carriers in hertz; `geometry` is that of the scene where it is known already."""
    geometry = geometry or Geometry.of(scene)
    settings = resolve_solver(geometry, settings)
    if settings.solver == "image":
        from xfreqbench.tracing.image.tracer import ImageTracer

        return ImageTracer(scene, carrier_hz, settings, geometry=geometry)
    from xfreqbench.tracing.sionna.tracer import SionnaTracer

    return SionnaTracer(scene, carrier_hz, settings, geometry)
