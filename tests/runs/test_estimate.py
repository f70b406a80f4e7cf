"""What runs will take: counts and time, before anything is run or written."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.stub_methods import run_jobs, task_of
from xfreqbench.cli import runs
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import ProtocolError, UnknownNameError, XFreqBenchError
from xfreqbench.methods.contract import Budget
from xfreqbench.runs.estimate import OVERHEAD_S, Estimate, estimate_runs, in_hours
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
    assert said.startswith(f"lofo on {dataset.path.name}: 8 runs: 8 to run, up to 21 min, 2 at a time; nothing")
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
    assert ahead.left == (jobs[1],)
    assert str(ahead) == "2 runs, 1 of them finished before: 1 to run, up to 1 min, one at a time"
    run_jobs(jobs, tmp_path)
    ahead = estimate_runs([task_of(job) for job in jobs], tmp_path)
    assert str(ahead) == "2 runs, 2 of them finished before: nothing is left to run"


def test_times_are_those_of_the_budgets(dataset: PasDataset) -> None:
    fits = [job(dataset, "aperture-gs", Budget(max_seconds=300.0)), job(dataset, "aperture-gs")]
    steps, trivial = job(dataset, "aperture-gs", Budget(max_steps=9)), job(dataset, "nearest", fits[0].budget)
    assert Estimate(1, (fits[0],)).seconds == 300 + OVERHEAD_S
    assert Estimate(1, (trivial,)).seconds == Estimate(1, (steps,)).seconds == OVERHEAD_S
    assert [in_hours(seconds) for seconds in (0, 420, 7500)] == ["1 min", "7 min", "2 h 05 min"]
    assert "2 fits without a budget in seconds come on top" in str(Estimate(3, (*fits, steps)))
    assert "of run time, shared by the workers of the cluster" in str(Estimate(1, (fits[0],), None))
