"""Methods that learn one map by gradient descent, with whatever has to be seen of their fits when they are killed."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from tests.support.places import ROOT
from tests.support.stub_methods import run_job
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.runs import checkpoints
from xfreqbench.runs.checkpoints import Checkpoint, CheckpointFolder
from xfreqbench.runs.predictions import read_predictions
from xfreqbench.runs.records import Job, RunRecord

NUM_STEPS = 200


@dataclass(frozen=True)
class DescentConfig:
    learning_rate: float = 0.5


class Descent:
    """One map for every query, by stochastic gradient descent with momentum and a falling step length."""

    num_parameters = 90 * 360
    num_steps_done: ClassVar[int] = 0
    pause_s: ClassVar[float] = 0.0
    interrupt_at: ClassVar[int | None] = None
    waits_at: ClassVar[int | None] = None

    def __init__(self, config=DescentConfig()):
        self.config = config
        self.step, self.share = 0, 0.0
        self.map, self.velocity = np.zeros((2, 90, 360))
        self.random_state = None

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Generator[Progress, float, None]:
        generator = np.random.default_rng(seed)
        if self.random_state:
            generator.bit_generator.state = self.random_state
        truth = train.pas(np.arange(len(train)))
        self.share = max(self.share, budget.share(self.step, 0.0))
        while True:
            self._interrupt()
            gradient = self.map - truth[generator.integers(len(train))]
            self.velocity = 0.5 * self.velocity - self.config.learning_rate * (1 - self.share) * gradient
            self.map = self.map + self.velocity
            self.step += 1
            self.random_state = generator.bit_generator.state
            type(self).num_steps_done += 1
            self.share = yield Progress(self.step, self._loss(gradient), {"maps": self.step})

    def _loss(self, gradient):
        return float((gradient**2).mean())

    def _interrupt(self):
        time.sleep(3600 if self.step == self.waits_at else self.pause_s)
        if self.step == self.interrupt_at:
            raise KeyboardInterrupt

    def predict(self, tx_position_m, carrier_hz):
        peak = np.clip(self.map / self.map.max(), 0, 1).astype(np.float32)
        return np.repeat(peak[None], len(carrier_hz), axis=0)

    def save(self, directory):
        np.savez(directory / "maps.npz", map=self.map, velocity=self.velocity)
        state = [self.config.learning_rate, self.step, self.share, self.random_state]
        (directory / "state.json").write_text(json.dumps(state))

    @classmethod
    def load(cls, directory):
        learning_rate, *state = json.loads((directory / "state.json").read_text())
        method = cls(DescentConfig(learning_rate))
        method.step, method.share, method.random_state = state
        stored = np.load(directory / "maps.npz")
        method.map, method.velocity = stored["map"], stored["velocity"]
        return method


class Forgetful(Descent):
    """Loads what `predict` needs, and fits anew."""

    def fit(self, train, budget, seed):
        self.__init__(self.config)
        yield from super().fit(train, budget, seed)


class Exploding(Descent):
    """Loses its finite loss at the third step."""

    def _loss(self, gradient):
        return math.inf if self.step == 3 else super()._loss(gradient)


def make_job(dataset: PasDataset, name: str = "Descent", max_steps: int = NUM_STEPS, **options) -> Job:
    method = f"{__name__}:{name}"
    return Job(str(dataset.path), method, "lofo", "lofo-24.25GHz", budget=Budget(max_steps), **options)


def fit_half(path: str, results: str) -> None:
    """What the process that is killed runs: half of the steps, saved every 0.05 s, and then it waits for its end."""
    checkpoints.CHECKPOINT_SECONDS = 0.05
    Descent.pause_s = 0.01
    Descent.waits_at = NUM_STEPS // 2
    run_job(make_job(open_dataset(Path(path))), Path(results))


def killed_after_three_checkpoints(code: str, folder: CheckpointFolder) -> Checkpoint:
    """What the newest checkpoint of a fit holds that is made by some code in a process of its own, and killed."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([sys.executable, "-c", code], env=environment)
    while (newest := folder.newest()) is None or int(newest.name) < 3:
        assert process.poll() is None, "the fit ended before it could be killed"
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    saved = folder.read()
    assert saved is not None
    return saved


def maps(results: Path, record: RunRecord) -> bytes:
    batches = read_predictions(results / "predictions" / f"{record.id}.h5").batches(100)
    return b"".join(batch.tobytes() for _, batch in batches)


def curve(record: RunRecord) -> list[tuple[int, float, float]]:
    return [(point.step, point.loss, point.ssim) for point in record.curve]
