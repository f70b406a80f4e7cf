"""Small plans of a generation, what a killed one leaves, and scenes and data sets that are slightly changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from xfreqbench.data import batches, plan
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.plan import Plan
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.scene.model import Scene
from xfreqbench.tracing.tracer import TraceSettings

SETTINGS = TraceSettings(interactions=("specular", "refraction"), rays=20_000, max_depth=3)
CARRIERS_HZ = [1e9, 24.25e9]


def small_plan(
    scene: str | Scene = "two_rooms",
    num_transmitters: int | None = 40,
    carriers_hz: Sequence[float] = CARRIERS_HZ,
    **changes: Any,
) -> Plan:
    return plan_generation(scene, carriers_hz, **{"settings": SETTINGS, "tx": num_transmitters, **changes})


def plan_generation(
    scene: str | Scene, carriers_hz: Sequence[float], settings: TraceSettings = TraceSettings(), **options: Any
) -> Plan:
    """The plan of a generation at carriers in hertz, with settings of rays in one object."""
    return plan.plan_generation(scene, GenerateOptions([hz / 1e9 for hz in carriers_hz], **vars(settings) | options))


def unfinished(asked: Plan, path: Path) -> Path:
    """The folder of batches as a process leaves it that is killed before it writes the data set."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batches, "_remove", lambda folder: None)
        generate_planned(asked, path).unlink()
    return batches.batch_folder(path)


def wall_moved(scene: Scene, shift_m: float) -> Scene:
    """The scene with the wall at the greatest y moved along y."""
    north = max(scene.surface, key=lambda surface: surface.min_m[1])
    ends = {end: (x, y + shift_m, z) for end in ("min_m", "max_m") for x, y, z in [getattr(north, end)]}
    return replace(scene, surface=tuple(replace(wall, **ends) if wall is north else wall for wall in scene.surface))


def rewritten(dataset: PasDataset, path: Path, **tables: object) -> PasDataset:
    """A data set with valid hashes and the same header, but other channels (`cfr`) or positions (`tx_position_m`)."""
    held = {name: np.asarray(table) for name, table in {**dataset.tables, **tables}.items()}
    samples = SampleBlock.of_channels(held["cfr"], held["num_paths"], dataset.beam, dataset.header.pas_kind)
    with PasWriter(path, dataset.header) as writer:
        writer.append(held["tx_position_m"], held["line_of_sight"].astype(bool), samples)
    return open_dataset(path)
