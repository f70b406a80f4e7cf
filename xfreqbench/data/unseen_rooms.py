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
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Int
from scipy.spatial import KDTree

from xfreqbench.data.collection import Collection, Part, Room
from xfreqbench.data.dataset import PasDataset, isolated
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
TOLD_MATERIAL, TOLD_THICKNESS_M = "concrete", 0.2  # of every surface of a plan
_SEED = 0
_SAME_PLAN_M = 5e-3


@dataclass(frozen=True)
class RoomSplit:
    """Rooms of one part of a collection, each with a number of given transmitters.

    `plan_told` is true in protocol `unseen-rooms-plan`.
    """

    collection: Collection
    part: Part
    num_heard: int
    plan_told: bool = False

    @property
    def protocol(self) -> str:
        """The name of the protocol in records."""
        name = UNSEEN_ROOMS_PLAN if self.plan_told else UNSEEN_ROOMS
        return f"{name}-validation" if self.part == "validation" else name

    @property
    def name(self) -> str:
        """Part and number of given transmitters, as in `heard-16` and `other-type-heard-16`."""
        return ("other-type-" if self.part == "other-type" else "") + f"heard-{self.num_heard}"

    @cached_property
    def rooms(self) -> Collection:
        """The rooms that are tested."""
        return self.collection.part(self.part)

    @cached_property
    def sha256(self) -> str:
        """Hash of the protocol, its version, the rooms that are trained on, and those that are tested."""
        names = [self.protocol, ROOM_PROTOCOL_VERSION, self.name]
        rooms = [[room.sha256 for room in part.rooms] for part in (self.collection.part("train"), self.rooms)]
        return json_sha256([*names, *rooms])

    def questions(self) -> Iterator[RoomQuestion]:
        """The question of each room, in turn: what is given and what is to be predicted."""
        for room, dataset in zip(self.rooms.rooms, self.rooms, strict=True):
            yield RoomQuestion(dataset, room.seed, self.num_heard, self.plan_told)


