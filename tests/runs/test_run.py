from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from xfreqbench.baselines.nearest import Nearest

from tests.support.clock import Clock, set_clock
from tests.support.damage import flip
from tests.support.forked import command_line
from tests.support.stub_methods import lofo_job, run_job, run_jobs, task_of
from xfreqbench.cli import runs
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import find_split
from xfreqbench.errors import ClusterError, DataError, InUseError, StorageError, XFreqBenchError
from xfreqbench.exchange.score_file import score_file
from xfreqbench.maps.metrics import METRICS
from xfreqbench.methods import fitting
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.runs import fit, records
from xfreqbench.runs import run as runner
from xfreqbench.runs.benchmark import Benchmark
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.predictions import read_predictions
from xfreqbench.runs.records import Job
from xfreqbench.runs.run import run
from xfreqbench.system import files

ON_A_TERMINAL = {"FORCE_COLOR": "1", "TTY_INTERACTIVE": "1", "COLUMNS": "200"}  # as Rich is told


@dataclass(frozen=True)
class WeightsConfig:
    weights: Path = Path("weights.pt")


class WithAPath(Nearest):
    Config = WeightsConfig


@dataclass(frozen=True)
class DeviceConfig:
    device: str = "cpu"


class Stepwise(Nearest):
    """Knows more maps at every step, and sleeps for a second where it predicts."""

    Config = DeviceConfig
    sleep: ClassVar[Callable[[float], None]] = staticmethod(lambda seconds: None)

    def fit(self, train, budget, seed):
        for step in range(1, 33):
            self.level = step / 32
            yield from super().fit(train, budget, seed) if step == 1 else [Progress(step, 1 - self.level)]

    def predict(self, tx_position_m, carrier_hz):
        type(self).sleep(1)
        return super().predict(tx_position_m, carrier_hz) ** np.float32(1 / self.level)


class Compiling(Stepwise):
    """Its first step in a process takes a minute, and more rows than a warm-up has are needed for `num_rows`."""

    compiled: ClassVar[bool] = False
    num_rows: ClassVar[int] = 0

    def fit(self, train, budget, seed):
        if not type(self).compiled:
            type(self).sleep(60)
        type(self).compiled = True
        if len(train) < self.num_rows:
            raise ValueError("too few rows")
        yield from super().fit(train, budget, seed)


def test_a_record_holds_the_scores_of_the_predictions_of_the_test_rows(dataset: PasDataset, tmp_path: Path) -> None:
    record, split = run_job(lofo_job(dataset), tmp_path), find_split(dataset, "lofo", "lofo-24.25GHz")
    predictions = read_predictions(tmp_path / "predictions" / f"{record.id}.h5")
    np.testing.assert_array_equal(predictions.rows, split.test)
    assert predictions.split_sha256 == split.sha256 == record.split_sha256
    assert predictions.dataset_sha256 == dataset.sha256 == record.dataset_sha256
    assert (record.pas_kind, record.settings) == ("power", dataset.header.settings)
    (rows, maps), *_ = predictions.batches(100)
    for name, metric in METRICS.items():
        expected = metric.score(maps, dataset.pas(rows), dataset.grid)
        assert record.scores[name].mean == pytest.approx(expected.mean())
        assert record.scores[name].median == pytest.approx(np.median(expected))
        assert record.scores[name].quantiles[0] == pytest.approx(expected.min(), abs=5e-5)  # as stored
        assert record.scores[name].quantiles[100] == pytest.approx(expected.max(), abs=5e-5)
        assert record.scores[name].median_by_carrier_hz == {"24250000000": pytest.approx(np.median(expected))}
    assert record.num_test == len(rows) == 5


def test_whatever_determines_the_result_changes_the_id(dataset: PasDataset) -> None:
    changes = [{}, {"seed": 1}, {"overrides": ("num_nearest=2",)}, {"split": "lofo-77GHz"}, {"method": "nearest"}]
    jobs = [lofo_job(dataset, **{"method": "mean-over-frequency", **change}) for change in changes]
    assert len({task_of(job).id for job in jobs}) == len(jobs)


