"""Runs jobs: fit, predict, store the predictions, score what was stored, record it.

A long fit is saved on its way, and a run that was killed goes on from there.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from xfreqbench import checkpoints, machine, records
from xfreqbench.angles import FloatArray
from xfreqbench.checkpoints import CHECKPOINTS_FOLDER, Checkpoint, CheckpointFolder
from xfreqbench.config import as_json
from xfreqbench.dataset import IntArray, PasDataset, open_dataset, verify
from xfreqbench.errors import DivergenceError, MethodError, XFreqBenchError
from xfreqbench.method import (
    Budget,
    ExplainedMethod,
    Fit,
    Maps,
    Method,
    Stopwatch,
    build_method,
    checked_maps,
    code_sha256,
    fit_within,
    predict_checked,
)
from xfreqbench.metrics import METRICS_VERSION, ssim
from xfreqbench.predictions import MapBatch, write_predictions
from xfreqbench.protocols import Split, find_split
from xfreqbench.records import (
    CURVE_SHARES,
    RECORDS_FILE,
    CurvePoint,
    Job,
    RunRecord,
    curve_positions,
)
from xfreqbench.scoring import (
    BATCH_SIZE,
    PREDICTIONS_FOLDER,
    median,
    predictions_path,
    scored_fields,
    stored_record,
)
from xfreqbench.storage import exclusive, require_space, storage_errors

__all__ = ["Job", "RunRecord", "run_all", "run_job"]

ProgressCallback = Callable[[int, int, RunRecord], None]
FittingCallback = Callable[[Job, Fit], None]


@dataclass(frozen=True)
class _Task:
    """A job with everything it names looked up; all errors a user can make come before the fit."""

    job: Job
    dataset: PasDataset
    split: Split
    method: Method

    @cached_property
    def id(self) -> str:
        """Hash of everything that determines the result."""
        content = [
            self.dataset.sha256,
            self.job.method,
            code_sha256(self.method),
            as_json(self.method.config),
            self.job.protocol,
            self.split.sha256,
            self.job.seed,
            asdict(self.job.budget),
            METRICS_VERSION,
        ]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    def predictions_path(self, results_dir: Path) -> Path:
        """Where this job's predictions are."""
        return predictions_path(results_dir, self.id)

    def checkpoint_folder(self, results_dir: Path) -> CheckpointFolder:
        """Where this job's fit is saved while it runs."""
        return CheckpointFolder(results_dir / CHECKPOINTS_FOLDER / self.id, self.id)


def run_all(
    jobs: Iterable[Job],
    results_dir: Path,
    progress: ProgressCallback | None = None,
    fitting: FittingCallback | None = None,
) -> list[RunRecord]:
    """Run jobs one after the other, the ones already in `results_dir` not again; their records, in order.

    A fit that was killed goes on from its last checkpoint. Every data set and checkpoint is verified,
    every job's names are resolved and `results_dir` is tried before the first fit. `progress` is told
    jobs done, jobs in all and the record after each one; `fitting` is told at every step how the fit
    stands. Raises any `XFreqBenchError`; jobs that were finished before it are kept.
    """
    jobs = list(jobs)
    datasets = {task.job.dataset: task.dataset for task in _checked(jobs, results_dir)}
    done = []
    for number, job in enumerate(jobs, start=1):
        done.append(_run(_prepare(job, datasets[job.dataset]), results_dir, fitting))
        if progress:
            progress(number, len(jobs), done[-1])
    return done


def unfinished(jobs: Sequence[Job], results_dir: Path) -> dict[Job, str]:
    """Jobs whose record or predictions are not in `results_dir` yet, once all were checked as `run_all` does.

    With the id that each record will have. Raises any `XFreqBenchError`.
    """
    known = {record.id for record in records.read(results_dir / RECORDS_FILE).records}
    return {
        task.job: task.id
        for task in _checked(jobs, results_dir)
        if task.id not in known or not task.predictions_path(results_dir).exists()
    }


def _checked(jobs: Sequence[Job], results_dir: Path) -> list[_Task]:
    """Find what would stop one of the jobs before the first fit: names, data sets, checkpoints, `results_dir`."""
    datasets = {path: open_dataset(path) for path in dict.fromkeys(job.dataset for job in jobs)}
    tasks = [_prepare(job, datasets[job.dataset]) for job in jobs]
    for task in tasks:
        task.checkpoint_folder(results_dir).read()
    _require_writable(results_dir)
    for path in datasets:
        verify(path)
    return tasks


