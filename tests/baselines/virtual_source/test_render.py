"""Rooms that are traced beside a learned field: when they are believed, and when the field stands alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source.room import render as render_module
from xfreqbench.baselines.virtual_source.room.refine import Refinement
from xfreqbench.baselines.virtual_source.room.render import (
    CHOOSE_AT,
    CHOOSE_AT_OF_STEPS,
    FROM,
    FROM_OF_STEPS,
    SETTLE_AT,
    RoomRender,
)
from xfreqbench.baselines.virtual_source.room.surfaces import surface_json
from xfreqbench.baselines.virtual_source.room.traced import DIFFRACTING, PREDICTING, tracer_in
from xfreqbench.baselines.virtual_source.stored import StoredFindings

from tests.support.found_box import ALL_PLANES, SETTINGS, found_room, generated
from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.contract import Budget
from xfreqbench.scene.array import rotation_quaternion
from xfreqbench.types import Maps

pytestmark = pytest.mark.usefixtures("one_thread")
STEPS = Budget(max_steps=100)
PAID = Budget(max_seconds=100.0), Budget(max_maps=10_000)  # that a refinement spends
AS_DEEP = replace(SETTINGS, max_depth=PREDICTING.max_depth)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return generated(tmp_path_factory.mktemp("data"), settings=AS_DEEP, tx=12)


@pytest.fixture(scope="module")
def diffracted(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    settings = replace(AS_DEEP, interactions=DIFFRACTING.interactions)
    return generated(tmp_path_factory.mktemp("diffracted"), settings=settings, tx=12)


@pytest.fixture
def unrefined(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refinements that have nothing to try, because tracing takes time."""
    monkeypatch.setattr(Refinement, "num_steps", 0)


class Known:
    """Predicts the maps of a data set, or a beam upwards wherever a function of the positions is true."""

    def __init__(self, dataset: PasDataset, is_wrong: Any = lambda tx_m: np.zeros(len(tx_m), bool)) -> None:
        samples = zip(dataset.tx_position_m.tolist(), dataset.carrier_hz.tolist(), dataset.pas(), strict=True)
        self._maps = {(*tx_m, carrier_hz): own for tx_m, carrier_hz, own in samples}
        self._is_wrong = is_wrong

    def __call__(self, tx_m: np.ndarray, carrier_hz: np.ndarray) -> Maps:
        queries = zip(tx_m.tolist(), carrier_hz.tolist(), strict=True)
        maps = np.array([self._maps[*at_m, hz] for at_m, hz in queries])
        upwards = np.zeros(maps.shape[1:], np.float32)
        upwards[-10:] = 1.0
        maps[self._is_wrong(tx_m)] = upwards
        return maps


def everywhere(tx_m: np.ndarray) -> np.ndarray:
    return np.ones(len(tx_m), bool)


def rendered(
    dataset: PasDataset, learned: Any, mode: Any = "blended", findings: Any = found_room, budget: Budget = STEPS
) -> RoomRender:
    render = RoomRender(mode)
    render.advance(dataset, budget, 1.0, findings, learned)
    return render


def asked(dataset: PasDataset) -> tuple[np.ndarray, np.ndarray]:
    return dataset.tx_position_m, dataset.carrier_hz


@pytest.mark.usefixtures("unrefined")
def test_the_traced_room_is_believed_where_the_learned_field_errs(dataset: PasDataset) -> None:
    learned = Known(dataset, everywhere)
    maps = rendered(dataset, learned).maps(learned(*asked(dataset)), *asked(dataset))
    np.testing.assert_allclose(maps, dataset.pas(), atol=5e-3)  # corners are float32
    np.testing.assert_allclose(maps.max(axis=(1, 2)), 1, rtol=1e-6)


@pytest.mark.usefixtures("unrefined")
@pytest.mark.parametrize("mode", ["blended", "traced"])
def test_edges_diffract_in_the_room_where_they_do_in_the_data(
    mode: Any, dataset: PasDataset, diffracted: PasDataset, tmp_path: Path
) -> None:
    for data, settings in ((dataset, PREDICTING), (diffracted, DIFFRACTING)):
        learned = Known(data, everywhere)
        render = rendered(data, learned, mode)
        assert render.tracer.settings == settings
        assert render.findings() == {"room": [surface_json(surface) for surface in render.tracer.room]}
        maps = render.maps(learned(*asked(data)), *asked(data))
        np.testing.assert_allclose(maps, data.pas(), atol=5e-3)
    render.save(tmp_path)
    loaded = RoomRender.load("blended", tmp_path, data.beam, data.header.pas_kind)
    np.testing.assert_array_equal(loaded.maps(learned(*asked(data)), *asked(data)), maps)
    assert np.abs(dataset.pas() - diffracted.pas()).max() > 0.05


