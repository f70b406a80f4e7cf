from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.support.furnished_room import GRID, RECEIVER, SHELL, write_meshes
from tests.support.fuzzing.common import xfreqbench
from tests.support.plans import plan_generation
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.glints import glints
from xfreqbench.errors import DataError
from xfreqbench.scene.model import Scene
from xfreqbench.tracing.tracer import TraceSettings

SETTINGS = TraceSettings("image", ("specular", "refraction"), max_depth=1, rays=20_000)
TX_M = np.array([[3.0, 2.2, 1.6], [0.5, 0.5, 1.6]])


@pytest.fixture(scope="module")
def tiled(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A floor below the receiver, and a metal tile of 20 cm above it, too small for a patch of 0.05 m²."""
    folder = tmp_path_factory.mktemp("tiled")
    tile = trimesh.creation.box(bounds=[[2.55, 1.85, 1.00], [2.75, 2.05, 1.01]])
    xml = write_meshes(folder, {"tile": ("metal", tile)})
    return Scene("tiled", RECEIVER, GRID, surface=SHELL[:1], scene=xml, folder=folder)


def traced(scene: Scene, path: Path) -> PasDataset:
    plan = plan_generation(scene, [24.25e9], SETTINGS, tx_positions=TX_M, maps=False)
    return open_dataset(generate_planned(plan, path))


@pytest.mark.sionna
def test_what_patches_leave_out_is_the_reflection_by_the_tile(tiled: Scene, tmp_path: Path) -> None:
    dataset = traced(tiled, tmp_path / "tiled.h5")
    assert dataset.header.settings["mirrors"] == "patches"
    left_out = glints(dataset, 2, folder=tiled.folder)
    np.testing.assert_array_equal(left_out.num_paths[1] - left_out.num_paths[0], [1, 0])
    assert (left_out.power[1] > left_out.power[0])[0].all()
    np.testing.assert_allclose(left_out.power[1, 1], left_out.power[0, 1])
    assert "patches leave out 1," in str(left_out)


def test_data_say_which_mirrors_they_were_traced_with(tiled: Scene, tmp_path: Path) -> None:
    dataset = traced(replace(tiled, mirrors="facets"), tmp_path / "facets.h5")
    assert dataset.header.settings["mirrors"] == "facets"
    assert dataset.scene.least_patch is None
    with pytest.raises(DataError, match="mirrors = 'facets'"):
        glints(dataset, 1, folder=tiled.folder)
    assert "--glints takes 0 or more" in xfreqbench("info", dataset.path, "--glints", "-1").stderr
