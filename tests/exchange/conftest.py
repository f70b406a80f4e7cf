"""A data set with its split file, and valid predictions for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.prediction_files import hand_out, write_predictions
from tests.support.synthetic import paper_dataset
from xfreqbench.data.dataset import PasDataset


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return paper_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=5)


@pytest.fixture(scope="session")
def split_file(dataset: PasDataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hand_out(dataset, tmp_path_factory.mktemp("split") / "split.h5")


@pytest.fixture(scope="session")
def noise(split_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A valid file of predictions, for tests to spoil a copy of."""
    return write_predictions(tmp_path_factory.mktemp("noise") / "predictions.h5", split_file)


@pytest.fixture
def predictions(noise: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "predictions.h5"
    copy.write_bytes(noise.read_bytes())
    return copy