def run_job(job: Job, results_dir: Path) -> RunRecord:
    """Fit, predict and score one job, or return its record where that and its predictions are stored."""
    return _run(_prepare(job, open_dataset(job.dataset)), results_dir)


def _run(task: _Task, results_dir: Path, fitting: FittingCallback | None = None) -> RunRecord:
    saved = task.checkpoint_folder(results_dir)
    lock = task.predictions_path(results_dir).with_suffix(".lock")
    with exclusive(lock):  # another process may be at the same job
        record = stored_record(results_dir, task.id)
        if record is None:
            record = _new_record(task, results_dir, fitting)
            records.append(results_dir / RECORDS_FILE, record)
        saved.remove()
    return record


def run_unkept(job: Job, results_dir: Path) -> RunRecord:
    """As `run_job`, but the record is left to whoever gets it, who stores it by `keep`.

    Until then the checkpoint stays, and the job is unfinished.
    """
    task = _prepare(job, open_dataset(job.dataset))
    with exclusive(task.predictions_path(results_dir).with_suffix(".lock")):
        return stored_record(results_dir, task.id) or _new_record(task, results_dir)


def keep(record: RunRecord, results_dir: Path) -> None:
    """Store the record of a job that `run_unkept` ran, and remove its checkpoint."""
    path = results_dir / RECORDS_FILE
    known = {(stored.id, stored.time_utc) for stored in records.read(path).records}
    if (record.id, record.time_utc) not in known:
        records.append(path, record)
    CheckpointFolder(results_dir / CHECKPOINTS_FOLDER / record.id, record.id).remove()


def _new_record(task: _Task, results_dir: Path, fitting: FittingCallback | None = None) -> RunRecord:
    saved = task.checkpoint_folder(results_dir)
    earlier = saved.read()
    if earlier:
        task = replace(task, method=saved.load(task.method))
    machine.reset_peak_memory()
    fit, curve = _fitted(task, saved, earlier, fitting)
    clock = Stopwatch()
    _store_predictions(task, results_dir, clock)
    memory_mib = machine.peak_memory_mib()
    return _record(task, fit, curve, clock, memory_mib, results_dir)


def _fitted(
    task: _Task, saved: CheckpointFolder, earlier: Checkpoint | None, fitting: FittingCallback | None
) -> tuple[Fit, tuple[CurvePoint, ...]]:
    train = task.dataset.subset(task.split.train).isolated()
    watch = _Watch(task, saved, earlier, fitting)
    spent = earlier.fit if earlier else None
    with _method_errors(task, "fit"), _divergence_advice(task, saved):
        fit = fit_within(task.method, train, task.job.budget, task.job.seed, spent=spent, observe=watch)
    return fit, watch.whole_curve(fit)


class _Watch:
    """Looks at a fit at every yield, on nobody's time: takes its learning curve, saves it, tells of it."""

    def __init__(
        self,
        task: _Task,
        saved: CheckpointFolder,
        earlier: Checkpoint | None,
        fitting: FittingCallback | None,
    ) -> None:
        self._task, self._saved, self._fitting = task, saved, fitting
        self._curve = earlier.curve if earlier else ()
        self._saved_s = earlier.seconds if earlier else 0.0
        self._yielded_often = earlier is not None

    def __call__(self, before: Fit | None, now: Fit) -> None:
        self._yielded_often = before is not None
        if before is None:
            self._curve, self._saved_s = (), 0.0
        if _is_curve_due(before, now):
            self._curve += (self._point(now),)
        if now.seconds - self._saved_s >= checkpoints.CHECKPOINT_SECONDS:
            self._save(now)
        if self._fitting:
            self._fitting(self._task.job, now)

    def whole_curve(self, end: Fit) -> tuple[CurvePoint, ...]:
        """The learning curve with the fit's end; empty without a budget, or for a method that yielded once."""
        if self._task.job.budget == Budget() or not self._yielded_often:
            return ()
        is_taken = bool(self._curve) and self._curve[-1].step == end.step
        return self._curve if is_taken else (*self._curve, self._point(end))

    def _point(self, fit: Fit) -> CurvePoint:
        with _method_errors(self._task, "predict"):
            ssim_median = median(_sampled_ssim(self._task))
        return CurvePoint(step=fit.step, seconds=fit.seconds, loss=fit.loss, ssim=ssim_median)

    def _save(self, fit: Fit) -> None:
        with _method_errors(self._task, "save"):
            self._saved.write(self._task.method, fit, self._curve)
        self._saved_s = fit.seconds


def _is_curve_due(before: Fit | None, now: Fit) -> bool:
    reached = before.share if before else 0.0
    return any(reached < share <= now.share for share in CURVE_SHARES)


