"""`xb.score` scores maps that are at hand, as a run scores those that it has stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import xfreqbench as xb
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import cell_m
from xfreqbench.errors import ArgumentError
from xfreqbench.runs.scoring import cells


def test_scores_are_those_of_a_run(dataset: PasDataset, tmp_path: Path) -> None:
    (record,) = xb.run(dataset, "mean-over-frequency", targets_ghz=[24.25], results=tmp_path)
    (split,) = xb.make_splits(dataset, "lofo", [24.25])
    test = dataset[split.test]
    maps = xb.load_method(tmp_path, record).predict(test.tx_position_m, test.carrier_hz)
    scores = xb.score(maps, split, dataset)
    assert scores.keys() == record.scores.keys()
    for name, values in scores.items():
        assert values.shape == split.test.shape
        assert np.median(values) == pytest.approx(record.scores[name].median, abs=1e-8)  # rounded there
    np.testing.assert_allclose(scores["ssim"], np.concatenate(record.ssim_by_tx), atol=1e-4)  # rounded there
    squares = [*map(tuple, np.floor(dataset.tx_position_m[split.test][:, :2] / cell_m(dataset)).tolist())]
    assert len(record.cell_of_tx) == len(record.ssim_by_tx) == len(squares)
    for one, cell in zip(squares, record.cell_of_tx, strict=True):
        assert [one == other for other in squares] == [cell == other for other in record.cell_of_tx]


def test_a_cell_is_a_square_of_the_floor_whatever_the_height() -> None:
    position_m = np.array([[0.2, 0.3, 1], [0.9, 0.99, 2], [1.0, 0.1, 1], [-0.1, 0.3, 1], [0.5, 0.5, 9]])
    assert cells(position_m, 1.0) == (1, 1, 2, 0, 1)
    assert cells(position_m / 5, 0.2) == (1, 1, 2, 0, 1)


def test_the_truth_has_perfect_scores(dataset: PasDataset) -> None:
    (split,) = xb.make_splits(dataset, "held-out-tx")
    assert len(split.test) < 32 or len(split.test) % 32  # the last batch is smaller
    scores = xb.score(dataset.pas(split.test), split, dataset)
    assert (scores["ssim"] > 1 - 1e-9).all() and (scores["aoa_error"] == 0).all()


def test_what_is_no_prediction_of_the_split_is_refused(dataset: PasDataset) -> None:
    (split,) = xb.make_splits(dataset, "lofo", [24.25])
    maps = dataset.pas(split.test)
    with pytest.raises(ArgumentError, match=r"numbers of shape \(5, 90, 360\).*got float32 of shape \(4, 90, 360\)"):
        xb.score(maps[1:], split, dataset)
    with pytest.raises(ArgumentError, match=r"The map of row 4 \(number 0\) has its peak at 0\.5"):
        xb.score(maps * np.float32(0.5), split, dataset)
    with pytest.raises(ArgumentError, match="Give the whole data set"):
        xb.score(maps, split, dataset[:3])
