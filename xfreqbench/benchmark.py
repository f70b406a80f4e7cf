"""The whole benchmark as one command: data sets, runs side by side, measurements, and what was left out."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

from xfreqbench import records
from xfreqbench.dataset import open_dataset
from xfreqbench.errors import UnknownNameError
from xfreqbench.generate import Plan, estimate_seconds, generate, plan_generation
from xfreqbench.many_runs import run_on
from xfreqbench.method import build_method, device_option, parse_budget
from xfreqbench.parallel import (
    HERE,
    SERIAL,
    LocalProcesses,
    Workers,
    all_cores,
    open_workers,
    own_cores,
)
from xfreqbench.presets import PRESETS, Block, Preset
from xfreqbench.protocols import LOFO_TARGETS_HZ, SPARSE_TRAINING_GHZ, Targets, make_splits
from xfreqbench.records import RECORDS_FILE, Job
from xfreqbench.scene import load_scene
from xfreqbench.tables import recorded
from xfreqbench.units import PAPER_CARRIERS_GHZ, ghz_to_hz

OVERHEAD_S = 13  # of a run besides its fit: start, learning curve, predictions and their scores
BENCH_COMMANDS = {  # with the minutes that they take on two cores
    "generate": (("bench", "generate"), 4),
    "plain": (("bench", "generate", "--against-plain", "--plain-tx", "8"), 4),
    "render": (("bench", "render"), 2),
    "savings": (("bench", "savings"), 5),
    "stress": (("stress",), 1),
}
_PAPER_HZ = tuple(map(ghz_to_hz, PAPER_CARRIERS_GHZ))

TracingProgress = Callable[[str, int, int], None]
RunProgress = Callable[[int, int, Job], None]


@dataclass(frozen=True)
class Benchmark:
    """A preset with the places of its data sets and results, and the device of methods that have the choice."""

    name: str
    preset: Preset
    data_dir: Path
    results_dir: Path
    device: str = "cpu"

    @property
    def records_path(self) -> Path:
        """Where every run and every measurement is recorded."""
        return self.results_dir / RECORDS_FILE

    @property
    def scenes(self) -> list[str]:
        """Scenes of the blocks, each once."""
        return list(dict.fromkeys(block.scene for block in self.preset.blocks))

    @cached_property
    def plans(self) -> dict[str, Plan]:
        """What would be generated, by scene."""
        return {
            name: plan_generation(load_scene(name), _PAPER_HZ, num_transmitters=self.preset.num_tx.get(name))
            for name in self.scenes
        }

    def data_path(self, scene: str) -> Path:
        """The data set of a scene; one of fewer transmitters has their number in its name."""
        number = self.preset.num_tx.get(scene)
        return self.data_dir / (f"{scene}-{number}.h5" if number else f"{scene}.h5")

    def jobs(self) -> list[Job]:
        """Every run, each once, in the order of the blocks; the data sets have to be there."""
        found = (job for block in self.preset.blocks for job in self._jobs_of(block))
        return list(dict.fromkeys(found))

    def _jobs_of(self, block: Block) -> Iterator[Job]:
        path = str(self.data_path(block.scene))
        splits = make_splits(open_dataset(path), block.protocol, _targets_hz(block))
        for setting in block.settings:
            overrides = (*setting.overrides, *device_option(setting.method, self.device))
            for seed in block.seeds:
                for split in splits:
                    budget = parse_budget(block.budget)
                    yield Job(path, setting.method, block.protocol, split.name, overrides, seed, budget)

    def missing_benches(self) -> list[str]:
        """Measurements that have no record yet."""
        known = {record.bench for record in records.read(self.records_path).benches}
        return [name for name in self.preset.benches if name not in known]

    @property
    def num_places(self) -> int:
        """Runs at a time: one a core, or one on a GPU."""
        return len(own_cores()) if self.device == "cpu" else 1


def plan_benchmark(name: str, data_dir: Path, results_dir: Path, device: str = "cpu") -> Benchmark:
    """A benchmark by the name of its preset; raises `UnknownNameError`, and what building its methods raises."""
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    preset = PRESETS[name]
    for setting in dict.fromkeys(setting for block in preset.blocks for setting in block.settings):
        build_method(setting.method, setting.overrides)
    return Benchmark(name, preset, data_dir, results_dir, device)


def run_workers(benchmark: Benchmark, executor: str | None) -> AbstractContextManager[Workers]:
    """Who runs: whom `--executor` names, else a fresh process a core, or one at a time on a GPU or with `serial`."""
    if executor is None or executor == SERIAL:
        one_a_core = executor is None and benchmark.device == "cpu"
        return LocalProcesses(own_cores() if one_a_core else all_cores(), is_fresh=True)
    return open_workers(executor, is_fresh=True)


def cost(benchmark: Benchmark, num_places: int | None = None) -> str:
    """What a benchmark takes before it starts, in words: data, runs, time, disk, and what it leaves out.

    `num_places` are the runs at a time where they are not `benchmark.num_places`.
    """
    preset = benchmark.preset
    places = num_places or benchmark.num_places
    num_runs = sum(map(_num_runs, preset.blocks))
    num_fits = sum(_num_runs(block) for block in preset.blocks if block.budget)
    return "\n".join(
        [
            f"preset {benchmark.name}: {preset.description}",
            f"left out: {preset.left_out}",
            *(_data_line(benchmark, scene) for scene in benchmark.scenes),
            f"{num_runs} runs, {num_fits} of them fits with a budget, {places} at a time, and "
            f"{len(preset.benches)} measurements: about {_hours(seconds_needed(benchmark, places))}; "
            f"{_disk_gb(benchmark):.0f} GB of predictions",
        ]
    )


def seconds_needed(benchmark: Benchmark, num_places: int | None = None) -> float:
    """Of runs, where none of them is done yet, and of measurements."""
    blocks = benchmark.preset.blocks
    runs_s = sum(_num_runs(block) * (_budget_s(block) + OVERHEAD_S) for block in blocks)
    benches_s = sum(60.0 * BENCH_COMMANDS[name][1] for name in benchmark.preset.benches)
    return runs_s / (num_places or benchmark.num_places) + benches_s


def generate_data(benchmark: Benchmark, progress: TracingProgress, workers: Workers = HERE) -> None:
    """Make the data sets that are not there yet; a killed generation goes on.

    Raises `OutputExistsError` for a file that holds something else, and any other `XFreqBenchError`.
    """
    for scene, plan in benchmark.plans.items():
        generate(plan, benchmark.data_path(scene), partial(progress, scene), workers=workers)


def run_benchmark(benchmark: Benchmark, progress: RunProgress, executor: str | None = None) -> list[str]:
    """Run what is not yet recorded, as `run_workers` says; what went wrong, in words, a line a failed run.

    Raises what `run_on` raises before the first run.
    """
    with run_workers(benchmark, executor) as workers:
        return run_on(workers, benchmark.jobs(), benchmark.results_dir, progress)


def measure(benchmark: Benchmark, name: str) -> list[str]:
    """Run one of the bench commands, its output shown, and record its tables; in words, what failed of it."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / RECORDS_FILE
        command = [*BENCH_COMMANDS[name][0], "--output", str(output)]
        outcome = subprocess.run([sys.executable, "-m", "xfreqbench.cli", *command])
        for record in records.read(output).benches:
            records.append(benchmark.records_path, record)
    failure = f"`xfreqbench {' '.join(command[:-2])}` ended with {outcome.returncode}; see above"
    return [failure] if outcome.returncode else []