@pytest.mark.usefixtures("unrefined")
def test_the_learned_field_is_believed_where_it_is_right(dataset: PasDataset) -> None:
    findings = found_room(error_m=0.05)
    learned = Known(dataset)(*asked(dataset))
    render = rendered(dataset, Known(dataset), findings=lambda: findings)
    assert RoomRender("blended").findings() == {}
    np.testing.assert_array_equal(render.maps(learned, *asked(dataset)), learned)
    traced = rendered(dataset, Known(dataset), "traced", findings=lambda: findings)
    assert np.abs(traced.maps(learned, *asked(dataset)) - learned).max() > 0.1


@pytest.mark.usefixtures("unrefined")
@pytest.mark.parametrize(
    ("mode", "findings", "budget"),
    [
        ("learned", found_room, STEPS),
        ("blended", lambda: ALL_PLANES, STEPS),  # without faces
        ("traced", lambda: ALL_PLANES, STEPS),
        ("blended", found_room, Budget(max_seconds=3.0)),
    ],
)
def test_the_learned_field_stands_where_no_room_can_be_made(
    dataset: PasDataset, mode: Any, findings: Any, budget: Budget
) -> None:
    learned = Known(dataset, everywhere)
    render = RoomRender(mode)
    for share in (FROM_OF_STEPS - 0.01, FROM_OF_STEPS, 1.0):
        render.advance(dataset, budget, share, findings, learned)
    maps = learned(*asked(dataset))
    np.testing.assert_array_equal(render.maps(maps, *asked(dataset)), maps)


@pytest.mark.usefixtures("unrefined")
def test_too_few_transmitters_choose_no_weights(dataset: PasDataset) -> None:
    few = dataset[np.flatnonzero(dataset.tx_index < 4)]
    assert rendered(few, Known(few, everywhere)).tracer is None


