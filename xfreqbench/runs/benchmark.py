"""The whole benchmark as one command: it generates data sets, runs methods side by side, and measures."""

from __future__ import annotations

import shlex
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from runpy import run_module
from types import MappingProxyType
from typing import Literal

from xfreqbench.data.collection import Collection, open_collection
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.plan import Plan, plan_generation
from xfreqbench.data.rooms import RoomsPlan, generate_planned_rooms, plan_rooms
from xfreqbench.data.splits import LOFO_TARGETS_GHZ, SPARSE_TRAINING_GHZ
from xfreqbench.data.unseen_rooms import NUMS_HEARD, ROOM_PROTOCOLS
from xfreqbench.errors import RunsFailedError, UnknownNameError
from xfreqbench.methods.contract import parse_budget
from xfreqbench.methods.registry import build_method, device_option, room_method_names
from xfreqbench.runs.estimate import in_hours, run_seconds
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.jobs import Task, tasks_of
from xfreqbench.runs.presets import BENCHES, COSTS, PRESETS, Block, Preset, Setting
from xfreqbench.runs.progress import RunProgress
from xfreqbench.runs.records import BenchRecord, Job, made_here
from xfreqbench.runs.run import imports_of, run_jobs
from xfreqbench.system.files import require_text
from xfreqbench.system.processes import SERIAL, LocalProcesses, all_cores, open_workers, own_cores
from xfreqbench.system.workers import HERE, Workers
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION
from xfreqbench.types import ProgressCallback, ignore_progress
from xfreqbench.units import PAPER_CARRIERS_GHZ

_TESTED_ROOMS = 107  # of a thousand


@dataclass(frozen=True)
class Benchmark:
    """The name of a preset, the folders of its data sets and results, and the device for methods that can use a GPU.

    `predictions` says which stored predictions stay after they were scored: `all`, or `shown`, those of the first
    seed in the first scene, of which reports show maps. Raises `UnknownNameError`; no method is imported.
    """

    name: str
    data_dir: Path
    results_dir: Path
    device: str = "cpu"
    predictions: Literal["all", "shown"] = "all"

    def __post_init__(self) -> None:
        require_text(self.data_dir)
        if self.name not in PRESETS:
            raise UnknownNameError("preset", self.name, PRESETS)

    @property
    def preset(self) -> Preset:
        """Which methods run on which scenes."""
        return PRESETS[self.name]

    @cached_property
    def results(self) -> ResultsFolder:
        """The folder in which every run and every measurement is recorded."""
        return ResultsFolder(self.results_dir)

    @property
    def scenes(self) -> list[str]:
        """Scenes of the blocks, each once; families of rooms are not among them."""
        named = dict.fromkeys(block.scene for block in self.preset.blocks)
        return [scene for scene in named if scene not in self.preset.num_rooms]

    @cached_property
    def rooms_plans(self) -> dict[str, RoomsPlan]:
        """The plan of every collection of rooms, by the name of the family."""
        num_tx, traced = self.preset.num_tx, WITHOUT_DIFFRACTION
        return {
            name: plan_rooms(name, GenerateOptions(rooms=number, tx=num_tx[name], interactions=traced))
            for name, number in self.preset.num_rooms.items()
        }

    @cached_property
    def plans(self) -> dict[str, Plan]:
        """The plan of every scene's data set, by the name of the scene."""
        return {name: plan_generation(name, GenerateOptions(tx=self.preset.num_tx.get(name))) for name in self.scenes}

    def data_path(self, scene: str) -> Path:
        """The file of a scene's data set; if the preset limits its transmitters, their number is in the name.

        Of a family it is the folder of its rooms.
        """
        if scene in self.preset.num_rooms:
            return self.data_dir / f"{scene}-{self.preset.num_rooms[scene]}"
        number = self.preset.num_tx.get(scene)
        return self.data_dir / (f"{scene}-{number}.h5" if number else f"{scene}.h5")

    def tasks(self) -> list[Task]:
        """All jobs, each once, in the order of the blocks; but of those that share a fit, all but the first come last.

        Otherwise they would wait for it beside it. The data sets must have been generated.
        """
        datasets: dict[str, PasDataset | Collection] = {
            scene: open_dataset(self.data_path(scene)) for scene in self.scenes
        }
        datasets |= {family: open_collection(self.data_path(family)) for family in self.preset.num_rooms}
        by_job = {
            task.job: task for block in self.preset.blocks for task in self._tasks_of(block, datasets[block.scene])
        }
        fits = {task: task.fit_id for task in by_job.values()}
        first = {fit: task for task, fit in reversed(fits.items())}
        return sorted(fits, key=lambda task: first[fits[task]] is not task)

    def _tasks_of(self, block: Block, data: PasDataset | Collection) -> Sequence[Task]:
        methods = [
            (setting.method, (*setting.overrides, *device_option(setting.method, self.device)))
            for setting in block.settings
        ]
        return tasks_of(str(self.data_path(block.scene)), data, methods, block)

    def missing_benches(self) -> list[str]:
        """The measurements that have no record yet."""
        known = {record.bench for record in self.results.stored.benches}
        return [name for name in self.preset.benches if name not in known]

    def keeps_predictions(self, job: Job) -> bool:
        """Whether the predictions of a job stay after they were scored."""
        shown = str(self.data_path(self.preset.blocks[0].scene)), self.preset.blocks[0].seeds[0]
        return self.predictions == "all" or (job.dataset, job.seed) == shown