def record_contents(benchmark: Benchmark) -> None:
    """Record what the benchmark consisted of and what it left out, where that is not recorded yet."""
    contents = recorded(
        bench="benchmark",
        title="What was run",
        command=f"xfreqbench benchmark --preset {benchmark.name}",
        note=f"Preset {benchmark.name}: {benchmark.preset.description}. "
        f"Left out: {benchmark.preset.left_out}.",
        columns=("scene", "protocol", "splits", "methods", "seeds", "budget", "runs"),
        rows=tuple(map(_contents, benchmark.preset.blocks)),
    )
    known = [(each.note, each.rows) for each in records.read(benchmark.records_path).benches]
    if (contents.note, contents.rows) not in known:
        records.append(benchmark.records_path, contents)


def _contents(block: Block) -> tuple[str, ...]:
    methods = [
        setting.method + (f" ({', '.join(setting.overrides)})" if setting.overrides else "")
        for setting in block.settings
    ]
    seeds = ", ".join(map(str, block.seeds))
    counts = str(_num_splits(block)), ", ".join(methods), seeds, block.budget or "none", str(_num_runs(block))
    return (block.scene, block.protocol, *counts)


def _targets_hz(block: Block) -> Targets:
    if block.targets_ghz is None or block.targets_ghz == "all":
        return block.targets_ghz
    return [ghz_to_hz(target) for target in block.targets_ghz]


def _num_splits(block: Block) -> int:
    """How many splits a block has on the paper's carriers."""
    if block.protocol not in ("lofo", "lofo-unseen-tx"):
        return len(SPARSE_TRAINING_GHZ) if block.protocol == "sparse" else 1
    if block.targets_ghz == "all":
        return len(_PAPER_HZ)
    return len(block.targets_ghz or LOFO_TARGETS_HZ)


def _num_runs(block: Block) -> int:
    return _num_splits(block) * len(block.settings) * len(block.seeds)


def _budget_s(block: Block) -> float:
    return parse_budget(block.budget).max_seconds or 0.0


def _data_line(benchmark: Benchmark, scene: str) -> str:
    path, plan = benchmark.data_path(scene), benchmark.plans[scene]
    if path.exists():
        return f"{path} is there already and is used"
    return f"{path}: {plan.num_bytes / 1e6:.0f} MB, traced in about {estimate_seconds(plan):.0f} s"


def _disk_gb(benchmark: Benchmark) -> float:
    """Of predictions, were every split to test every transmitter once."""
    return sum(
        _num_runs(block) * len(benchmark.plans[block.scene].tx_position_m) * 90 * 360 * 2 / 1e9
        for block in benchmark.preset.blocks
    )


def _hours(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02} min" if minutes >= 60 else f"{minutes} min"
