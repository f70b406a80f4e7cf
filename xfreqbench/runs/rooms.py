"""Runs on protocol `unseen-rooms`: one fit across rooms, then every test room in turn, heard, asked and scored.

Predictions are stored as the sums over lags of the array's elements (`LagFunctions`), 50 numbers in place of 32,400: a
map that the array cannot give is scored as the nearest that it can. One fit serves all numbers of transmitters heard.
A room that is done is kept, so that a run that was killed goes on at the next one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
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
from xfreqbench.data.unseen_rooms import ROOM_PROTOCOL_VERSION, RoomQuestion, RoomSplit, room_splits
from xfreqbench.errors import DataError, InUseError, MethodError
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.lags import LagFunctions
from xfreqbench.maps.metrics import METRICS_VERSION, score_all
from xfreqbench.methods.contract import Budget, RoomMethod
from xfreqbench.methods.fitting import Fit, Stopwatch, checked_maps, checked_num_parameters, fit_within
from xfreqbench.methods.registry import code_sha256
from xfreqbench.methods.rooms import PerRoom, build_room_method
from xfreqbench.runs import checkpoints
from xfreqbench.runs.fit import FitProgress
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.jobs import Task
from xfreqbench.runs.predictions import fault_of_maps, require_no_others
from xfreqbench.runs.records import Job, RunRecord, utc_now
from xfreqbench.runs.scoring import by_group, summary
from xfreqbench.system import machine
from xfreqbench.system.files import atomic_path, json_sha256
from xfreqbench.types import FloatArray, IntArray, NDArray

SCHEMA = "xfreqbench/room-predictions/1"
# among the counts of a record: median seconds to adapt to a room and predict what is asked, and how many rooms a
# method learned from, where it says so
ROOM_SECONDS, NUM_ROOMS = "seconds_a_room", "rooms"
# among the settings of a record, of every tested room in turn: its type, and "1" or "0" for each transmitter asked for
ROOM_TYPES, ROOM_SIGHT = "room_types", "line_of_sight"
_WAIT_S = 0.5


@dataclass(frozen=True, eq=False)
class RoomTask(Task):
    """A job on the rooms of a part of a collection, of each of which so many transmitters are heard."""

    split: RoomSplit  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        return RoomTask, (self.job, self.split, self.dataset_path)

    @cached_property
    def method(self) -> RoomMethod:  # type: ignore[override]
        """The method, untrained; raises what `build_method` raises."""
        return self.new_method()

    @cached_property
    def code_sha256(self) -> str:
        """Hash of the code that the method's results depend on."""
        return code_sha256(self.method.built if isinstance(self.method, PerRoom) else self.method)

    @cached_property
    def id(self) -> str:
        """Hash of everything that determines the result, 16 hexadecimal digits: the id of the record."""
        return self._hash(self.split.sha256, METRICS_VERSION)

    @cached_property
    def fit_id(self) -> str:
        """The same for the fit across rooms, which several jobs share."""
        return self._hash("fit", *(room.sha256 for room in self.split.collection.part("train").rooms))

    def _hash(self, *more: str) -> str:
        content = [self.job.method, self.code_sha256, self.config, self.job.seed, asdict(self.job.budget), *more]
        return json_sha256(content)[:16]

    def new_method(self) -> RoomMethod:
        """Another untrained method."""
        return build_room_method(self.job.method, self.job.overrides)

    @property
    def notes(self) -> list[str]:
        """Nothing: a method may learn from other rooms at all carriers."""
        return []

    @property
    def files(self) -> dict[Path, str]:
        """None: every worker compares the hash of each room that it opens with that of the collection."""
        return {}

    def require_data(self) -> None:
        """Rooms are compared with their hashes when they are opened."""


def room_tasks(
    data: str,
    collection: Collection,
    methods: Sequence[tuple[str, tuple[str, ...]]],
    protocol: str,
    seeds: Sequence[int],
    budget: Budget,
    on: str = "test",
) -> list[RoomTask]:
    """One task for each method, seed and split of a collection; raises as `room_splits` and `build_room_method` do."""
    splits = room_splits(collection, protocol, on)
    tasks = [
        RoomTask(Job(data, name, split.protocol, split.name, options, seed, budget), split, collection.path)
        for name, options in methods
        for seed in seeds
        for split in splits
    ]
    for task in tasks:
        _ = task.id  # builds the method, or says what is wrong with it
    return tasks


