"""Training transmitters are looked up by position, and stored as the rows of a data set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.synthetic import write_dataset
from xfreqbench.data import hdf5
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError
from xfreqbench.methods import lookup
from xfreqbench.methods.lookup import TrainingTransmitters


@pytest.fixture(scope="module")
def train(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    dataset = write_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=4)
    return dataset[np.flatnonzero(dataset.tx_index != 2)]


def test_only_positions_of_training_transmitters_are_known(train: PasDataset) -> None:
    positions = np.stack([train.tx_position_m[0], train.tx_position_m[0] + [1e-3, 0, 0]])
    np.testing.assert_array_equal(TrainingTransmitters(train).knows(positions), [True, False])


@pytest.mark.parametrize(("most_maps", "num_openings"), [(512, 1), (4, 2)])
def test_what_many_queries_share_is_read_at_once_as_far_as_there_is_room(
    train: PasDataset, most_maps: int, num_openings: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened, maps, open_sealed = [], train.pas(), hdf5.open_sealed
    monkeypatch.setattr(hdf5, "open_sealed", lambda *file: opened.append(file) or open_sealed(*file))
    monkeypatch.setattr(lookup, "_MOST_MAPS", most_maps)
    queries = [2, 0, 1], [0, 1], [0, 1], [1], [8, 2, 5]
    asked = [(np.array(rows), 1 / np.arange(1, 1 + len(rows))) for rows in queries]
    transmitters = TrainingTransmitters(train)
    sums = transmitters.sums(iter(asked))
    expected = np.stack([np.tensordot(weights, maps[rows], 1) for rows, weights in asked])
    np.testing.assert_allclose(sums, expected / expected.max(axis=(1, 2), keepdims=True), atol=1e-6)
    np.testing.assert_array_equal(transmitters.sums(iter(asked[-1:])), sums[-1:])  # known from the last reading
    assert len(opened) == num_openings


@pytest.mark.parametrize("stored", [None, "", "[]", '["a.h5", "b"]', '["a.h5", "b", [-1]]', '["a.h5", "b", "c"]'])
def test_rows_that_are_not_stored_are_refused_by_the_name_of_their_file(tmp_path: Path, stored: str | None) -> None:
    if stored is not None:
        (tmp_path / "training_rows.json").write_text(stored, encoding="utf-8")
    with pytest.raises(DataError, match=r"training_rows\.json names no data set and rows to look up"):
        TrainingTransmitters.load(tmp_path)
