"""A room with a metal screen, and a data set of it."""

from __future__ import annotations

from pathlib import Path

from tests.support.plans import plan_generation
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.scene.model import ReceiverArray, Scene, Surface, TransmitterGrid
from xfreqbench.tracing.tracer import TraceSettings

CARRIERS_GHZ = (2.4, 24.25, 77.0)
SETTINGS = TraceSettings(interactions=("specular", "refraction"), rays=20_000, max_depth=2)
SCENE = Scene(
    name="screened",
    description="A room with a metal screen, for tests.",
    receiver=ReceiverArray(position_m=(4.0, 3.0, 2.5), rows=2, cols=2),
    transmitters=TransmitterGrid(min_m=(1.0, 1.0, 1.0), max_m=(7.0, 5.0, 1.0), step_m=(1.0, 1.0, 1.0)),
    surface=(
        Surface("floor", "concrete", 0.2, (0.0, 0.0, 0.0), (8.0, 6.0, 0.0)),
        Surface("ceiling", "concrete", 0.2, (0.0, 0.0, 2.8), (8.0, 6.0, 2.8)),
        Surface("wall", "plasterboard", 0.1, (8.0, 0.0, 0.0), (8.0, 6.0, 2.8)),
        Surface("screen, metal", "metal", 0.002, (5.5, 1.5, 0.0), (5.5, 4.5, 2.3)),
    ),
)
ONE_LIT_TX, ONE_SHADOWED_TX = 0, 27  # at (1, 1, 1) and, behind the screen, at (6, 3, 1)


def store(scene: Scene, path: Path) -> PasDataset:
    carriers_hz = [carrier * 1e9 for carrier in CARRIERS_GHZ]
    return open_dataset(generate_planned(plan_generation(scene, carriers_hz, SETTINGS), path))
