from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.damage import data_offset, flip
from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.runs.predictions import read_predictions, write_predictions


def _write_predictions(path: Path) -> np.ndarray:
    maps = np.random.default_rng(0).random((5, 90, 360), dtype=np.float32)
    batches = ((np.arange(start, min(start + 2, 5)), maps[start : start + 2]) for start in (0, 2, 4))
    write_predictions(path, batches, 5, (90, 360), dataset_sha256="d", split_sha256="s")
    return maps


def test_predictions_come_back_to_half_a_step_of_packed_maps(tmp_path: Path) -> None:
    maps = _write_predictions(tmp_path / "predictions.h5")
    predictions = read_predictions(tmp_path / "predictions.h5")
    assert (predictions.dataset_sha256, predictions.split_sha256) == ("d", "s")
    stored = list(predictions.batches(3))
    np.testing.assert_array_equal(np.concatenate([rows for rows, _ in stored]), np.arange(5))
    np.testing.assert_allclose(np.concatenate([batch for _, batch in stored]), maps, rtol=0, atol=0.51 / 65280)


def test_damaged_predictions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "predictions.h5"
    _write_predictions(path)
    flip(path, data_offset(path, "pas"))
    with pytest.raises(DataError, match="dataset 'pas'"):
        read_predictions(path)


def test_a_file_of_somebody_else_is_left_and_named(tmp_path: Path) -> None:
    path = tmp_path / "predictions.h5"
    path.write_text("years of work", encoding="utf-8")
    with pytest.raises(OutputExistsError, match=r"predictions\.h5 exists and holds no predictions"):
        _write_predictions(path)
    assert path.read_text(encoding="utf-8") == "years of work"
    path.unlink()
    _write_predictions(path)
    _write_predictions(path)  # of a run whose record was lost
