"""Methods that raise, leave, fork or answer nonsense: each is told by its name, and nothing is recorded of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from xfreqbench.baselines.nearest import Nearest

from tests.support.fuzzing.common import xfreqbench
from tests.support.stub_methods import lofo_job, run_job, run_jobs
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import find_split
from xfreqbench.errors import DataError, MethodError
from xfreqbench.exchange.score_file import score_file
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.runs import checkpoints, records


class Leaving(Nearest):
    """Raises `error` in the part of its contract that `part` names."""

    part, error = "", SystemExit(0)

    def _reach(self, part):
        if self.part == part:
            raise self.error

    def fit(self, train, budget, seed):
        self._reach("fit")
        if self.part == "count":
            self.num_parameters = float("nan")
        yield from super().fit(train, budget, seed)
        yield Progress(2, 0.0)

    def predict(self, tx_position_m, carrier_hz):
        self._reach("predict")
        return super().predict(tx_position_m, carrier_hz)

    def save(self, directory):
        self._reach("save")

    def findings(self):
        self._reach("findings")
        return {"text": "\udcff"} if self.part == "text" else {}


class UnheardError(Exception):
    def __str__(self):
        raise ValueError


class Faint(Nearest):
    """Its maps have power in one direction alone, `peak`."""

    peak = 1.0

    def predict(self, tx_position_m, carrier_hz):
        maps = np.zeros((len(carrier_hz), 90, 360), np.float32)
        maps[:, 3, 4] = self.peak
        return maps


MEASURED = ("fit_seconds", "fit_processor_seconds", "predict_ms_per_map", "peak_memory_mib")
PARTS = ("fit", "predict", "save", "findings")
ERRORS = (GeneratorExit(), UnheardError(), RuntimeError("half a pair: \udcff"))


@pytest.mark.parametrize(
    ("part", "error", "words"),
    [
        *((part, SystemExit(0), rf"Leaving' failed in {part} on split .*SystemExit: ") for part in PARTS),
        *(("fit", error, rf"Leaving' failed in fit on split .*{type(error).__name__}: ") for error in ERRORS),
        ("count", None, r"Leaving\.num_parameters is nan, a float"),
        ("text", None, r"Leaving' failed in findings on split .*surrogate"),
    ],
    ids=repr,
)
def test_whatever_a_method_raises_or_says_that_no_record_can_hold_names_the_method_and_the_part(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str, error: BaseException, words: str
) -> None:
    monkeypatch.setattr(Leaving, "part", part)
    monkeypatch.setattr(Leaving, "error", error)
    monkeypatch.setattr(checkpoints, "CHECKPOINT_SECONDS", 0.0)
    with pytest.raises(MethodError, match=words) as raised:
        run_job(lofo_job(dataset, f"{__name__}:Leaving", budget=Budget(max_steps=9)), tmp_path)
    str(raised.value).encode()
    assert not (tmp_path / "records.jsonl").exists()


@pytest.mark.parametrize("part", PARTS)
def test_an_interrupted_method_is_no_broken_one(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    wrapped = SystemError("a kernel was interrupted")
    wrapped.__cause__ = KeyboardInterrupt()
    monkeypatch.setattr(Leaving, "part", part)
    monkeypatch.setattr(checkpoints, "CHECKPOINT_SECONDS", 0.0)
    for seed, error in enumerate((KeyboardInterrupt(), wrapped)):
        monkeypatch.setattr(Leaving, "error", error)
        with pytest.raises(KeyboardInterrupt):
            run_job(lofo_job(dataset, f"{__name__}:Leaving", budget=Budget(max_steps=9), seed=seed), tmp_path)


FORKING = """
import os
from xfreqbench.baselines.nearest import Nearest

class Forking(Nearest):
    fails = False

    def fit(self, train, budget, seed):
        self.child = os.fork()
        yield from super().fit(train, budget, seed)
        if self.child:
            os.waitpid(self.child, 0)
        elif self.fails:
            raise RuntimeError("in the child")

class Failing(Forking):
    fails = True

class Ending(Nearest):
    def fit(self, train, budget, seed):
        yield from super().fit(train, budget, seed)
        os._exit(0)
"""


def test_a_fit_that_forks_is_recorded_once_and_one_that_ends_its_process_stops_no_other(
    dataset: PasDataset, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(FORKING)
    options = f"--data {dataset.path} --results results --targets 77 --methods mine:Ending,mine:Forking,mine:Failing"
    command = [sys.executable, "-m", "xfreqbench.cli", "run", *options.split()]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    # each once before the clock starts, and once in the fit
    assert done.stderr.count("it forked the process; the child ends here") == 4
    assert "1 of 3 runs failed" in done.stderr
    assert "mine:Ending on lofo-77GHz" in done.stderr
    assert "ended itself with exit status 0" in done.stderr
    stored = records.read(tmp_path / "results" / "records.jsonl").records
    assert sorted(record.job.method for record in stored) == ["mine:Failing", "mine:Forking"]
    assert not list(tmp_path.glob("results/predictions/*.lock"))


class Centring(Nearest):
    """Changes the training data that it is given."""

    def fit(self, train, budget, seed):
        for values in (train.tables["tx_position_m"], train.tx_position_m, train.header.carrier_hz, train.rows):
            values[:] = values[0]
        train.grid.azimuth_rad[:] = 0
        train.header.settings.clear()
        yield from super().fit(train, budget, seed)


def test_what_a_fit_does_to_its_training_data_changes_no_other_run(dataset: PasDataset, tmp_path: Path) -> None:
    jobs = [lofo_job(dataset, name) for name in (f"{__name__}:Centring", "line-of-sight")]
    _, after = run_jobs(jobs, tmp_path / "after")
    assert after == run_job(jobs[1], tmp_path / "alone").model_copy(
        update={name: getattr(after, name) for name in ("time_utc", *MEASURED)}
    )


def test_a_method_that_exits_does_not_look_like_success(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "leaving.py").write_text("import sys\n\nsys.exit(0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    words = f"run --data {dataset.path} --results {tmp_path / 'results'} --targets 77 --method leaving:Method"
    done = xfreqbench(*words.split())
    assert done.code == 2
    assert "Method 'leaving:Method' cannot be imported: SystemExit: 0" in done.stderr


@pytest.mark.parametrize("peak", [0.0, 1.0, 1e-7, 0.5])
def test_a_run_and_a_file_of_predictions_accept_the_same_maps(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, peak: float
) -> None:
    monkeypatch.setattr(Faint, "peak", peak)
    split = find_split(dataset, "lofo", "lofo-24.25GHz")
    maps = Faint().predict(np.zeros((len(split.test), 3)), np.zeros(len(split.test)))
    path = tmp_path / "file.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group(split.name)
        group["pas"] = maps
        group.attrs.update(split_sha256=split.sha256, method="theirs")
    job = lofo_job(dataset, f"{__name__}:Faint")
    if 0 < peak < 1:
        with pytest.raises(MethodError, match=rf"the map of row \d+ has its peak at {peak:g}\. Divide each map"):
            run_job(job, tmp_path / "run")
        with pytest.raises(DataError, match=rf"has its peak at {peak:g}\. Divide each map"):
            score_file(path, Path(dataset.path), tmp_path / "scored")
    else:
        ran = run_job(job, tmp_path / "run")
        (scored,) = score_file(path, Path(dataset.path), tmp_path / "scored").records
        assert ran.scores["ssim"] == scored.scores["ssim"]