def run_workers(
    benchmark: Benchmark, executor: str | None, tasks: Sequence[Task] = ()
) -> AbstractContextManager[Workers]:
    """The workers that `--executor` names; without it, a new process on each core for every run, or one on a GPU.

    With `serial` it is one new process at a time, which may use all cores. `tasks` are those that will be run.
    """
    imports = imports_of(tasks) if tasks else ()
    if executor is None or executor == SERIAL:
        one_a_core = executor is None and benchmark.device == "cpu"
        return LocalProcesses(own_cores() if one_a_core else all_cores(), is_fresh=True, imports=imports)
    return open_workers(executor, is_fresh=True, imports=imports)


def cost(benchmark: Benchmark, num_places: int) -> str:
    """What a benchmark will take, as text: data sets, runs, time, disk space, and what it leaves out.

    `num_places` is the number of runs at a time. The time is that of all runs, as if none was done yet, and all
    measurements.
    """
    preset = benchmark.preset
    seconds = {run: _run_seconds(block, run[3]) for block in preset.blocks for run in _runs(block)}
    benches_s = sum(60.0 * BENCHES[name]["minutes"] for name in preset.benches)
    num_fits = sum(budget is not None for *_, budget in seconds)
    is_all = benchmark.predictions == "all"
    num_bytes = sum(  # if every split tests every transmitter once
        len(plan.tx_position_m) * 90 * 360 * 2
        for scene, *_, seed, _ in seconds
        if (plan := benchmark.plans.get(scene))
        and (is_all or (scene, seed) == (preset.blocks[0].scene, preset.blocks[0].seeds[0]))
    )
    return "\n".join(
        [
            f"preset {benchmark.name}: {preset.description}",
            f"left out: {preset.left_out}",
            *(_data_line(benchmark, scene) for scene in benchmark.scenes),
            *(
                f"{benchmark.data_path(family)}: {number:,} rooms, traced in about "
                f"{in_hours(number * COSTS['a_room'] / num_places)}, of which are used whichever are there already"
                for family, number in preset.num_rooms.items()
            ),
            f"{len(seconds)} runs, {num_fits} of them fits with a budget, {num_places} at a time, and "
            f"{len(preset.benches)} measurements: about {in_hours(sum(seconds.values()) / num_places + benches_s)}; "
            f"{num_bytes / 1e9:.0f} GB of predictions" + ("" if is_all else " stay"),
        ]
    )


def _run_seconds(block: Block, setting: Setting) -> float:
    """Estimated seconds of one run on one core."""
    budget = parse_budget(block.budget)
    if block.protocol not in ROOM_PROTOCOLS:
        return run_seconds(setting.method, budget)
    is_across = setting.method in room_method_names()  # one fit for all splits, or a fit in every room
    num_fits = 1 / len(_splits(block)) if is_across else _TESTED_ROOMS
    return run_seconds(setting.method, budget, num_fits, _TESTED_ROOMS)


def generate_data(
    benchmark: Benchmark, progress: Mapping[str, ProgressCallback] = MappingProxyType({}), workers: Workers = HERE
) -> None:
    """Generate the data sets that do not exist yet; a generation that was killed goes on.

    `progress` has the callback of a scene by its name. Raises `OutputExistsError` if a file holds something else, any
    other `XFreqBenchError`, and before all whatever building the methods raises.
    """
    for setting in dict.fromkeys(setting for block in benchmark.preset.blocks for setting in block.settings):
        build_method(setting.method, setting.overrides)
    for scene, plan in benchmark.plans.items():
        callback = progress.get(scene, ignore_progress)
        generate_planned(plan, benchmark.data_path(scene), callback, workers=workers)
    for family, rooms in benchmark.rooms_plans.items():
        generate_planned_rooms(rooms, benchmark.data_path(family), workers, progress.get(family, ignore_progress))


