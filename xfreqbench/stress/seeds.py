"""Generation of data: the same bytes from the same seed, others from another."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from xfreqbench.generate import generate, plan_generation
from xfreqbench.scene import load_scene
from xfreqbench.stress.case import Case
from xfreqbench.stress.channels import CARRIERS_GHZ
from xfreqbench.tracing import TraceSettings
from xfreqbench.units import ghz_to_hz


def _generated(seed: int, folder: str) -> bytes:
    """A data set of three transmitters in free space."""
    settings = TraceSettings(solver="image", rays=1000, seed=seed)
    carriers = [ghz_to_hz(ghz) for ghz in (CARRIERS_GHZ[0], CARRIERS_GHZ[-1])]
    plan = plan_generation(load_scene("empty"), carriers, settings, num_transmitters=3, maps=False)
    return generate(plan, Path(folder) / "data.h5").read_bytes()


def _same_seed() -> float:
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        first, second = _generated(1, one), _generated(1, other)
    assert len(first) == len(second), f"files of {len(first)} and {len(second)} bytes"
    return float((np.frombuffer(first, np.uint8) != np.frombuffer(second, np.uint8)).sum())


def _other_seed() -> float:
    """1 where the transmitters are the same."""
    scene = load_scene("empty")
    chosen = [
        plan_generation(
            scene, [1e9], TraceSettings(solver="image", seed=seed), num_transmitters=3
        ).tx_position_m
        for seed in (1, 2)
    ]
    return float(np.array_equal(chosen[0], chosen[1]))


CASES = (
    Case("two data sets with one seed", "seeds", 0, "bytes", _same_seed),
    Case("two data sets with two seeds differ", "seeds", 0, "data sets", _other_seed),
)