def test_progress_counts_the_jobs(dataset: PasDataset, tmp_path: Path) -> None:
    seen = []
    jobs = [lofo_job(dataset), lofo_job(dataset, "line-of-sight")]
    records = run_jobs(jobs, tmp_path, progress=lambda *ended: seen.append(ended))
    assert seen == [(1, 2, jobs[0], records[0]), (2, 2, jobs[1], records[1])]


def test_damaged_data_are_refused_before_the_first_fit(dataset: PasDataset, tmp_path: Path) -> None:
    path = tmp_path / "damaged.h5"
    shutil.copyfile(dataset.path, path)
    flip(path, path.stat().st_size - 200_000)
    with pytest.raises(DataError, match="damaged"):
        run_jobs([Job(str(path), "nearest", "lofo", "lofo-77GHz")], tmp_path / "results")


def test_a_second_process_is_told_who_runs_jobs_in_the_folder(dataset: PasDataset, tmp_path: Path) -> None:
    with ResultsFolder(tmp_path).alone(), ThreadPoolExecutor(1) as other:
        ran = other.submit(run_jobs, [lofo_job(dataset)], tmp_path)
        with pytest.raises(InUseError, match=rf"{tmp_path} is being written by process {os.getpid()} on .* Wait"):
            ran.result()
    assert len(run_jobs([lofo_job(dataset)], tmp_path)) == 1


