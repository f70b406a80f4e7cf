"""The field of virtual sources, and the method that trains it: tiny ones, in small rooms."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from xfreqbench.baselines.virtual_source.config import SourceConfig
from xfreqbench.baselines.virtual_source.field import field as field_module
from xfreqbench.baselines.virtual_source.field.field import VirtualSourceField
from xfreqbench.baselines.virtual_source.findings.compared import reflection_difference
from xfreqbench.baselines.virtual_source.method import VirtualSource, VirtualSourceConfig
from xfreqbench.baselines.virtual_source.search.planes import Plane
from xfreqbench.baselines.virtual_source.search.range_profile import random_planes
from xfreqbench.baselines.virtual_source.stored import FoundSlab, StoredFindings
from xfreqbench.baselines.xfreq_gs import XFreqGS

from tests.support.box_room import SIZE_M, closed_room, plane
from tests.support.mirrored_room import Room as MirroredRoom
from tests.support.mirrored_room import Wall
from tests.support.synthetic import write_dataset
from tests.support.training import predicted, reloaded, trained
from xfreqbench.data.dataset import PasDataset, isolated
from xfreqbench.data.plane_waves import stored_channels
from xfreqbench.errors import MethodError
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods import contract
from xfreqbench.methods.check import check_method
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within
from xfreqbench.methods.learning.network import NetworkConfig
from xfreqbench.methods.registry import build_method
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

pytestmark = pytest.mark.usefixtures("one_thread")

TINY = {
    "width": 8,
    "layers": 2,
    "batch_size": 4,
    "stride": 15,
    "free_sources": 6,
    "max_planes": 4,
    "max_images": 20,
    "render": "learned",
}


def tiny(**options: Any) -> VirtualSource:
    return VirtualSource(VirtualSourceConfig(**{**TINY, **options}))


def lone_field(**options: Any) -> VirtualSourceField:
    """Nothing but the line of sight, at an array that looks along the world's z."""
    config = SourceConfig(free_sources=0, max_order=0, **options)
    field = VirtualSourceField(config, NetworkConfig(width=8, layers=2))
    field.scaling.rotation.copy_(torch.eye(3))
    field.room.antenna_code.copy_(torch.tensor([False, True]))  # both ends horizontal: 1 in every direction
    return field


def direct(field: VirtualSourceField, offset_m: torch.Tensor, carrier_hz: torch.Tensor) -> np.ndarray:
    element = torch.as_tensor(ReceiverArray((0.0, 0.0, 0.0)).element_position_wavelengths, dtype=torch.float32)
    with torch.no_grad():
        return field.channels(offset_m, field.room.traced(offset_m), carrier_hz, element).numpy()


