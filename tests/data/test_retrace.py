"""A data set that is not what its header says is found out by tracing it again, whatever its hashes say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.fuzzing.common import xfreqbench
from tests.support.plans import SETTINGS, rewritten, small_plan
from tests.support.synthetic import append_all, make_header
from xfreqbench.data import retrace
from xfreqbench.data.batches import BatchStore
from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.retrace import drawn_rows, require_origin, traced_scene
from xfreqbench.data.writer import PasWriter
from xfreqbench.errors import DataError, SceneError
from xfreqbench.scene.meshes import meshes_sha256, surface_meshes
from xfreqbench.scene.model import load_scene
from xfreqbench.scene.toml_files import shipped_folder
from xfreqbench.tracing.tracer import Channel


@pytest.fixture(scope="module")
def traced(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    path = tmp_path_factory.mktemp("traced") / "rooms.h5"
    return open_dataset(generate_planned(small_plan(num_transmitters=20), path))


@pytest.mark.sionna
def test_what_solver_sionna_traced_is_found_again(tmp_path: Path) -> None:
    plan = small_plan(num_transmitters=4, settings=replace(SETTINGS, solver="sionna"))
    traced = open_dataset(generate_planned(plan, tmp_path / "rooms.h5"))
    assert require_origin(traced, drawn_rows(traced, 8)).difference < 3e-4


def test_what_was_traced_is_found_again(traced: PasDataset) -> None:
    assert require_origin(traced, drawn_rows(traced, 40)).difference < 3e-4  # maps are stored in 16 bits
    worst = require_origin(traced, drawn_rows(traced, 3, seed=5))
    assert worst.carrier_hz in traced.header.carrier_hz
    assert 0 <= worst.tx < 20
    assert {require_origin(traced, drawn_rows(traced, 1, seed)).tx for seed in range(6)} != {worst.tx}


def test_other_channels_maps_and_positions_are_found_out(traced: PasDataset, tmp_path: Path) -> None:
    cfr, position_m = traced.tables["cfr"], traced.tables["tx_position_m"]
    rows = drawn_rows(traced, 2)
    refusal = r"does not hold what its header says: traced again, transmitter \d+ at .* GHz differs by"
    for name, changes in {
        "swapped": {"cfr": np.roll(cfr, 1, axis=0)},
        "carriers": {"cfr": cfr[:, ::-1]},
        "louder": {"cfr": cfr * 1.002},
        "moved": {"tx_position_m": position_m + np.array([0.001, 0, 0])},
    }.items():
        with pytest.raises(DataError, match=refusal):
            require_origin(rewritten(traced, tmp_path / f"{name}.h5", **changes), rows)
    same = rewritten(traced, tmp_path / "same.h5")
    verify(same.path)
    require_origin(same, rows)


def test_a_sample_that_is_traced_to_no_number_is_found_out(traced: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retrace, "_apart", lambda stored, again: float("nan"))
    with pytest.raises(DataError, match="differs by nan"):
        require_origin(traced, drawn_rows(traced, 3))


def test_a_generation_whose_channels_are_not_its_own_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = BatchStore.read

    def wrong(store: BatchStore, index: int) -> Channel:
        channel = read(store, index)
        return Channel(channel.cfr[::-1].copy(), channel.num_paths)

    monkeypatch.setattr(BatchStore, "read", wrong)
    with pytest.raises(DataError, match="does not hold what its header says"):
        generate_planned(small_plan(num_transmitters=4), tmp_path / "rooms.h5")
    assert [path.name for path in tmp_path.iterdir()] == ["rooms.h5.parts"]
    monkeypatch.undo()
    generate_planned(small_plan(num_transmitters=4), tmp_path / "rooms.h5")


def test_info_traces_samples_again(traced: PasDataset) -> None:
    told = xfreqbench("info", traced.path, "--retrace", "3")
    assert told.code == 0
    assert "3 samples traced again: transmitter" in told.stdout
    assert "--retrace and --seed take 0 or more" in xfreqbench("info", traced.path, "--retrace", "-1").stderr


def test_without_its_meshes_nothing_can_be_traced(traced: PasDataset) -> None:
    other = replace(traced, header=replace(traced.header, scene_sha256="0" * 64))
    with pytest.raises(SceneError, match="not those that the data were traced with"):
        require_origin(other, np.zeros(1, int))


def test_the_meshes_of_a_shipped_scene_are_found_wherever_the_data_are(tmp_path: Path) -> None:
    lounge = load_scene("lounge")
    header = replace(
        make_header(num_tx=1),
        scene_json=lounge.canonical_json,
        scene_sha256=meshes_sha256(surface_meshes(lounge)),
        settings=lounge.mirror_settings,
    )
    with PasWriter(tmp_path / "lounge.h5", header) as writer:
        append_all(writer, header)
    assert traced_scene(open_dataset(tmp_path / "lounge.h5")).folder == shipped_folder().absolute()
