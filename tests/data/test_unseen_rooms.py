"""Protocol `unseen-rooms`: what is heard and asked, what stays hidden, and that no room is there twice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.rooms import tiny_rooms, write_room
from xfreqbench.data.collection import Collection, room_of, write_collection
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.unseen_rooms import NUMS_HEARD, room_question, room_splits
from xfreqbench.errors import DataError, ProtocolError, UnknownNameError


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Collection:
    return tiny_rooms(tmp_path_factory.mktemp("rooms"), train=1, validation=1, test=1, other=1)


def test_a_method_hears_more_of_the_same_and_is_always_asked_for_other_transmitters(rooms: Collection) -> None:
    questions = {number: room_question(rooms[2], 5, number) for number in NUMS_HEARD}
    heard = {number: {*map(tuple, question.heard.tx_position_m)} for number, question in questions.items()}
    assert [len(heard[number]) for number in NUMS_HEARD] == list(NUMS_HEARD)
    assert heard[0] < heard[4] < heard[16] < heard[64]
    asked = questions[64].asked
    assert all(np.array_equal(question.asked.rows, asked.rows) for question in questions.values())
    assert not heard[64] & {*map(tuple, asked.tx_position_m)}
    assert len(asked) == 16 * 6
    assert {*questions[4].heard.carrier_hz / 1e9} == {1.0, 10.0, 60.0}
    assert {*asked.carrier_hz / 1e9} == {1.0, 2.4, 10.0, 24.25, 60.0, 77.0}


@pytest.mark.parametrize("are_stored", [False, True])
def test_what_is_heard_has_the_true_maps_and_nothing_else_of_the_room(
    rooms: Collection, tmp_path: Path, are_stored: bool
) -> None:
    room = rooms[2]
    if are_stored:
        write_room(tmp_path / "room.h5", rooms.rooms[2].seed, maps=True)
        room = open_dataset(tmp_path / "room.h5")
    heard = room_question(room, 5, 4).heard
    for nth in range(len(heard)):
        same_tx = (room.tx_position_m == heard.tx_position_m[nth]).all(axis=1)
        (row,) = np.flatnonzero(same_tx & (room.carrier_hz == heard.carrier_hz[nth]))
        np.testing.assert_allclose(heard.pas(nth), room.pas(int(row)), atol=1e-4)  # maps are stored in two bytes
    assert len(heard.tables["tx_position_m"]) == 4
    assert np.count_nonzero(heard.tables["cfr"].any(axis=2)) == 12
    assert room.scene.name not in repr(heard)
    with pytest.raises(DataError, match="which scene"):
        _ = heard.scene


def test_a_plan_that_is_told_says_where_walls_are_but_not_of_what(rooms: Collection) -> None:
    told = room_question(rooms[2], 5, 0, plan_told=True).heard
    (wall,), (true,) = told.scene.surface, rooms[2].scene.surface
    assert (wall.min_m, wall.max_m) == (true.min_m, true.max_m)
    assert (wall.name, wall.material, wall.thickness_m) == ("surface 0", "concrete", 0.2)
    assert len(told) == 0


def test_splits_are_those_of_test_rooms_then_of_other_types_or_of_validation_rooms(rooms: Collection) -> None:
    names = [f"{part}heard-{number}" for part in ("", "other-type-") for number in NUMS_HEARD]
    assert [split.name for split in room_splits(rooms, "unseen-rooms")] == names
    (first, *_) = room_splits(rooms, "unseen-rooms-plan", "validation")
    assert (first.protocol, len(rooms.part(first.part))) == ("unseen-rooms-plan-validation", 1)
    assert len({split.sha256 for split in room_splits(rooms, "unseen-rooms")}) == 8
    with pytest.raises(ProtocolError, match="needs rooms of part 'train'"):
        room_splits(rooms.part("test"), "unseen-rooms")
    with pytest.raises(UnknownNameError):
        room_splits(rooms, "lofo")


def test_a_room_of_nearly_the_same_plan_is_refused_whatever_its_walls_are_made_of(
    rooms: Collection, tmp_path: Path
) -> None:
    write_room(tmp_path / "a.h5", 3, num_tx=80)
    write_room(tmp_path / "b.h5", 3, num_tx=81, moved_m=1e-3)
    pair = [room_of(tmp_path, name, seed, "box") for seed, name in enumerate(("a.h5", "b.h5"))]
    told = {"name": "twice", "family": {}, "options": {}, "carrier_hz": rooms.record.carrier_hz}
    with pytest.raises(ProtocolError, match=r"a\.h5 and b\.h5 .* have the same plan"):
        room_splits(write_collection(tmp_path, pair, **told), "unseen-rooms")


def test_a_room_of_too_few_transmitters_is_refused(rooms: Collection) -> None:
    few = replace(rooms[0], tables={name: table[:20] for name, table in rooms[0].tables.items()})
    with pytest.raises(ProtocolError, match="Generate rooms of 80 transmitters or more"):
        _ = room_question(few, 0, 16).heard
