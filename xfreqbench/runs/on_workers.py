"""Runs jobs on workers, several at a time. This process checks first what they have to see, and keeps their records."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from uuid import uuid4

from xfreqbench.data.dataset import open_dataset
from xfreqbench.errors import ClusterError, DataError
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.jobs import look_up, look_up_all
from xfreqbench.runs.records import Job, RunRecord
from xfreqbench.runs.run import run_one
from xfreqbench.system.files import storage_errors
from xfreqbench.system.workers import Workers, side_by_side

ProgressCallback = Callable[[int, int, Job], None]


@dataclass(frozen=True)
class Outcome:
    """What became of jobs: records of those that are finished, in the jobs' order, and a line for each that failed."""

    records: list[RunRecord]
    failures: list[str]


def run_on(workers: Workers, jobs: Sequence[Job], results_dir: Path, progress: ProgressCallback) -> Outcome:
    """Run jobs as `run_jobs` does, but on workers, as many at a time as there are places for them.

    One failure stops no other job. `progress` is told jobs done, jobs in all and the job after each one.
    Everything that can be checked is checked before the first run, and raises the `XFreqBenchError` that it
    is: `ClusterError` for workers that do not see the data sets and `results_dir` as this process does.
    """
    folder = ResultsFolder(results_dir)
    ids = {task.job: task.id for task in look_up_all(jobs, folder)}
    records = {job: folder.finished(record_id) for job, record_id in ids.items()}
    missing = [job for job, record in records.items() if record is None]
    require_shared_folder(workers, results_dir)
    require_shared_datasets(workers, dict.fromkeys(job.dataset for job in missing))
    done, failures = len(jobs) - len(missing), []
    call = partial(_run_there, cwd=Path.cwd(), results_dir=results_dir)
    for job, ended in side_by_side(workers, call, missing):
        done += 1
        fault = _fault_of(ended, ids[job])
        if fault:
            failures.append(f"{job.method} on {job.split}, seed {job.seed}: {fault}")
        else:
            ran = ended.result().model_copy(update={"job": job})
            folder.keep(ran)
            records[job] = ran
        progress(done, len(jobs), job)
    return Outcome([found for job in jobs if (found := records[job])], failures)


def require_shared_folder(workers: Workers, folder: Path) -> None:
    """Raise `ClusterError` unless every worker finds what is put into a folder, and may write there."""
    token = folder.absolute() / f".shared-{uuid4().hex}"
    with storage_errors(token):
        token.parent.mkdir(parents=True, exist_ok=True)
        token.touch()
    try:
        blind = [worker for worker, sees in workers.ask(_sees, token).items() if not sees]
    finally:
        token.unlink()
    if blind:
        raise ClusterError(
            f"{len(blind)} workers do not see {token.parent}, or may not write there, {blind[0]} among them. Choose "
            "a folder on a file system that is mounted at the same path on every machine."
        )


def require_shared_datasets(workers: Workers, paths: Iterable[str]) -> None:
    """Raise `ClusterError` unless every worker finds the same data sets at the same paths, by their sha256."""
    for path in paths:
        expected = open_dataset(path).sha256
        for worker, found in workers.ask(_sha256_there, Path(path).absolute()).items():
            if found != expected:
                raise ClusterError(
                    f"Worker {worker} finds {found or 'no data set'} at {Path(path).absolute()}, but it is {expected} "
                    "here. Keep data sets on a file system that is mounted at the same path on every machine."
                )


def _run_there(job: Job, cwd: Path, results_dir: Path) -> RunRecord:
    """On the worker: run one job whose relative paths start at `cwd`, the driver's working folder.

    The record is returned and not stored, for only the driver writes records.
    """
    job, folder = replace(job, dataset=str(cwd / job.dataset)), ResultsFolder(cwd / results_dir)
    task = look_up(job, open_dataset(job.dataset))
    with folder.lock(task.id):
        return folder.finished(task.id) or run_one(task, folder)


def _sees(path: Path) -> bool:
    return path.exists() and os.access(path.parent, os.W_OK)


def _sha256_there(path: Path) -> str | None:
    try:
        return open_dataset(path).sha256
    except DataError:
        return None


def _fault_of(ended: Future[RunRecord], expected_id: str) -> str | None:
    """Why the record of a call cannot be kept, in words; None where it can."""
    error = ended.exception()
    if error:
        return str(error)
    if ended.result().id == expected_id:
        return None
    return (
        "the worker has other code of the method than this process, or other data; nothing of it is kept. Restart "
        "the workers with the same code."
    )
