from __future__ import annotations

import hashlib
import shlex
from dataclasses import replace
from pathlib import Path

import mlcroissant
import numpy as np
import pytest
import yaml

from tests.support import rooms
from tests.support.fuzzing.common import xfreqbench
from tests.support.plans import small_plan
from xfreqbench.data.collection import Collection, open_collection
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.power import power_db
from xfreqbench.data.rooms import generate_rooms
from xfreqbench.report.view import card
from xfreqbench.report.view.card import write_card
from xfreqbench.scene.families import load_family
from xfreqbench.scene.model import load_scene, parse_scene

HIGH = replace(load_scene("two_rooms").receiver, name="high")
LOW = replace(HIGH, position_m=(4.0, 2.0, 1.1), name="low")
ROOMS = replace(
    load_scene("two_rooms"),
    name="our rooms",
    description='two "rooms"\nand a door',
    receiver=HIGH,
    other_receivers=(LOW,),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("card")
    links = {"receiver": ["all"], "polarization": ["V", "H"]}
    data = generate_planned(small_plan(ROOMS, 3, maps=False, paths=True, **links), folder / "rooms.h5")
    said = xfreqbench("card", data, "--license", "cc-by-4.0", "-o", folder / "new/card", is_bounded=False)
    assert said.code == 0, said
    return folder / "new/card"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Collection:
    """Rooms of a family that does not ship, of seeds 1 and 5."""
    folder = tmp_path_factory.mktemp("drawn") / "rooms"
    asked = {"rays": 500, "max_depth": 1, "interactions": ["specular"], "solver": "image", "tx": 2}
    family = replace(load_family("rooms"), name="ours")
    generate_rooms(family, folder, [2.4, 24.25], rooms=1, seed=5, **asked)
    rooms = generate_rooms(family, folder, [2.4, 24.25], rooms=1, **asked)
    said = xfreqbench("card", folder, "--license", "CC0-1.0", "-o", folder.parent / "card", is_bounded=False)
    assert said.code == 0, said
    return rooms


def test_the_card_of_a_collection_is_a_collection_whose_commands_make_the_same_bytes(
    drawn: Collection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = drawn.path.parent / "card"
    open_collection(folder).verify()
    assert set(sums_of(folder)) == {path.relative_to(folder).as_posix() for path in folder.rglob("*.*")} - {
        "SHA256SUMS"
    }
    make_again(folder, tmp_path, monkeypatch, "family.toml")
    for path in drawn.path.rglob("*.*"):
        assert (tmp_path / "rooms" / path.relative_to(drawn.path)).read_bytes() == path.read_bytes()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rdflib, within mlcroissant
@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_mlcroissant_finds_no_fault_and_reads_samples_and_rooms(folder: Path, drawn: Collection) -> None:
    found, data = mlcroissant.Dataset(jsonld=str(folder / "croissant.json")), open_dataset(folder / "rooms.h5")
    assert not found.metadata.ctx.issues.errors
    rows = list(found.records("sample"))
    assert [row["sample/sample"] for row in rows] == list(range(len(data)))
    assert np.allclose([row["sample/power_db"] for row in rows], power_db(data), atol=1e-3)
    assert [row["sample/in_sight"] for row in rows] == data.tables["line_of_sight"][data.tx_index].tolist()
    found = mlcroissant.Dataset(jsonld=str(drawn.path.parent / "card/croissant.json"))
    assert not found.metadata.ctx.issues.errors
    rows = list(found.records("sample"))
    assert [row["sample/room"] for row in rows] == [room.seed for room in drawn.rooms for _ in range(4)]
    assert [row["rooms/part"].decode() for row in found.records("rooms")] == [*map(drawn.part_of, drawn.rooms)]


def test_rooms_that_another_version_drew_have_no_command(
    drawn: Collection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(card, "DRAWING", 0)
    assert not card._room_commands(drawn, tmp_path) and not list(tmp_path.iterdir())


def sums_of(folder: Path) -> dict[str, str]:
    """The hashes that a card states, by file; they are those of the files."""
    sums = dict(reversed(line.split("  ")) for line in (folder / "SHA256SUMS").read_text().splitlines())
    assert all(hashlib.sha256((folder / name).read_bytes()).hexdigest() == sha256 for name, sha256 in sums.items())
    return sums


def test_a_card_says_what_the_hub_asks_and_its_sums_are_those_of_the_files(folder: Path) -> None:
    front = yaml.safe_load((folder / "README.md").read_text().split("---\n")[1])
    assert front["license"] == "cc-by-4.0" and front["configs"][0]["data_files"] == "sample.csv"
    sums = sums_of(folder)
    assert set(sums) == {path.name for path in folder.iterdir()} - {"SHA256SUMS"}
    assert {"rooms.h5", "scene.toml", "maps.png", "statistics.png", "croissant.json"} < set(sums)
    assert str(folder.parents[1]) not in (folder / "README.md").read_text()


def test_its_command_makes_the_same_data_again(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert parse_scene((folder / "scene.toml").read_text(), ROOMS.folder) == ROOMS
    make_again(folder, tmp_path, monkeypatch)
    again, before = open_dataset("rooms.h5"), open_dataset(folder / "rooms.h5")
    assert again.recipe == before.recipe
    for link in ("high", "VV"), ("low", "HV"):
        assert np.array_equal(again.at(*link).cfr, before.at(*link).cfr)


def make_again(source: Path, where: Path, monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Run a card's commands in a folder with some of its files alone: by default its scene and transmitters."""
    for name in names or ("scene.toml", "transmitters.csv"):
        (where / name).write_bytes((source / name).read_bytes())
    monkeypatch.chdir(where)
    lines = [line for line in (source / "README.md").read_text().splitlines() if line.startswith("xfreqbench gen")]
    for line in lines:
        assert xfreqbench(*shlex.split(line)[1:], "-q", is_bounded=False).code == 0
    assert lines


def test_what_cannot_be_a_card_is_refused_and_nothing_is_written(folder: Path, tmp_path: Path) -> None:
    refused = xfreqbench("card", folder / "rooms.h5", "--license", "free", "-o", tmp_path / "card")
    assert "no licence 'free'" in refused.stderr and not list(tmp_path.iterdir())
    refused = xfreqbench("card", folder / "rooms.h5", "--license", "CC0-1.0", "-o", folder)
    assert "not an empty folder" in refused.stderr


def test_data_of_a_scene_that_ships_name_it(tmp_path: Path) -> None:
    data = generate_planned(small_plan(num_transmitters=2, paths=True), tmp_path / "rooms.h5")
    write_card(data, tmp_path / "card", "LicenseRef-Ours", lambda _: None)
    told = (tmp_path / "card/README.md").read_text()
    assert "xfreqbench generate two_rooms --tx" in told and "license: other\n" in told
    assert not (tmp_path / "card/scene.toml").exists()


def test_the_name_of_a_scene_is_no_markup_in_the_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named = rooms.Scene
    name = "<img src=x>\n---\nlicense: other\x1b\u202e"
    monkeypatch.setattr(rooms, "Scene", lambda _, *fields, **others: named(name, *fields, **others))
    rooms.write_room(tmp_path / "room.h5", 3, 8)
    write_card(tmp_path / "room.h5", tmp_path / "card", "CC0-1.0", lambda _: None)
    text = (
        (tmp_path / "card" / "README.md").read_text(encoding="utf-8").split("\n---\n", 1)[1]
    )  # below the front matter
    assert "# Power angular spectra of scene &lt;img src=x> " in text and "in scene &lt;img src=x> " in text
