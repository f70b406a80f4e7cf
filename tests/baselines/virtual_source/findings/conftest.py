"""The data set of a box, whose findings several modules show."""

from __future__ import annotations

import pytest

from tests.support.found_box import SCENE, SETTINGS
from tests.support.plans import plan_generation
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.generate import generate_planned


@pytest.fixture(scope="session")
def box(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    plan = plan_generation(SCENE, [2.4e9, 24.25e9], SETTINGS, tx=10)
    return open_dataset(generate_planned(plan, tmp_path_factory.mktemp("data") / "box.h5"))
