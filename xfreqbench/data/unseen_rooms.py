"""Protocol `unseen-rooms`: which rooms a method learns from, and what it is given and predicts in an unseen room.

A method learns from the training rooms of a collection. In every test room it is given the maps of 0, 4, 16 or 64
transmitters at 1, 10 and 60 GHz (`heard`). Then it predicts those of 16 other transmitters of that room, at 2.4, 24.25
and 77 GHz and at the three given carriers (`asked`). Smaller sets of given transmitters are parts of larger ones, and
the predicted ones are always the same, so that scores differ only by what was given.

It knows the position and the elements of the array. The room itself is hidden from it: none of its data say where walls
are. In protocol `unseen-rooms-plan` it is given the plan, in which every surface has the same material and thickness,
whatever it is made of.

The test is made in rooms of the types that were trained on, and then in rooms of types that were not, which have
materials of their own. Settings are chosen in validation rooms: `on="validation"`.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Int
from scipy.spatial import KDTree

from xfreqbench.data.collection import Collection, Part, Room
from xfreqbench.data.dataset import PasDataset, isolated
from xfreqbench.data.splits import Question
from xfreqbench.errors import ProtocolError, UnknownNameError
from xfreqbench.scene.model import ReceiverArray, Scene
from xfreqbench.system.files import json_sha256
from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import format_ghz_list, ghz_to_hz

UNSEEN_ROOMS, UNSEEN_ROOMS_PLAN = "unseen-rooms", "unseen-rooms-plan"
ROOM_PROTOCOLS = (UNSEEN_ROOMS, UNSEEN_ROOMS_PLAN)
ROOM_PROTOCOL_VERSION = "1"
NUMS_HEARD = (0, 4, 16, 64)  # transmitters
NUM_ASKED = 16
HEARD_GHZ, ASKED_GHZ = (1.0, 10.0, 60.0), (2.4, 24.25, 77.0)  # the given carriers are predicted too


@dataclass(frozen=True)
class RoomSplit:
    """Rooms of one part of a collection, each with a number of given transmitters.

    `name` has part and number, as in `heard-16` and `other-type-heard-16`; `plan_told` is that of protocol
    `unseen-rooms-plan`. `sha256` is the hash of the protocol, its version, the rooms that are trained on, and those
    that are tested.
    """

    name: str
    protocol: str
    version: str
    sha256: str
    part: Part
    num_heard: int
    plan_told: bool

    @classmethod
    def of(cls, rooms: Collection, part: Part, num_heard: int, plan_told: bool) -> RoomSplit:
        """The split of a collection, of which some rooms are of that part."""
        name = ("other-type-" if part == "other-type" else "") + f"heard-{num_heard}"
        protocol = UNSEEN_ROOMS_PLAN if plan_told else UNSEEN_ROOMS
        protocol = f"{protocol}-validation" if part == "validation" else protocol
        hashes = [[room.sha256 for room in rooms.part(each).rooms] for each in ("train", part)]
        sha256 = json_sha256([protocol, ROOM_PROTOCOL_VERSION, name, *hashes])
        return cls(name, protocol, ROOM_PROTOCOL_VERSION, sha256, part, num_heard, plan_told)

    def training_part(self, rooms: Collection) -> Collection:
        """The rooms that a method is fitted to, of the collection that was split, as copies that it may change."""
        return deepcopy(rooms.part("train"))

    def questions(self, rooms: Collection) -> Iterator[Question]:
        """What is heard and what is asked in each tested room, in turn."""
        tested = rooms.part(self.part)
        for room, dataset in zip(tested.rooms, tested, strict=True):
            yield room_question(dataset, room.seed, self.num_heard, self.plan_told)

    def notes(self, rooms: Collection) -> list[str]:
        """What a user may not expect: nothing."""
        return []


def room_question(room: PasDataset, seed: int, num_heard: int, plan_told: bool = False) -> Question:
    """What a method hears of one room, and what it is asked for; `seed` is that of the room, and draws transmitters.

    It hears `num_heard` transmitters at three carriers, and is asked for sixteen others at six. Nothing else of other
    transmitters is told, and where the plan is not told, no scene.
    """
    has_path = (room.tables["peak_power"] > 0).all(axis=1)
    order = np.random.default_rng([0, seed]).permutation(np.flatnonzero(has_path))
    if len(order) < NUM_ASKED + num_heard:
        raise ProtocolError(
            f"Protocol {UNSEEN_ROOMS!r} hears {num_heard} transmitters of a room and asks for {NUM_ASKED} others, but "
            f"in {room.path} a path of every carrier reaches {len(order)}. Generate rooms of "
            f"{NUM_ASKED + max(NUMS_HEARD)} transmitters or more."
        )
    tx = np.sort(order[NUM_ASKED : NUM_ASKED + num_heard])
    rows = _rows(room, tx, HEARD_GHZ)
    given = isolated(room[rows])
    num_carriers = room.header.num_carriers
    plan = _plan(room) if plan_told else None
    header = replace(
        given.header,
        scene_name="room",
        scene_json=plan.canonical_json if plan else "{}",
        scene_sha256="0" * 64,
        settings=dict(room.header.settings) if plan else {},
        rejected={},
        num_tx=max(1, len(tx)),
        maps=False,  # rows are no longer those of the file
    )
    heard = replace(
        given,
        header=header,
        file_header=header,
        tables={name: table[tx] for name, table in given.tables.items()},
        rows=np.searchsorted(tx, rows // num_carriers) * num_carriers + rows % num_carriers,
    )
    asked = room[_rows(room, np.sort(order[:NUM_ASKED]), (*HEARD_GHZ, *ASKED_GHZ))]
    return Question(asked, heard, f"in room {room.path.name}")


def _rows(room: PasDataset, tx: Int[IntArray, "T"], carriers_ghz: tuple[float, ...]) -> Int[IntArray, "n"]:
    """The rows of ascending transmitters of a room at some carriers; raises `ProtocolError` where it lacks some."""
    carriers_hz = [ghz_to_hz(carrier) for carrier in carriers_ghz]
    present_hz = room.header.carrier_hz
    missing = [carrier for carrier in carriers_hz if carrier not in present_hz]
    if missing:
        raise ProtocolError(
            f"Protocol {UNSEEN_ROOMS!r} needs {format_ghz_list(missing)}, but the rooms have "
            f"{format_ghz_list(present_hz)}. Generate those carriers too."
        )
    columns = np.searchsorted(present_hz, np.sort(carriers_hz))
    return (tx[:, None] * len(present_hz) + columns).ravel()


def room_splits(collection: Collection, protocol: str, on: str = "test") -> list[RoomSplit]:
    """The splits of protocol `unseen-rooms` or `unseen-rooms-plan`, by the number of given transmitters.

    Those of the test rooms come first, then those of other types, if there are any. Raises `ProtocolError` if there is
    no room to train or to test on, or a room occurs twice, and `UnknownNameError` for another protocol.
    """
    if protocol not in ROOM_PROTOCOLS:
        raise UnknownNameError("protocol for rooms", protocol, ROOM_PROTOCOLS)
    _require_no_room_twice(collection)
    parts: list[Part] = ["validation"] if on == "validation" else ["test", "other-type"]
    for part in ("train", parts[0]):
        if not len(collection.part(part)):
            raise ProtocolError(
                f"Protocol {protocol!r} needs rooms of part {part!r}, but none of the {len(collection)} rooms of "
                f"{collection.path} is. Generate more rooms: about one in ten is in each part except the training."
            )
    plan_told = protocol == UNSEEN_ROOMS_PLAN
    tested = [part for part in parts if len(collection.part(part))]
    return [RoomSplit.of(collection, part, num, plan_told) for part in tested for num in NUMS_HEARD]


@lru_cache(maxsize=1)
def _require_no_room_twice(collection: Collection) -> None:
    """Raise `ProtocolError` where two rooms of a collection, which differ in seed and data, have the same plan.

    Plans are compared without names and materials: rooms with walls of the same shape are the same room, even if
    surfaces differ by a few millimetres. A thousand rooms take half a minute, so the answer for a collection is kept
    for its other splits.
    """
    plans = defaultdict[str, list[tuple[Room, FloatArray]]](list)
    for room, dataset in zip(collection.rooms, collection, strict=True):
        if plan := _plan(dataset):
            bare = replace(plan, surface=(), receiver=ReceiverArray(position_m=(0.0, 0.0, 0.0)), other_receivers=())
            spans_m = [[*surface.corners_m.min(axis=0), *surface.corners_m.max(axis=0)] for surface in plan.surface]
            shape = np.sort(np.reshape(spans_m, (-1, 6)), axis=0).ravel()  # the order of surfaces does not matter
            plans[f"{len(shape)} {bare.canonical_json}"].append((room, np.append(shape, 0.0)))
    for alike in plans.values():
        if near := KDTree([shape for _, shape in alike]).query_pairs(5e-3, p=np.inf):
            first, second = (alike[place][0].file for place in min(near))
            raise ProtocolError(
                f"Rooms {first} and {second} of {collection.path} have the same plan, so a test room may be trained "
                "on. Remove one of them, or generate the collection again."
            )


def _plan(dataset: PasDataset) -> Scene | None:
    """The plan that methods are given: all surfaces of one material, without names; None for data without a scene."""
    if not json.loads(dataset.header.scene_json):
        return None
    scene = dataset.scene
    surfaces = (
        replace(surface, name=f"surface {number}", material="concrete", thickness_m=0.2)
        for number, surface in enumerate(scene.surface)
    )
    return replace(scene, name="room", description="", surface=tuple(surfaces), material=(), transmitters=None)
