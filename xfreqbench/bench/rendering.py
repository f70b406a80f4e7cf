"""What `bench render` prints: the time of splatting and of training steps, with the errors of splatting."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xfreqbench.bench.splatting import DIRECTIONS_PER_GAUSSIAN, SplatCost, num_threads, splat_costs
from xfreqbench.bench.tables import Bench
from xfreqbench.bench.training_step import METHOD, StepCost, loop_s, step_cost
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.plane_waves import plane_wave_data
from xfreqbench.methods.registry import build_method
from xfreqbench.units import ghz_to_hz

STEPS: tuple[tuple[str, ...], ...] = (  # settings of xfreq-gs-paper
    ("batch_size=32",),
    ("num_gaussians=1000", "batch_size=32"),
    ("batch_size=8",),
    (),
)
GOAL_SAMPLES_PER_S = 100
FIRST = (  # settings of xfreq-gs that come nearest to its defaults in version 0.1
    "network=pairwise",
    "width=64",
    "layers=4",
    "max_spread=2",
    "start=random",
    "direct_wave=false",
    "band=false",
    "num_gaussians=256",
    "angular_size_deg=6",
    "move_from=0",
    "position_rate=10",
    "densify_every=200",
    "averaging=0",
    "batch_size=32",
    "stride=5",
    "ssim_window=3",
)
FITS: tuple[
    tuple[str, str, tuple[str, ...]], ...
] = (  # methods whose steps are compared, with how they are named
    ("xfreq-gs", "xfreq-gs", ()),
    ("xfreq-gs, all pairs", "xfreq-gs", ("network=pairwise", "width=64", "layers=4")),
    ("xfreq-gs as in version 0.1", "xfreq-gs", FIRST),
    *((name, name, ()) for name in ("fixed-frequency-gs", "frequency-embedded-gs", "aperture-gs")),
    *((name, name, ()) for name in ("gsrf", "swift-wrf", "wideband-3dgs", "wrf-gs-plus")),
)
FIT_COLUMNS = ("method", "maps a step", "ms a step", "maps/s", "maps/s, of xfreq-gs as in version 0.1")
CARRIERS_HZ = np.array([ghz_to_hz(carrier) for carrier in (1.0, 10.0)])  # of the training data
SPLATTING_COLUMNS = (
    "N",
    "B",
    "pairs",
    "numba ms",
    "samples/s",
    "torch ms",
    "samples/s",
    "dense ms",
    "dense / numba",
    "dense / torch",
    "error of values",
    "of gradients",
)


def bench_render(
    bench: Bench, num_gaussians: Sequence[int], batch_sizes: Sequence[int], with_step: bool
) -> None:
    """Print the table of splatting alone and, with `with_step`, tables of training steps."""
    bench.introduce()
    tabulate_splatting(bench, num_gaussians, batch_sizes)
    if with_step:
        with tempfile.TemporaryDirectory() as folder:
            train = plane_wave_data(Path(folder) / "waves.h5", CARRIERS_HZ, num_tx=32)
            tabulate_fits(bench, train)
            for settings in STEPS:
                tabulate_step(bench, train, settings)


def tabulate_splatting(bench: Bench, num_gaussians: Sequence[int], batch_sizes: Sequence[int]) -> None:
    """Print the time of splatting alone, for all combinations of numbers of Gaussians and batch sizes."""
    note = (
        f"Forward and backward, footprints given, all 90 × 360 directions, about {DIRECTIONS_PER_GAUSSIAN} "
        f"of them a Gaussian; ms a sample, numba and torch on {num_threads()} threads. Dense: one sample in "
        "float32, every Gaussian on every direction; where `1/n` stands, timed on that part of the directions "
        "and scaled up. Errors are those of numba in float32 against dense float64, relative to the largest "
        "value, on 1/81 of the directions."
    )
    with bench.table("Splatting alone", note, SPLATTING_COLUMNS) as table:
        for cost in splat_costs(num_gaussians, batch_sizes):
            table.add(*_splatting_cells(cost))


def tabulate_fits(bench: Bench, train: PasDataset) -> None:
    """Print the maps that training steps of methods see a second, and their ratio to those of a named setting."""
    note = f"The method's own loop on a data set of 64 maps, {num_threads()} threads, after its first step."
    rates = {}
    for title, method, settings in FITS:
        batch_size = build_method(method, settings).config.batch_size
        rates[title] = batch_size, loop_s(train, method, settings)
    first_size, first_s = rates["xfreq-gs as in version 0.1"]
    with bench.table("Training steps of methods", note, FIT_COLUMNS) as table:
        for title, (size, seconds) in rates.items():
            ratio = size / seconds / (first_size / first_s)
            table.add(title, str(size), f"{1e3 * seconds:.1f}", f"{size / seconds:,.0f}", f"{ratio:.2f}")


def tabulate_step(bench: Bench, train: PasDataset, settings: Sequence[str]) -> None:
    """Print the time of a training step and of each part of it."""
    cost = step_cost(train, settings)
    whole_ms, parts_ms = cost.sample_ms(cost.step_s), cost.sample_ms(sum(cost.parts_s.values()))
    parts = {name: cost.sample_ms(seconds) for name, seconds in cost.parts_s.items()}
    sums = {"sum of the parts": parts_ms, "whole step as `fit` takes it": whole_ms}
    title = f"Training step of {METHOD}, {named(settings)}"
    with bench.table(title, _step_note(cost), ("part", "ms a sample", "share")) as table:
        for name, part_ms in (parts | sums).items():
            table.add(name, f"{part_ms:.2f}", f"{part_ms / parts_ms:.0%}")


def named(settings: Sequence[str]) -> str:
    """Settings of a method as a table shows them."""
    return " ".join(settings) or "defaults"


def _splatting_cells(cost: SplatCost) -> tuple[str, ...]:
    """A row of the table `SPLATTING_COLUMNS`."""
    part = "" if cost.dense_stride == 1 else f" (1/{cost.dense_stride**2})"
    return (
        str(cost.num_gaussians),
        str(cost.batch_size),
        f"{cost.num_pairs:,}",
        f"{cost.numba_ms:.2f}",
        f"{1e3 / cost.numba_ms:.0f}",
        f"{cost.torch_ms:.2f}",
        f"{1e3 / cost.torch_ms:.0f}",
        f"{cost.dense_ms:.0f}{part}",
        f"{cost.dense_ms / cost.numba_ms:.0f}",
        f"{cost.dense_ms / cost.torch_ms:.0f}",
        f"{cost.value_error:.0e}",
        f"{cost.gradient_error:.0e}",
    )


def _step_note(cost: StepCost) -> str:
    """The sizes of the step, its rate, and how its time compares with the goal."""
    network_ms, others_ms = (
        cost.sample_ms(sum(s for name, s in cost.parts_s.items() if name.startswith("network") == is_network))
        for is_network in (True, False)
    )
    return (
        f"{cost.num_gaussians} Gaussians, {cost.batch_size} samples, {cost.num_pairs:,} pairs, "
        f"{num_threads()} threads. {cost.samples_per_s:.1f} samples/s. {GOAL_SAMPLES_PER_S} samples/s allow "
        f"{1e3 / GOAL_SAMPLES_PER_S:.1f} ms a sample, and the step takes {cost.sample_ms(cost.step_s):.1f}: the "
        f"network {network_ms:.1f}, of which the products of its hidden layers need "
        f"{cost.sample_ms(cost.products_s):.1f} at this machine's rate, and all else {others_ms:.1f}."
    )
