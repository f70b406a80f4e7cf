from __future__ import annotations

import hashlib
import shlex
from dataclasses import replace
from pathlib import Path

import mlcroissant
import numpy as np
import pytest
import yaml

from tests.support.fuzzing.common import xfreqbench
from tests.support.plans import small_plan
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.report.view.card import write_card
from xfreqbench.scene.model import load_scene, parse_scene

ROOMS = replace(load_scene("two_rooms"), name="our rooms", description='two "rooms"\nand a door')


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("card")
    data = generate_planned(small_plan(ROOMS, 6, maps=False, paths=True), folder / "rooms.h5")
    said = xfreqbench("card", data, "--license", "cc-by-4.0", "-o", folder / "new/card", is_bounded=False)
    assert said.code == 0, said
    return folder / "new/card"


def test_a_card_says_what_the_hub_asks_and_its_sums_are_those_of_the_files(folder: Path) -> None:
    front = yaml.safe_load((folder / "README.md").read_text().split("---\n")[1])
    assert front["license"] == "cc-by-4.0" and front["configs"][0]["data_files"] == "sample.csv"
    sums = dict(reversed(line.split("  ")) for line in (folder / "SHA256SUMS").read_text().splitlines())
    assert set(sums) == {path.name for path in folder.iterdir()} - {"SHA256SUMS"}
    assert {"rooms.h5", "scene.toml", "maps.png", "statistics.png", "croissant.json"} < set(sums)
    assert all(hashlib.sha256((folder / name).read_bytes()).hexdigest() == sha256 for name, sha256 in sums.items())
    assert str(folder.parents[1]) not in (folder / "README.md").read_text()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rdflib, within mlcroissant
@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_mlcroissant_finds_no_fault_and_reads_the_sample(folder: Path) -> None:
    card, data = mlcroissant.Dataset(jsonld=str(folder / "croissant.json")), open_dataset(folder / "rooms.h5")
    assert not card.metadata.ctx.issues.errors
    rows = list(card.records("sample"))
    assert [row["sample/sample"] for row in rows] == list(range(len(data)))
    assert np.allclose([row["sample/power_db"] for row in rows], data.power_db, atol=1e-3)
    assert [row["sample/in_sight"] for row in rows] == data.line_of_sight.tolist()


def test_its_command_makes_the_same_data_again(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert parse_scene((folder / "scene.toml").read_text(), ROOMS.folder) == ROOMS
    make_again(folder, tmp_path, monkeypatch)
    again, before = open_dataset("rooms.h5"), open_dataset(folder / "rooms.h5")
    assert again.recipe == before.recipe and np.array_equal(again.cfr, before.cfr)


def make_again(card: Path, where: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the card's command in a folder with the card's scene and transmitters alone."""
    for name in ("scene.toml", "transmitters.csv"):
        (where / name).write_bytes((card / name).read_bytes())
    monkeypatch.chdir(where)
    (line,) = [line for line in (card / "README.md").read_text().splitlines() if line.startswith("xfreqbench gen")]
    assert xfreqbench(*shlex.split(line)[1:], "-q", is_bounded=False).code == 0


def test_what_cannot_be_a_card_is_refused_and_nothing_is_written(folder: Path, tmp_path: Path) -> None:
    refused = xfreqbench("card", folder / "rooms.h5", "--license", "free", "-o", tmp_path / "card")
    assert "no licence 'free'" in refused.stderr and not list(tmp_path.iterdir())
    refused = xfreqbench("card", folder / "rooms.h5", "--license", "CC0-1.0", "-o", folder)
    assert "no empty folder" in refused.stderr


def test_data_of_a_scene_that_ships_name_it(tmp_path: Path) -> None:
    data = generate_planned(small_plan(num_transmitters=2, paths=True), tmp_path / "rooms.h5")
    write_card(data, tmp_path / "card", "LicenseRef-Ours", lambda _: None)
    card = (tmp_path / "card/README.md").read_text()
    assert "xfreqbench generate two_rooms --tx" in card and "license: other\n" in card
    assert not (tmp_path / "card/scene.toml").exists()


def test_data_of_several_receivers_and_polarizations_are_made_again_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    high = replace(ROOMS.receiver, name="high")
    scene = replace(ROOMS, receiver=high, other_receivers=(replace(high, position_m=(4.0, 2.0, 1.1), name="low"),))
    links = {"receivers": ["all"], "polarizations": ["V", "H"]}
    before = open_dataset(generate_planned(small_plan(scene, 2, maps=False, **links), tmp_path / "rooms.h5"))
    write_card(before.path, tmp_path / "card", "CC0-1.0", lambda _: None)
    (tmp_path / "again").mkdir()
    make_again(tmp_path / "card", tmp_path / "again", monkeypatch)
    again = open_dataset("rooms.h5", "low", "HV")
    assert np.array_equal(again.cfr, before.at("low", "HV").cfr) and again.at("high", "VV").recipe == before.recipe