def test_a_job_that_a_worker_without_a_driver_is_at_is_not_made_beside_it(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, job = ResultsFolder(tmp_path), lofo_job(dataset)
    monkeypatch.setattr(files, "_LONGEST_WAIT_S", 0.1)
    with (
        folder.lock(task_of(job).id),
        ThreadPoolExecutor(1) as other,
        pytest.raises(InUseError, match="is being written by process"),
    ):
        other.submit(run_job, job, tmp_path).result()
    assert not folder.records and not folder.predictions_paths()


def test_the_record_of_a_worker_with_other_code_is_not_stored(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record_of = runner.record_of
    monkeypatch.setattr(runner, "record_of", lambda _, *told: record_of("0" * 16, *told))
    with pytest.raises(ClusterError, match="A worker has other code of method 'nearest', or other data at "):
        run_job(lofo_job(dataset), tmp_path)
    assert not ResultsFolder(tmp_path).records


@pytest.mark.slow
def test_a_method_of_the_working_folder_is_imported_in_every_process_and_nothing_else_of_it(
    dataset: PasDataset, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text("from xfreqbench.baselines.nearest import Nearest\nclass Mine(Nearest): ...")
    for name in ("types", "cyclopts", "numpy", "pickle"):
        (tmp_path / f"{name}.py").write_text("open('imported', 'w')")
    command = [command_line(), "run", "--data", str(dataset.path), "--method", "mine:Mine", "--targets", "77"]
    for executor in ("serial", "2"):
        subprocess.run([*command, "--executor", executor, "--results", executor, "--quiet"], cwd=tmp_path, check=True)
        assert len(records.read(tmp_path / executor / "records.jsonl").records) == 1
    assert not (tmp_path / "imported").exists()


def test_running_needs_neither_sionna_nor_matplotlib() -> None:
    code = (
        "import sys, xfreqbench.runs.run, xfreqbench.report.leaderboard.report;"
        "print({'sionna', 'mitsuba', 'drjit', 'matplotlib'} & set(sys.modules))"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "set()"


def test_a_configuration_with_a_path_is_hashed_and_recorded(dataset: PasDataset, tmp_path: Path) -> None:
    record = run_job(lofo_job(dataset, f"{__name__}:WithAPath"), tmp_path)
    assert record.config == {"weights": "weights.pt"}
    assert records.read(tmp_path / "records.jsonl").records == (record,)


def test_a_name_that_no_record_can_hold_is_told_before_the_first_fit(dataset: PasDataset, tmp_path: Path) -> None:
    path, results = tmp_path / "caf\udce9.h5", tmp_path / "results"  # 0xE9, é of Latin-1, as Python reads file names
    shutil.copyfile(dataset.path, path)
    for refused in (
        lambda: run(path, "nearest", targets_ghz=24.25, results=results),
        lambda: run(dataset, {"nearest": ["neighbours=\udce9"]}, results=results),
        lambda: score_file(dataset.path, path, results),
        lambda: Benchmark("quick", path, results),
    ):
        with pytest.raises(StorageError, match=r"udce9.*' is not UTF-8, and a record cannot hold it\. Rename it"):
            refused()
    assert not results.exists()


@pytest.mark.parametrize("name", ["", "predictions"])
def test_results_that_cannot_be_written_are_told_before_the_first_fit(
    dataset: PasDataset, tmp_path: Path, name: str
) -> None:
    results = tmp_path / "results"
    if name:
        results.mkdir()
    (results / name).write_text("")
    with pytest.raises(StorageError, match="results"):
        run_jobs([lofo_job(dataset, "tests.support.stub_methods:FailsInFit")], results)


def test_the_time_of_a_prediction_leaves_our_checks_out(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = set_clock(monkeypatch, fitting)
    monkeypatch.setattr(fitting, "_fault_of", lambda *_: clock.sleep(1))
    assert run_job(lofo_job(dataset), tmp_path).predict_ms_per_map == 0
    assert clock.now_s >= 1


def run_stepwise(dataset: PasDataset, folder: Path, budget: Budget) -> records.RunRecord:
    return run_job(lofo_job(dataset, f"{__name__}:Stepwise", budget=budget), folder)


def test_a_learning_curve_has_a_point_at_each_share_of_the_budget_and_at_the_end(
    dataset: PasDataset, tmp_path: Path
) -> None:
    record = run_stepwise(dataset, tmp_path, Budget(max_steps=64))
    assert [point.step for point in record.curve] == [1, 2, 4, 8, 16, 32]  # it ends itself at 1/2
    ssim = [point.ssim for point in record.curve]
    assert ssim == sorted(ssim)
    assert ssim[-1] == pytest.approx(record.scores["ssim"].median, abs=1e-3)  # stored maps are packed
    assert [point.loss for point in record.curve][1:] == [1 - step / 32 for step in (2, 4, 8, 16, 32)]
    assert records.read(tmp_path / "records.jsonl").records[0].curve[1:] == record.curve[1:]


def test_a_learning_curve_is_not_charged(dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = set_clock(monkeypatch, fitting)
    monkeypatch.setattr(Stepwise, "sleep", clock.sleep)
    record = run_stepwise(dataset, tmp_path, Budget(max_steps=6))
    assert [point.step for point in record.curve] == [1, 2, 3, 6]  # shares of 1/6, 1/3, 1/2 and the end
    assert record.fit_seconds == 0
    assert clock.now_s > 4  # points of the curve alone


def test_without_a_budget_or_after_one_step_there_is_no_learning_curve(dataset: PasDataset, tmp_path: Path) -> None:
    assert run_stepwise(dataset, tmp_path, Budget()).curve == ()
    assert run_job(lofo_job(dataset, budget=Budget(max_steps=10)), tmp_path).curve == ()


def test_what_is_not_fitted_has_no_budget(dataset: PasDataset, tmp_path: Path) -> None:
    methods = {"nearest": (), "mean-over-frequency": ["num_nearest=1"], f"{__name__}:Stepwise": ()}
    found = run(dataset, methods, "lofo", tmp_path, targets_ghz=[77], budget="2steps")
    assert [record.job.budget.max_steps for record in found] == [None, 2, 2]  # one with options is no baseline
    with pytest.raises(XFreqBenchError, match="twelve"):
        run(dataset, "nearest", "lofo", tmp_path, budget="twelve")


def test_whoever_asks_is_told_of_every_step(dataset: PasDataset, tmp_path: Path) -> None:
    seen = []
    job = lofo_job(dataset, f"{__name__}:Stepwise", budget=Budget(max_steps=4))
    run_jobs([job], tmp_path, fitting=lambda *told: seen.append(told))
    assert [(told.step, told.share) for _, told in seen] == [(1, 0.25), (2, 0.5), (3, 0.75), (4, 1.0)]
    assert {told_job for told_job, _ in seen} == {job}


def run_cli(dataset: PasDataset, results: Path, method: str, **options: str) -> list[records.Job]:
    arguments = runs.RunArguments(results=results, targets_ghz="77", budget="1steps", **options)
    runs.run(data=dataset.path, method=f"nearest,{__name__}:{method}", options=arguments, quiet=True)
    return [record.job for record in records.read(results / "records.jsonl").records]


def test_a_list_of_seeds_is_a_run_each(dataset: PasDataset, tmp_path: Path) -> None:
    jobs = run_cli(dataset, tmp_path, "Stepwise", seeds="0, 2,2")
    names = ("nearest", f"{__name__}:Stepwise")
    assert [(job.method, job.seed) for job in jobs] == [(name, seed) for name in names for seed in (0, 2)]


@pytest.mark.parametrize("seed", ["", "1;2", "-1", "0.5"])
def test_a_seed_that_is_no_whole_number_is_refused(dataset: PasDataset, tmp_path: Path, seed: str) -> None:
    with pytest.raises(XFreqBenchError, match="--seeds takes whole numbers"):
        run_cli(dataset, tmp_path, "Stepwise", seeds=seed)


def test_a_device_is_an_option_of_the_methods_that_have_one(dataset: PasDataset, tmp_path: Path) -> None:
    assert [job.overrides for job in run_cli(dataset, tmp_path / "cpu", "Stepwise", device="cpu")] == [(), ()]
    on_cuda = run_cli(dataset, tmp_path / "cuda", "Stepwise", device="cuda")
    assert [job.overrides for job in on_cuda] == [(), ("device=cuda",)]


@pytest.mark.parametrize(("executor", "state"), [("serial", "step 4, loss 0.875"), (None, "step 1, 25% of the budget")])
def test_a_running_fit_is_shown(
    dataset: PasDataset,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    executor: str | None,
    state: str,
) -> None:
    """A fit in another process, which is that of a method of another package, is shown ten times a second."""
    for name, value in ON_A_TERMINAL.items():
        monkeypatch.setenv(name, value)
    options = runs.RunArguments(results=tmp_path, targets_ghz="77", budget="4steps", executor=executor)
    runs.run(data=dataset.path, method=f"{__name__}:Stepwise", options=options)
    shown = " ".join(capsys.readouterr().err.split())
    assert "1 of 1 runs" in shown
    assert state in shown


@pytest.mark.parametrize("num_rows", [0, 1])
def test_what_a_first_step_compiles_is_not_on_the_clock(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, num_rows: int
) -> None:
    split = find_split(dataset, "lofo", "lofo-24.25GHz")
    monkeypatch.setattr(fit, "_WARM_UP_TX", 1)
    monkeypatch.setattr(Compiling, "compiled", False)
    monkeypatch.setattr(Compiling, "num_rows", num_rows * len(split.train))  # then the warm-up itself fails
    clock = set_clock(monkeypatch, fitting)
    monkeypatch.setattr(Compiling, "sleep", clock.sleep)
    record = run_job(lofo_job(dataset, f"{__name__}:Compiling", budget=Budget(max_steps=3)), tmp_path)
    assert Compiling.compiled
    assert clock.now_s >= 60
    assert record.step == 3
    assert record.fit_seconds == 0


class Waiting(Stepwise):
    """Waits for others for half of its fit."""

    clock: ClassVar[Clock]

    def fit(self, train, budget, seed):
        for progress in super().fit(train, budget, seed):
            self.clock.now_s += 2
            self.clock.processor_s += 1
            yield progress


def test_a_fit_that_got_little_of_a_core_is_told(
    dataset: PasDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Waiting, "clock", set_clock(monkeypatch, fitting), raising=False)
    options = runs.RunArguments(results=tmp_path, targets_ghz="24.25", budget="3steps", executor="serial")
    runs.run(data=dataset.path, method=f"{__name__}:Waiting", options=options)
    (record,) = records.read(tmp_path / "records.jsonl").records
    assert record.core_share == 0.5 < records.LEAST_CORE_SHARE
    said = capsys.readouterr()
    assert f"{said.out} {said.err}".count("of a core") == 1
    assert "Fitted beside busy programs" in said.out
