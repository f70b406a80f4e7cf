"""The data set of a room with a screen, and what `xfreqbench view` draws of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.screened_room import ONE_LIT_TX, SCENE, store
from xfreqbench.data.dataset import PasDataset
from xfreqbench.report.view.plan import ViewPlan, plan_view
from xfreqbench.report.view.write import write_view


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return store(SCENE, tmp_path_factory.mktemp("view") / "room.h5")


@pytest.fixture(scope="session")
def view(dataset: PasDataset) -> ViewPlan:
    return plan_view(str(dataset.path), ONE_LIT_TX).with_rays()


@pytest.fixture(scope="session")
def folder(view: ViewPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "office"
    write_view(view, folder)
    return folder
