from __future__ import annotations

import pickle
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from synthetic import paper_dataset
from xfreqbench.baselines.nearest import Nearest

from xfreqbench import method as method_module
from xfreqbench import records
from xfreqbench.dataset import PasDataset
from xfreqbench.errors import DataError, MethodError, StorageError, UnknownNameError
from xfreqbench.metrics import METRICS
from xfreqbench.predictions import read_predictions
from xfreqbench.protocols import find_split
from xfreqbench.run import Job, run_all, run_job


@dataclass(frozen=True)
class WeightsConfig:
    weights: Path = Path("weights.pt")


class WithAPath(Nearest):
    Config = WeightsConfig


class FailsInFit(Nearest):
    def fit(self, train, budget, seed):
        raise RuntimeError("no memory left")
        yield


class FailsInPredict(Nearest):
    def predict(self, tx_position_m, carrier_hz):
        return {}["map"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return paper_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=5)


def make_job(dataset, method="nearest", split="lofo-24.25GHz", **options):
    return Job(str(dataset.path), method, "lofo", split, **options)


def test_a_record_holds_the_scores_of_the_stored_predictions(dataset: PasDataset, tmp_path: Path) -> None:
    record = run_job(make_job(dataset), tmp_path)
    predictions = read_predictions(tmp_path / "predictions" / f"{record.id}.h5")
    (rows, maps), *_ = predictions.batches(100)
    for name, metric in METRICS.items():
        expected = metric.score(maps, dataset.pas(rows), dataset.grid)
        assert record.scores[name].mean == pytest.approx(expected.mean())
        assert record.scores[name].median == pytest.approx(np.median(expected))
        assert record.scores[name].quantiles[0] == expected.min()
        assert record.scores[name].quantiles[100] == expected.max()
        assert record.scores[name].median_by_carrier_hz == {"24250000000": pytest.approx(np.median(expected))}
    assert record.num_test == len(rows) == 5


def test_predictions_are_for_the_test_rows_of_the_split(dataset: PasDataset, tmp_path: Path) -> None:
    record = run_job(make_job(dataset), tmp_path)
    predictions = read_predictions(tmp_path / "predictions" / f"{record.id}.h5")
    split = find_split(dataset, "lofo", "lofo-24.25GHz")
    np.testing.assert_array_equal(predictions.rows, split.test)
    assert predictions.split_sha256 == split.sha256 == record.split_sha256
    assert predictions.dataset_sha256 == dataset.sha256 == record.dataset_sha256


def test_the_record_is_what_the_file_holds(dataset: PasDataset, tmp_path: Path) -> None:
    record = run_job(make_job(dataset), tmp_path)
    assert records.read(tmp_path / "records.jsonl").records == (record,)


def test_a_finished_job_is_not_run_again(dataset: PasDataset, tmp_path: Path) -> None:
    jobs = [make_job(dataset), make_job(dataset, "line-of-sight")]
    first = run_all(jobs[:1], tmp_path)
    again = run_all(jobs, tmp_path)
    assert again[0] == first[0]
    assert [record.job.method for record in records.read(tmp_path / "records.jsonl").records] == [
        "nearest",
        "line-of-sight",
    ]


def test_a_job_whose_predictions_are_gone_is_run_again(dataset: PasDataset, tmp_path: Path) -> None:
    record = run_job(make_job(dataset), tmp_path)
    path = tmp_path / "predictions" / f"{record.id}.h5"
    path.unlink()
    run_job(make_job(dataset), tmp_path)
    assert path.exists()
    assert len(records.read(tmp_path / "records.jsonl").records) == 2


def test_whatever_determines_the_result_changes_the_id(dataset: PasDataset, tmp_path: Path) -> None:
    jobs = [
        make_job(dataset, "mean-over-frequency"),
        make_job(dataset, "mean-over-frequency", seed=1),
        make_job(dataset, "mean-over-frequency", overrides=("num_nearest=2",)),
        make_job(dataset, "mean-over-frequency", split="lofo-77GHz"),
        make_job(dataset, "nearest"),
    ]
    assert len({record.id for record in run_all(jobs, tmp_path)}) == len(jobs)


