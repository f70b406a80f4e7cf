"""Families of rooms: what a seed draws is a room in which rays can be traced, and the same room on every machine."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from tests.support.plans import plan_generation
from xfreqbench.errors import SceneError, UnknownNameError
from xfreqbench.scene.drawn_rooms import DrawnRoom, draw_room
from xfreqbench.scene.families import family_schema, load_family
from xfreqbench.scene.model import load_scene
from xfreqbench.scene.toml_files import shipped_families, shipped_folder, shipped_scenes
from xfreqbench.tracing.tracer import TraceSettings

FAMILY = load_family("rooms")
FINGERPRINTS = (  # of seeds 0 to 19
    "5252c157 2a0ba67e 66d0e5a5 63cc1f2e a5d3f8e3 379be747 d5be651c 321a5a15 7bd50f1b 79c13d35 "
    "bb01a670 b3c4554e f89b67a6 2e202b59 dedf8ebc 604bf578 01c3bed7 a9e89f8e d4e7f10e 49adb535"
)


def fingerprint(room: DrawnRoom) -> str:
    """First digits of a hash of a room and of places of its transmitters."""
    told = room.scene.canonical_json + repr(room.transmitters(3).tolist())
    return hashlib.sha256(told.encode()).hexdigest()[:8]


def test_a_seed_draws_the_same_room_everywhere() -> None:
    assert [fingerprint(draw_room(FAMILY, seed)) for seed in range(20)] == FINGERPRINTS.split()


def require_valid(seed: int) -> None:
    """Plan a room as `generate` does, which checks that array and transmitters are in free space, and overlaps."""
    room = draw_room(FAMILY, seed)
    tx_position_m = room.transmitters(40)
    plan = plan_generation(room.scene, [1e9, 94e9], TraceSettings(), tx_positions=tx_position_m, maps=False)
    assert plan.tracing.settings.solver == "image"
    for solid in room.solids:
        start_m, along_m = solid.outline_m, np.roll(solid.outline_m, -1, axis=0) - solid.outline_m
        x_m, y_m = np.moveaxis(tx_position_m[:, None, :2] - start_m, -1, 0)
        is_left = along_m[:, 0] * y_m - along_m[:, 1] * x_m > 0
        is_inside = is_left.all(axis=1) | ~is_left.any(axis=1)  # of a convex outline; nothing is inside a line
        is_as_high = (tx_position_m[:, 2] > solid.low_m) & (tx_position_m[:, 2] < solid.high_m)
        assert len(start_m) < 3 or not (is_inside & is_as_high).any()


@pytest.mark.parametrize("seeds", [range(20), pytest.param(range(20, 80), marks=pytest.mark.slow)])
def test_drawn_rooms_can_be_traced(seeds: range) -> None:
    for seed in seeds:
        require_valid(seed)


def test_rooms_of_a_family_differ_in_type_and_shape_and_place_of_the_array() -> None:
    rooms = [draw_room(FAMILY, seed) for seed in range(20)]
    assert {room.type.name for room in rooms} == {room_type.name for room_type in FAMILY.type}
    assert {len(room.outline_m) for room in rooms} == {4, 5, 6, 8}
    assert {room.scene.receiver.boresight[2] for room in rooms} == {0.0, -1.0}
    of_hall = {surface.material for room in rooms if room.type.held_out for surface in room.scene.surface}
    of_others = {surface.material for room in rooms if not room.type.held_out for surface in room.scene.surface}
    assert of_hall & of_others <= {"person"}
    assert np.array_equal(rooms[0].transmitters(5), rooms[0].transmitters(9)[:5])


def test_a_family_is_no_scene_and_ships_with_its_schema() -> None:
    assert "rooms" in shipped_families()
    assert "rooms" not in shipped_scenes()
    with pytest.raises(SceneError, match=r"family of rooms, not a scene.*--rooms"):
        load_scene("rooms")
    with pytest.raises(UnknownNameError, match="family of rooms 'room'"):
        load_family("room")
    assert {"type", "outline", "piece"} <= family_schema()["properties"].keys()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('outlines = ["rectangle", "L", "L", "niche"]', 'outlines = ["M"]', "names outline 'M'"),
        ('{piece = "bed", number = [0, 2]}', '{piece = "bath", number = [0, 2]}', "names piece of furniture 'bath'"),
        ("length_m = [4.0, 7.5]", "length_m = [7.5, 4.0]", r"type.4.length_m: .*\[7.5, 4.0\] descends"),
        ("faces = [[0, 1, 2, 3]]", "faces = [[0, 1, 2, 4]]", "names a vertex that does not exist"),
        ("share = 0.25", "share = 0.25\nlenght_m = [1, 2]", "lenght_m"),
        ("spans = {b = [0.7, 0.95]}", "spans = {a = [0.7, 0.95]}", "has no span 'b'"),
    ],
)
def test_a_family_that_cannot_be_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        load_family(changed(tmp_path, old, new))


def changed(folder: Path, old: str, new: str) -> Path:
    text = (shipped_folder() / "rooms.toml").read_text()
    assert old in text
    (folder / "mine.toml").write_text(text.replace(old, new, 1))
    return folder / "mine.toml"


def test_a_room_that_cannot_be_is_refused_in_words(tmp_path: Path) -> None:
    family = load_family(changed(tmp_path, 'name = "rooms"', 'name = "rooms"\nrows = 65'))
    with pytest.raises(SceneError, match=r"room 3 of family 'rooms' has no valid form:\n.*64"):
        draw_room(family, 3)