def run_in_rooms(
    task: RoomTask, folder: ResultsFolder, fitting: FitProgress | None, require_claim: Callable[[], None]
) -> RunRecord:
    """Fit, or take the fit of another job; adapt to every room, predict, store and score; the record of all that."""
    path = folder.predictions_path(task.id)
    require_no_others(path, SCHEMA)
    machine.reset_peak_memory()
    method, fit = _fitted(task, folder, fitting, require_claim)
    kept = folder.checkpoints(task.id).path
    kept.mkdir(parents=True, exist_ok=True)
    rooms, started_s = task.split.rooms.rooms, time.perf_counter()
    answers = []
    for number, question in enumerate(task.split.questions()):
        answers.append(_answer(task, method, question, kept / f"room-{rooms[number].sha256[:16]}.npz"))
        if fitting:
            fitting(task.job, Fit(number + 1, np.nan, time.perf_counter() - started_s, (number + 1) / len(rooms)))
    require_claim()
    _write(path, task.split, answers)
    return _record(task, path, method, fit)


def _fitted(
    task: RoomTask, folder: ResultsFolder, fitting: FitProgress | None, require_claim: Callable[[], None]
) -> tuple[RoomMethod, Fit]:
    """The method fitted across rooms, here or before, and how its fit stood at its end."""
    stored, unfinished = folder.fitted_across_rooms(task.fit_id), folder.checkpoints(task.fit_id)
    while (done := stored.read()) is None:
        try:
            with folder.lock(task.fit_id):
                if stored.read() is None:
                    method, fit = _fit(task, folder, fitting, require_claim)
                    with task.method_errors("save"):
                        stored.write(method, fit, ())
                    unfinished.remove()
        except InUseError:
            time.sleep(_WAIT_S)
    return stored.load(task.method), done.fit


def _fit(
    task: RoomTask, folder: ResultsFolder, fitting: FitProgress | None, require_claim: Callable[[], None]
) -> tuple[RoomMethod, Fit]:
    saved = folder.checkpoints(task.fit_id)
    earlier = saved.read()
    method: Any = saved.load(task.method) if earlier else task.new_method()
    saved_s = earlier.seconds if earlier else 0.0

    def observe(before: Fit | None, now: Fit) -> None:
        nonlocal saved_s
        if now.seconds - saved_s >= checkpoints.CHECKPOINT_SECONDS:
            require_claim()
            with task.method_errors("save"):
                saved.write(method, now, ())
            saved_s = now.seconds
        if fitting:
            fitting(task.job, now)

    train: Any = deepcopy(task.split.collection.part("train"))
    with task.method_errors("fit"):
        fit = fit_within(
            method, train, task.job.budget, task.job.seed, spent=earlier.fit if earlier else None, observe=observe
        )
    return method, fit


@dataclass(frozen=True)
class _Answer:
    """What is predicted of one room: the rows of its data set, the sums over lags, and the seconds it took."""

    rows: Int[IntArray, "n"]
    sums: Float[NDArray[np.float32], "n L"]
    seconds: float  # to adapt
    predict_seconds: float


def _answer(task: RoomTask, method: RoomMethod, question: RoomQuestion, kept: Path) -> _Answer:
    """What the method predicts of a room; kept in a file, from which it is read where the room is done."""
    if kept.exists():
        with np.load(kept) as stored:
            return _Answer(stored["rows"], stored["sums"], float(stored["seconds"]), float(stored["predict_seconds"]))
    asked, adapting, predicting = question.asked, Stopwatch(), Stopwatch()
    with _errors(task, question, "adapt"), adapting:
        predictor = method.adapt(question.heard, task.job.budget)
    with _errors(task, question, "predict"), predicting:
        maps = predictor.predict(asked.tx_position_m.copy(), asked.carrier_hz.copy())
    maps = checked_maps(predictor, maps, (len(asked), *asked.grid.shape))
    if fault := fault_of_maps(maps):
        raise MethodError(
            f"Method {task.job.method!r} failed in predict in {asked.path.name}: the map of row "
            f"{asked.rows[fault[0]]} {fault[1]}"
        )
    sums = _lag_functions(asked).of_maps(maps, asked.header.pas_kind)
    answer = _Answer(asked.rows, sums, adapting.seconds, predicting.seconds)
    with atomic_path(kept) as temporary, temporary.open("wb") as file:
        np.savez(file, **vars(answer))
    return answer


@contextmanager
def _errors(task: RoomTask, question: RoomQuestion, part: str) -> Iterator[None]:
    with task.method_errors(f"{part} in room {question.room.path.name}"):
        yield


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