@pytest.mark.usefixtures("unrefined")
def test_no_transmitter_that_validates_is_compared_by_the_refinement(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    render = RoomRender("blended")
    compared: list[np.ndarray] = []
    weigh = RoomRender._weigh

    def watched(self: RoomRender, refinement: Refinement, *rest: Any) -> None:
        compared.append(refinement.score.samples.tx_position_m)
        weigh(self, refinement, *rest)

    monkeypatch.setattr(RoomRender, "_weigh", watched)
    render.advance(dataset, STEPS, 1.0, found_room, Known(dataset))
    validating = {*map(tuple, render.weights.position_m.tolist())}
    assert len(validating) >= 3
    assert not validating & {*map(tuple, compared[0].tolist())}


@pytest.mark.usefixtures("unrefined")
def test_a_stored_room_predicts_the_same(dataset: PasDataset, tmp_path: Path) -> None:
    learned = Known(dataset, lambda tx_m: tx_m[:, 0] > 2.5)
    render = rendered(dataset, learned)
    render.save(tmp_path)
    loaded = RoomRender.load("blended", tmp_path, dataset.beam, dataset.header.pas_kind)
    maps = [rendering.maps(learned(*asked(dataset)), *asked(dataset)) for rendering in (render, loaded)]
    np.testing.assert_array_equal(*maps)
    assert np.abs(maps[0] - learned(*asked(dataset))).max() > 0.1


def test_a_refinement_keeps_to_its_part_of_a_budget_and_goes_on_after_it_was_stored(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = []

    def step(self: Refinement, is_over: Any = None) -> None:
        self.room = self.room[1:] if len(self.room) > 3 else self.room
        self.done += 1
        done.append(self.done)

    monkeypatch.setattr(Refinement, "num_steps", 8)
    monkeypatch.setattr(Refinement, "step", step)
    learned = Known(dataset)
    first = RoomRender("traced")
    first.advance(dataset, STEPS, (FROM_OF_STEPS + CHOOSE_AT_OF_STEPS) / 2, found_room, learned)
    assert 0 < done[-1] < 8
    assert first.tracer is None
    first.save(tmp_path)
    loaded = RoomRender.load("traced", tmp_path, dataset.beam, dataset.header.pas_kind)
    rooms = []
    for render in (first, loaded):
        render.advance(dataset, STEPS, 1.0, found_room, learned)
        assert done[-1] == 8
        rooms.append([(surface.number, surface.corners_m.tolist()) for surface in render.tracer.room])
    assert rooms[0] == rooms[1]
    assert len(rooms[0]) == 3


@pytest.mark.parametrize("mode", ["blended", "traced"])
def test_a_budget_of_too_few_maps_is_spent_on_learning_alone(mode: Any, dataset: PasDataset) -> None:
    render = RoomRender(mode)
    for share in (FROM, SETTLE_AT, CHOOSE_AT):
        render.advance(dataset, Budget(max_maps=3000), share, found_room, Known(dataset))
    assert render.has_begun
    assert render.refinement is render.tracer is None
    assert render.count.maps == 0


@pytest.mark.slow
def test_a_refinement_spends_maps_of_a_budget_and_goes_on_from_a_file(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(render_module, "_LEAST_COMPARISONS", 0)
    most, learned, shares = 3000, Known(dataset), np.linspace(FROM, CHOOSE_AT, 100).tolist()
    budget = Budget(max_maps=most)

    def go_on(render: RoomRender, up_to: float) -> None:
        for learning in shares:
            if learning + render.count.maps / most <= up_to:
                render.advance(dataset, budget, learning + render.count.maps / most, found_room, learned)

    first = RoomRender("traced")
    go_on(first, 0.3)
    assert first.tracer is None
    assert 0 < first.count.maps < (SETTLE_AT - FROM) * most
    first.save(tmp_path)
    loaded = RoomRender.load("traced", tmp_path, dataset.beam, dataset.header.pas_kind)
    rooms = []
    for render in (first, loaded):
        go_on(render, CHOOSE_AT)
        render.advance(dataset, budget, 1.0, found_room, learned)
        rooms.append([(surface.number, surface.corners_m.tolist()) for surface in render.tracer.room])
    assert rooms[0] == rooms[1]
    assert loaded.count == first.count
    assert most / 2 < first.count.maps < (1 - FROM) * most  # some are compared after the last look at the count


@pytest.mark.parametrize("budget", PAID)
def test_other_rounds_begin_while_the_budget_allows_and_something_changes(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch, budget: Budget
) -> None:
    rounds = []

    def step(self: Refinement, is_over: Any = None) -> None:
        rounds.append(self)
        self.room = self.room[1:] if len(self.room) > 3 else self.room
        self.done += 1

    monkeypatch.setattr(Refinement, "steps", [])
    monkeypatch.setattr(Refinement, "num_steps", 2)
    monkeypatch.setattr(Refinement, "step", step)
    render = RoomRender("traced")
    for share in np.linspace(FROM, SETTLE_AT - 0.01, 40).tolist():
        render.advance(dataset, budget, share, found_room, Known(dataset))
    found = len(rounds[0].found)
    # the last has nothing to change
    assert [len(refinement.found) for refinement in rounds[::2]] == [*range(found, 3, -2), 3]
    assert len(rounds[-1].room) == 3


@pytest.mark.parametrize("budget", PAID)
def test_learning_goes_on_where_a_refinement_is_over_before_its_part_is(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch, budget: Budget
) -> None:
    monkeypatch.setattr(Refinement, "steps", [])
    monkeypatch.setattr(Refinement, "num_steps", 2)
    monkeypatch.setattr(Refinement, "step", lambda self, is_over: setattr(self, "done", self.done + 1))
    render = RoomRender("traced")
    shares = np.linspace(FROM, CHOOSE_AT, 5).tolist()
    is_weighed = []
    for share in shares:
        render.advance(dataset, budget, share, found_room, Known(dataset))
        is_weighed.append(render.tracer is not None)
    assert is_weighed == [False] * 4 + [True]


@pytest.mark.usefixtures("unrefined")
def test_a_map_stays_as_it_was_learned_where_no_path_is_traced(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    render = rendered(dataset, Known(dataset, everywhere))
    monkeypatch.setattr(render.tracer, "maps", lambda tx_m, hz: np.zeros((len(hz), *dataset.grid.shape), np.float32))
    learned = Known(dataset)(*asked(dataset))
    np.testing.assert_array_equal(render.maps(learned, *asked(dataset)), learned)


def test_rooms_are_traced_to_arrays_in_any_plane_of_their_frame(dataset: PasDataset) -> None:
    """Published data have arrays in plane yz: here one that has its elements where the box's array has them."""
    receiver = dataset.header.receiver
    to_world = receiver.rotation[:, [2, 0, 1]]
    pole = tuple(to_world[:, 2].tolist())
    turned = replace(receiver, plane="yz", boresight=pole, orientation=rotation_quaternion(to_world))
    refinement = Refinement.of(StoredFindings.model_validate(found_room()), dataset)
    tx_m = dataset.tx_position_m[:: len(dataset) // 2]
    own, other = (tracer_in(refinement.room, array, [2.4e9]).channel(tx_m).cfr for array in (receiver, turned))
    assert abs(own).min() > 0
    np.testing.assert_allclose(other, own, rtol=1e-9)
