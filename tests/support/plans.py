"""Small plans of a generation."""

from __future__ import annotations

from xfreqbench.data.plan import Plan, plan_generation
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.tracer import TraceSettings

SETTINGS = TraceSettings(interactions=("specular", "refraction"), rays=20_000, max_depth=3)
CARRIERS_HZ = [1e9, 24.25e9]


def small_plan(scene_name: str = "two_rooms", num_transmitters: int = 40, **changes: object) -> Plan:
    arguments = {"settings": SETTINGS, "num_transmitters": num_transmitters, **changes}
    return plan_generation(load_scene(scene_name), CARRIERS_HZ, **arguments)  # type: ignore[arg-type]
