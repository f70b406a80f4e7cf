"""Several receivers and polarizations in one file: every link is as in a file of its own."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from xfreqbench.baselines.line_of_sight import LineOfSight

import xfreqbench as xb
from tests.support.fuzzing.common import xfreqbench
from tests.support.synthetic import write_dataset
from xfreqbench.data.batches import BatchStore
from xfreqbench.data.dataset import PasDataset, isolated, links, verify
from xfreqbench.data.schema import variables
from xfreqbench.data.splits import find_split
from xfreqbench.data.trace import traced
from xfreqbench.errors import DataError, OutputExistsError, ProtocolError, UnknownNameError, XFreqBenchError
from xfreqbench.exchange.split_file import write_splits
from xfreqbench.methods.lookup import TrainingTransmitters
from xfreqbench.report.view.describe import describe
from xfreqbench.runs.options import RunOptions
from xfreqbench.runs.run import asked_tasks
from xfreqbench.scene.model import ReceiverArray, Scene
from xfreqbench.tracing.tracer import Channel

TX_M = [[1.0, 1.2, 1.0], [4.1, 2.2, 1.5]]
HOW: dict[str, Any] = {"freqs_ghz": [2.4, 24.25], "tx_positions": TX_M, "max_depth": 3, "rays": 20_000, "paths": True}
SMALL = {"rows": 2, "cols": 3}


def two_receivers() -> Scene:
    scene = xb.load_scene("two_rooms")
    first = replace(scene.receiver, name="first one", **SMALL)
    return replace(scene, receiver=first, other_receivers=(ReceiverArray((4.0, 2.0, 1.1), **SMALL, name="low"),))


SOLVERS = ["image", pytest.param("sionna", marks=[pytest.mark.sionna, pytest.mark.slow])]


@pytest.fixture(scope="module", params=SOLVERS)
def joint(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    path = tmp_path_factory.mktemp("links") / "joint.h5"
    return xb.generate(two_receivers(), path, **HOW, solver=request.param, receiver="all", polarization=["V", "H"])


def test_every_link_is_as_in_a_file_of_its_own(joint: PasDataset, tmp_path: Path) -> None:
    solver = joint.trace_settings.solver
    for receiver, pair in (("low", "HV"), ("first one", "VH"))[: 2 if solver == "image" else 1]:
        path = tmp_path / f"{receiver}{pair}.h5"
        alone = xb.generate(two_receivers(), path, **HOW, solver=solver, receiver=receiver, polarization=pair)
        link = joint.at(receiver, pair)
        assert link.header.attributes() == alone.header.attributes()
        assert link.recipe == alone.recipe
        for name in ("cfr", "peak_power", "num_paths", "line_of_sight"):
            np.testing.assert_array_equal(link.tables[name], alone.tables[name], name)
        np.testing.assert_array_equal(link.pas(), alone.pas())
        assert link.sha256 != alone.sha256 and len(alone.file_header.receivers) == 0
        for sample in range(len(alone)):
            gains = [data.paths(sample).impulse_response().gain.sum(0) for data in (link, alone)]
            np.testing.assert_allclose(*gains, rtol=0, atol=1e-12)


def test_the_line_of_sight_does_not_turn_the_field(joint: PasDataset) -> None:
    crossed, parallel = joint.at(polarization="VH").paths(0), joint.at(polarization="VV").paths(0)
    in_sight = (crossed.interactions == 0).all(axis=1)
    assert in_sight.sum() == 1
    assert abs(crossed.gain[in_sight][0]) < 1e-6 * abs(parallel.gain[in_sight][0])
    assert np.abs(crossed.gain).max() > 1e-3 * np.abs(parallel.gain).max()  # walls and floor turn the field


def test_a_file_says_which_links_it_holds_and_shows_one(joint: PasDataset, tmp_path: Path) -> None:
    assert joint.file_header.link_names == (("first one", "low"), ("VV", "VH", "HV", "HH"))
    assert joint.link == ("first one", "VV") and "first one, of first one, low" in repr(joint)
    assert len({link.sha256 for link in links(joint)}) == len({link.recipe for link in links(joint)}) == 8
    link = joint.at("low", "HV")[[3, 1]]
    again = pickle.loads(pickle.dumps(link))
    assert (again.link, again.rows.tolist()) == (("low", "HV"), [3, 1])
    np.testing.assert_array_equal(again.pas(), link.pas())
    assert link.at(polarization="HH").link == ("low", "HH")
    with pytest.raises(UnknownNameError, match="low"):
        joint.at("lo")
    with pytest.raises(DataError, match="with only one receiver"):
        isolated(joint).at("low")
    assert xb.open_dataset(joint.path, "low").link == ("low", "VV")
    with h5py.File(joint.path) as file:
        axes = [dimension[0].name for dimension in file["cfr"].dims]
        assert axes == ["/tx", "/receiver", "/polarization", "/carrier_hz", "/element"]
        assert file["receiver"].attrs["flag_meanings"].decode() == "first_one low"
        assert file["polarization"].attrs["flag_meanings"].decode() == "VV VH HV HH"
        assert file["rx_position_m"].shape == (2, 3) and file["line_of_sight"].shape == (2, 2)
    with pytest.raises(ValueError, match="'receivers_json': the scene has the receivers"):
        replace(joint.file_header, receivers=("first one", "high")).at()


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_channel_back_has_the_letters_of_its_pair_turned(solver: Any) -> None:
    scene, settings = xb.load_scene("two_rooms"), xb.TraceSettings(solver, ("specular", "refraction"), 3, 50_000)
    ends_m = (1.0, 1.2, 1.0), (6.5, 2.3, 1.6)

    def channel(heard_m: Any, sent_m: Any, pair: Any) -> complex:
        alone = replace(scene, receiver=ReceiverArray(heard_m, rows=1, cols=1)).with_polarization(pair)
        return complex(xb.make_tracer(alone, [2.4], settings).channel(np.array([sent_m])).cfr[0, 0, 0])

    there, back = channel(*ends_m, "VH"), channel(*ends_m[::-1], "HV")
    assert abs(there - back) < 1e-3 * abs(there)  # Sionna RT is in single precision


def test_a_pair_of_polarizations_goes_before_what_a_scene_states() -> None:
    scene = xb.load_scene("two_rooms")
    assert scene.transmitters
    lying = replace(scene, transmitters=replace(scene.transmitters, polarization="H", pattern="dipole"))
    for given in (scene, lying, replace(scene, transmitters=None)):
        for pair in ("VV", "VH", "HV", "HH"):
            turned = given.with_polarization(pair)
            assert turned.transmitter_antenna[:2] == (given.transmitter_antenna.pattern, pair[0])
            assert turned.receiver.polarization == pair[1]
            assert turned.with_polarization(pair) == turned
    assert scene.with_polarization("VV") == scene  # which is all of V
    assert scene.with_polarization("HH").transmitter_polarization is None  # transmitters have the receiver's


def few(path: Path, **changes: Any) -> PasDataset:
    scene = replace(two_receivers(), transmitters=xb.load_scene("two_rooms").transmitters)
    how = {"freqs_ghz": [2.4, 10.0], "tx": 12, "interactions": ["specular", "refraction"], "max_depth": 1}
    return xb.generate(scene, path, **{**how, "receiver": "all", "polarization": ["HV", "VV"], **changes})


@pytest.mark.slow
def test_a_killed_generation_of_several_links_ends_in_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = few(tmp_path / "whole.h5", paths=True)
    verify(whole.path)
    write = BatchStore.write

    def killed(store: BatchStore, index: int, channel: Channel) -> None:
        if index == 2:
            raise KeyboardInterrupt
        write(store, index, channel)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(BatchStore, "write", killed)
        few(tmp_path / "again.h5", paths=True)
    assert len(list((tmp_path / "again.h5.parts").glob("*.npz"))) == 2
    few(tmp_path / "again.h5", paths=True)
    assert (tmp_path / "again.h5").read_bytes() == whole.path.read_bytes()
    with pytest.raises(OutputExistsError, match="polarizations"):
        few(tmp_path / "again.h5", paths=True, polarization="VV")


def test_the_proof_of_origin_sees_every_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def spoilt(*arguments: Any, **named: Any) -> Channel:
        channel = traced(*arguments, **named)
        if channel.cfr.ndim > 3:
            channel.cfr[:, 1, 1] *= 1.01  # in the file, and in no channel of one link
        return channel

    monkeypatch.setattr("xfreqbench.data.generate.traced", spoilt)
    with pytest.raises(DataError, match="does not hold what its header says"):
        few(tmp_path / "data.h5")


def test_the_plan_counts_links(tmp_path: Path) -> None:
    said: list[str] = []
    dataset = few(tmp_path / "data.h5", tell=said.append)
    assert "12 transmitters" in said[0]
    assert "× 2 receivers (first one, low) × 2 pairs (HV, VV) × 2 carriers = 96 samples" in said[0]
    stored = sum(variable.num_bytes for variable in variables(dataset.file_header, dataset.grid))
    assert stored == dataset.file_header.num_bytes > 96 * dataset.grid.directions[..., 0].size * 2
    assert "links      first one, low × HV, VV" in describe(dataset.path)


def test_what_links_cannot_be_asked_for_is_refused(tmp_path: Path) -> None:
    for asked, nearest in (({"receiver": "lw"}, "low"), ({"polarization": "VX"}, "VH")):
        with pytest.raises(UnknownNameError, match=nearest):
            few(tmp_path / "x.h5", **asked)
    other = replace(two_receivers().other_receivers[0], rows=4)
    with pytest.raises(XFreqBenchError, match="'first one' and 'low' have different arrays"):
        xb.generate(replace(two_receivers(), other_receivers=(other,)), tmp_path / "x.h5", receiver="all")


@pytest.mark.slow
def test_runs_on_different_links_have_different_records(tmp_path: Path) -> None:
    dataset = few(tmp_path / "data.h5", tx=24, polarization=["VV", "VH"])
    how = {"methods": ["nearest"], "protocol": "held-out-tx", "results": tmp_path / "results"}
    (first,) = xb.run(dataset, **how)
    (chosen,) = xb.run(dataset.path, **how, receiver="low", polarization="VH")
    (again,) = xb.run(dataset.at("low", "VH"), **how)
    assert first.id != chosen.id == again.id
    assert (chosen.job.receiver, chosen.job.polarization) == ("low", "VH")
    assert first.recipe != chosen.recipe
    alone = few(tmp_path / "alone.h5", tx=24, receiver="low", polarization="VH")
    (record,) = xb.run(alone, **how)
    assert "receiver" not in record.model_dump_json() and record.recipe == chosen.recipe
    np.testing.assert_equal(record.scores["ssim"], chosen.scores["ssim"])


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    """Three receivers, of which the last looks sideways."""
    scene = two_receivers()
    north = replace(scene.receiver, position_m=(4.0, 2.0, 1.1), name="north")
    wall = replace(scene.receiver, position_m=(2.0, 3.0, 1.5), boresight=(1.0, 0.0, 0.0), name="wall")
    scene = replace(scene, other_receivers=(north, wall), transmitters=xb.load_scene("two_rooms").transmitters)
    how = {"freqs_ghz": [2.4, 10.0], "tx": 6, "interactions": ["specular", "refraction"], "max_depth": 1}
    return xb.generate(scene, tmp_path_factory.mktemp("rooms") / "rooms.h5", receiver="all", **how)


def training_part(dataset: PasDataset) -> PasDataset:
    return xb.make_splits(dataset, "held-out-receiver")[0].training_part(dataset)


def test_nothing_heard_at_a_held_out_receiver_is_trained_on(rooms: PasDataset, tmp_path: Path) -> None:
    (split,) = xb.make_splits(rooms.at("north"), "held-out-receiver")
    assert split.name == "held-out-receiver-north" and len(split.train) == 0
    assert len(split.test) + split.num_without_path == len(rooms)
    assert dict(split.receivers) == {name: rooms.at(name).recipe.id for name in ("first one", "wall")}
    train = split.training_part(rooms.at("north"))
    assert len(train) == 0 and train._is_isolated and train.header.receiver.name == "north"
    for part in (train, pickle.loads(pickle.dumps(train))):
        assert not any(part.tables[name].any() for name in ("cfr", "peak_power", "num_paths"))
        assert [other.link[0] for other in part.other_receivers] == ["first one", "wall"]
        assert all(other._is_isolated and other.has_path.all() for other in part.other_receivers)
        with pytest.raises(DataError, match="with only one receiver"):
            part.at("wall")
    for refused in ({"on": "validation"}, {"targets_ghz": [2.4]}):
        with pytest.raises(ProtocolError):
            xb.make_splits(rooms, "held-out-receiver", **refused)
    with pytest.raises(ProtocolError, match="which a split file cannot hold"):
        write_splits(rooms, [split], tmp_path / "split.h5")
    found = find_split(rooms.at("north"), "held-out-receiver", split.name)
    assert found.sha256 == split.sha256


def test_every_receiver_is_held_out_in_turn(rooms: PasDataset, tmp_path: Path) -> None:
    how = {"protocol": "held-out-receiver", "results": tmp_path / "results"}
    records = xb.run(rooms.path, ["line-of-sight", "nearest", "mean-spectrum"], **how)
    assert len({record.id for record in records}) == 9
    assert {record.job.receiver for record in records} == {"first one", "north", "wall"}
    assert all(record.scores["ssim"].median > 0 for record in records)
    (one,) = xb.run(rooms.path, "nearest", **how, receiver="wall")
    assert one in records
    with pytest.raises(XFreqBenchError, match=r"'xfreq-gs' can only predict the receiver.*line-of-sight and nearest"):
        xb.run(rooms.path, "xfreq-gs", **how)
    with pytest.raises(ProtocolError, match="--receiver all"):
        xb.run(write_dataset(tmp_path / "one.h5"), "nearest", **how)


def test_line_of_sight_knows_where_the_held_out_receiver_is(rooms: PasDataset, tmp_path: Path) -> None:
    wall = rooms.at("wall")
    maps = []
    for train in (isolated(wall), training_part(wall)):
        method = LineOfSight()
        list(method.fit(train, xb.Budget(), 0))
        method.save(tmp_path)
        maps.append(LineOfSight.load(tmp_path).predict(wall.tx_position_m, wall.carrier_hz))
    np.testing.assert_array_equal(*maps)


def test_a_map_of_another_receiver_is_turned_into_the_frame_of_the_one_that_is_asked_for(rooms: PasDataset) -> None:
    wall = rooms.at("wall")
    (train,) = [data for data in training_part(wall).other_receivers if data.link[0] == "north"]
    north = TrainingTransmitters(train, wall)
    world = np.array([1.0, 0.2, -1.0]) / np.linalg.norm([1.0, 0.2, -1.0])  # in front of both

    def lobe(receiver: ReceiverArray) -> Any:
        towards = wall.grid.directions @ receiver.rotation.T @ world
        return np.exp(50 * (towards - 1)).astype(np.float32)

    turned = north.turned(lobe(train.header.receiver))
    is_heard = wall.grid.directions @ wall.header.receiver.rotation.T @ train.header.receiver.boresight >= 0
    assert np.abs(turned - lobe(wall.header.receiver))[is_heard].max() < 0.1  # a degree of the grid
    assert not turned[~is_heard].any()


def test_a_run_says_which_link_of_several_methods_see(joint: PasDataset, tmp_path: Path) -> None:
    words = f"run --data {joint.path} --method nearest --targets 24.25 --results {tmp_path}"
    done = xfreqbench(*words.split())
    assert done.code == 0, done.message
    assert "methods see receiver first one of first one, low; option receiver chooses another" in done.message
    assert "methods see polarization VV of VV, VH, HV, HH; option polarization chooses another" in done.message
    held_out = asked_tasks(joint.path, ["nearest"], RunOptions("held-out-receiver", polarization="VH"))
    crossed = ["methods see polarization VH of VV, VH, HV, HH; option polarization chooses another"]
    assert [task.split.notes(task.data) for task in held_out] == [crossed, crossed]


def test_a_run_of_sparse_says_which_splits_the_data_do_not_serve(tmp_path: Path) -> None:
    data = write_dataset(tmp_path / "data.h5", carriers_ghz=(10.0, 24.25, 37.0)).path
    words = f"run --data {data} --method nearest --protocol sparse --results {tmp_path / 'results'}"
    done = xfreqbench(*words.split())
    assert done.code == 0, done.message
    assert "sparse leaves out 2 of 3 splits" in done.message