def run_benchmark(benchmark: Benchmark, progress: RunProgress | None = None, executor: str | None = None) -> list[str]:
    """Run the jobs that are not finished, on the workers of `run_workers`; returns a line for each run that failed.

    Raises what `run_jobs` raises before the first run.
    """
    tasks = benchmark.tasks()
    with run_workers(benchmark, executor, tasks) as workers:
        try:
            run_jobs(tasks, benchmark.results_dir, workers, progress, keeps_predictions=benchmark.keeps_predictions)
        except RunsFailedError as error:
            return error.lines
    return []


def measure(benchmark: Benchmark, name: str) -> list[str]:
    """Run the command of one measurement, showing its output; returns what failed, in words.

    Its tables are recorded if all of it succeeded, so that what failed is measured again.
    """
    with tempfile.TemporaryDirectory() as folder:
        measured = ResultsFolder(Path(folder))
        command = [*shlex.split(BENCHES[name]["command"]), "--output", str(measured.records_path)]
        with LocalProcesses(all_cores(), is_fresh=True) as own:
            ended = own.submit(_command, command)
        status = ended.exception() or ended.result()
        for record in () if status else measured.stored.benches:
            benchmark.results.append(record)
    return [f"`xfreqbench {' '.join(command[:-2])}` ended with {status}; see above"] if status else []


def _command(arguments: list[str]) -> str | int | None:
    """Run the command line in this process, as `python -m xfreqbench.cli` does; returns its exit status."""
    sys.argv[1:] = arguments
    try:
        run_module("xfreqbench.cli", run_name="__main__", alter_sys=True)
    except SystemExit as ended:
        return ended.code
    return 0


def record_contents(benchmark: Benchmark) -> None:
    """Record what the benchmark consists of and what it leaves out, unless that is recorded already."""
    contents = BenchRecord(
        bench="benchmark",
        title=f"Preset {benchmark.name}",
        command=f"xfreqbench benchmark --preset {benchmark.name}",
        note=f"Preset {benchmark.name}: {benchmark.preset.description}. Left out: {benchmark.preset.left_out}.",
        columns=("scene", "protocol", "splits", "methods", "seeds", "budget", "runs"),
        rows=tuple(map(_contents, benchmark.preset.blocks)),
        **made_here(),
    )
    known = [(bench.note, bench.rows) for bench in benchmark.results.stored.benches]
    if (contents.note, contents.rows) not in known:
        benchmark.results.append(contents)


def _contents(block: Block) -> tuple[str, ...]:
    methods = [
        setting.method + (f" ({', '.join(setting.overrides)})" if setting.overrides else "")
        for setting in block.settings
    ]
    seeds = ", ".join(map(str, block.seeds))
    counts = len(_splits(block)), ", ".join(methods), seeds, block.budget or "none", len(_runs(block))
    return (block.scene, block.protocol, *map(str, counts))


def _splits(block: Block) -> Sequence[float]:
    """The splits of a block's protocol on the paper's carriers: of lofo its targets, of others numbers.

    Rooms have those with a held-out type, too.
    """
    if block.protocol in ROOM_PROTOCOLS:
        return range(2 * len(NUMS_HEARD))
    if block.protocol not in ("lofo", "lofo-unseen-tx"):
        return range(len(SPARSE_TRAINING_GHZ) if block.protocol == "sparse" else 1)
    return PAPER_CARRIERS_GHZ if block.targets_ghz == "all" else block.targets_ghz or LOFO_TARGETS_GHZ


def _runs(block: Block) -> list[tuple[str, str, float, Setting, int, object]]:
    """Scene, protocol, split, setting, seed and budget of each run of a block; two blocks may have the same."""
    every = product(_splits(block), block.settings, block.seeds)
    return [(block.scene, block.protocol, *run, block.budget) for run in every]


def _data_line(benchmark: Benchmark, scene: str) -> str:
    path, plan = benchmark.data_path(scene), benchmark.plans[scene]
    if path.exists():
        return f"{path} is there already and is used"
    shot_s, transmitter_s = COSTS["traced"].get(scene, COSTS["traced"]["usual"])
    seconds = shot_s + transmitter_s * len(plan.tx_position_m)
    return f"{path}: {plan.header.num_bytes / 1e6:.0f} MB, traced in about {seconds:.0f} s"
