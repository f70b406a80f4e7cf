"""Runs on workers: what they have to see is checked first, and this process alone keeps their records."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from uuid import uuid4

from xfreqbench.dataset import open_dataset
from xfreqbench.errors import ClusterError, DataError
from xfreqbench.parallel import Workers, side_by_side
from xfreqbench.records import Job, RunRecord
from xfreqbench.run import keep, run_unkept, unfinished
from xfreqbench.storage import storage_errors

ProgressCallback = Callable[[int, int, Job], None]


def run_on(workers: Workers, jobs: Sequence[Job], results_dir: Path, progress: ProgressCallback) -> list[str]:
    """Run jobs that are not in `results_dir` yet, as many at a time as there are places for them.

    Returns what went wrong, in words, a line a failed job; one failure stops no other job. `progress` is
    told jobs done, jobs in all and the job after each one. Everything that can be checked is checked before
    the first run, and raises the `XFreqBenchError` that it is: `ClusterError` for workers that do not see
    the data sets and `results_dir` as this process does.
    """
    missing = unfinished(jobs, results_dir)
    require_shared_folder(workers, results_dir)
    require_shared_datasets(workers, dict.fromkeys(job.dataset for job in missing))
    done, failures = len(jobs) - len(missing), []
    call = partial(_run_there, folder=Path.cwd(), results_dir=results_dir)
    for job, ended in side_by_side(workers, call, missing):
        done += 1
        error = ended.exception() or _refusal(ended.result(), missing[job])
        if error:
            failures.append(f"{job.method} on {job.split}, seed {job.seed}: {error}")
        else:
            keep(ended.result().model_copy(update={"job": job}), results_dir)
        progress(done, len(jobs), job)
    return failures


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


def _run_there(job: Job, folder: Path, results_dir: Path) -> RunRecord:
    """On the worker: a run whose relative paths start at the driver's `folder`."""
    return run_unkept(replace(job, dataset=str(folder / job.dataset)), folder / results_dir)


def _sees(path: Path) -> bool:
    return path.exists() and os.access(path.parent, os.W_OK)


def _sha256_there(path: Path) -> str | None:
    try:
        return open_dataset(path).sha256
    except DataError:
        return None


def _refusal(record: RunRecord, expected_id: str) -> str | None:
    if record.id == expected_id:
        return None
    return (
        "the worker has other code of the method than this process, or other data; nothing of it is kept. Restart "
        "the workers with the same code."
    )
