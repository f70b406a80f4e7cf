"""Collections: a folder of data sets, one for each of many rooms, and `collection.json`, which says what they are."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import accumulate
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, overload

import numpy as np
from jaxtyping import Int
from pydantic import ConfigDict, Field, PositiveInt, TypeAdapter, ValidationError, model_validator
from pydantic.dataclasses import dataclass as record

from xfreqbench.data.dataset import PasDataset, Rows, chosen_rows, open_dataset, verify
from xfreqbench.errors import ArgumentError, DataError, UnknownNameError
from xfreqbench.system.arguments import FilePath, Texts, checked
from xfreqbench.system.files import json_sha256, read_bytes, write_text
from xfreqbench.system.remote import RemotePath, located
from xfreqbench.types import IntArray
from xfreqbench.units import format_ghz_list

FILE = "collection.json"
Part = Literal["train", "validation", "test", "other-type"]
PARTS: tuple[Part, ...] = get_args(Part)
_STRICT = ConfigDict(extra="forbid")
_Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


@record(frozen=True, config=_STRICT)
class Room:
    """One room of a collection: its seed, its type, its data set with the hash of that, and its transmitters.

    `file` is relative to the folder of the collection.
    """

    seed: Annotated[int, Field(ge=0)]
    type: str
    file: Annotated[str, Field(pattern=r"^\w[\w-]*(/\w[\w-]*)*\.h5$")]
    sha256: _Sha256
    num_tx: PositiveInt

    @property
    def percent(self) -> int:
        """A number below 100 that depends only on the seed."""
        return int.from_bytes(hashlib.sha256(f"room {self.seed}".encode()).digest()[:8]) % 100


@record(frozen=True, config=_STRICT)
class CollectionRecord:
    """The content of `collection.json`: the family that the rooms are drawn from, the options, and the rooms.

    `family` is the family's recipe and `family_sha256` its hash. `options` are those of the generation, with the names
    of `generate`. Rooms of `held_out_types` are only for the test.
    """

    name: str
    family: dict[str, Any]
    family_sha256: _Sha256
    options: dict[str, Any]
    carrier_hz: tuple[Annotated[float, Field(gt=0)], ...]
    held_out_types: tuple[str, ...]
    rooms: tuple[Room, ...]
    schema: Literal["xfreqbench/rooms/1"] = "xfreqbench/rooms/1"

    @model_validator(mode="after")
    def _has_each_room_once(self) -> CollectionRecord:
        for what in ("seed", "file", "sha256"):
            if len({getattr(room, what) for room in self.rooms}) < len(self.rooms):
                raise ValueError(f"two rooms have the same {what}")
        return self


@dataclass(frozen=True, eq=False, repr=False)
class Collection:
    """The data sets of many rooms, all at the same carriers, or some of them.

    `collection[3]` is the `PasDataset` of a room, and so is what iteration yields; a slice, whole numbers or a mask
    give a `Collection` of these rooms. A data set is opened when it is asked for, and up to 4,096 stay open. Maps are
    derived from the channels when they are read. A collection is pickled as its path and its rooms.
    """

    path: Path
    record: CollectionRecord
    rooms: tuple[Room, ...]

    def __len__(self) -> int:
        return len(self.rooms)

    @overload
    def __getitem__(self, rooms: int | np.integer) -> PasDataset: ...

    @overload
    def __getitem__(self, rooms: Rows) -> Collection: ...

    def __getitem__(self, rooms: int | np.integer | Rows) -> PasDataset | Collection:
        """The data set of a room by its number, or a collection of some rooms.

        Raises `IndexError`, and `DataError` for a data set that is missing, damaged, or another than the collection's.
        """
        if isinstance(rooms, int | np.integer):
            return self._opened(self[[int(rooms)]].rooms[0])
        numbers = np.arange(len(self))[chosen_rows(rooms, len(self))]
        return replace(self, rooms=tuple(self.rooms[number] for number in numbers))

    def __iter__(self) -> Iterator[PasDataset]:
        return map(self._opened, self.rooms)

    def __repr__(self) -> str:
        counts = ", ".join(f"{sum(room.type == name for room in self.rooms)} {name}" for name in self.types)
        subset = "" if len(self) == len(self.record.rooms) else f" of {len(self.record.rooms)}"
        return (
            f"Collection {str(self.path)!r}\n"
            f"family    {self.record.name}, sha256 {self.record.family_sha256[:12]}\n"
            f"rooms     {len(self)}{subset}: {counts or 'none'}\n"
            f"samples   {self.num_samples:,}, at {format_ghz_list(self.record.carrier_hz)}"
        )

    @property
    def description(self) -> str:
        """The content of the collection, in lines: rooms by type and part, and the options."""
        parts = {part: self.part(part) for part in PARTS}
        lines = [repr(self), "", f"{'type':16}" + "".join(f"{part:>12}" for part in PARTS)]
        for name in self.types:
            counts = (sum(room.type == name for room in rooms.rooms) for rooms in parts.values())
            lines.append(f"{name:16}" + "".join(f"{number:12}" for number in counts))
        lines += ["", "options   " + ", ".join(f"{name} {value}" for name, value in self.record.options.items())]
        return "\n".join(lines)

    def __reduce__(self) -> tuple[Any, ...]:
        return open_collection, (str(self.path),), {"rooms": self.rooms}

    @property
    def types(self) -> tuple[str, ...]:
        """The types of the rooms, in alphabetical order."""
        return tuple(sorted({room.type for room in self.rooms}))

    @property
    def num_samples(self) -> int:
        """Number of samples (transmitter, carrier) of all rooms."""
        return int(self.first_sample[-1])

    @cached_property
    def first_sample(self) -> Int[IntArray, "offsets"]:
        """Number of each room's first sample among those of all R rooms, then the number of all samples (R + 1,)."""
        counts = (room.num_tx * len(self.record.carrier_hz) for room in self.rooms)
        return np.array([*accumulate(counts, initial=0)])

    def by_room(self, numbers: Int[IntArray, "n"]) -> Iterator[tuple[int, Int[IntArray, "k"], Int[IntArray, "k"]]]:
        """For each room that has some of the samples: its number, their indices in `numbers`, and their rows in it."""
        rooms = np.searchsorted(self.first_sample, numbers, side="right") - 1
        for room in np.unique(rooms).tolist():
            places = np.flatnonzero(rooms == room)
            yield room, places, numbers[places] - self.first_sample[room]

    @checked
    def part(self, name: Part) -> Collection:
        """The rooms to train on, to choose settings on (`validation`), to test on, or those of held-out types.

        About 80, 10 and 10 of a hundred seeds are in the first three parts. The part of a room depends only on its
        seed and type: it is the same in a collection with more rooms. Raises `ArgumentError`.
        """
        return replace(self, rooms=tuple(room for room in self.rooms if self.part_of(room) == name))

    def part_of(self, room: Room) -> Part:
        """The part that a room belongs to."""
        if room.type in self.record.held_out_types:
            return "other-type"
        return "train" if room.percent < 80 else "validation" if room.percent < 90 else "test"

    @checked
    def select(self, types: Texts | None = None, num_rooms: PositiveInt | None = None) -> Collection:
        """The rooms of some types, or the first `num_rooms` of them.

        Raises `UnknownNameError` for a type that no room has, and `ArgumentError` if there are fewer rooms.
        """
        for name in types or ():
            if name not in self.types:
                raise UnknownNameError("type of room", name, self.types)
        rooms = tuple(room for room in self.rooms if types is None or room.type in types)
        if num_rooms is not None and num_rooms > len(rooms):
            raise ArgumentError(f"{num_rooms} rooms are asked for, but there are {len(rooms)}. Generate more rooms.")
        return replace(self, rooms=rooms[:num_rooms])

    def verify(self) -> None:
        """Read every byte of all data sets; raises a `DataError` that names missing, damaged and replaced ones."""
        if not self.record.rooms:
            raise DataError(
                f"{self.path} describes no room: its generation was not finished. Run the same command again."
            )
        faults = [f"{room.file} ({fault})" for room, fault in self.faults()]
        if faults:
            more = ", and others" if len(faults) > 5 else ""
            raise DataError(
                f"{len(faults)} of {len(self)} rooms are missing or damaged: {', '.join(faults[:5])}{more}. "
                "Run the command that generated them again; it makes only these."
            )

    def faults(self) -> Iterator[tuple[Room, str]]:
        """Every room whose data set is missing, damaged or replaced, with the fault; every byte is read."""
        for room in self.rooms:
            try:
                verify(self.path / room.file)
                _opened.__wrapped__(self.path / room.file, room.sha256)  # which may have been written since
            except DataError as error:
                yield room, str(error)

    def _opened(self, room: Room) -> PasDataset:
        shared = _opened(self.path / room.file, room.sha256)
        own = {name: deepcopy(getattr(shared, name)) for name in ("header", "file_header", "beam")}
        return replace(shared, **own)


