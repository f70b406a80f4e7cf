"""Runs jobs: fit, predict, store the predictions, score what was stored, record it."""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from xfreqbench import machine, records
from xfreqbench.angles import FloatArray
from xfreqbench.config import as_json
from xfreqbench.dataset import PasDataset, open_dataset, verify
from xfreqbench.errors import DataError, MethodError, XFreqBenchError
from xfreqbench.method import Fit, Method, build_method, checked_maps, code_sha256, fit_within
from xfreqbench.metrics import METRICS_VERSION, bootstrap_interval, quantiles, score_all
from xfreqbench.predictions import MapBatch, read_predictions, write_predictions
from xfreqbench.protocols import Split, find_split
from xfreqbench.records import NUM_QUANTILES, RECORDS_FILE, Job, RunRecord, Summary
from xfreqbench.storage import require_space, storage_errors

__all__ = ["Job", "RunRecord", "run_all", "run_job"]

PREDICTIONS_FOLDER = "predictions"
BATCH_SIZE = 32
_BOOTSTRAP_SEED = 0

ProgressCallback = Callable[[int, int, RunRecord], None]


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
        return results_dir / PREDICTIONS_FOLDER / f"{self.id}.h5"


def run_all(
    jobs: Iterable[Job], results_dir: Path, progress: ProgressCallback | None = None
) -> list[RunRecord]:
    """Run jobs one after the other, the ones already in `results_dir` not again; their records, in order.

    Every data set is verified, every job's names are resolved and `results_dir` is tried before the first
    fit. `progress` is told jobs done, jobs in all and the record after each one. Raises any
    `XFreqBenchError`; jobs that were finished before it are kept.
    """
    jobs = list(jobs)
    datasets = {path: _verified(path) for path in dict.fromkeys(job.dataset for job in jobs)}
    for job in jobs:
        _ = _prepare(job, datasets[job.dataset]).id
    _require_writable(results_dir)
    done = []
    for number, job in enumerate(jobs, start=1):
        done.append(_run(_prepare(job, datasets[job.dataset]), results_dir))
        if progress:
            progress(number, len(jobs), done[-1])
    return done


def run_job(job: Job, results_dir: Path) -> RunRecord:
    """Fit, predict and score one job, or return its record where that and its predictions are stored."""
    return _run(_prepare(job, open_dataset(job.dataset)), results_dir)


def _run(task: _Task, results_dir: Path) -> RunRecord:
    stored = _stored_record(task, results_dir)
    if stored:
        return stored
    train = task.dataset.subset(task.split.train).isolated()
    machine.reset_peak_memory()
    with _method_errors(task, "fit"):
        fit = fit_within(task.method, train, task.job.budget, task.job.seed)
    clock = _Stopwatch()
    _store_predictions(task, results_dir, clock)
    memory_mib = machine.peak_memory_mib()
    record = _record(task, fit, clock, memory_mib, _summaries(task, results_dir))
    records.append(results_dir / RECORDS_FILE, record)
    return record


def _verified(path: str) -> PasDataset:
    verify(path)
    return open_dataset(path)


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


def _prepare(job: Job, dataset: PasDataset) -> _Task:
    return _Task(
        job=job,
        dataset=dataset,
        split=find_split(dataset, job.protocol, job.split),
        method=build_method(job.method, job.overrides),
    )


def _stored_record(task: _Task, results_dir: Path) -> RunRecord | None:
    if not task.predictions_path(results_dir).exists():
        return None
    known = records.read(results_dir / RECORDS_FILE).records
    return next((record for record in reversed(known) if record.id == task.id), None)


class _Stopwatch:
    """Seconds spent inside `with` blocks."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __enter__(self) -> None:
        self._started_s = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.seconds += time.perf_counter() - self._started_s


def _store_predictions(task: _Task, results_dir: Path, clock: _Stopwatch) -> None:
    write_predictions(
        task.predictions_path(results_dir),
        _predicted(task, clock),
        num_rows=len(task.split.test),
        grid_shape=task.dataset.grid.shape,
        dataset_sha256=task.dataset.sha256,
        split_sha256=task.split.sha256,
    )


def _predicted(task: _Task, clock: _Stopwatch) -> Iterator[MapBatch]:
    test = task.dataset.subset(task.split.test)
    for start in range(0, len(test), BATCH_SIZE):
        part = slice(start, start + BATCH_SIZE)
        rows, query = task.split.test[part], (test.tx_position_m[part], test.carrier_hz[part])
        with _method_errors(task, "predict"), clock:
            maps = task.method.predict(*query)
        yield rows, checked_maps(task.method, maps, (len(rows), *test.grid.shape))


def _summaries(task: _Task, results_dir: Path) -> dict[str, Summary]:
    """Every metric, from the predictions as they are stored."""
    predictions = read_predictions(task.predictions_path(results_dir))
    if predictions.split_sha256 != task.split.sha256 or not np.array_equal(predictions.rows, task.split.test):
        raise DataError(f"{predictions.path} holds predictions of another split. Delete it and run again.")
    batches = [
        score_all(maps, task.dataset.pas(rows), task.dataset.grid, task.dataset.header.pas_kind)
        for rows, maps in predictions.batches(BATCH_SIZE)
    ]
    test = task.dataset.subset(task.split.test)
    return {
        name: _summary(np.concatenate([batch[name] for batch in batches]), test.tx_index, test.carrier_hz)
        for name in batches[0]
    }


def _summary(
    values: Float[FloatArray, "N"], tx_index: Int[NDArray[np.int64], "N"], carrier_hz: Float[FloatArray, "N"]
) -> Summary:
    return Summary(
        mean=float(values.mean()),
        median=_median(values),
        p10=float(quantiles(values, [0.1])[0]),
        interval=bootstrap_interval(values, tx_index, _median, _BOOTSTRAP_SEED),
        quantiles=quantiles(values, np.linspace(0, 1, NUM_QUANTILES).tolist()).tolist(),
        median_by_carrier_hz={
            f"{carrier:.0f}": _median(values[carrier_hz == carrier]) for carrier in np.unique(carrier_hz)
        },
    )


def _median(values: Float[FloatArray, "N"]) -> float:
    return float(np.median(values))


def _record(
    task: _Task, fit: Fit, clock: _Stopwatch, memory_mib: float, scores: dict[str, Summary]
) -> RunRecord:
    return RunRecord(
        id=task.id,
        job=task.job,
        dataset_sha256=task.dataset.sha256,
        scene=task.dataset.header.scene_name,
        pas_kind=task.dataset.header.pas_kind,
        settings=dict(task.dataset.header.settings),
        split_sha256=task.split.sha256,
        protocol_version=task.split.version,
        metrics_version=METRICS_VERSION,
        config=as_json(task.method.config),
        step=fit.step,
        fit_seconds=fit.seconds,
        predict_ms_per_map=clock.seconds / len(task.split.test) * 1e3,
        peak_memory_mib=memory_mib,
        parameters=task.method.num_parameters,
        num_test=len(task.split.test),
        num_without_path=task.split.num_without_path,
        shares_transmitters=task.split.shares_transmitters,
        scores=scores,
        hardware=machine.hardware(),
        software=machine.software(),
        git_commit=machine.git_commit(),
        time_utc=datetime.now(UTC).isoformat(timespec="seconds"),
    )
