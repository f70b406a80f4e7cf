"""Predictions in rooms: kept room by room, stored in one file, and scored.

Predictions are stored as the sums over lags of the array's elements (`LagFunctions`), 50 numbers in place of 32,400: a
map that the array cannot give is scored as the nearest that it can.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.hdf5 import (
    Variable,
    create_sealed,
    open_sealed,
    read_array,
    require_layout,
    text_attributes,
    verify_sealed,
)
from xfreqbench.data.unseen_rooms import RoomSplit
from xfreqbench.errors import DataError
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.lags import LagFunctions
from xfreqbench.maps.metrics import score_all
from xfreqbench.runs.scoring import summaries
from xfreqbench.system.files import json_sha256
from xfreqbench.types import FloatArray, IntArray, Maps, NDArray

ROOM_SCHEMA = "xfreqbench/room-predictions/1"
# among the counts of a record: median seconds to adapt to a room and predict what is asked, and how many rooms a
# method learned from, where it says so
ROOM_SECONDS, NUM_ROOMS = "seconds_a_room", "rooms"
# among the settings of a record, of every tested room in turn: its type, and "1" or "0" for each transmitter asked for
ROOM_TYPES, ROOM_SIGHT = "room_types", "line_of_sight"


@dataclass(frozen=True)
class RoomAnswer:
    """What is predicted of one room: the rows of its data set, the sums over lags, and the seconds it took."""

    rows: Int[IntArray, "n"]
    sums: Float[NDArray[np.float32], "n L"]
    seconds: float  # to adapt
    predict_seconds: float


def answer_of(asked: PasDataset, maps: Float[Maps, "n E A"], seconds: float, predict_seconds: float) -> RoomAnswer:
    """The answer for samples of a room whose maps were predicted in some seconds, after others to adapt to it."""
    sums = _lag_functions(asked).of_maps(maps, asked.header.pas_kind)
    return RoomAnswer(asked.rows, sums, seconds, predict_seconds)


def _lag_functions(asked: PasDataset) -> LagFunctions:
    """The lag functions of a room's array; of arrays and grids that are alike the same object."""
    grid, elements = asked.grid, asked.beam.element_position_wavelengths
    return _lags_of(*(each.tobytes() for each in (elements, grid.elevation_rad, grid.azimuth_rad)))


@lru_cache(maxsize=8)
def _lags_of(elements: bytes, elevation_rad: bytes, azimuth_rad: bytes) -> LagFunctions:
    positions, *angles = (np.frombuffer(each) for each in (elements, elevation_rad, azimuth_rad))
    return LagFunctions(BartlettBeam(positions.reshape(-1, 3), AngularGrid(*angles)))


def _variables(num_rooms: int, num_rows: int, num_sums: int) -> list[Variable]:
    return [
        Variable("room", "<i4", (num_rows,), ("row",), "1", "number of the room in the tested part"),
        Variable("row", "<i8", (num_rows,), ("row",), "1", "row of the room's data set: tx · F + carrier"),
        Variable("lags", "<f4", (num_rows, num_sums), ("row", "lag"), "1", "sums over lags, real parts first"),
        Variable("lag", "<i4", (num_sums,), ("lag",), "1", "number of a sum"),
        Variable("tested_room", "<i4", (num_rooms,), ("tested_room",), "1", "number of a room"),
        Variable("adapt_seconds", "<f8", (num_rooms,), ("tested_room",), "s", "time to adapt to a room"),
        Variable("predict_seconds", "<f8", (num_rooms,), ("tested_room",), "s", "time to predict what is asked of it"),
    ]


def write_answers(path: Path, split_sha256: str, answers: Sequence[RoomAnswer]) -> None:
    """Store predictions, whole or not at all."""
    num_rows = sum(len(answer.rows) for answer in answers)
    attributes = {"schema": ROOM_SCHEMA, "split_sha256": split_sha256}
    with create_sealed(path, _variables(len(answers), num_rows, answers[0].sums.shape[1]), attributes) as writer:
        writer.append("lag", np.arange(answers[0].sums.shape[1]))
        writer.append("tested_room", np.arange(len(answers)))
        writer.append("adapt_seconds", np.array([answer.seconds for answer in answers]))
        writer.append("predict_seconds", np.array([answer.predict_seconds for answer in answers]))
        for number, answer in enumerate(answers):
            writer.append("room", np.full(len(answer.rows), number))
            writer.append("row", answer.rows)
            writer.append("lags", answer.sums)


def _read(path: Path, split_sha256: str, num_rooms: int) -> tuple[list[RoomAnswer], IntArray]:
    """Stored predictions of every room, and the room of each; raises `DataError` for a file that is damaged."""
    verify_sealed(path, ROOM_SCHEMA)
    with open_sealed(path, ROOM_SCHEMA) as file:
        room, row, sums, adapt_s, predict_s = (
            read_array(file, name) for name in ("room", "row", "lags", "adapt_seconds", "predict_seconds")
        )
        require_layout(file, _variables(len(adapt_s), len(row), sums.shape[1]))
        if text_attributes(file)["split_sha256"] != split_sha256 or len(adapt_s) != num_rooms:
            raise DataError(f"{path} holds predictions of another split. Delete it and run again.")
    answers = [
        RoomAnswer(row[room == number], sums[room == number], float(adapt_s[number]), float(predict_s[number]))
        for number in range(len(adapt_s))
    ]
    return answers, room.astype(np.int64)


def scored_in_rooms(rooms: Collection, split: RoomSplit, path: Path) -> dict[str, Any]:
    """What a record holds of a split and of the scores of its stored predictions, by room in `ssim_by_tx`.

    Raises `DataError` if the predictions are damaged or of another split.
    """
    tested = rooms.part(split.part)
    answers, room = _read(path, split.sha256, len(tested))
    scores = defaultdict[str, list[FloatArray]](list)
    carriers_hz, in_sight = [], []
    for question, answer in zip(split.questions(rooms), answers, strict=True):
        asked, kind = question.asked, question.asked.header.pas_kind
        if not np.array_equal(asked.rows, answer.rows):
            raise DataError(f"{path} holds predictions of other samples. Delete it and run again.")
        maps = _lag_functions(asked).maps(answer.sums, kind)
        for name, values in score_all(maps, asked.pas(), asked.grid, kind).items():
            scores[name].append(values)
        carriers_hz.append(asked.carrier_hz)
        seen = asked.tables["line_of_sight"][np.unique(asked.tx_index)]
        in_sight.append("".join(str(int(each)) for each in seen))
    every = {name: np.concatenate(values) for name, values in scores.items()}
    collection = rooms.record
    recipe = [collection.family_sha256, collection.options, [each.seed for each in rooms.rooms]]
    return {
        "dataset_sha256": json_sha256([each.sha256 for each in collection.rooms]),
        "recipe": f"data-{json_sha256(recipe)}",
        "scene": collection.name,
        "pas_kind": tested[0].header.pas_kind,
        "settings": {
            "rooms_trained_on": len(rooms.part("train")),
            "rooms_tested": len(answers),
            ROOM_TYPES: [each.type for each in tested.rooms],
            ROOM_SIGHT: in_sight,
        },
        "split_sha256": split.sha256,
        "protocol_version": split.version,
        "num_test": len(room),
        "num_without_path": 0,
        "shares_transmitters": False,
        **summaries(every, np.concatenate(carriers_hz), room),
    }
