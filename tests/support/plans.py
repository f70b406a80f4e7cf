"""Small plans of a generation."""

from __future__ import annotations

from xfreqbench.data.plan import Plan, plan_generation
from xfreqbench.scene.model import Scene, load_scene
from xfreqbench.tracing.tracer import TraceSettings

SETTINGS = TraceSettings(interactions=("specular", "refraction"), rays=20_000, max_depth=3)
CARRIERS_HZ = [1e9, 24.25e9]


def small_plan(scene: str | Scene = "two_rooms", num_transmitters: int | None = 40, **changes: object) -> Plan:
    arguments = {"settings": SETTINGS, "num_transmitters": num_transmitters, **changes}
    loaded = load_scene(scene) if isinstance(scene, str) else scene
    return plan_generation(loaded, CARRIERS_HZ, **arguments)  # type: ignore[arg-type]
