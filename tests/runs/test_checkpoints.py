"""A fit that is killed goes on from its last checkpoint, and ends as if nothing had happened."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from unittest.mock import Mock

import numpy as np
import pytest
from pydantic_core import from_json

from tests.support.clock import set_clock
from tests.support.damage import flip
from tests.support.places import ROOT
from tests.support.stub_methods import curve, lofo_job, maps, run_job, run_jobs
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.errors import DataError, DivergenceError, MethodError, StorageError
from xfreqbench.methods import fitting
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.fitting import Fit
from xfreqbench.runs import checkpoints
from xfreqbench.runs.checkpoints import Checkpoint, CheckpointFolder
from xfreqbench.runs.records import Job
from xfreqbench.runs.sealed import SEAL, content_sha256

NUM_STEPS = 200
WARM_UP_STEPS = 1  # of another method of the kind, before the clock of a fit starts


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
    return lofo_job(dataset, f"{__name__}:{name}", budget=Budget(max_steps), **options)


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


@pytest.fixture(autouse=True)
def undisturbed(monkeypatch: pytest.MonkeyPatch) -> None:
    for method in (Descent, Forgetful):
        monkeypatch.setattr(method, "num_steps_done", 0)
        monkeypatch.setattr(method, "interrupt_at", None)


@pytest.fixture
def saves_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoints, "CHECKPOINT_SECONDS", 0.0)


def interrupted(dataset: PasDataset, results: Path, method: type[Descent], step: int, **options) -> None:
    method.interrupt_at = step
    with pytest.raises(KeyboardInterrupt):
        run_job(make_job(dataset, method.__name__, **options), results)
    method.interrupt_at, method.num_steps_done = None, 0


def test_a_fit_killed_in_the_middle_ends_in_the_bytes_of_an_unbroken_one(dataset: PasDataset, tmp_path: Path) -> None:
    unbroken = run_job(make_job(dataset), tmp_path / "unbroken")
    results = tmp_path / "killed"
    code = f"from {__name__} import fit_half; fit_half({str(dataset.path)!r}, {str(results)!r})"
    folder = CheckpointFolder(results / "checkpoints" / unbroken.id, unbroken.id)
    saved = killed_after_three_checkpoints(code, folder)
    assert not (results / "records.jsonl").exists()

    Descent.num_steps_done = 0
    resumed = run_job(make_job(dataset), results)
    assert 0 < Descent.num_steps_done < NUM_STEPS
    assert maps(results, resumed) == maps(tmp_path / "unbroken", unbroken)
    assert curve(resumed) == curve(unbroken)
    assert (resumed.step, resumed.counts) == (NUM_STEPS, {"maps": NUM_STEPS})
    assert resumed.fit_seconds > saved.fit.seconds
    assert not (results / "checkpoints" / resumed.id).exists()


@pytest.mark.usefixtures("saves_every_step")
def test_a_method_that_starts_anew_is_not_charged_twice(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_clock(monkeypatch, fitting, sys.modules[__name__])
    monkeypatch.setattr(Forgetful, "pause_s", 1)
    unbroken = run_job(make_job(dataset, "Forgetful", 20), tmp_path / "unbroken")
    interrupted(dataset, tmp_path, Forgetful, 10, max_steps=20)
    resumed = run_job(make_job(dataset, "Forgetful", 20), tmp_path)
    assert Forgetful.num_steps_done == WARM_UP_STEPS + 20
    assert curve(resumed) == curve(unbroken)
    assert resumed.fit_seconds == unbroken.fit_seconds == 20


@pytest.mark.usefixtures("saves_every_step")
def test_a_resumed_fit_is_warmed_up_before_its_clock_starts(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_clock(monkeypatch, fitting, sys.modules[__name__])
    monkeypatch.setattr(Descent, "pause_s", 1)
    interrupted(dataset, tmp_path, Descent, 5, max_steps=10)
    resumed = run_job(make_job(dataset, max_steps=10), tmp_path)
    assert Descent.num_steps_done == WARM_UP_STEPS + 10 - 5
    assert resumed.fit_seconds == 10


@pytest.mark.usefixtures("saves_every_step")
def test_a_fit_whose_budget_was_spent_is_not_fitted_again(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("xfreqbench.runs.run.write_predictions", lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            run_job(make_job(dataset, max_steps=5), tmp_path)
    assert run_job(make_job(dataset, max_steps=5), tmp_path).step == 5
    assert Descent.num_steps_done == WARM_UP_STEPS + 5


@pytest.mark.usefixtures("saves_every_step")
def test_a_checkpoint_is_another_jobs_under_another_seed_or_option(dataset: PasDataset, tmp_path: Path) -> None:
    interrupted(dataset, tmp_path, Descent, 5, max_steps=10)
    for options in ({"seed": 1}, {"overrides": ("learning_rate=0.25",)}):
        Descent.num_steps_done = 0
        run_job(make_job(dataset, max_steps=10, **options), tmp_path)
        assert Descent.num_steps_done == WARM_UP_STEPS + 10


def test_a_short_fit_leaves_no_trace_of_checkpoints(dataset: PasDataset, tmp_path: Path) -> None:
    run_job(make_job(dataset, max_steps=3), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["methods", "predictions", "records.jsonl"]


@pytest.mark.usefixtures("saves_every_step")
def test_a_damaged_checkpoint_is_told_before_the_first_fit(dataset: PasDataset, tmp_path: Path) -> None:
    interrupted(dataset, tmp_path, Descent, 5, max_steps=10)
    (damaged,) = tmp_path.glob("checkpoints/*/*/method/maps.npz")
    flip(damaged, damaged.stat().st_size - 1000)
    jobs = [make_job(dataset, max_steps=4), make_job(dataset, max_steps=10)]
    with pytest.raises(DataError, match=r"checkpoints/\w+ is damaged: maps\.npz .*Delete that folder"):
        run_jobs(jobs, tmp_path)
    assert Descent.num_steps_done == 0


@pytest.mark.parametrize(
    ("seconds", "left"),
    [(0.0, r"its last good checkpoint is .*checkpoints/\w+/2"), (math.inf, "it has no checkpoint yet")],
)
def test_a_fit_that_diverges_names_its_job_and_its_last_good_checkpoint(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seconds: float, left: str
) -> None:
    monkeypatch.setattr(checkpoints, "CHECKPOINT_SECONDS", seconds)
    words = (
        rf"loss is not finite at step 3\. Method 'tests\.runs\.test_checkpoints:Exploding' diverged on split .*{left}"
    )
    with pytest.raises(DivergenceError, match=words) as raised:
        run_job(make_job(dataset, "Exploding"), tmp_path)
    assert (raised.value.step, raised.value.tensor) == (3, "loss")
    assert "--set learning_rate=" in str(raised.value)


@pytest.fixture
def folder(tmp_path: Path) -> CheckpointFolder:
    return CheckpointFolder(tmp_path / "checkpoints" / "abc", "abc")


def save(folder: CheckpointFolder, step: int, method: Descent | None = None) -> None:
    folder.write(method or Descent(), Fit(step, math.nan, 2.5, 0.25, {"gaussians": 3.0}), ())


def names(folder: CheckpointFolder) -> list[str]:
    return sorted(path.name for path in folder.path.iterdir())


def test_a_checkpoint_comes_back_as_it_was_written(folder: CheckpointFolder) -> None:
    assert folder.read() is None
    for step in (1, 2, 7):
        save(folder, step)
    assert names(folder) == ["3"]  # the newest is kept alone
    checkpoint = folder.read()
    assert math.isnan(checkpoint.loss)
    assert (checkpoint.fit.step, checkpoint.fit.seconds, checkpoint.fit.share) == (7, 2.5, 0.25)
    assert checkpoint.fit.counts == {"gaussians": 3}
    assert sorted(checkpoint.sha256) == ["maps.npz", "state.json"]


def test_a_fit_that_goes_on_while_its_checkpoint_is_read_is_not_called_damaged(
    folder: CheckpointFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    save(folder, 1)
    hashed = checkpoints._sha256_by_name

    def overtaken(path: Path) -> dict[str, str]:
        if folder.newest().name == "1":
            monkeypatch.setattr(checkpoints, "_sha256_by_name", hashed)
            save(folder, 2)
        return hashed(path)

    monkeypatch.setattr(checkpoints, "_sha256_by_name", overtaken)
    assert folder.read().step == 2


@pytest.fixture
def killed(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    def while_it_calls(module: object, name: str, call: Callable[..., None], *given: object) -> None:
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(module, name, Mock(side_effect=KeyboardInterrupt))
            call(*given)

    return while_it_calls


def test_a_kill_leaves_the_checkpoint_before_or_the_new_one_and_never_a_half(
    folder: CheckpointFolder, killed: Callable[..., None]
) -> None:
    save(folder, 1)
    killed(json, "dumps", save, folder, 2)  # the maps are saved by then
    assert folder.read().step == 1
    save(folder, 3)
    assert (names(folder), folder.read().step) == (["2"], 3)
    killed(shutil, "rmtree", save, folder, 4)  # of the old one
    half, new = names(folder)
    assert (half.endswith(".partial"), new, folder.read().step) == (True, "3", 4)
    save(folder, 5)
    assert names(folder) == ["4"]
    killed(shutil, "rmtree", folder.remove)
    assert folder.read() is None
    folder.remove()
    assert list(folder.path.parent.iterdir()) == []


@pytest.mark.parametrize("place", ["", "2/method/state.safetensors", "1/checkpoint.json"])
def test_what_somebody_else_has_put_there_is_not_removed(folder: CheckpointFolder, place: str) -> None:
    if place.startswith("2"):
        save(folder, 1)
    theirs = folder.path / place
    theirs.parent.mkdir(parents=True, exist_ok=True)
    theirs.write_text("years of work", encoding="utf-8")
    with pytest.raises(DataError, match="and is not removed"):
        folder.remove()
    assert theirs.read_text(encoding="utf-8") == "years of work"


def test_a_link_in_a_checkpoints_place_is_not_followed(folder: CheckpointFolder, tmp_path: Path) -> None:
    somebodys = tmp_path / "chapters"
    (somebodys / "1").mkdir(parents=True)
    (somebodys / "1" / "thesis.tex").write_text("years of work", encoding="utf-8")
    folder.path.parent.mkdir(parents=True, exist_ok=True)
    folder.path.symlink_to(somebodys, target_is_directory=True)
    with pytest.raises(DataError, match="symbolic link"):
        folder.read()
    with pytest.raises(DataError, match="symbolic link"):
        save(folder, 2)
    folder.remove()
    assert (somebodys / "1" / "thesis.tex").exists() and not folder.path.is_symlink()


def sealed(name: str, value: object) -> Callable[[str], str]:
    """A change of one number of a state, which then has the hash of what it says."""

    def change(text: str) -> str:
        content = from_json(json.dumps({**json.loads(text), name: value}))
        del content[SEAL]
        return json.dumps(content | {SEAL: content_sha256(content)})

    return change


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda text: "{}", "cannot be read"),
        (lambda text: text.replace('"step":7', '"step":8'), "it was changed after it was written.*Delete that folder"),
        (sealed("seconds", -1.0), "cannot be read: seconds: "),
        (sealed("seconds", "NaN"), "cannot be read: seconds: "),
        (sealed("step", 10**400), "cannot be read: step: "),
    ],
)
def test_a_checkpoint_of_another_job_or_with_another_state_is_refused(
    folder: CheckpointFolder, change: Callable[[str], str], told: str
) -> None:
    save(folder, 7)
    with pytest.raises(DataError, match=r"checkpoints/abc belongs to job abc, not to xyz\. Delete"):
        CheckpointFolder(folder.path, "xyz").read()
    state = folder.path / "1" / "checkpoint.json"
    state.write_text(change(state.read_text()))
    with pytest.raises(DataError, match=told):
        folder.read()


def test_a_method_that_cannot_load_its_own_files_is_told_where_they_are(folder: CheckpointFolder) -> None:
    save(folder, 1)
    (folder.path / "1" / "method" / "state.json").unlink()
    words = r"checkpoints/abc cannot be loaded: Descent\.load raised FileNotFoundError.*Delete"
    with pytest.raises(MethodError, match=words):
        folder.load(Descent())


@pytest.mark.parametrize("name", ["checkpoint.json", "method/state.json"])
def test_a_checkpoint_on_a_disk_that_fails_is_not_to_be_deleted(folder: CheckpointFolder, name: str) -> None:
    save(folder, 1)
    (folder.path / "1" / name).unlink()
    (folder.path / "1" / name).symlink_to("/proc/self/mem")  # which the system opens, and cannot read
    readings: list[Callable[[], object]] = [folder.read]
    if name != "checkpoint.json":
        readings.append(lambda: folder.load(Descent()))
    for reading in readings:
        with pytest.raises(StorageError, match=r"cannot be read: Input/output error\. Try again later\.$"):
            reading()


def test_a_method_that_comes_back_with_another_configuration_is_refused(folder: CheckpointFolder) -> None:
    save(folder, 1, Descent(DescentConfig(0.125)))
    assert folder.load(Descent(DescentConfig(0.125))).config == DescentConfig(0.125)
    with pytest.raises(DataError, match=r"has configuration .*0\.125.*but the job has .*0\.5"):
        folder.load(Descent())