@dataclass(frozen=True, eq=False)
class RoomQuestion:
    """What a method is given of one room, and what it predicts. `seed` is that of the room, and draws transmitters."""

    room: PasDataset
    seed: int
    num_heard: int
    plan_told: bool = False

    @cached_property
    def _drawn(self) -> tuple[Int[IntArray, "K"], Int[IntArray, "16"]]:
        """The given transmitters and the predicted ones, drawn from those with a path at every carrier."""
        has_path = (self.room.tables["peak_power"] > 0).all(axis=1)
        order = np.random.default_rng([_SEED, self.seed]).permutation(np.flatnonzero(has_path))
        if len(order) < NUM_ASKED + self.num_heard:
            raise ProtocolError(
                f"Protocol {UNSEEN_ROOMS!r} gives {self.num_heard} transmitters of a room and tests {NUM_ASKED} "
                f"others, but in {self.room.path} {len(order)} have a path at every carrier. Generate rooms of "
                f"{NUM_ASKED + max(NUMS_HEARD)} transmitters or more."
            )
        return order[NUM_ASKED : NUM_ASKED + self.num_heard], order[:NUM_ASKED]

    def _rows(self, tx: Int[IntArray, "T"], carriers_ghz: tuple[float, ...]) -> Int[IntArray, "n"]:
        carriers_hz = [ghz_to_hz(carrier) for carrier in carriers_ghz]
        present_hz = self.room.header.carrier_hz
        missing = [carrier for carrier in carriers_hz if carrier not in present_hz]
        if missing:
            raise ProtocolError(
                f"Protocol {UNSEEN_ROOMS!r} needs {format_ghz_list(missing)}, but the rooms have "
                f"{format_ghz_list(present_hz)}. Generate those carriers too."
            )
        columns = np.searchsorted(present_hz, np.sort(carriers_hz))
        return (np.sort(tx)[:, None] * len(present_hz) + columns).ravel()

    @cached_property
    def asked(self) -> PasDataset:
        """The samples to predict, with their true maps: sixteen transmitters at six carriers."""
        return self.room[self._rows(self._drawn[1], (*HEARD_GHZ, *ASKED_GHZ))]

    @cached_property
    def heard(self) -> PasDataset:
        """What a method is given: K transmitters at three carriers, the array, and in `unseen-rooms-plan` the plan.

        It contains nothing of other transmitters, and otherwise no scene.
        """
        tx = np.sort(self._drawn[0])
        rows = self._rows(tx, HEARD_GHZ)
        given = isolated(self.room[rows])
        tables = {name: table[tx] for name, table in given.tables.items()}
        num_carriers = self.room.header.num_carriers
        kept = np.searchsorted(tx, rows // num_carriers) * num_carriers + rows % num_carriers
        plan = _plan(self.room) if self.plan_told else None
        header = replace(
            given.header,
            scene_name="room",
            scene_json=plan.canonical_json if plan else "{}",
            scene_sha256="0" * 64,
            settings=dict(self.room.header.settings) if plan else {},
            rejected={},
            num_tx=max(1, len(tx)),
            maps=False,  # rows are no longer those of the file
        )
        return replace(given, header=header, file_header=header, tables=tables, rows=kept)


def room_splits(collection: Collection, protocol: str, on: str = "test") -> list[RoomSplit]:
    """The splits of protocol `unseen-rooms` or `unseen-rooms-plan`, by the number of given transmitters.

    Those of the test rooms come first, then those of other types, if there are any. Raises `ProtocolError` if there is
    no room to train or to test on, or a room occurs twice, and `UnknownNameError` for another protocol.
    """
    if protocol not in ROOM_PROTOCOLS:
        raise UnknownNameError("protocol for rooms", protocol, ROOM_PROTOCOLS)
    require_no_room_twice(collection)
    parts: list[Part] = ["validation"] if on == "validation" else ["test", "other-type"]
    for part in ("train", parts[0]):
        if not len(collection.part(part)):
            raise ProtocolError(
                f"Protocol {protocol!r} needs rooms of part {part!r}, but none of the {len(collection)} rooms of "
                f"{collection.path} is. Generate more rooms: about one in ten is in each part except the training."
            )
    plan_told = protocol == UNSEEN_ROOMS_PLAN
    splits = [RoomSplit(collection, part, num, plan_told) for part in parts for num in NUMS_HEARD]
    return [split for split in splits if len(split.rooms)]


@lru_cache(maxsize=1)
def require_no_room_twice(collection: Collection) -> None:
    """Raise `ProtocolError` if two rooms of a collection have the same seed, the same data, or the same plan.

    Plans are compared without names and materials: rooms with walls of the same shape are the same room, even if
    surfaces differ by a few millimetres. A thousand rooms take half a minute, so the answer for a collection is kept
    for its other splits.
    """
    seen, plans = dict[tuple[str, str], Room](), defaultdict[str, list[tuple[Room, FloatArray]]](list)
    for room, dataset in zip(collection.rooms, collection, strict=True):
        for what, value in (("seed", str(room.seed)), ("data", room.sha256)):
            _require_other(collection, what, seen.setdefault((what, value), room), room)
        if plan := _plan(dataset):
            bare = replace(plan, surface=(), receiver=ReceiverArray(position_m=(0.0, 0.0, 0.0)), other_receivers=())
            spans_m = [[*surface.corners_m.min(axis=0), *surface.corners_m.max(axis=0)] for surface in plan.surface]
            shape = np.sort(np.reshape(spans_m, (-1, 6)), axis=0).ravel()  # the order of surfaces does not matter
            plans[f"{len(shape)} {bare.canonical_json}"].append((room, np.append(shape, 0.0)))
    for alike in plans.values():
        near = KDTree([shape for _, shape in alike]).query_pairs(_SAME_PLAN_M, p=np.inf)
        for first, second in sorted(near):
            _require_other(collection, "plan", alike[first][0], alike[second][0])


def _require_other(collection: Collection, what: str, first: Room, second: Room) -> None:
    if first is not second:
        raise ProtocolError(
            f"Rooms {first.file} and {second.file} of {collection.path} have the same {what}, so a test room may be "
            "trained on. Remove one of them, or generate the collection again."
        )


def _plan(dataset: PasDataset) -> Scene | None:
    """The plan that methods are given: all surfaces of one material, without names; None for data without a scene."""
    if not json.loads(dataset.header.scene_json):
        return None
    scene = dataset.scene
    surfaces = (
        replace(surface, name=f"surface {number}", material=TOLD_MATERIAL, thickness_m=TOLD_THICKNESS_M)
        for number, surface in enumerate(scene.surface)
    )
    return replace(scene, name="room", description="", surface=tuple(surfaces), material=(), transmitters=None)
