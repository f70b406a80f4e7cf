"""A run keeps the method that it has fitted, and `xb.load_method` gives it back."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import xfreqbench as xb
from tests.support.damage import flip
from tests.support.stub_methods import lofo_job, run_job, task_of
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError
from xfreqbench.methods.contract import Budget
from xfreqbench.runs import fit
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.records import RunRecord

FEW = ("num_gaussians=4",)


@pytest.fixture(scope="module")
def kept(dataset: PasDataset, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunRecord]:
    results = tmp_path_factory.mktemp("kept")
    job = lofo_job(dataset, "aperture-gs", overrides=FEW, budget=Budget(max_steps=3))
    return results, run_job(job, results)


@pytest.fixture
def copied(kept: tuple[Path, RunRecord], tmp_path: Path) -> tuple[Path, RunRecord]:
    shutil.copytree(kept[0], tmp_path / "results")
    return tmp_path / "results", kept[1]


def test_a_loaded_method_predicts_what_the_run_stored(dataset: PasDataset, kept: tuple[Path, RunRecord]) -> None:
    results, record = kept
    test = dataset[task_of(record.job).split.test]
    stored = ResultsFolder(results).predictions(record).maps_of(test.rows, 8)
    for run in (record, record.id):
        method = xb.load_method(results, run)
        maps = method.predict(test.tx_position_m, test.carrier_hz)
        np.testing.assert_allclose(maps, stored, atol=2**-11)  # stored in half precision
    assert method.config.num_gaussians == 4


def test_predictions_are_read_of_the_rows_that_are_asked_for(kept: tuple[Path, RunRecord]) -> None:
    results, record = kept
    every, tested = xb.load_predictions(results, record), task_of(record.job).split.test.tolist()
    np.testing.assert_array_equal(xb.load_predictions(results, record, tested[2::-1]), every[2::-1])
    assert xb.load_predictions(results, record, []).shape == (0, 90, 360)
    with pytest.raises(DataError, match="holds no prediction of row -1"):
        xb.load_predictions(results, record, [-1])


def test_a_loaded_method_goes_on_with_its_fit(dataset: PasDataset, kept: tuple[Path, RunRecord]) -> None:
    method = xb.load_method(*kept)
    train = dataset[task_of(kept[1].job).split.train]
    assert next(iter(method.fit(train, Budget(max_steps=9), 0))).step == 4


def test_a_run_that_was_killed_after_its_fit_predicts_with_the_method_that_it_has_stored(
    copied: tuple[Path, RunRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    results, record = copied
    path = ResultsFolder(results).predictions_path(record.id)
    before = path.read_bytes()
    path.unlink()
    (results / "records.jsonl").unlink()
    monkeypatch.setattr(fit, "fit_within", None)
    again = run_job(record.job, results)
    assert (again.fit_seconds, again.scores, again.curve) == (record.fit_seconds, record.scores, record.curve)
    assert path.read_bytes() == before


def test_a_method_of_a_damaged_file_is_refused_in_a_line(copied: tuple[Path, RunRecord]) -> None:
    results, record = copied
    (path,) = results.glob(f"methods/{record.id}/*/method/state.safetensors")
    flip(path, path.stat().st_size - 1)
    words = r"The method in .* is damaged: state\.safetensors changed .* Delete .*\.h5 and .*, and run the same again"
    with pytest.raises(DataError, match=words) as raised:
        xb.load_method(results, record)
    assert "\n" not in str(raised.value)


def test_a_method_of_another_run_is_refused(dataset: PasDataset, copied: tuple[Path, RunRecord]) -> None:
    results, record = copied
    other = run_job(lofo_job(dataset, "nearest"), results)
    shutil.rmtree(results / "methods" / record.id)
    shutil.copytree(results / "methods" / other.id, results / "methods" / record.id)
    with pytest.raises(DataError, match=f"belongs to job {other.id}, not to {record.id}"):
        xb.load_method(results, record)


def test_what_is_not_kept_is_told_and_stored_by_another_run(copied: tuple[Path, RunRecord]) -> None:
    results, record = copied
    with pytest.raises(DataError, match="has no run 'absent'"):
        xb.load_method(results, "absent")
    shutil.rmtree(results / "methods")
    with pytest.raises(DataError, match=f"The method of run {record.id} is not at .* run the same again"):
        xb.load_method(results, record)
    (results / "predictions" / f"{record.id}.h5").unlink()
    run_job(record.job, results)
    assert xb.load_method(results, record).config.num_gaussians == 4
