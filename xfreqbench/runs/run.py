"""Runs jobs one after the other: fit, predict, store the predictions, score what was stored, record it.

A long fit is saved on its way, and a run that was killed goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from jaxtyping import Float, Int

from xfreqbench.errors import MethodError
from xfreqbench.methods.contract import ExplainedMethod, Method
from xfreqbench.methods.fitting import Stopwatch, checked_maps, checked_num_parameters
from xfreqbench.methods.guard import plain_json
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.jobs import Task, look_up_all
from xfreqbench.runs.predictions import MapBatch, fault_of_maps, require_no_others, write_predictions
from xfreqbench.runs.records import Job, RunRecord, machine_and_time
from xfreqbench.runs.scoring import BATCH_SIZE, scored_fields
from xfreqbench.runs.watch import FittingCallback, WatchedFit
from xfreqbench.system import machine
from xfreqbench.types import IntArray, Maps

__all__ = ["Job", "RunRecord", "run_job", "run_jobs", "run_one"]

ProgressCallback = Callable[[int, int, RunRecord], None]


def run_jobs(
    jobs: Iterable[Job],
    results_dir: Path,
    progress: ProgressCallback | None = None,
    fitting: FittingCallback | None = None,
) -> list[RunRecord]:
    """Run jobs one after the other and store their records in `results_dir`; returns the records, in order.

    A job that is finished there is not run again, and a fit that was killed goes on from its last checkpoint.
    Everything that can be checked is checked before the first fit; see `look_up_all`. `progress` is told jobs
    done, jobs in all and the record after each one; `fitting` is told at every step how the fit stands. Raises
    any `XFreqBenchError`; jobs that were finished before it are kept.
    """
    folder = ResultsFolder(results_dir)
    tasks = look_up_all(list(jobs), folder)
    records = []
    for task in tasks:
        with folder.lock(task.id):  # another process may be at the same job
            record = folder.finished(task.id)
            if record is None:
                record = run_one(task, folder, fitting)
                folder.append(record)
            folder.checkpoints(task.id).remove()
        records.append(record)
        if progress:
            progress(len(records), len(tasks), record)
    return records


def run_job(job: Job, results_dir: Path) -> RunRecord:
    """The record of one job; as `run_jobs`."""
    return run_jobs([job], results_dir)[0]


def run_one(task: Task, folder: ResultsFolder, fitting: FittingCallback | None = None) -> RunRecord:
    """Fit, predict, store the predictions in `folder`, and score what was stored; the record of all that.

    The caller holds `folder.lock(task.id)`, stores the record and then removes the checkpoints, which stay until
    then: a job without a record is unfinished.
    """
    require_no_others(folder.predictions_path(task.id))
    watched = WatchedFit(task, folder.checkpoints(task.id), fitting)
    machine.reset_peak_memory()
    fit = watched.run()
    method, clock, path = watched.method, Stopwatch(), folder.predictions_path(task.id)
    write_predictions(
        path,
        _predicted(task, method, clock),
        num_rows=len(task.split.test),
        grid_shape=task.dataset.grid.shape,
        dataset_sha256=task.dataset.sha256,
        split_sha256=task.split.sha256,
    )
    peak_memory_mib = machine.peak_memory_mib()
    return RunRecord(
        id=task.id,
        job=task.job,
        **scored_fields(task.dataset, task.split, path),
        config=task.config,
        step=fit.step,
        fit_seconds=fit.seconds,
        fit_processor_seconds=fit.processor_seconds,
        predict_ms_per_map=clock.seconds / len(task.split.test) * 1e3,
        peak_memory_mib=peak_memory_mib,
        parameters=_num_parameters(task, method),
        counts=dict(fit.counts),
        curve=watched.curve,
        code_sha256=task.code_sha256,
        findings=_findings(task, method),
        **machine_and_time(),
    )


def _predicted(task: Task, method: Method, clock: Stopwatch) -> Iterator[MapBatch]:
    """Rows and predicted maps of the split's test rows, batch by batch; `clock` runs within `predict` alone."""
    test = task.dataset.subset(task.split.test)
    for start in range(0, len(test), BATCH_SIZE):
        part = slice(start, start + BATCH_SIZE)
        rows, asked = task.split.test[part], (test.tx_position_m[part], test.carrier_hz[part])
        with task.method_errors("predict"), clock:
            maps = method.predict(*asked)
        yield rows, _scorable(task, rows, checked_maps(method, maps, (len(rows), *test.grid.shape)))


def _scorable(task: Task, rows: Int[IntArray, "n"], maps: Float[Maps, "n E A"]) -> Float[Maps, "n E A"]:
    """The maps predicted for some rows; raises `MethodError` for the first that no file of predictions may hold."""
    fault = fault_of_maps(maps)
    if fault:
        raise MethodError(
            f"Method {task.job.method!r} failed in predict on split {task.split.name!r}: the map of row "
            f"{rows[fault[0]]} {fault[1]}"
        )
    return maps


def _findings(task: Task, method: Method) -> dict[str, Any]:
    """What the method says it has learned, as JSON has it; empty for a method that does not say."""
    with task.method_errors("findings"):
        return plain_json(dict(method.findings())) if isinstance(method, ExplainedMethod) else {}


def _num_parameters(task: Task, method: Method) -> int:
    with task.method_errors("num_parameters"):
        return checked_num_parameters(method)
