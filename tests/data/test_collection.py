"""Collections: the data sets of many rooms, their parts, and what is said of damaged ones."""

from __future__ import annotations

import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from torch.utils.data import DataLoader

from tests.support.synthetic import write_dataset
from xfreqbench.data.collection import FILE, PARTS, Collection, Room, open_collection, room_of, write_collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import ArgumentError, DataError, UnknownNameError

NUM_TX = (4, 2, 3)  # of each room, at three carriers
PERCENT = [64, 84, 62, 57, 30, 43]  # of seeds 0 to 5, on every machine


@pytest.fixture(scope="module")
def collection(tmp_path_factory: pytest.TempPathFactory) -> Collection:
    """Three rooms: two offices, and a hall, whose type is held out."""
    folder = tmp_path_factory.mktemp("rooms")
    names = [f"000/{seed:06d}.h5" for seed in range(3)]
    datasets = [
        write_dataset(folder / name, num_tx=num_tx, maps=False) for name, num_tx in zip(names, NUM_TX, strict=True)
    ]
    rooms = [room_of(folder, name, seed, "hall" if seed == 2 else "office") for seed, name in enumerate(names)]
    told = {"name": "tiny", "family": {"type": []}, "options": {"tx": 4}, "held_out_types": ["hall"]}
    return write_collection(folder, rooms, carrier_hz=datasets[0].header.carrier_hz.tolist(), **told)


def test_a_collection_is_a_sequence_of_data_sets(collection: Collection) -> None:
    assert [len(data) for data in collection] == [12, 6, 9]
    assert isinstance(collection[-1], PasDataset)
    assert collection[-1].path == collection.path / "000/000002.h5"
    assert collection[0] is collection[[0, 2]][0]  # opened once
    assert [room.seed for room in collection[[True, False, True]].rooms] == [0, 2]
    assert pickle.loads(pickle.dumps(collection[1:])).rooms == collection.rooms[1:]
    assert "3: 1 hall, 2 office" in repr(collection)
    assert "1 of 3: 1 hall" in repr(collection.select("hall"))
    assert collection.select("office", 1).rooms == collection.rooms[:1]


def test_a_room_stays_in_its_part_whatever_rooms_are_beside_it(collection: Collection) -> None:
    seeds = [Room(seed, "office", "a.h5", "0" * 64, 1) for seed in range(1000)]
    shares = [sum(collection.part_of(room) == part for room in seeds) / 1000 for part in PARTS]
    np.testing.assert_allclose(shares, [0.8, 0.1, 0.1, 0], atol=0.03)
    assert [room.percent for room in seeds[:6]] == PERCENT
    assert collection.part("other-type").rooms == collection.rooms[2:]
    assert all(part.part(name).rooms == part.rooms for name in PARTS for part in [collection[::-1].part(name)])


def test_a_loader_gives_the_samples_of_all_rooms(collection: Collection) -> None:
    samples = collection.torch()
    assert len(samples) == collection.num_samples == 27
    (batch,) = DataLoader(samples, batch_size=27)
    assert batch.room.tolist() == [0] * 12 + [1] * 6 + [2] * 9
    np.testing.assert_array_equal(batch.map, np.concatenate([data.pas() for data in collection]))
    np.testing.assert_array_equal(batch.cfr, np.concatenate([data.cfr for data in collection]))
    assert samples[-1].room == 2
    with pytest.raises(IndexError, match="27 is asked for"):
        samples[27]


def test_damaged_missing_and_other_data_sets_are_named(collection: Collection, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(collection.path, tmp_path / "rooms"))
    assert not list(open_collection(folder).faults())
    damaged, missing, other = (folder / room.file for room in collection.rooms)
    content = bytearray(damaged.read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    shutil.copy(missing, other)
    missing.unlink()
    faults = {room.seed: fault for room, fault in open_collection(folder).faults()}
    assert [*faults] == [0, 1, 2]
    assert "damaged" in faults[0]
    assert "no file" in faults[1]
    assert "another data set" in faults[2]


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda c: open_collection(c.path / "000"), DataError, "holds no collection.json"),
        (lambda c: c.part("other"), ArgumentError, "'train', 'validation', 'test' or 'other-type'"),
        (lambda c: c.select("offices"), UnknownNameError, "Did you mean 'office'"),
        (lambda c: c.select(num_rooms=4), ArgumentError, "there are 3"),
        (lambda c: c[3], IndexError, "3 is asked for"),
    ],
)
def test_what_is_not_there_is_refused_in_words(
    collection: Collection, change: Callable[[Collection], object], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        change(collection)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("000/000001.h5", "000/000000.h5", "two rooms have the same file"),
        ("000/000001.h5", "../000001.h5", "rooms.1.file"),
        ('"seed": 1', '"seed": -1', "rooms.1.seed"),
        ("xfreqbench/rooms/1", "xfreqbench/rooms/2", "schema"),
    ],
)
def test_a_description_that_cannot_be_is_refused(
    collection: Collection, tmp_path: Path, old: str, new: str, words: str
) -> None:
    text = (collection.path / FILE).read_text()
    assert old in text
    (tmp_path / FILE).write_text(text.replace(old, new))
    with pytest.raises(DataError, match=words):
        open_collection(tmp_path)