def _write(path: Path, split: RoomSplit, answers: Sequence[_Answer]) -> None:
    """Store predictions, whole or not at all."""
    num_rows = sum(len(answer.rows) for answer in answers)
    attributes = {"schema": SCHEMA, "split_sha256": split.sha256}
    with create_sealed(path, _variables(len(answers), num_rows, answers[0].sums.shape[1]), attributes) as writer:
        writer.append("lag", np.arange(answers[0].sums.shape[1]))
        writer.append("tested_room", np.arange(len(answers)))
        writer.append("adapt_seconds", np.array([answer.seconds for answer in answers]))
        writer.append("predict_seconds", np.array([answer.predict_seconds for answer in answers]))
        for number, answer in enumerate(answers):
            writer.append("room", np.full(len(answer.rows), number))
            writer.append("row", answer.rows)
            writer.append("lags", answer.sums)


def _read(path: Path, split: RoomSplit) -> tuple[list[_Answer], IntArray]:
    """Stored predictions of every room, and the room of each; raises `DataError` for a file that is damaged."""
    verify_sealed(path, SCHEMA)
    with open_sealed(path, SCHEMA) as file:
        room, row, sums, adapt_s, predict_s = (
            read_array(file, name) for name in ("room", "row", "lags", "adapt_seconds", "predict_seconds")
        )
        require_layout(file, _variables(len(adapt_s), len(row), sums.shape[1]))
        if text_attributes(file)["split_sha256"] != split.sha256 or len(adapt_s) != len(split.rooms):
            raise DataError(f"{path} holds predictions of another split. Delete it and run again.")
    answers = [
        _Answer(row[room == number], sums[room == number], float(adapt_s[number]), float(predict_s[number]))
        for number in range(len(adapt_s))
    ]
    return answers, room.astype(np.int64)


def _record(task: RoomTask, path: Path, method: RoomMethod, fit: Fit) -> RunRecord:
    """The record of a task, whose stored predictions are scored here; scores stand by room in `ssim_by_tx`."""
    answers, room = _read(path, task.split)
    scores: dict[str, list[FloatArray]] = {}
    carriers_hz, in_sight = [], []
    for question, answer in zip(task.split.questions(), answers, strict=True):
        asked, kind = question.asked, question.room.header.pas_kind
        if not np.array_equal(asked.rows, answer.rows):
            raise DataError(f"{path} holds predictions of other samples. Delete it and run again.")
        maps = _lag_functions(asked).maps(answer.sums, kind)
        for name, values in score_all(maps, asked.pas(), asked.grid, kind).items():
            scores.setdefault(name, []).append(values)
        carriers_hz.append(asked.carrier_hz)
        seen = question.room.tables["line_of_sight"][np.unique(asked.tx_index)]
        in_sight.append("".join(str(int(each)) for each in seen))
    every, carrier_hz = {name: np.concatenate(values) for name, values in scores.items()}, np.concatenate(carriers_hz)
    told = task.split.collection.record
    recipe = [told.family_sha256, told.options, [each.seed for each in task.split.collection.rooms]]
    with task.method_errors("num_parameters"):
        parameters = checked_num_parameters(method)
    return RunRecord(
        id=task.id,
        job=task.job,
        dataset_sha256=json_sha256([each.sha256 for each in told.rooms]),
        recipe=f"data-{json_sha256(recipe)}",
        scene=told.name,
        pas_kind=task.split.rooms[0].header.pas_kind,
        settings={
            "rooms_trained_on": len(task.split.collection.part("train")),
            "rooms_tested": len(answers),
            ROOM_TYPES: [each.type for each in task.split.rooms.rooms],
            ROOM_SIGHT: in_sight,
        },
        split_sha256=task.split.sha256,
        protocol_version=ROOM_PROTOCOL_VERSION,
        metrics_version=METRICS_VERSION,
        config=task.config,
        step=fit.step,
        fit_seconds=fit.seconds,
        fit_processor_seconds=fit.processor_seconds,
        predict_ms_per_map=sum(answer.predict_seconds for answer in answers) / len(room) * 1e3,
        peak_memory_mib=machine.peak_memory_mib(),
        parameters=parameters,
        num_test=len(room),
        num_without_path=0,
        shares_transmitters=False,
        scores={name: summary(values, carrier_hz) for name, values in every.items()},
        hardware=machine.hardware(),
        software=machine.software(),
        git_commit=machine.git_commit(),
        time_utc=utc_now(),
        counts=dict(fit.counts)
        | {ROOM_SECONDS: float(np.median([answer.seconds + answer.predict_seconds for answer in answers]))},
        ssim_by_tx=by_group(every["ssim"], room),
        code_sha256=task.code_sha256,
    )
