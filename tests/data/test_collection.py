"""Collections: the data sets of many rooms, their parts, and what is said of damaged ones."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from torch.utils.data import DataLoader

from tests.support.damage import flip
from tests.support.synthetic import write_dataset
from xfreqbench.cli.data import GenerateArguments, generate, info, sealed
from xfreqbench.data.collection import FILE, PARTS, Collection, Room, open_collection, room_of, write_collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.retrace import drawn_rows, require_origin
from xfreqbench.data.rooms import generate_rooms
from xfreqbench.errors import ArgumentError, DataError, OutputExistsError, UnknownNameError, XFreqBenchError
from xfreqbench.methods.learning.samples import to_torch
from xfreqbench.scene.drawn_rooms import draw_room
from xfreqbench.scene.families import load_family
from xfreqbench.system.files import json_sha256

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
    assert collection[0].tables is collection[[0, 2]][0].tables  # opened once
    with pytest.raises(ValueError, match="read-only"):
        collection[0].tables["tx_position_m"][0] = 0
    collection[0].header.carrier_hz[0] = 0
    assert collection[0].header.carrier_hz[0] == 1e9
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
    samples = to_torch(collection)
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
    flip(damaged, damaged.stat().st_size // 2)
    shutil.copy(missing, other)
    missing.unlink()
    faults = {room.seed: fault for room, fault in open_collection(folder).faults()}
    for seed, told in enumerate(("damaged", "no file", "another data set")):
        assert told in faults[seed]


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda c: open_collection(c.path / "000"), DataError, "has no collection.json"),
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


TINY = {"freqs_ghz": [2.4, 24.25], "tx": 3, "interactions": ["specular"], "rays": 500, "max_depth": 1}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Collection:
    """Three rooms of the shipped family."""
    return generate_rooms("rooms", tmp_path_factory.mktemp("drawn") / "rooms", rooms=3, **TINY)


def content(folder: Path) -> dict[str, bytes]:
    """Every file of a folder by its path there."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_drawn_collection_holds_rooms_that_can_be_traced_again(drawn: Collection) -> None:
    assert [room.seed for room in drawn.rooms] == [1, 2, 3]
    assert [room.type for room in drawn.rooms] == [draw_room("rooms", seed).type.name for seed in (1, 2, 3)]
    for room, data in zip(drawn.rooms, drawn, strict=True):
        expected = draw_room("rooms", room.seed)
        assert data.scene == expected.scene
        np.testing.assert_array_equal(data.tables["tx_position_m"], expected.transmitters(3))
        assert require_origin(data, drawn_rows(data, 2)).difference < 1e-3
    assert drawn.record.family_sha256 == load_family("rooms").sha256 == json_sha256(drawn.record.family)


def test_a_stopped_generation_goes_on_to_the_same_bytes(drawn: Collection, tmp_path: Path) -> None:
    whole, folder = content(drawn.path), tmp_path / "rooms"
    generate_rooms("rooms", folder, rooms=1, seed=3, **TINY)  # as one that was killed: no room is described
    described = json.loads((folder / FILE).read_text())
    (folder / FILE).write_text(json.dumps({**described, "rooms": []}))
    with pytest.raises(DataError, match="was not finished"):
        info(folder)
    generate_rooms("rooms", folder, rooms=3, **TINY)
    assert content(folder) == whole
    damaged, missing, _ = (folder / room.file for room in drawn.rooms)
    damaged.write_bytes(whole["000/000001.h5"][:-10])
    missing.unlink()
    with pytest.raises(DataError, match=r"2 of 3 rooms are missing or damaged.*000001\.h5.*000002\.h5"):
        info(folder)
    told: list[str] = []
    generate_rooms("rooms", folder, rooms=2, tell=told.append, **TINY)  # what else was asked for stays
    assert content(folder) == whole
    assert told == ["missing or damaged, and made again: 2 of 3 rooms, 000/000001.h5, 000/000002.h5"]
    damaged.write_bytes(whole["000/000002.h5"])
    with pytest.raises(OutputExistsError, match=r"000001.h5 holds 'rooms-.*-2' .* not the room"):
        generate_rooms("rooms", folder, rooms=2, **TINY)


@pytest.mark.slow
def test_processes_make_the_same_bytes(drawn: Collection, tmp_path: Path) -> None:
    generate_rooms("rooms", tmp_path / "rooms", rooms=3, executor="2", **TINY)
    assert content(tmp_path / "rooms") == content(drawn.path)


def test_another_collection_is_not_written_over(drawn: Collection, tmp_path: Path) -> None:
    for other, words in (
        ({"max_depth": 2}, "max_depth 1 there, 2 here"),
        ({"freqs_ghz": [2.4]}, "carriers there, 1 here"),
    ):
        with pytest.raises(OutputExistsError, match=f"holds other rooms: .*{words}. Choose"):
            generate_rooms("rooms", drawn.path, rooms=3, **{**TINY, **other})
    with pytest.raises(ArgumentError, match=r"cannot use seed=3000000000: it is 0 to 2,147,483,647"):
        generate_rooms("rooms", tmp_path / "rooms", rooms=1, seed=3_000_000_000)
    with pytest.raises(XFreqBenchError, match="are of one data set: give one of its files"):
        info(drawn.path, retrace=4)
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(OutputExistsError, match=r"holds 'thesis.tex' and no collection\.json"):
        generate_rooms("rooms", tmp_path, rooms=3, **TINY)


def test_the_command_generates_says_what_it_takes_and_describes(
    drawn: Collection, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = GenerateArguments(rooms=40, **TINY)
    generate("rooms", output=tmp_path / "no", options=asked, dry_run=True)
    assert "40 rooms of 'rooms' × 3 transmitters × 2 carriers" in capsys.readouterr().out
    assert not (tmp_path / "no").exists()
    generate("rooms", output=drawn.path, options=replace(asked, rooms=3), quiet=True)
    info(drawn.path)
    said = capsys.readouterr().out
    assert "rooms     3: " in said
    assert "every hash holds" in said


def test_sealed_rooms_follow_from_the_release_the_family_and_a_public_number(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def command(release: str, number: str) -> str:
        sealed(release, reveal=number)
        return capsys.readouterr().out

    first = command("0.2", "0a" * 32)
    assert first == command("0.2", "0A" * 32 + "\n")
    assert len({first, command("0.3", "0a" * 32), command("0.2", "0b" * 32)}) == 3
    seed = int(first.split("--seed ")[1].split()[0])
    draw_room(load_family("rooms"), seed)  # which raises if it cannot be
    with pytest.raises(XFreqBenchError, match="64 hexadecimal digits"):
        sealed("0.2", reveal="soon")
