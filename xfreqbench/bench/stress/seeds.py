"""Seeds: the same data and the same fit from the same seed, others from another one."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import torch

from xfreqbench.bench.stress.case import Area
from xfreqbench.bench.stress.channels import CARRIERS_GHZ
from xfreqbench.bench.stress.training import TINY_FIT, on_random_channels
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import plan_generation
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.registry import build_method
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.units import ghz_to_hz

SEEDS = Area("seeds")


def _refit(train: PasDataset, seeds: tuple[int, int]) -> float:
    """Largest difference between the maps of two fits of three steps, which have these seeds."""
    maps, num_threads = [], torch.get_num_threads()
    torch.set_num_threads(1)  # so that sums have the same order in both fits
    try:
        for seed in seeds:
            method = build_method("xfreq-gs", TINY_FIT)
            for _, _ in zip(range(3), method.fit(train, Budget(), seed), strict=False):
                continue
            maps.append(method.predict(train.tx_position_m[:4], train.carrier_hz[:4]))
    finally:
        torch.set_num_threads(num_threads)
    return float(np.abs(maps[0] - maps[1]).max())


@SEEDS.case("two fits with one seed", limit=0, unit="absolute")
@on_random_channels
def _equal_fits(train: PasDataset) -> float:
    return _refit(train, (1, 1))


@SEEDS.case("two fits with two seeds differ", limit=0, unit="fits")
@on_random_channels
def _unequal_fits(train: PasDataset) -> float:
    """1 where another seed gives the same maps, else 0."""
    return float(_refit(train, (1, 2)) == 0)


@SEEDS.case("two data sets with one seed", limit=0, unit="bytes")
def _same_seed() -> float:
    """Number of bytes that differ between two files."""
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        first, second = _generated(1, one), _generated(1, other)
    assert len(first) == len(second), f"files of {len(first)} and {len(second)} bytes"
    return float((np.frombuffer(first, np.uint8) != np.frombuffer(second, np.uint8)).sum())


def _generated(seed: int, folder: str) -> bytes:
    """The file of a data set of three transmitters in free space."""
    settings = TraceSettings(solver="image", rays=1000, seed=seed)
    carriers = [ghz_to_hz(ghz) for ghz in (CARRIERS_GHZ[0], CARRIERS_GHZ[-1])]
    plan = plan_generation(load_scene("empty"), carriers, settings, num_transmitters=3, maps=False)
    return generate_planned(plan, Path(folder) / "data.h5").read_bytes()


@SEEDS.case("two data sets with two seeds differ", limit=0, unit="data sets")
def _other_seed() -> float:
    """1 where another seed chooses the same transmitters, else 0."""
    scene = load_scene("empty")
    chosen = [
        plan_generation(
            scene, [1e9], TraceSettings(solver="image", seed=seed), num_transmitters=3
        ).tx_position_m
        for seed in (1, 2)
    ]
    return float(np.array_equal(chosen[0], chosen[1]))
