"""Methods that keep the contract of `xfreqbench.methods.contract.Method` or break it, and jobs of them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from xfreqbench.baselines.nearest import Nearest

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.splits import find_split
from xfreqbench.errors import RunsFailedError
from xfreqbench.methods.contract import Progress
from xfreqbench.runs import run
from xfreqbench.runs.jobs import Task
from xfreqbench.runs.predictions import read_predictions
from xfreqbench.runs.records import Job, RunRecord


@dataclass(frozen=True)
class EndlessConfig:
    pause_s: float = 0.0


class Endless:
    """Trains for ever and predicts `answer`."""

    num_parameters = 0
    answer: object = None

    def __init__(self, config=EndlessConfig()):
        self.config = config

    def fit(self, train, budget, seed):
        for step in range(1, 10**9):
            yield Progress(step, 1 / step)

    def predict(self, tx_position_m, carrier_hz):
        return self.answer

    def save(self, directory): ...

    @classmethod
    def load(cls, directory): ...


class Short(Endless):
    """Ends by itself after three steps."""

    def fit(self, train, budget, seed):
        for step in (1, 2, 3):
            yield Progress(step, math.nan)


class FailsInFit(Nearest):
    def fit(self, train, budget, seed):
        raise RuntimeError("no memory left")
        yield


def lofo_job(dataset: PasDataset, method: str = "nearest", split: str = "lofo-24.25GHz", **options) -> Job:
    """A fit of a method to all carriers of a data set but one."""
    return Job(str(dataset.path), method, "lofo", split, **options)


def task_of(job: Job) -> Task:
    """A job with its data set and its split, which are found by their names."""
    dataset = open_dataset(job.dataset)
    return Task.of(job, dataset, find_split(dataset, job.protocol, job.split))


def run_jobs(jobs: Iterable[Job], results_dir: Path, *workers, **callbacks) -> list[RunRecord]:
    """`xfreqbench.runs.run.run_jobs` of jobs by name."""
    return run.run_jobs([task_of(job) for job in jobs], results_dir, *workers, **callbacks)


def run_job(job: Job, results_dir: Path) -> RunRecord:
    """The record of one job; raises its own error."""
    try:
        return run_jobs([job], results_dir)[0]
    except RunsFailedError as failed:
        (error,) = failed.errors.values()
        raise error from None


def maps(results: Path, record: RunRecord) -> bytes:
    batches = read_predictions(results / "predictions" / f"{record.id}.h5").batches(100)
    return b"".join(batch.tobytes() for _, batch in batches)


def curve(record: RunRecord) -> list[tuple[int, float, float]]:
    return [(point.step, point.loss, point.ssim) for point in record.curve]
