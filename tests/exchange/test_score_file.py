from __future__ import annotations

import itertools
import os
import signal
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.support.prediction_files import SPLITS, killed, noisy_maps, write_predictions
from tests.support.stub_methods import run_job
from xfreqbench.cli import exchange
from xfreqbench.data.dataset import PasDataset, isolated
from xfreqbench.data.splits import make_splits
from xfreqbench.errors import DataError, UnknownNameError
from xfreqbench.exchange import score_file as external
from xfreqbench.exchange.score_file import read_parts, score_file
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within
from xfreqbench.methods.registry import build_method
from xfreqbench.runs.predictions import fault_of_maps
from xfreqbench.runs.records import Job, RunRecord, read


def stored(results: Path) -> tuple[RunRecord, ...]:
    return read(results / "records.jsonl").records


def fitted(name: str, dataset: PasDataset, split):
    method = build_method(name)
    fit_within(method, isolated(dataset[split.train]), Budget(), seed=0)
    return method


@pytest.mark.parametrize("method", ["nearest", "log-frequency"])
def test_predictions_of_a_built_in_method_score_exactly_as_its_run_does(
    dataset: PasDataset, split_file: Path, tmp_path: Path, method: str
) -> None:
    by_carrier = {dataset.carrier_hz[split.test[0]]: split for split in make_splits(dataset, "lofo")}
    path = write_predictions(
        tmp_path / "predictions.h5",
        split_file,
        lambda tx, carrier: fitted(method, dataset, by_carrier[carrier[0]]).predict(tx, carrier),
    )
    scored = score_file(path, dataset.path, tmp_path / "results").records
    for record in scored:
        ran = run_job(Job(str(dataset.path), method, "lofo", record.job.split), tmp_path / "run")
        same = ("dataset_sha256", "split_sha256", "scores", "ssim_by_tx", "num_test", "nearest_trained_m")
        assert {name: getattr(record, name) for name in same} == {name: getattr(ran, name) for name in same}
        assert record.id != ran.id
    assert [record.job.split for record in scored] == SPLITS
    assert stored(tmp_path / "results") == scored


def test_a_record_says_what_was_declared_and_that_nothing_was_measured(
    dataset: PasDataset, split_file: Path, tmp_path: Path
) -> None:
    declared = {"fit_seconds": 12.5, "parameters": 7, "hardware": "4 × H200", "url": "https://a.org/x", "seed": 3}
    path = write_predictions(tmp_path / "told.h5", split_file, **declared)
    record = score_file(path, dataset.path, tmp_path / "results").records[0]
    assert (record.fit_seconds, record.parameters, record.job.seed) == (12.5, 7, 3)
    assert record.external is not None
    assert (record.external.hardware, record.external.url) == ("4 × H200", "https://a.org/x")
    assert (record.predict_ms_per_map, record.peak_memory_mib, record.hardware) == (None, None, {})
    assert read(tmp_path / "results" / "records.jsonl").records[0].external == record.external


def test_scoring_a_file_again_gives_its_records_and_a_changed_one_has_records_of_its_own(
    dataset: PasDataset, split_file: Path, predictions: Path, tmp_path: Path
) -> None:
    first = score_file(predictions, dataset.path, tmp_path / "results")
    rewritten = write_predictions(tmp_path / "again.h5", split_file)
    assert score_file(rewritten, dataset.path, tmp_path / "results") == first
    assert stored(tmp_path / "results") == first.records
    with h5py.File(predictions, "r+") as file:
        file["lofo-77GHz/pas"][0, :, :180] = 0
        file.attrs["seed"] = 5  # of the root, for groups that say nothing else
        file["lofo-77GHz"].attrs["seed"] = 6
    changed = score_file(predictions, dataset.path, tmp_path / "results").records
    assert [record.job.seed for record in changed] == [5, 5, 6]
    assert {record.external for record in changed}.isdisjoint(record.external for record in first.records)
    assert stored(tmp_path / "results") == first.records + changed


