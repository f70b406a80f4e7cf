"""`xb.run` is the command `run`: methods on every split of a protocol."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

import xfreqbench as xb
from tests.support.fuzzing.common import xfreqbench
from tests.support.stub_methods import lofo_job, run_jobs
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import MethodError, RunsFailedError, UnknownNameError, XFreqBenchError
from xfreqbench.runs.options import MethodOptions, RunOptions

TARGET = {"targets_ghz": [77.0]}
TEXTS = ("num_gaussians=4", "derive_targets=false")


def test_the_options_of_the_command_are_those_of_python_and_each_says_what_it_is() -> None:
    options = {each.name: each for each in inspect.signature(RunOptions).parameters.values()}
    taken = {**inspect.signature(xb.run).parameters}
    assert [*taken] == ["data", "methods", *options]
    command = xfreqbench("run", "--help").stdout
    for name, option in options.items():
        assert (taken[name].default, taken[name].kind) == (option.default, option.kind)
        assert f"    {name}: " in xb.run.__doc__
        assert name == "progress" or f"--{name.replace('_', '-')}" in command


def test_records_come_in_the_order_of_methods_seeds_and_splits(dataset: PasDataset, tmp_path: Path) -> None:
    asked = {"targets_ghz": [24.25, 77.0], "seeds": [0, 3]}
    records = xb.run(dataset, ["nearest", "line-of-sight"], results=tmp_path, **asked)  # type: ignore[arg-type]
    jobs = [(record.job.method, record.job.seed, record.job.split) for record in records]
    splits = ("lofo-24.25GHz", "lofo-77GHz")
    assert jobs == [
        (method, seed, split) for method in ("nearest", "line-of-sight") for seed in (0, 3) for split in splits
    ]
    assert xb.read_records(tmp_path) == tuple(records)


def test_what_is_finished_is_not_run_again_whether_the_data_come_open_or_as_a_path(
    dataset: PasDataset, tmp_path: Path
) -> None:
    for data in (dataset, dataset.path, str(dataset.path)):
        xb.run(data, "nearest", results=tmp_path, **TARGET)  # type: ignore[arg-type]
    assert len(xb.read_records(tmp_path)) == 1


def test_all_targets_are_a_split_each(dataset: PasDataset, tmp_path: Path) -> None:
    records = xb.run(dataset, "line-of-sight", results=tmp_path, targets_ghz="all")
    assert len(records) == dataset.header.num_carriers


def test_validation_runs_stand_on_a_board_of_their_own_and_leave_the_test_alone(
    dataset: PasDataset, tmp_path: Path
) -> None:
    (tested,) = xb.run(dataset, "nearest", results=tmp_path, **TARGET)  # type: ignore[arg-type]
    (validated,) = xb.run(dataset, "nearest", results=tmp_path, on="validation", **TARGET)  # type: ignore[arg-type]
    assert (validated.job.protocol, validated.job.split) == ("lofo-validation", "lofo-validation-77GHz")
    assert (validated.id, validated.split_sha256) != (tested.id, tested.split_sha256)
    assert set(validated.scores["ssim"].median_by_carrier_hz) == {"60000000000"}
    (again,) = xb.run(dataset, "nearest", results=tmp_path, on="validation", **TARGET)  # type: ignore[arg-type]
    assert again == validated
    shown = str(xb.leaderboard(tmp_path))
    test, validation = shown.split("synthetic · lofo-validation · power maps")
    assert "Validation rows: some of the training rows of the lofo split" in validation
    assert "Validation" not in test
    for board, record in ((test, tested), (validation, validated)):
        assert "77GHz" in board and f"{record.scores['ssim'].median:.4f}" in board


@pytest.mark.parametrize(
    ("options", "budget"), [({"num_gaussians": 4, "derive_targets": False}, "1steps"), (TEXTS, xb.Budget(max_steps=1))]
)
def test_options_of_a_method_are_values_or_texts_and_a_budget_a_text_or_a_budget(
    dataset: PasDataset, tmp_path: Path, options: MethodOptions, budget: str | xb.Budget
) -> None:
    asked = {"budget": budget, "results": tmp_path, **TARGET}
    (record,) = xb.run(dataset, {"aperture-gs": options}, **asked)  # type: ignore[arg-type]
    assert (record.job.overrides, record.job.budget) == (TEXTS, xb.Budget(max_steps=1))
    assert (record.config["num_gaussians"], record.config["derive_targets"]) == (4, False)


def test_names_and_subsets_are_refused_before_the_first_fit(
    dataset: PasDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'nearest'"):
        xb.run(dataset, ["nearest", "neares"], results=tmp_path, progress=True, budget="2h", targets_ghz="all")
    assert not capsys.readouterr().err
    with pytest.raises(XFreqBenchError, match="subset of 2 of the"):
        xb.run(dataset[:2], "nearest", results=tmp_path)
    with pytest.raises(MethodError, match="5m, 2h, 2000steps or 64000maps"):
        xb.run(dataset, "nearest", results=tmp_path, budget="long")
    assert not list(tmp_path.iterdir())


def test_runs_are_told_of_where_that_is_asked_for(
    dataset: PasDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    xb.run(dataset, "nearest", results=tmp_path, **TARGET)  # type: ignore[arg-type]
    assert not capsys.readouterr().err
    (record,) = xb.run(dataset, "nearest", results=tmp_path / "shown", progress=True, **TARGET)  # type: ignore[arg-type]
    told = f"1/1 nearest on lofo-77GHz, seed 0: median SSIM {record.scores['ssim'].median:.4f}, "
    assert re.fullmatch(rf"{re.escape(told)}\d+\.\d s of fitting\n", capsys.readouterr().err)


@pytest.mark.parametrize("executor", ["serial", "2"])
def test_a_run_that_fails_stops_no_other_here_or_on_workers(
    dataset: PasDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], executor: str
) -> None:
    name = "tests.support.stub_methods:FailsInFit"
    asked = {"results": tmp_path, "executor": executor, "progress": True, "seeds": [0, 1], **TARGET}
    with pytest.raises(RunsFailedError) as raised:
        xb.run(dataset, [name, "nearest"], **asked)  # type: ignore[arg-type]
    number, *each = sorted(str(raised.value).splitlines())  # on workers, whichever fails first is first
    assert number.startswith("2 of 4 runs failed")
    where = f"{name} on lofo-77GHz of {dataset.path.name}, seed 0: Method '{name}' failed in fit on split 'lofo-77GHz'"
    assert re.match(rf"{where}: RuntimeError: no memory left \(.*stub_methods\.py", each[0])
    assert [type(error) for error in raised.value.errors.values()] == [MethodError] * 2
    assert [record.job.method for record in xb.read_records(tmp_path)] == ["nearest"] * 2
    told = capsys.readouterr().err
    assert "FailsInFit on lofo-77GHz, seed 0: failed\n" in told
    assert "nearest on lofo-77GHz, seed 0: median SSIM " in told


def test_a_job_whose_options_say_the_defaults_is_run_once(dataset: PasDataset, tmp_path: Path) -> None:
    name = "mean-over-frequency"
    jobs = [lofo_job(dataset, name), lofo_job(dataset, name, overrides=("num_nearest=6",))]
    seen: list[tuple] = []
    first, second = run_jobs(jobs, tmp_path, progress=lambda *ended: seen.append(ended))
    assert first == second
    assert [(done, total) for done, total, *_ in seen] == [(1, 1)]


def test_what_may_take_more_than_ten_minutes_is_said_before_the_first_run(
    dataset: PasDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A fit that ends after its only step takes no time, but its budget is twelve minutes."""
    methods = {"aperture-gs": {"num_gaussians": 4, "steps": 1}}
    asked = {"results": tmp_path, "progress": True, "budget": "12m", **TARGET}
    xb.run(dataset, methods, **asked)  # type: ignore[arg-type]
    first, second = capsys.readouterr().err.splitlines()
    assert first == "1 runs: 1 to run, about 12 min, one at a time"
    assert second.startswith("1/1 aperture-gs")
    xb.run(dataset, methods, **asked)  # type: ignore[arg-type]
    (again,) = capsys.readouterr().err.splitlines()
    assert again.startswith("1/1 aperture-gs")
