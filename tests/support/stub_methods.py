"""Methods that keep the contract of `xfreqbench.methods.contract.Method` or break it, each in one way."""

from __future__ import annotations

import math
import time
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
        self.closed = False

    def fit(self, train, budget, seed):
        try:
            for step in range(1, 10**9):
                time.sleep(self.config.pause_s)
                yield Progress(step, 1 / step)
        finally:
            self.closed = True

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


class Told(Endless):
    """Remembers the shares of the budget that it is told."""

    def fit(self, train, budget, seed):
        self.shares = []
        for step in range(1, 9):
            time.sleep(self.config.pause_s)
            self.shares.append((yield Progress(step, math.nan)))


class Plain(Endless):
    """Its `fit` is no generator, but a plain iterator."""

    def fit(self, train, budget, seed):
        return iter([Progress(1, 1.0), Progress(2, 0.5)])


class Delegating(Endless):
    """A generator that leaves its yields to an iterator that takes no share."""

    def fit(self, train, budget, seed):
        yield from self.steps()

    def steps(self):
        yield from map(Progress, (1, 2, 3), (1.0, 0.5, 0.25))


class Losing(Endless):
    """Yields the losses it is given."""

    losses: tuple[float, ...] = ()

    def fit(self, train, budget, seed):
        for step, loss in enumerate(self.losses, start=1):
            yield Progress(step, loss)


class Untidy(Short):
    """Takes its time when it is closed."""

    def fit(self, train, budget, seed):
        try:
            yield from super().fit(train, budget, seed)
        finally:
            time.sleep(self.config.pause_s)


class Resumed(Endless):
    """Goes on after `step`."""

    step = 0

    def fit(self, train, budget, seed):
        while True:
            time.sleep(self.config.pause_s)
            self.step += 1
            yield Progress(self.step, 1.0, {"gaussians": 10 * self.step})


class Silent(Endless):
    def fit(self, train, budget, seed):
        yield from ()


class Loose(Endless):
    def fit(self, train, budget, seed):
        yield 0.5


class Incomplete:
    def fit(self, train, budget, seed): ...


class WithoutConfig(Short):
    def __init__(self): ...


class WithoutDefault(Short):
    def __init__(self, config):
        self.config = config


class ConfiguredByADict(Short):
    def __init__(self, config=None):
        self.config = config or {"hidden": 1}


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