def test_one_split_may_stand_at_the_root_as_matlab_writes_attributes(
    dataset: PasDataset, split_file: Path, tmp_path: Path
) -> None:
    path = tmp_path / "matlab.h5"
    with h5py.File(split_file) as splits, h5py.File(path, "w") as file:
        split = splits["lofo-77GHz"]
        file["pas"] = noisy_maps(None, split["test_carrier_hz"]).astype(np.float64)
        file.attrs["split_sha256"] = np.array([split.attrs["split_sha256"]])
        file.attrs["method"] = np.bytes_(b"mine")
        file.attrs["seed"] = np.array([[2.0]])
    scored = score_file(path, dataset.path, tmp_path / "results")
    (record,) = scored.records
    assert (record.job.split, record.job.method, record.job.seed) == ("lofo-77GHz", "mine", 2)
    assert scored.missing == ("lofo-2.4GHz", "lofo-24.25GHz")
    assert not scored.is_data_known


def test_a_scoring_killed_in_the_middle_keeps_whole_records_and_the_next_try_adds_the_others(
    dataset: PasDataset, predictions: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results, calls, original = tmp_path / "results", [], external.record_of

    def killed_at_the_second(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return original(*arguments)

    monkeypatch.setattr(external, "record_of", killed_at_the_second)
    killed(lambda: score_file(predictions, dataset.path, results))
    monkeypatch.undo()
    (first,) = stored(results)
    records = score_file(predictions, dataset.path, results).records
    assert records[0] == first
    assert stored(results) == records and len(records) == 3


def test_the_commands_hand_out_score_and_say_what_is_missing(
    dataset: PasDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    split_file = tmp_path / "split.h5"
    exchange.split(data=Path(dataset.path), output=split_file, targets="24.25", maps=True)
    exchange.split(data=Path(dataset.path), output=split_file, targets="24.25", maps=True)
    path = write_predictions(tmp_path / "predictions.h5", split_file, hardware="a cluster")
    exchange.score(path, data=Path(dataset.path), results=tmp_path / "results")
    shown = capsys.readouterr().out
    assert "lofo-24.25GHz" in shown and f"{split_file} already holds these splits" in shown
    assert f"{path} has no predictions for lofo-2.4GHz, lofo-77GHz, which its protocol tests too" in shown
    assert "mine (external): a cluster" in shown
    assert "without dataset_sha256" not in shown


def test_maps_of_zeros_are_scored_as_they_are_and_asked_about(
    dataset: PasDataset, split_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_predictions(
        tmp_path / "predictions.h5",
        split_file,
        lambda tx, carrier: noisy_maps(tx, carrier) * np.float32(carrier[0] > 1e10),
    )
    exchange.score(path, data=Path(dataset.path), results=tmp_path / "results", quiet=True)
    assert len(stored(tmp_path / "results")) == 3
    assert f"every map of lofo-2.4GHz in {path} is zero" in capsys.readouterr().out


def test_a_split_on_validation_is_handed_out_predicted_and_scored_as_its_run_is(
    dataset: PasDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    split_file, results = tmp_path / "split.h5", tmp_path / "results"
    exchange.split(data=Path(dataset.path), output=split_file, targets="24.25", on="validation", maps=True)
    (validation,) = make_splits(dataset, "lofo", [24.25], on="validation")
    (tested,) = make_splits(dataset, "lofo", [24.25])
    with h5py.File(split_file) as file:
        assert list(file) == [validation.name]
        handed_out = file[validation.name]
        assert not np.isin([*handed_out["train_row"], *handed_out["test_row"]], tested.test).any()
    nearest = fitted("nearest", dataset, validation)
    path = write_predictions(tmp_path / "predictions.h5", split_file, nearest.predict)
    exchange.score(path, data=Path(dataset.path), results=results)
    (scored,) = stored(results)
    job = Job(str(dataset.path), "nearest", "lofo-validation", "lofo-validation-24.25GHz")
    ran = run_job(job, tmp_path / "run")
    assert (scored.job.protocol, scored.job.split) == (ran.job.protocol, ran.job.split)
    assert (scored.split_sha256, scored.scores) == (ran.split_sha256, ran.scores)
    missing = "lofo-validation-2.4GHz, lofo-validation-77GHz"
    assert f"{path} has no predictions for {missing}, which its protocol tests too" in capsys.readouterr().out


def edited(edit):
    def spoil(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            edit(file)

    return spoil


def in_place_of_the_maps(file):
    del file["lofo-77GHz/pas"]
    return file["lofo-77GHz"]


def one_value(value: float):
    return edited(lambda file: file["lofo-77GHz/pas"].__setitem__((3, 20, 7), value))


def attribute(name: str, value):
    return edited(lambda file: file["lofo-77GHz"].attrs.__setitem__(name, value))


def without(name: str):
    return edited(lambda file: file["lofo-77GHz"].attrs.pop(name))


def maps(make):
    return edited(lambda file: in_place_of_the_maps(file).update(pas=make(noisy_maps(None, range(5)))))


def elsewhere(put):
    """The maps kept in another file."""

    def spoil(path: Path) -> None:
        other = path.with_name("other.h5")
        other.write_bytes(path.read_bytes())
        edited(lambda file: put(in_place_of_the_maps(file), other))(path)

    return spoil


def put_virtual(group, other: Path) -> None:
    layout = h5py.VirtualLayout((5, 90, 360), "f4")
    layout[...] = h5py.VirtualSource(other, "lofo-77GHz/pas", (5, 90, 360))
    group.create_virtual_dataset("pas", layout)


def in_a_chunk_of_gigabytes(file) -> None:
    shape = {"shape": (5, 90, 360), "maxshape": (None, 90, 360), "chunks": (30_000, 90, 360)}
    in_place_of_the_maps(file).create_dataset("pas", dtype="f4", compression="gzip", **shape)


REFUSED = {
    "text": (lambda path: path.write_text("pas"), "not HDF5"),
    "cut": (
        lambda path: path.write_bytes(path.read_bytes()[:5000]),
        "is damaged, cut short or not HDF5.*Write it again",
    ),
    "absent": (lambda path: path.unlink(), "There is no file"),
    "empty": (edited(lambda file: [file.pop(name) for name in SPLITS]), "is empty"),
    "group": (edited(lambda file: file.move("lofo-77GHz", "lofo-77")), r"Did you mean 'lofo-77GHz'"),
    "not a group": (edited(lambda file: file.create_dataset("lofo-37GHz", data=[1])), "is not a group"),
    "soft link": (edited(lambda file: file.update({"lofo-37GHz": h5py.SoftLink("/lofo-77GHz")})), "is not a group"),
    "root too": (edited(lambda file: file.create_dataset("pas", data=[1])), "at its root and group"),
    "no maps": (edited(lambda file: file.move("lofo-77GHz/pas", "lofo-77GHz/PAS")), "it holds PAS"),
    "maps a group": (
        edited(lambda file: in_place_of_the_maps(file).create_group("pas")),
        "'pas' is a link, not a dataset, or",
    ),
    "link": (
        elsewhere(lambda group, other: group.update(pas=h5py.ExternalLink(other.name, "lofo-77GHz/pas"))),
        "'pas' is a link, not a dataset, or",
    ),
    "virtual": (elsewhere(put_virtual), "'pas' is a link, not a dataset, or"),
    "backwards": (maps(lambda each: each.T), r"\(360, 90, 5\).*permute\(pas, \[3 2 1\]\)"),
    "rows": (maps(lambda each: each[:4]), r"shape \(4, 90, 360\), but 5 test rows need \(5, 90, 360\)"),
    "chunk": (edited(in_a_chunk_of_gigabytes), "'pas' is .* in chunks far larger than its data"),
    "scalar": (maps(lambda each: 1.0), r"shape \(\)"),
    "complex": (maps(lambda each: each.astype(complex)), "real numbers"),
    "texts": (maps(lambda each: np.full(each.shape, b"1")), "real numbers"),
    "bool": (maps(lambda each: each > 0.5), "real numbers"),
    "bytes": (maps(lambda each: (255 * each).astype(np.uint8)), r"map 0 .* at \[0, 0\]; maps are finite"),
    "nan": (one_value(np.nan), r"map 3 \(row 3\d\) has nan at \[20, 7\]"),
    "infinite": (one_value(np.inf), r"map 3 \(row \d+\) has inf at \[20, 7\]"),
    "negative": (one_value(-0.5), r"map 3 \(row \d+\) has -0\.5 at \[20, 7\]"),
    "absolute power": (maps(lambda each: each * 1e-7), r"map 0 \(row \d+\) has its peak at 1e-07\. Divide"),
    "peak": (maps(lambda each: each / 2), r"map 0 \(row \d+\) has its peak at 0\.5\. Divide"),
    "split": (attribute("split_sha256", "0" * 64), "is not that of lofo-77GHz of data.h5 under version 1"),
    "no split": (without("split_sha256"), "'split_sha256': it is missing. Copy it"),
    "data": (attribute("dataset_sha256", "0" * 64), "made for the data set with sha256 000"),
    "no method": (without("method"), "'method': it is missing.*--method"),
    "two lines": (attribute("method", "mine\nyours"), "'method': .*one line"),
    "nobody": (attribute("method", " "), "'method'"),
    "time": (attribute("fit_seconds", -1.0), "'fit_seconds': .*greater than or equal to 0"),
    "endless": (attribute("predict_ms_per_map", np.inf), "'predict_ms_per_map': .*finite"),
    "half": (attribute("parameters", 1.5), "'parameters': .*integer"),
    "several": (attribute("seed", [1, 2]), "'seed': .*integer"),
    "script": (attribute("url", "javascript:alert(1)"), "'url': .*https://"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_with_a_fault_is_refused_in_words_before_anything_is_scored(
    dataset: PasDataset, predictions: Path, tmp_path: Path, case: str
) -> None:
    spoil, words = REFUSED[case]
    spoil(predictions)
    with pytest.raises((DataError, UnknownNameError), match=words):
        score_file(predictions, dataset.path, tmp_path / "results")
    assert not list(tmp_path.glob("results/**/*.*"))


def with_coordinates(path: Path, split_file: Path, change, *names: str) -> None:
    """Write coordinates of the split file beside the maps, as others do that carry theirs along."""
    with h5py.File(split_file) as splits, h5py.File(path, "r+") as file:
        split = splits["lofo-77GHz"]
        for name in names:
            known = {"row": "test_row", "sample": "test_row", "tx_position_m": "test_tx_position_m"}.get(name, name)
            file["lofo-77GHz"][name] = change(split[known][...])


COORDINATES = (
    *("test_row", "row", "sample", "test_tx_position_m", "tx_position_m", "test_carrier_hz"),
    *("elevation_deg", "azimuth_deg"),
)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        *((name, np.flipud) for name in COORDINATES if name != "test_carrier_hz"),  # for it is one
        *itertools.product(COORDINATES, [lambda known: known[1:], lambda known: 1.5 * known + 1, lambda _: "text"]),
    ],
)
def test_maps_with_coordinates_in_another_order_are_refused(
    dataset: PasDataset, split_file: Path, predictions: Path, name: str, change
) -> None:
    with_coordinates(predictions, split_file, change, name)
    with pytest.raises(DataError, match=rf"'lofo-77GHz': '{name}' is not that of the split file, so maps would"):
        read_parts(predictions, dataset, None)


@pytest.mark.parametrize("dtype", ["f8", "f4"])
def test_maps_with_coordinates_of_the_split_file_are_scored(
    dataset: PasDataset, split_file: Path, predictions: Path, dtype: str
) -> None:
    with_coordinates(predictions, split_file, lambda known: known.astype(dtype)[None], *COORDINATES)
    with h5py.File(predictions, "r+") as file:  # as netCDF writes an axis without coordinates
        del file["lofo-77GHz/azimuth_deg"]
        file["lofo-77GHz/azimuth_deg"] = np.zeros(360)
        file["lofo-77GHz/azimuth_deg"].attrs["NAME"] = b"This is a netCDF dimension but not a netCDF variable.   360"
    assert len(read_parts(predictions, dataset, None)) == 3


@settings(max_examples=40)
@given(values=st.lists(st.floats(width=32), min_size=1, max_size=20), kind=st.sampled_from(["<f4", "<f8"]))
@example([-5e-5, 1.00005], "<f4")  # rounding, of a division in single precision
def test_maps_are_accepted_where_every_value_is_and_never_otherwise(values: list[float], kind: str) -> None:
    part = np.ones((1, 1, len(values) + 1), kind)
    part[0, 0, 1:] = values
    is_allowed = all(-1e-4 <= value <= 1.0001 for value in np.asarray(values, kind).tolist())
    assert (fault_of_maps(part) is None) == is_allowed
