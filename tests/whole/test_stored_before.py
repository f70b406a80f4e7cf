"""Files of version 0.1, written while every module lay in one folder, are read as they were then."""

from __future__ import annotations

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from places import ROOT

from xfreqbench.data.dataset import open_dataset, verify
from xfreqbench.data.splits import lofo
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.methods.registry import build_method
from xfreqbench.report.leaderboard.report import write_report
from xfreqbench.runs.checkpoints import CheckpointFolder
from xfreqbench.runs.predictions import read_predictions
from xfreqbench.runs.records import read

STORED = ROOT / "tests" / "stored"
CHECKPOINT = "0123456789abcdef"
OPTIONS = ("num_gaussians=4", "width=4", "layers=2")
TARGET_HZ = 24.25e9


def test_a_data_set_has_its_channels_its_scene_and_the_hash_that_its_record_names() -> None:
    verify(STORED / "data.h5")
    dataset = open_dataset(STORED / "data.h5")
    assert dataset.header.scene_name == "empty"
    assert dataset.pas([0]).shape == (1, 90, 360)
    (record,) = read(STORED / "records.jsonl").records
    assert record.dataset_sha256 == dataset.sha256


def test_the_same_samples_have_the_same_hash_today(tmp_path: Path) -> None:
    """What other programs are told beside them is not part of it."""
    stored = open_dataset(STORED / "data.h5")
    num_tx, shape = stored.header.num_tx, (stored.header.num_tx, stored.num_carriers)
    cfr, num_paths = stored.cfr.reshape(*shape, -1), stored.num_paths.reshape(shape)
    maps = stored.pas().reshape(*shape, *stored.grid.shape)
    samples = SampleBlock(maps, stored.peak_power.reshape(shape), num_paths, cfr)
    first = np.arange(num_tx) * stored.num_carriers
    with PasWriter(tmp_path / "data.h5", stored.header) as writer:
        writer.append(stored.tx_position_m[first], stored.line_of_sight[first], samples)
    assert open_dataset(tmp_path / "data.h5").sha256 == stored.sha256


def test_a_split_file_names_the_rows_of_the_split_of_today() -> None:
    (split,) = lofo(open_dataset(STORED / "data.h5"), [TARGET_HZ])
    with h5py.File(STORED / "split.h5") as file:
        stored = file[split.name]
        assert stored.attrs["split_sha256"] in (split.sha256, split.sha256.encode())


def test_records_make_a_leaderboard(tmp_path: Path) -> None:
    shutil.copy(STORED / "records.jsonl", tmp_path)
    written = write_report(tmp_path, tmp_path / "BENCHMARK.md")
    assert written.num_truncated == 0
    assert "| nearest" in (tmp_path / "BENCHMARK.md").read_text("utf-8")


def test_stored_predictions_are_of_the_test_rows() -> None:
    (record,) = read(STORED / "records.jsonl").records
    stored = read_predictions(STORED / "predictions" / f"{record.id}.h5")
    (split,) = lofo(open_dataset(STORED / "data.h5"), [TARGET_HZ])
    np.testing.assert_array_equal(stored.rows, split.test)
    assert stored.split_sha256 == split.sha256


@pytest.mark.usefixtures("one_thread")
def test_a_checkpoint_predicts_as_it_did(tmp_path: Path) -> None:
    shutil.copytree(STORED / "checkpoints", tmp_path / "checkpoints")
    folder = CheckpointFolder(tmp_path / "checkpoints" / CHECKPOINT, CHECKPOINT)
    found = folder.read()
    assert found is not None
    assert (found.step, found.curve[0].ssim) == (3, 0.5)
    method = folder.load(build_method("aperture-gs", OPTIONS))
    dataset = open_dataset(STORED / "data.h5")
    (split,) = lofo(dataset, [TARGET_HZ])
    asked = dataset.subset(split.test[:1])
    predicted = method.predict(asked.tx_position_m, asked.carrier_hz)[:, ::10, ::10]
    expected = np.load(STORED / "checkpoints" / "prediction.npy").astype(np.float32)
    np.testing.assert_allclose(predicted, expected, atol=1e-3)  # stored as float16, on one kind of processor
