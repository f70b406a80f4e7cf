"""The data set of a room with a screen, what `xfreqbench view` draws of it, and maps that somebody published."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.screened_room import ONE_LIT_TX, SCENE, store
from tests.support.synthetic import make_header, transmitters, write_dataset
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.writer import PasWriter, SampleBlock
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


@pytest.fixture(scope="session")
def imported(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    """Maps alone, of which no scene is known."""
    folder = tmp_path_factory.mktemp("imported")
    told = {"imported_from": "somebody", "convention": {"rows": "polar angle 0 to 90 degrees, " * 6}}
    header = replace(make_header(num_tx=3, pas_kind="amplitude"), channels=False, settings=told)
    maps = write_dataset(folder / "channels.h5", num_tx=3).pas()
    with PasWriter(folder / "maps.h5", header) as writer:
        samples = SampleBlock.of_maps(maps.reshape(3, 3, *maps.shape[1:]))
        writer.append(transmitters(3), np.ones(3, bool), samples)
    return open_dataset(folder / "maps.h5")