def test_an_override_that_says_the_default_is_the_same_job(dataset: PasDataset, tmp_path: Path) -> None:
    plain = run_job(make_job(dataset, "mean-over-frequency"), tmp_path)
    spelled = run_job(make_job(dataset, "mean-over-frequency", overrides=("num_nearest=6",)), tmp_path)
    assert spelled == plain


def test_progress_counts_the_jobs(dataset: PasDataset, tmp_path: Path) -> None:
    seen = []
    jobs = [make_job(dataset), make_job(dataset, "line-of-sight")]
    run_all(jobs, tmp_path, lambda done, total, record: seen.append((done, total, record.job)))
    assert seen == [(1, 2, jobs[0]), (2, 2, jobs[1])]


def test_a_wrong_name_in_the_last_job_is_told_before_the_first_fit(
    dataset: PasDataset, tmp_path: Path
) -> None:
    with pytest.raises(UnknownNameError, match="nearst"):
        run_all([make_job(dataset), make_job(dataset, "nearst")], tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_damaged_data_are_refused_before_the_first_fit(dataset: PasDataset, tmp_path: Path) -> None:
    path = tmp_path / "damaged.h5"
    content = bytearray(dataset.path.read_bytes())
    content[-200_000] ^= 1
    path.write_bytes(content)
    with pytest.raises(DataError, match="damaged"):
        run_all([Job(str(path), "nearest", "lofo", "lofo-77GHz")], tmp_path / "results")


def test_a_job_pickles(dataset: PasDataset) -> None:
    job = make_job(dataset, overrides=("a=1",))
    assert pickle.loads(pickle.dumps(job)) == job


def test_running_needs_neither_sionna_nor_matplotlib() -> None:
    code = (
        "import sys, xfreqbench.run, xfreqbench.report;"
        "print({'sionna', 'mitsuba', 'drjit', 'matplotlib'} & set(sys.modules))"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "set()"


def test_a_configuration_with_a_path_is_hashed_and_recorded(dataset: PasDataset, tmp_path: Path) -> None:
    record = run_job(make_job(dataset, f"{__name__}:WithAPath"), tmp_path)
    assert record.config == {"weights": "weights.pt"}
    assert records.read(tmp_path / "records.jsonl").records == (record,)


def test_a_record_says_what_data_it_is_of(dataset: PasDataset, tmp_path: Path) -> None:
    record = run_job(make_job(dataset), tmp_path)
    assert record.pas_kind == dataset.header.pas_kind == "power"
    assert record.settings == dataset.header.settings


@pytest.mark.parametrize("name", ["", "predictions"])
def test_results_that_cannot_be_written_are_told_before_the_first_fit(
    dataset: PasDataset, tmp_path: Path, name: str
) -> None:
    results = tmp_path / "results"
    if name:
        results.mkdir()
    (results / name).write_text("")
    with pytest.raises(StorageError, match="results"):
        run_all([make_job(dataset, f"{__name__}:FailsInFit")], results)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "FailsInFit",
            r"failed in fit on split 'lofo-24\.25GHz': RuntimeError: no memory left \(.*test_run\.py",
        ),
        ("FailsInPredict", r"failed in predict on split 'lofo-24\.25GHz': KeyError: 'map' \(.*test_run\.py"),
    ],
)
def test_a_method_that_fails_is_named_and_the_jobs_before_it_are_kept(
    dataset: PasDataset, tmp_path: Path, name: str, words: str
) -> None:
    with pytest.raises(MethodError, match=words):
        run_all([make_job(dataset), make_job(dataset, f"{__name__}:{name}")], tmp_path)
    assert [record.job.method for record in records.read(tmp_path / "records.jsonl").records] == ["nearest"]


def test_the_time_of_a_prediction_leaves_our_checks_out(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(method_module, "_fault_of", lambda *_: time.sleep(1))
    assert run_job(make_job(dataset), tmp_path).predict_ms_per_map < 200  # a check's second over five maps