def _sampled_ssim(task: _Task) -> Float[FloatArray, "n"]:
    """SSIM of what the method now predicts for a sample of the test rows, the same for every method."""
    rows = task.split.test[curve_positions(task.split.sha256, len(task.split.test))]
    return np.concatenate(
        [_batch_ssim(task, part) for part in np.split(rows, range(BATCH_SIZE, len(rows), BATCH_SIZE))]
    )


def _batch_ssim(task: _Task, rows: Int[IntArray, "n"]) -> Float[FloatArray, "n"]:
    part, grid = task.dataset.subset(rows), task.dataset.grid
    predicted: Maps = predict_checked(task.method, part.tx_position_m, part.carrier_hz, grid.shape)
    return ssim(predicted, task.dataset.pas(rows), grid)


def _require_writable(results_dir: Path) -> None:
    """Raise `StorageError` for a folder in which a run would find no place for its result."""
    path = results_dir / RECORDS_FILE
    for folder in (results_dir, results_dir / PREDICTIONS_FOLDER):
        require_space(folder / RECORDS_FILE, 1)
        with storage_errors(folder), tempfile.TemporaryFile(dir=folder):
            pass
    if path.exists():
        with storage_errors(path), path.open("ab"):
            pass


@contextmanager
def _method_errors(task: _Task, part: str) -> Iterator[None]:
    """Turn whatever a method raises into a `MethodError` that says where."""
    try:
        yield
    except XFreqBenchError:
        raise
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        raise MethodError(
            f"Method {task.job.method!r} failed in {part} on split {task.split.name!r}: "
            f"{type(error).__name__}: {error} ({frame.filename}, line {frame.lineno}). "
            "Mend it and run the same command again; finished jobs are kept."
        ) from error


@contextmanager
def _divergence_advice(task: _Task, saved: CheckpointFolder) -> Iterator[None]:
    """Name the job that diverged, and what is left of it."""
    try:
        yield
    except DivergenceError as error:
        newest = saved.newest()
        job, left = (
            task.job,
            f"its last good checkpoint is {newest}" if newest else "it has no checkpoint yet",
        )
        raise DivergenceError(
            error.step,
            error.tensor,
            f"Method {job.method!r} diverged on split {task.split.name!r} with seed {job.seed}; {left}. Lower "
            "the learning rate, as in --set learning_rate=…; a checkpoint is deleted to start anew.",
        ) from error


def _prepare(job: Job, dataset: PasDataset) -> _Task:
    return _Task(
        job=job,
        dataset=dataset,
        split=find_split(dataset, job.protocol, job.split),
        method=build_method(job.method, job.overrides),
    )


def _store_predictions(task: _Task, results_dir: Path, clock: Stopwatch) -> None:
    write_predictions(
        task.predictions_path(results_dir),
        _predicted(task, clock),
        num_rows=len(task.split.test),
        grid_shape=task.dataset.grid.shape,
        dataset_sha256=task.dataset.sha256,
        split_sha256=task.split.sha256,
    )


def _predicted(task: _Task, clock: Stopwatch) -> Iterator[MapBatch]:
    test = task.dataset.subset(task.split.test)
    for start in range(0, len(test), BATCH_SIZE):
        part = slice(start, start + BATCH_SIZE)
        rows, query = task.split.test[part], (test.tx_position_m[part], test.carrier_hz[part])
        with _method_errors(task, "predict"), clock:
            maps = task.method.predict(*query)
        yield rows, checked_maps(task.method, maps, (len(rows), *test.grid.shape))


def _record(
    task: _Task,
    fit: Fit,
    curve: tuple[CurvePoint, ...],
    clock: Stopwatch,
    memory_mib: float,
    results_dir: Path,
) -> RunRecord:
    return RunRecord(
        id=task.id,
        job=task.job,
        **scored_fields(task.dataset, task.split, task.predictions_path(results_dir)),
        config=as_json(task.method.config),
        step=fit.step,
        fit_seconds=fit.seconds,
        predict_ms_per_map=clock.seconds / len(task.split.test) * 1e3,
        peak_memory_mib=memory_mib,
        parameters=task.method.num_parameters,
        hardware=machine.hardware(),
        software=machine.software(),
        git_commit=machine.git_commit(),
        time_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        counts=dict(fit.counts),
        curve=curve,
        code_sha256=code_sha256(task.method),
        findings=_findings(task),
    )


def _findings(task: _Task) -> dict[str, Any]:
    if not isinstance(task.method, ExplainedMethod):
        return {}
    with _method_errors(task, "findings"):
        return json.loads(json.dumps(dict(task.method.findings())))
