"""Generates a data set: plan → tracer → batches → maps → writer, each entered once."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle, islice
from pathlib import Path

import numpy as np
from pydantic import InstanceOf

from xfreqbench.data.batches import BatchStore, claimed_batches, holds_batches_of
from xfreqbench.data.dataset import PasDataset, holds_same_job, links, open_dataset
from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.paths import PathTotals
from xfreqbench.data.plan import Plan, plan_generation
from xfreqbench.data.retrace import require_origin
from xfreqbench.data.trace import forget_rays, traced
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.model import Scene
from xfreqbench.system.arguments import FilePath, taking
from xfreqbench.system.bars import announcing, progress_bars
from xfreqbench.system.cluster import differences
from xfreqbench.system.files import require_space
from xfreqbench.system.processes import open_workers
from xfreqbench.system.workers import HERE, Workers, side_by_side
from xfreqbench.types import IntArray, ProgressCallback, ignore_progress


@taking(GenerateOptions, without=("rooms",))
def generate(scene: FilePath | InstanceOf[Scene], output: FilePath, options: GenerateOptions) -> PasDataset:
    """Trace a scene at some carriers, write channels and maps to the file `output`, and open it.

    `scene` is a shipped scene's name, the path of a scene TOML, or a `Scene`. The options are those of
    `xfreqbench generate`, with the same names and defaults. Names that the command takes with commas are a list here,
    and `tx_positions` is an array (T, 3) in metres, for which the scene needs no grid. `progress` shows the progress on
    stderr, as bars on a terminal and as a line every ten seconds elsewhere; with `auto` only on a terminal and in a
    notebook. `tell` is called with a summary of what will be traced, a few lines, before the first ray. A file with
    several receivers or polarizations has a link for each receiver and pair, and the first one is opened; see
    `PasDataset.at`.

    The same call continues where a killed one stopped, and opens a finished output: see `generate_planned`, also for
    what is raised. A mistake is an `XFreqBenchError`, before the first ray if possible.
    """
    with announcing(options.progress) as is_shown:
        plan = plan_generation(scene, options)
        if options.tell:
            options.tell(plan.summary)
        with (
            open_workers(options.executor) as workers,
            progress_bars("transmitters", ["tracing", "writing"], not is_shown) as (tracing, writing),
        ):
            dataset = open_dataset(generate_planned(plan, Path(output), tracing, writing, workers))
    if options.tell and (differing := differences(plan.header.software, dataset.header.software)):
        options.tell(f"{output} was traced by other software, {differing}, and has the same recipe: it is kept.")
    return dataset


def generate_planned(
    plan: Plan,
    path: Path,
    progress: ProgressCallback = ignore_progress,
    write_progress: ProgressCallback = ignore_progress,
    workers: Workers = HERE,
) -> Path:
    """Trace every transmitter of a plan, then write the data set; a killed run continues where it stopped.

    `progress` and `write_progress` are called, for each stage, with the number of transmitters that are done and of
    all. `workers` trace; this process writes the file, which is the same for all workers.

    Finished batches are kept next to the output, in `PATH.parts`, until the file is complete; only the same code and
    software use them again. Before the file gets its name, four of its samples are traced again from its own header,
    and one of each batch that an earlier process has traced. An output that already holds this job is kept, whichever
    software made it. Raises `OutputExistsError` for an output that holds another job, `StorageError` if there is no
    space or another process writes it, `DataError` if a sample differs, and `ClusterError` for workers whose solvers
    differ, or that die.
    """
    num_tx = len(plan.tx_position_m)
    is_whole = holds_same_job(path, plan.header, plan.tx_position_m)
    if not is_whole:
        require_space(path, plan.header.num_bytes)
    if not is_whole or holds_batches_of(path, plan):
        try:
            with claimed_batches(path, plan) as store:
                if not holds_same_job(path, plan.header, plan.tx_position_m):  # nor did another process write it
                    _trace_missing(plan, store, progress, workers)
                    _write(plan, store, path, write_progress, workers)
        finally:
            forget_rays()
    progress(num_tx, num_tx)
    write_progress(num_tx, num_tx)
    return path


def _trace_missing(plan: Plan, store: BatchStore, report: ProgressCallback, workers: Workers) -> None:
    missing = store.missing()
    done = len(plan.tx_position_m) - sum(rows.stop - rows.start for _, rows in missing)
    report(done, len(plan.tx_position_m))
    batches = ((index, plan.tx_position_m[rows]) for index, rows in missing)
    call = partial(traced, plan.tracing, software=None if workers is HERE else plan.header.software)
    for (index, tx), channel in side_by_side(workers, call, batches, ahead=1):
        store.write(index, channel.result())
        done += len(tx)
        report(done, len(plan.tx_position_m))


def _write(plan: Plan, store: BatchStore, path: Path, report: ProgressCallback, workers: Workers) -> None:
    """Derive the maps of each batch, write it, and check the origin of the file before it gets its name."""
    beam = BartlettBeam(plan.header.receiver.element_position_wavelengths, AngularGrid.hemisphere())

    def prove(written: Path) -> None:
        sampled = _sampled(plan, store.kept)
        for number, link in enumerate(links(open_dataset(written))):
            rows = sampled[number % len(sampled) :: plan.num_links]
            require_origin(link, rows, folder=plan.tracing.scene.folder, workers=workers)

    totals = None
    if plan.header.paths:
        names = tuple(mesh.name for mesh in plan.tracing.geometry.meshes)
        parts = (store.read(index).paths for index in range(len(plan.batches)))
        totals = PathTotals.of((part for part in parts if part is not None), names)
    with PasWriter(path, plan.header, prove=prove, paths=totals) as writer:
        for index, rows in enumerate(plan.batches):
            channel = store.read(index)
            samples = SampleBlock.of_channels(channel.cfr, channel.num_paths, beam, plan.header.pas_kind)
            writer.append(plan.tx_position_m[rows], plan.line_of_sight[rows], samples, channel.paths)
            report(rows.stop, len(plan.tx_position_m))


def _sampled(plan: Plan, kept: Sequence[int]) -> IntArray:
    """Rows of the samples that are traced again: one of each batch that was kept, and four at least."""
    generator = np.random.default_rng(int(plan.sha256[:8], 16))
    others = generator.permutation([index for index in range(len(plan.batches)) if index not in kept]).tolist()
    number, num_carriers = max(4, len(kept)), len(plan.header.carrier_hz)
    batches = [plan.batches[index] for index in islice(cycle([*kept, *others]), number)]
    return np.unique([generator.integers(num_carriers * rows.start, num_carriers * rows.stop) for rows in batches])


def estimate_seconds(plan: Plan, probes: int = 4) -> float:
    """Time in seconds that the job will take here, estimated by tracing a few of its transmitters.

    Compilation is not included: it happens now, and its result is stored.
    """
    spread = np.linspace(0, len(plan.tx_position_m) - 1, probes).astype(int)
    times = []
    few_rays = replace(
        plan.tracing, settings=replace(plan.tracing.settings, rays=1000)
    )  # which meet all that is compiled
    for tracing, tx in ((few_rays, spread[:1]), (plan.tracing, spread[:1]), (plan.tracing, spread)):
        start = time.perf_counter()
        traced(tracing, (0, plan.tx_position_m[tx]))
        times.append(time.perf_counter() - start)
    forget_rays()
    return times[1] + times[2] / probes * len(plan.tx_position_m)
