"""Protocol `unseen-rooms`: which rooms a method learns from, and what it hears and is asked for in a room it never saw.

A method learns from the training rooms of a collection. In every test room it hears 0, 4, 16 or 64 transmitters at
1, 10 and 60 GHz. It is then asked for 16 other transmitters of that room, at 2.4, 24.25 and 77 GHz and at the three
carriers that it heard. What it hears first it also hears when it hears more, and it is always asked for the same, so
that scores differ by what was heard alone.

It knows where the array is and how it is built. The room itself is hidden from it: nothing of what it is given says
where walls stand. Protocol `unseen-rooms-plan` tells it the plan, every surface of which then has one material and one
thickness, whatever it is made of.

The test is made in rooms of the types that were trained on, and then in rooms of types that were not, which have
materials of their own. Settings are chosen in validation rooms: `on="validation"`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.data.collection import Collection, Part
from xfreqbench.data.dataset import PasDataset
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
HEARD_GHZ, ASKED_GHZ = (1.0, 10.0, 60.0), (2.4, 24.25, 77.0)  # it is asked for those it heard too
TOLD_MATERIAL, TOLD_THICKNESS_M = "concrete", 0.2  # of every surface of a plan
_SAME_M = 0.005  # by which walls may differ in what is one room
_SEED = 0


@dataclass(frozen=True)
class RoomSplit:
    """Rooms of one part of a collection, in each of which a number of transmitters is heard.

    `plan_told` is that of protocol `unseen-rooms-plan`.
    """

    collection: Collection
    part: Part
    num_heard: int
    plan_told: bool = False

    @property
    def protocol(self) -> str:
        """The name of the protocol, as records have it."""
        name = UNSEEN_ROOMS_PLAN if self.plan_told else UNSEEN_ROOMS
        return f"{name}-validation" if self.part == "validation" else name

    @property
    def name(self) -> str:
        """Part and number of transmitters heard, as in `heard-16` and `other-type-heard-16`."""
        return ("other-type-" if self.part == "other-type" else "") + f"heard-{self.num_heard}"

    @cached_property
    def rooms(self) -> Collection:
        """The rooms that are tested."""
        return self.collection.part(self.part)

    @cached_property
    def sha256(self) -> str:
        """Hash of the protocol, its version, the rooms that are trained on, and those that are tested."""
        told = [self.protocol, ROOM_PROTOCOL_VERSION, self.name]
        rooms = [[room.sha256 for room in part.rooms] for part in (self.collection.part("train"), self.rooms)]
        return json_sha256([*told, *rooms])

    def questions(self) -> Iterator[RoomQuestion]:
        """What is heard and what is asked in each room, in turn."""
        for room, dataset in zip(self.rooms.rooms, self.rooms, strict=True):
            yield RoomQuestion(dataset, room.seed, self.num_heard, self.plan_told)


@dataclass(frozen=True, eq=False)
class RoomQuestion:
    """What a method hears of one room, and what it is asked for. `seed` is that of the room, and draws transmitters."""

    room: PasDataset
    seed: int
    num_heard: int
    plan_told: bool = False

    @cached_property
    def _drawn(self) -> tuple[Int[IntArray, "K"], Int[IntArray, "16"]]:
        """The transmitters that are heard and those that are asked for, of the ones that a path reaches everywhere."""
        has_path = (self.room.tables["peak_power"] > 0).all(axis=1)
        order = np.random.default_rng([_SEED, self.seed]).permutation(np.flatnonzero(has_path))
        if len(order) < NUM_ASKED + self.num_heard:
            raise ProtocolError(
                f"Protocol {UNSEEN_ROOMS!r} hears {self.num_heard} transmitters of a room and asks for {NUM_ASKED} "
                f"others, but in {self.room.path} a path of every carrier reaches {len(order)}. Generate rooms of "
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
        """The samples that are asked for, with their true maps: sixteen transmitters at six carriers."""
        return self.room.subset(self._rows(self._drawn[1], (*HEARD_GHZ, *ASKED_GHZ)))

    @cached_property
    def heard(self) -> PasDataset:
        """What a method is given: K transmitters at three carriers, the array, and the plan where it is told.

        Nothing of other transmitters is in it, and where the plan is not told, no scene.
        """
        tx = np.sort(self._drawn[0])
        rows = self._rows(tx, HEARD_GHZ)
        given = self.room.subset(rows).isolated()
        tables = {name: table[tx] for name, table in given.tables.items()}
        num_carriers = self.room.num_carriers
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
    """The splits of protocol `unseen-rooms` or `unseen-rooms-plan`, by the number of transmitters heard.

    On the test rooms, then on those of other types where there are any. Raises `ProtocolError` where there is no room
    to train or to test on, and where a room is there twice; `UnknownNameError` for another protocol.
    """
    if protocol not in ROOM_PROTOCOLS:
        raise UnknownNameError("protocol for rooms", protocol, ROOM_PROTOCOLS)
    require_no_room_twice(collection)
    parts: list[Part] = ["validation"] if on == "validation" else ["test", "other-type"]
    for part in ("train", parts[0]):
        if not len(collection.part(part)):
            raise ProtocolError(
                f"Protocol {protocol!r} needs rooms of part {part!r}, but of the {len(collection)} rooms of "
                f"{collection.path} none is. Generate more rooms: about one in ten is of each part but the training."
            )
    plan_told = protocol == UNSEEN_ROOMS_PLAN
    splits = [RoomSplit(collection, part, num, plan_told) for part in parts for num in NUMS_HEARD]
    return [split for split in splits if len(split.rooms)]


@lru_cache(maxsize=1)
def require_no_room_twice(collection: Collection) -> None:
    """Raise `ProtocolError` where two rooms of a collection have the same seed, the same data, or the same plan.

    Plans are compared to `_SAME_M`, without names and materials: a room with other walls of the same shape is that
    room. A thousand rooms take half a minute, so the answer for a collection is kept for its other splits.
    """
    seen, shapes = dict[tuple[str, str], str](), dict[int, list[tuple[str, FloatArray]]]()
    for room, dataset in zip(collection.rooms, collection, strict=True):
        shape_m, plan = _shape_m(dataset), _plan_sha256(dataset)
        if shape_m is not None:
            known = shapes.setdefault(len(shape_m), [])
            plan = next((file for file, other_m in known if np.abs(other_m - shape_m).max() < _SAME_M), room.file)
            known.append((room.file, shape_m))
        for what, value in (("seed", str(room.seed)), ("data", room.sha256), ("plan", plan)):
            other = seen.setdefault((what, value), room.file) if value else room.file
            if other != room.file:
                raise ProtocolError(
                    f"Rooms {other} and {room.file} of {collection.path} have the same {what}, so that a test room may "
                    "be trained on. Remove one of them, or generate the collection again."
                )


def _plan(dataset: PasDataset) -> Scene | None:
    """The scene of a room as it is told: all surfaces of one material, without names; None for data without a scene."""
    if not json.loads(dataset.header.scene_json):
        return None
    scene = dataset.scene
    told = (
        replace(surface, name=f"surface {number}", material=TOLD_MATERIAL, thickness_m=TOLD_THICKNESS_M)
        for number, surface in enumerate(scene.surface)
    )
    return replace(scene, name="room", description="", surface=tuple(told), material=(), transmitters=None)


def _shape_m(dataset: PasDataset) -> Float[FloatArray, "n 3"] | None:
    """The corners of all surfaces of a room, each coordinate in ascending order; None where there are other meshes.

    A wall that moves by a little changes it by no more, and the order of surfaces does not matter.
    """
    plan = _plan(dataset)
    if plan is None or plan.scene or not plan.surface:
        return None
    return np.sort(np.concatenate([surface.corners_m for surface in plan.surface]), axis=0)


def _plan_sha256(dataset: PasDataset) -> str:
    """Hash of where everything stands in a room, wherever its array is; empty for data without a scene."""
    plan = _plan(dataset)
    if plan is None:
        return ""
    bare = replace(plan, receiver=ReceiverArray(position_m=(0.0, 0.0, 0.0)), other_receivers=())
    return hashlib.sha256(bare.canonical_json.encode()).hexdigest()
