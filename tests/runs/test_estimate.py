"""What runs will take: counts and time, before anything is run or written."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.stub_methods import run_jobs, task_of
from xfreqbench.cli import runs
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import ProtocolError, UnknownNameError, XFreqBenchError
from xfreqbench.methods.contract import Budget
from xfreqbench.runs.estimate import Estimate, estimate_runs, fit_seconds, in_hours, run_seconds
from xfreqbench.runs.records import Job

UNLIMITED = Budget()


def job(dataset: PasDataset, method: str = "nearest", budget: Budget = UNLIMITED) -> Job:
    return Job(str(dataset.path), method, "lofo", "lofo-77GHz", budget=budget)


def test_a_dry_run_says_jobs_and_time_and_writes_nothing(
    dataset: PasDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "results"
    options = runs.RunArguments(results=results, targets_ghz="2.4,77", budget="10m", seeds="0,1", executor="2")
    runs.run(data=dataset.path, method="nearest,aperture-gs", options=options, dry_run=True)
    said = capsys.readouterr().out
    assert said.startswith(f"lofo on {dataset.path.name}: 8 runs: 8 to run, about 20 min, 2 at a time; nothing")
    assert not results.exists()


@pytest.mark.parametrize(
    ("wrong", "options", "kind"),
    [
        ({"method": "neares"}, {}, UnknownNameError),
        ({}, {"targets_ghz": "3"}, ProtocolError),
        ({}, {"executor": "many"}, XFreqBenchError),
        ({"set_": ("width=1",)}, {}, XFreqBenchError),
    ],
)
def test_a_dry_run_finds_the_mistakes_of_a_run(
    dataset: PasDataset, tmp_path: Path, wrong: dict, options: dict, kind: type[Exception]
) -> None:
    asked = runs.RunArguments(**{"results": tmp_path, "targets_ghz": "77", **options})
    with pytest.raises(kind):
        runs.run(**{"data": dataset.path, "method": "nearest", "dry_run": True, **wrong}, options=asked)


def test_finished_runs_take_no_time(dataset: PasDataset, tmp_path: Path) -> None:
    jobs = [job(dataset), job(dataset, "line-of-sight")]
    run_jobs(jobs[:1], tmp_path)
    ahead = estimate_runs([task_of(job) for job in jobs], tmp_path)
    assert ahead.num_left == 1
    assert str(ahead) == "2 runs, 1 of them finished before: 1 to run, about 1 min, one at a time"
    run_jobs(jobs, tmp_path)
    ahead = estimate_runs([task_of(job) for job in jobs], tmp_path)
    assert str(ahead) == "2 runs, 2 of them finished before: nothing is left to run"


def test_times_are_those_of_the_budgets_and_of_their_maps() -> None:
    minutes, maps, steps = Budget(max_seconds=300.0), Budget(max_maps=64_000), Budget(max_steps=500)
    assert [fit_seconds("aperture-gs", budget) for budget in (minutes, UNLIMITED)] == [300, None]
    assert fit_seconds("xfreq-gs-paper", maps) == pytest.approx(1152)
    assert fit_seconds("xfreq-gs", maps) == pytest.approx(6.4) == fit_seconds("xfreq-gs", steps)
    assert fit_seconds("package.module:Mine", maps) is None  # of which nothing was measured
    assert [fit_seconds("nearest", budget) for budget in (minutes, UNLIMITED)] == [0, 0]
    assert run_seconds("aperture-gs", minutes) > run_seconds("package.module:Mine", maps) > 0
    assert [in_hours(seconds) for seconds in (0, 420, 7500)] == ["1 min", "7 min", "2 h 05 min"]
    assert str(Estimate(3, 3, 4500, 2)).endswith(
        "about 1 h 15 min, one at a time; 2 fits come on top, of which no time is known"
    )
    assert "of run time, shared by the workers of the cluster" in str(Estimate(1, 1, 9, num_places=None))
