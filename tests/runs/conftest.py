"""What tests of runs share."""

from __future__ import annotations

import pytest

from tests.support.synthetic import paper_dataset
from xfreqbench.data.dataset import PasDataset


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return paper_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=5)
