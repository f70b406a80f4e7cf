"""Training transmitters are looked up by position, and stored as the rows of a data set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.synthetic import write_dataset
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError
from xfreqbench.methods import lookup
from xfreqbench.methods.lookup import TrainingTransmitters


@pytest.fixture(scope="module")
def train(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    dataset = write_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=4)
    return dataset.subset(np.flatnonzero(dataset.tx_index != 2))


def test_only_positions_of_training_transmitters_are_known(train: PasDataset) -> None:
    positions = np.stack([train.tx_position_m[0], train.tx_position_m[0] + [1e-3, 0, 0]])
    np.testing.assert_array_equal(TrainingTransmitters(train).knows(positions), [True, False])


@pytest.mark.parametrize(("most", "reads"), [(512, 1), (4, 2), (1, 3)])
def test_maps_of_several_queries_are_read_at_once(
    train: PasDataset, monkeypatch: pytest.MonkeyPatch, most: int, reads: int
) -> None:
    asked = [(np.array(rows), np.arange(1.0, len(rows) + 1)) for rows in ([0, 1], [1, 2], [1, 2], [3, 4, 0])]
    sums = [weights @ train.pas(rows).reshape(len(rows), -1) for rows, weights in asked]
    read, original = [], PasDataset.pas

    def counted(dataset: PasDataset, rows: Any) -> Any:
        read.append(rows)
        return original(dataset, rows)

    monkeypatch.setattr(PasDataset, "pas", counted)
    monkeypatch.setattr(lookup, "_MOST_MAPS", most)
    found = TrainingTransmitters(train).sums(iter(asked))
    assert len(read) == reads
    for map_, total in zip(found, sums, strict=True):
        np.testing.assert_allclose(map_.ravel(), total / total.max(), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("stored", [None, "", "[]", '["a.h5", "b"]', '["a.h5", "b", [-1]]', '["a.h5", "b", "c"]'])
def test_rows_that_are_not_stored_are_refused_by_the_name_of_their_file(tmp_path: Path, stored: str | None) -> None:
    if stored is not None:
        (tmp_path / "training_rows.json").write_text(stored, encoding="utf-8")
    with pytest.raises(DataError, match=r"training_rows\.json names no data set and rows to look up"):
        TrainingTransmitters.load(tmp_path)