@checked
def open_collection(path: FilePath) -> Collection:
    """The collection of rooms in a folder, or at an address (http, https) of one; data sets are opened later.

    Raises `DataError` if there is no collection or it is damaged, and `StorageError` if it cannot be read.
    """
    folder = located(path)
    file = folder / FILE
    if folder.is_file():
        raise DataError(f"{folder} is one file, but a collection is the folder that `generate FAMILY --rooms` writes.")
    try:
        content = file.read_bytes() if isinstance(file, RemotePath) else read_bytes(file)
        found = TypeAdapter(CollectionRecord).validate_json(content)
    except OSError as error:
        raise DataError(
            f"{folder} has no {FILE} that can be read ({error.strerror or error}). Give the folder of a complete "
            "collection; if its generation was stopped, run the same command again."
        ) from error
    except ValidationError as error:
        fault = error.errors()[0]
        where = ".".join(map(str, fault["loc"])) or "the whole"
        raise DataError(f"{file} is not a valid collection: {where}: {fault['msg']}. Generate it again.") from error
    return Collection(folder.resolve(), found, found.rooms)


def write_collection(
    folder: Path,
    rooms: Sequence[Room],
    *,
    name: str,
    family: Mapping[str, Any],
    options: Mapping[str, Any],
    carrier_hz: Sequence[float],
    held_out_types: Sequence[str] = (),
) -> Collection:
    """Write `collection.json` for the data sets of a folder, and open the collection; raises `StorageError`."""
    content = CollectionRecord(
        name, dict(family), json_sha256(family), dict(options), tuple(carrier_hz), tuple(held_out_types), tuple(rooms)
    )
    write_text(folder / FILE, TypeAdapter(CollectionRecord).dump_json(content, indent=1).decode() + "\n")
    return open_collection(folder)


def room_of(folder: Path, file: str, seed: int, kind: str) -> Room:
    """The entry of a room whose data set is stored in a file of the folder; raises as `open_dataset` does."""
    dataset = open_dataset(folder / file)
    return Room(seed, kind, file, dataset.file_sha256, dataset.header.num_tx)


@lru_cache(maxsize=4096)  # about 200 kB each
def _opened(path: Path, sha256: str) -> PasDataset:
    dataset = open_dataset(path)
    if dataset.file_sha256 != sha256:
        raise DataError(f"{path} is another data set than that of its collection. Run the same generation again.")
    for shared in (dataset.rows, *dataset.tables.values()):
        shared.setflags(write=False)
    return dataset
