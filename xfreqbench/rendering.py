"""What `bench render` prints: how fast the Gaussians are splatted and trained, errors beside the times."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from xfreqbench.angles import AngularGrid
from xfreqbench.dataset import DatasetHeader, PasDataset, PasWriter, open_dataset
from xfreqbench.machine import hardware, software
from xfreqbench.pas import cfr_of_plane_waves
from xfreqbench.scene import ReceiverArray
from xfreqbench.splatting.benchmark import DIRECTIONS_PER_GAUSSIAN, SplatCost, num_threads, splat_costs
from xfreqbench.splatting.savings import Saving, savings
from xfreqbench.splatting.training_step import PAPER_NETWORK, StepCost, step_cost
from xfreqbench.units import SPEED_OF_LIGHT_M_S, ghz_to_hz

STEPS = (  # settings of xfreq-gs
    (*PAPER_NETWORK, "num_gaussians=4000", "batch_size=32"),
    (*PAPER_NETWORK, "num_gaussians=1000", "batch_size=32"),
    (*PAPER_NETWORK, "num_gaussians=4000", "batch_size=8"),
    (),
)
SAVINGS = (*PAPER_NETWORK, "num_gaussians=4000", "batch_size=8")
GOAL_SAMPLES_PER_S = 100
_RECEIVER = ReceiverArray(position_m=(4.0, 3.0, 2.6))
_CARRIERS_GHZ = (1.0, 10.0)
_NUM_WAVES = 5

Say = Callable[[str], None]


def bench_render(num_gaussians: Sequence[int], batch_sizes: Sequence[int], with_step: bool, say: Say) -> None:
    """Print the tables of splatting alone and, with `with_step`, of the training step and its savings."""
    say(_preamble())
    say_splatting(num_gaussians, batch_sizes, say)
    if with_step:
        with tempfile.TemporaryDirectory() as folder:
            train = plane_wave_data(Path(folder) / "waves.h5", num_tx=32)
            for settings in STEPS:
                say_step(train, settings, say)
            say_savings(train, SAVINGS, say)


def say_splatting(num_gaussians: Sequence[int], batch_sizes: Sequence[int], say: Say) -> None:
    """Print what splatting alone costs, a row as soon as it is known."""
    say(
        "Splatting alone, forward and backward, footprints given, all 90 × 360 directions, about "
        f"{DIRECTIONS_PER_GAUSSIAN} of them a Gaussian; ms a sample.\n"
        "Dense: one sample in float32, every Gaussian on every direction; where `1/n` stands, timed on that "
        "part of the directions and scaled up.\n"
        "Errors of numba in float32 against dense float64, relative to the largest value, on 1/81 of the "
        "directions.\n\n"
        "| N | B | pairs | numba ms | samples/s | torch ms | samples/s | dense ms | dense / numba "
        "| dense / torch | error of values | of gradients |\n" + "|---" * 12 + "|"
    )
    for cost in splat_costs(num_gaussians, batch_sizes):
        say(_splat_row(cost))


def say_step(train: PasDataset, settings: Sequence[str], say: Say) -> None:
    """Print what a training step costs, part by part."""
    say(_step_table(step_cost(train, settings)))


def say_savings(train: PasDataset, settings: Sequence[str], say: Say) -> None:
    """Print every saving off and on."""
    batch_size = int(dict(setting.split("=") for setting in settings)["batch_size"])
    say(
        f"\nSavings at {_named(settings)}; ms a sample.\n\n"
        "| saving | timed | off | on | off / on | change in the answer |\n" + "|---" * 6 + "|"
    )
    for saving in savings(train, settings):
        say(_saving_row(saving, batch_size))


def plane_wave_data(path: Path, num_tx: int) -> PasDataset:
    """Channels and maps of a few plane waves from anywhere for every transmitter: no scene is traced."""
    header = DatasetHeader(
        scene_name="plane waves",
        scene_json="{}",
        scene_sha256="0" * 64,
        receiver=_RECEIVER,
        carrier_hz=np.array([ghz_to_hz(carrier) for carrier in _CARRIERS_GHZ]),
        num_tx=num_tx,
        pas_kind="power",
        maps=True,
        settings={},
        software={},
        rejected={},
    )
    rng = np.random.default_rng(0)
    tx_position_m = rng.uniform((0.5, 0.5, 0.9), (7.5, 5.5, 1.7), size=(num_tx, 3))
    cfr = [[_channel(rng, carrier) for carrier in header.carrier_hz.tolist()] for _ in range(num_tx)]
    num_paths = np.full((num_tx, len(header.carrier_hz)), _NUM_WAVES, dtype=np.int32)
    with PasWriter(path, header) as writer:
        writer.append(tx_position_m, np.ones(num_tx, dtype=bool), np.array(cfr), num_paths)
    return open_dataset(path)


def _channel(rng: np.random.Generator, carrier_hz: float) -> NDArray[np.complex128]:
    directions = AngularGrid.hemisphere().directions.reshape(-1, 3)
    gain, delay_s = rng.normal(size=_NUM_WAVES).astype(np.complex128), rng.uniform(0, 1e-7, size=_NUM_WAVES)
    element_m = _RECEIVER.element_position_wavelengths * (SPEED_OF_LIGHT_M_S / carrier_hz)
    arrival = directions[rng.integers(len(directions), size=_NUM_WAVES)]
    return cfr_of_plane_waves(gain, delay_s, arrival, element_m, carrier_hz)


def _preamble() -> str:
    machine, versions = hardware(), software()
    return (
        f"{machine['processor']}, {machine['cores']} cores, {machine['system']}; torch {versions['torch']} "
        f"and numba {versions['numba']} on {num_threads()} threads.\n"
    )


def _splat_row(cost: SplatCost) -> str:
    part = "" if cost.dense_stride == 1 else f" (1/{cost.dense_stride**2})"
    return (
        f"| {cost.num_gaussians} | {cost.batch_size} | {cost.num_pairs:,} "
        f"| {cost.numba_ms:.2f} | {1e3 / cost.numba_ms:.0f} | {cost.torch_ms:.2f} | {1e3 / cost.torch_ms:.0f} "
        f"| {cost.dense_ms:.0f}{part} | {cost.dense_ms / cost.numba_ms:.0f} "
        f"| {cost.dense_ms / cost.torch_ms:.0f} | {cost.value_error:.0e} | {cost.gradient_error:.0e} |"
    )


def _step_table(cost: StepCost) -> str:
    step_ms, parts_ms = (
        seconds / cost.batch_size * 1e3 for seconds in (cost.step_s, sum(cost.parts_s.values()))
    )
    lines = [
        f"\nTraining step of xfreq-gs, {_named(cost.settings)}: {cost.num_gaussians} Gaussians, "
        f"{cost.batch_size} samples, {cost.num_pairs:,} pairs.\n",
        "| part | ms a sample | share |",
        "|---|---|---|",
    ]
    for name, seconds in cost.parts_s.items():
        part_ms = seconds / cost.batch_size * 1e3
        lines.append(f"| {name} | {part_ms:.2f} | {part_ms / parts_ms:.0%} |")
    lines.append(f"| sum of the parts | {parts_ms:.2f} | {parts_ms / parts_ms:.0%} |")
    lines.append(f"| whole step as `fit` takes it | {step_ms:.2f} | {step_ms / parts_ms:.0%} |")
    return "\n".join(lines) + "\n\n" + _distance_from_goal(cost, step_ms)


def _distance_from_goal(cost: StepCost, step_ms: float) -> str:
    allowed_ms = 1e3 / GOAL_SAMPLES_PER_S
    network_ms, others_ms = (
        sum(seconds for name, seconds in cost.parts_s.items() if name.startswith("network") == is_network)
        / cost.batch_size
        * 1e3
        for is_network in (True, False)
    )
    return (
        f"{cost.samples_per_s:.1f} samples/s. {GOAL_SAMPLES_PER_S} samples/s allow {allowed_ms:.1f} ms a "
        f"sample, and the step takes {step_ms:.1f}: the network {network_ms:.1f}, of which the products of "
        f"its hidden layers need {cost.products_s / cost.batch_size * 1e3:.1f} at this machine's rate, and "
        f"all else {others_ms:.1f}."
    )


def _saving_row(saving: Saving, batch_size: int) -> str:
    off_ms, on_ms = saving.off_s / batch_size * 1e3, saving.on_s / batch_size * 1e3
    return (
        f"| {saving.name} | {saving.timed} | {off_ms:.2f} | {on_ms:.2f} | {off_ms / on_ms:.2f} "
        f"| {saving.change} |"
    )


def _named(settings: Sequence[str]) -> str:
    return " ".join(settings) or "defaults"