def test_a_wave_from_nearby_is_curved_across_the_array() -> None:
    drawn = torch.randn(40, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    offset_m = 2.0 * torch.nn.functional.normalize(drawn, dim=1)
    wavelength_m = SPEED_OF_LIGHT_M_S / 1e9
    cfr = direct(lone_field(), offset_m, torch.tensor([1e9], dtype=torch.float64))[:, 0]
    element_m = ReceiverArray((0.0, 0.0, 0.0)).element_position_wavelengths * wavelength_m
    length_m = np.linalg.norm(offset_m.numpy()[:, None] - element_m, axis=2)
    error_rad = np.angle(cfr * np.exp(2j * np.pi * length_m / wavelength_m))
    # the third order, k r³ sin²cos / 2d², is 0.03 rad at the corners, r = 0.32 m; the second is 0.5 rad
    assert abs(error_rad).max() < 0.05
    plane_wave_m = 2.0 - offset_m.numpy() @ element_m.T / 2.0
    assert abs(np.angle(cfr * np.exp(2j * np.pi * plane_wave_m / wavelength_m))).max() > 0.3


def test_the_phase_of_a_long_path_at_a_high_carrier_takes_double_precision() -> None:
    carrier_hz = torch.tensor([94e9], dtype=torch.float64)
    offset_m = torch.tensor([(30.0 + 0.123 * index, 0.0, 0.0) for index in range(20)], dtype=torch.float64)
    turns = (offset_m[:, :1] * carrier_hz / SPEED_OF_LIGHT_M_S).numpy()
    errors_rad = {}
    for lengths in ("float64", "float32"):
        field = lone_field(lengths=lengths)
        travel = field._travel(offset_m[:, :1], carrier_hz)[:, 0].numpy()
        errors_rad[lengths] = abs(np.angle(travel * np.exp(2j * np.pi * (turns % 1)))).max()
    assert errors_rad["float64"] < 1e-5  # an angle below 2π, and its sine, in float32
    assert errors_rad["float32"] > 1e-3  # 9400 turns, of which float32 keeps 5e-4


def test_the_method_keeps_its_contract() -> None:
    overrides = [f"{name}={value}" for name, value in {**TINY, "planes": "random"}.items()]
    assert [str(finding) for finding in check_method("virtual-source", overrides) if finding.fault] == []


@pytest.mark.parametrize(
    "options",
    [
        {},  # a search that finds no plane among so few transmitters
        {"planes": "random"},
        {"planes": "random", "max_gain": 0.3, "free_sources": 0},
        {"planes": "random", "max_images": 1},
        {"planes": "random", "phase": False},
        {"max_order": 0, "free_sources": 0},
        {"max_planes": 0},
    ],
    ids=str,
)
def test_a_field_of_any_size_is_fitted_and_explains_itself(
    options: dict[str, Any], dataset: PasDataset, tmp_path: Path
) -> None:
    model = tiny(**options)
    trained(model, dataset, 3)
    maps = predicted(model, dataset)
    assert np.isfinite(maps).all()
    np.testing.assert_allclose(maps.max(axis=(1, 2)), 1, rtol=1e-6)
    assert np.array_equal(predicted(reloaded(model, tmp_path / "saved"), dataset), maps)
    StoredFindings.model_validate(json.loads(json.dumps(model.findings(), allow_nan=False)))


def test_where_no_plane_is_found_xfreq_gs_learns_instead(dataset: PasDataset, tmp_path: Path) -> None:
    model, other = tiny(), XFreqGS()
    losses = trained(other, dataset, 6)
    before = trained(model, dataset, 2, end=6)
    resumed = reloaded(model, tmp_path / "saved")
    assert [*before, *trained(resumed, dataset, 6)] == losses
    assert np.array_equal(predicted(resumed, dataset), predicted(other, dataset))
    assert resumed.findings() == {**model.findings(), **other.findings()}
    assert resumed.findings()["planes"] == []
    assert resumed.num_parameters == other.num_parameters
    assert resumed.config == model.config


@pytest.mark.parametrize("number", [1, 2])
def test_two_planes_are_enough_to_begin_with(number: int, dataset: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    planes = random_planes(dataset, 0, number)
    monkeypatch.setattr(field_module, "find_planes", lambda *_: planes)
    model, other = tiny(), XFreqGS()
    losses = [trained(method, dataset, 1)[-1].loss for method in (model, other)]
    assert (losses[0] == losses[1]) == (number == 1)
    assert len(model.findings()["planes"]) == number


def test_with_seconds_too_few_for_a_search_xfreq_gs_learns_instead(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(field_module, "find_planes", lambda *_: pytest.fail("no search was asked for"))
    model, other = tiny(), XFreqGS()
    few = Budget(max_seconds=3)
    assert next(model.fit(dataset, few, 0)).loss == next(other.fit(dataset, few, 0)).loss
    assert model.findings() == other.findings()
    ablation = tiny(planes="random")  # searches nothing, so it needs no time for it
    next(ablation.fit(dataset, few, 0))
    assert "planes" in ablation.findings()


def test_a_device_other_than_the_processor_is_refused_before_any_work() -> None:
    with pytest.raises(MethodError, match=r"device.*cpu"):
        build_method("virtual-source", ["device=cuda"])


@pytest.mark.parametrize("options", [{}, {"max_gain": 0.3}], ids=str)
def test_a_fit_goes_on_from_its_files_as_if_it_had_never_stopped(
    options: dict[str, Any], dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = field_module.find_more_planes
    monkeypatch.setattr(field_module, "_MIN_STEPS_BETWEEN_LOOKS", 4)
    monkeypatch.setattr(field_module, "find_planes", lambda train, seed, _: random_planes(train, seed, 3))
    monkeypatch.setattr(
        field_module,
        "find_more_planes",
        lambda train, known, explained, _: [*search(train, known, explained), *random_planes(train, len(known), 1)],
    )
    unbroken, broken = (tiny(**options) for _ in range(2))
    losses = trained(unbroken, dataset, 30)
    before = trained(broken, dataset, 8, end=30)
    assert int(broken._training.field.num_looks) == 1
    resumed = reloaded(broken, tmp_path / "first")
    between = trained(resumed, dataset, 13, end=30)
    resumed = reloaded(resumed, tmp_path / "second")
    after = trained(resumed, dataset, 30)
    assert int(resumed._training.field.num_looks) == 3
    assert [*before, *between, *after] == losses
    for model, name in ((unbroken, "unbroken"), (resumed, "resumed")):
        (tmp_path / name).mkdir()
        model.save(tmp_path / name)
    for file in ("state.safetensors", "state.json"):
        assert (tmp_path / "unbroken" / file).read_bytes() == (tmp_path / "resumed" / file).read_bytes()


def test_searches_take_a_share_of_a_budget_in_seconds_and_all_the_time_they_need_of_one_in_steps(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [100.0]
    over_at: dict[Budget, list[float]] = {}
    monkeypatch.setattr(contract.time, "perf_counter", lambda: now_s[0])

    def searched(train: PasDataset, seed: int, is_over: Callable[[], bool]) -> list[Plane]:
        start_s = now_s[0]
        while not is_over() and now_s[0] < start_s + 1000:
            now_s[0] += 1
        over_at.setdefault(budget, []).append(now_s[0] - start_s)
        return random_planes(train, seed, 3)

    monkeypatch.setattr(field_module, "find_planes", searched)
    for budget in (Budget(max_seconds=20), Budget(max_steps=1)):
        next(tiny().fit(dataset, budget, 0))
    assert over_at == {Budget(max_seconds=20): [15], Budget(max_steps=1): [1000]}


def test_no_look_begins_that_would_end_after_the_budget(dataset: PasDataset) -> None:
    method = tiny(planes="random")
    trained(method, dataset, 1)
    field = method._training.field
    field.config = replace(field.config, planes="search")
    assert field.is_time_to_look(10_000, 0.79)
    assert field.is_time_to_look(10_000, 0.99)
    field.budget = Budget(max_seconds=20)
    assert field.is_time_to_look(10_000, 0.79)
    assert not field.is_time_to_look(10_000, 0.81)


def test_another_look_keeps_planes_that_hold_something_and_what_is_known_of_them() -> None:
    field = VirtualSourceField(SourceConfig(max_images=30), NetworkConfig(width=8, layers=2))
    room = field.room
    tx_m = torch.tensor([(1.0, 0.3, -0.7), (1.2, 0.1, -0.5)], dtype=torch.float64)
    room.enter(("iso", "V"), tx_m, torch.tensor([1e9, 2e9], dtype=torch.float64))
    room.take([], [plane((1, 0, 0), 3.0), plane((0, 1, 0), 2.0), plane((0, 0, -1), 1.5)])
    with torch.no_grad():
        room.presence.logits[1, ..., 0] = 9.0  # empty
        room.presence.logits[2, 1, 1] = torch.tensor([0.0, 5.0, 1.0, 0.0])
        room.slabs.log_thickness[0] = torch.tensor([0.11, 0.12, 0.13]).log()
    kept, logits = room.worth_keeping(), room.presence.logits.detach().clone()
    assert kept == [0, 2]
    room.take(kept, [plane((-1, 0, 0), 1.0)])
    assert room.distance_m.tolist() == [3.0, 1.5, 1.0]
    rows, columns = room.presence.logits.shape[1:3]
    torch.testing.assert_close(room.presence.logits.detach()[:2], logits[[0, 2], :rows, :columns])
    torch.testing.assert_close(room.slabs.log_thickness[0, :2].detach().exp(), torch.tensor([0.11, 0.13]))
    assert float(room.presence.most_held()[2]) < 0.1  # what is found later is there hardly, to begin with


def test_a_cell_of_metal_reflects_everything_and_lets_nothing_through() -> None:
    field = VirtualSourceField(SourceConfig(max_images=30), NetworkConfig(width=8, layers=2))
    room = field.room
    tx_m = torch.tensor([(1.0, 0.3, -0.7)], dtype=torch.float64)
    carrier_hz = torch.tensor([1e9, 77e9], dtype=torch.float64)
    room.enter(("iso", "V"), tx_m, carrier_hz)
    room.take([], [plane((1, 0, 0), 3.0), plane((1, 0, 0), 0.5)])  # one behind the transmitter, one in its way
    with torch.no_grad():
        room.presence.logits[0] = torch.tensor([0.0, 0.0, 0.0, 30.0])
        room.presence.logits[1] = torch.tensor([30.0, 0.0, 0.0, 0.0])
        room.presence.settle()
        room.sequence = torch.tensor([[-1, -1, -1], [0, -1, -1]])
        traces = room.traced(tx_m)
        gain = room.attenuated(traces, carrier_hz)[0]
        spread = (traces.direct_m[:, None] / traces.length_m)[0]
        te, tm = traces.polarised[0, 1, [0, 4]]  # of the first bounce; the other two are none
        expected = (spread[1].float() * (tm - te).abs()).repeat(2)
        assert float(expected[0]) > 0.1
        np.testing.assert_allclose(gain[1].abs(), expected, rtol=1e-5)
        room.presence.logits[1] = torch.tensor([0.0, 0.0, 0.0, 30.0])
        room.presence.settle()
        assert room.attenuated(room.traced(tx_m), carrier_hz)[0, 0].abs().max() < 1e-6
        *_, metal = room.slabs.described(0, [0.0, 0.0, 1.0])
    assert reflection_difference([FoundSlab.model_validate(metal)], {}, np.array([1e9, 77e9])).min() > 0.999


@pytest.mark.parametrize("what", ["one transmitter", "one carrier", "twice at a place", "maps alone"])
def test_a_data_set_of_little_is_learned_from(what: str, tmp_path: Path) -> None:
    if what == "maps alone":
        room = MirroredRoom([Wall(0.0, 0.0, 2.0)], np.array([2e9, 9e9]), 8)
        data = room.stored_maps(tmp_path, "amplitude", 255)
    elif what == "twice at a place":
        room = MirroredRoom([Wall(0.0, 0.0, 2.0)], np.array([2e9, 9e9]), 4)
        twice = np.concatenate([room.tx_position_m, room.tx_position_m])
        cfr = np.concatenate([room.cfr(), room.cfr()])
        data = stored_channels(tmp_path / "twice.h5", room.receiver, room.carrier_hz, twice, cfr, maps=False)
    elif what == "one carrier":
        data = write_dataset(tmp_path / "one.h5", 6, (10.0,))
    else:
        data = write_dataset(tmp_path / "one.h5", 1)
    model = tiny(planes="random", stride=5)
    losses = [point.loss for point in trained(model, data, 3)]
    maps = model.predict(data.tx_position_m[:2], data.carrier_hz[:2])
    assert np.isfinite(losses).all()
    assert np.isfinite(maps).all()
    np.testing.assert_allclose(maps.max(axis=(1, 2)), 1, rtol=1e-6)


@pytest.mark.slow
def test_a_room_that_was_found_tells_of_a_carrier_that_was_not_heard(tmp_path: Path) -> None:
    scene = closed_room(ReceiverArray(position_m=(2.1, 1.7, 2.5)), [("concrete", 0.2)] * 6)
    carrier_hz = np.array([1e9, 2.4e9, 5e9, 10e9, 24.25e9, 47.2e9, 77e9])
    tx_m = np.random.default_rng(0).uniform((0.3, 0.3, 0.5), (4.7, 3.7, 1.9), (150, 3))
    settings = TraceSettings(max_depth=3, interactions=("specular",), rays=20_000)
    cfr = ImageTracer(scene, carrier_hz.tolist(), settings).channel(tx_m).cfr
    data = stored_channels(tmp_path / "room.h5", scene.receiver, carrier_hz, tx_m, cfr, maps=False)
    is_heard = data.carrier_hz != 5e9
    test, train = data[np.flatnonzero(~is_heard)], isolated(data[np.flatnonzero(is_heard)])

    def score(model: Any) -> float:
        return float(np.median(ssim(model.predict(test.tx_position_m, test.carrier_hz), test.pas(), data.grid)))

    others = [build_method(name) for name in ("line-of-sight", "mean-over-frequency")]
    for other in others:
        fit_within(other, train, Budget(max_steps=1), 0)
    model = tiny(max_planes=8, max_order=2, batch_size=8, stride=5)
    trained(model, train, 120)
    # 0.946 against 0.775 and 0.833 after 150 steps
    assert score(model) > max(map(score, others)) + 0.05

    to_wall_m = {tuple(np.eye(3)[axis]): SIZE_M[axis] - scene.receiver.position_m[axis] for axis in range(3)}
    to_wall_m |= {tuple(-np.eye(3)[axis]): scene.receiver.position_m[axis] for axis in range(3)}
    del to_wall_m[0.0, 0.0, 1.0]  # 0.1 m above the array: too near for a detour of its own
    for normal, distance_m in to_wall_m.items():
        found = [plane for plane in model.findings()["planes"] if np.dot(plane["normal"], normal) > 0.999]
        assert len(found) == 1
        assert abs(found[0]["distance_m"] - distance_m) < 1e-3
        assert found[0]["held"] > 0.5


@pytest.mark.parametrize(
    ("receiver", "settings"),
    [
        ({"pattern": "tr38901"}, {}),
        ({"pattern": "dipole", "antenna_orientation_deg": (0.0, 20.0, 0.0)}, {}),
        ({}, {"transmitter_pattern": "dipole", "transmitter_polarization": "V"}),
        ({}, {"transmitter_pattern": "iso", "transmitter_polarization": "H"}),
    ],
)
def test_antennas_that_it_does_not_know_are_refused_before_a_fit(
    dataset: PasDataset, receiver: dict[str, Any], settings: dict[str, str]
) -> None:
    header = dataset.header
    header = replace(header, receiver=replace(header.receiver, **receiver), settings={**header.settings, **settings})
    with pytest.raises(MethodError, match=r"iso or dipole, not turned, .* such as xfreq-gs"):
        next(VirtualSource().fit(replace(dataset, header=header), Budget(max_steps=1), seed=0))
