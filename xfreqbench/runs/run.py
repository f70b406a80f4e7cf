"""Runs methods: every job is fitted, predicts, has its predictions stored and scored, and is recorded.

Jobs are run in this process, one after the other, or on workers, several at a time. A long fit is saved on its way,
and a run that was killed goes on from there.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from math import nan
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from pydantic import InstanceOf

from xfreqbench.data.collection import Collection, open_collection
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.splits import HELD_OUT_RECEIVER, Question
from xfreqbench.data.unseen_rooms import ROOM_PROTOCOLS, RoomSplit
from xfreqbench.errors import (
    ClusterError,
    DataError,
    InUseError,
    MethodError,
    ProtocolError,
    RunsFailedError,
    XFreqBenchError,
    was_interrupted,
)
from xfreqbench.methods.fitting import Fit, Stopwatch, checked_findings, checked_maps, checked_num_parameters
from xfreqbench.methods.registry import device_option, method_names, name_of, require_installed, room_method_names
from xfreqbench.runs.estimate import estimate_runs
from xfreqbench.runs.fit import FitProgress, fitted
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.jobs import Task, require_importable, require_runnable, tasks_of
from xfreqbench.runs.options import MethodOptions, Methods, RunOptions
from xfreqbench.runs.predictions import SCHEMA, MapBatch, fault_of_maps, require_no_others, write_predictions
from xfreqbench.runs.progress import RunProgress, run_bars
from xfreqbench.runs.records import Job, RunRecord
from xfreqbench.runs.rooms import ROOM_SCHEMA, ROOM_SECONDS, RoomAnswer, answer_of, scored_in_rooms, write_answers
from xfreqbench.runs.scoring import BATCH_SIZE, record_of, scored_on_split
from xfreqbench.system import machine
from xfreqbench.system.arguments import FilePath, taking
from xfreqbench.system.bars import announcing
from xfreqbench.system.files import exclusive, storage_errors
from xfreqbench.system.pieces import Pieces
from xfreqbench.system.processes import SERIAL, open_workers, send_message
from xfreqbench.system.workers import HERE, Workers, side_by_side

_sent_s = 0.0


@taking(RunOptions)
def run(
    data: FilePath | InstanceOf[PasDataset] | InstanceOf[Collection], methods: Methods, options: RunOptions
) -> list[RunRecord]:
    """Fit methods on a protocol's training rows, store and score their predictions; returns a record for each run.

    `data` is a whole data set or its path, and for protocol `unseen-rooms` a collection or its folder. `methods` is
    one name, several, or `all` for every installed method; a class stands for its name. As a mapping it gives each its
    options, as in `{"nearest": {}, "xfreq-gs": {"width": 64}}`, or as texts `["width=64"]`.

    `receiver` and `polarization` are by default those that a given data set shows. Protocol `held-out-receiver` tests
    that receiver, and every one in turn of a path where none is named. With `budget=None` a method ends its fit
    itself. See `make_splits` for `on="validation"`.

    What is finished in the folder of results is not run again, and a fit that was killed goes on from its last
    checkpoint. Mistakes are `XFreqBenchError`s, before the first fit where that is possible. A run that fails stops no
    other: at the end `RunsFailedError` names those that failed. A single run raises its own error.
    """
    with announcing(options.progress) as is_shown:
        tasks = asked_tasks(data, methods, options)
        if options.executor != SERIAL:
            require_importable(tasks)
        return run_shown(tasks, Path(options.results), options.executor, is_shown)


def asked_tasks(data: str | Path | PasDataset | Collection, methods: Methods, options: RunOptions) -> list[Task]:
    """The tasks of a call of `run`; raises what is wrong with its arguments."""
    protocol, receiver, polarization = options.protocol, options.receiver, options.polarization
    if isinstance(data, PasDataset):
        num_samples = data.header.num_tx * data.header.num_carriers
        if len(data) != num_samples:
            raise XFreqBenchError(
                f"Protocols split whole data sets, but a subset of {len(data)} of the {num_samples} samples of "
                f"{data.path} was given. Give the whole data set, or its path."
            )
        shown, data = data.link, data.path
        receiver, polarization = receiver or shown[0], polarization or shown[1]
    if not isinstance(methods, Mapping):
        methods = dict.fromkeys(methods, ())
    if list(methods) == ["all"]:  # those that learn across rooms run on the protocols of rooms alone
        installed = method_names() + (room_method_names() if protocol in ROOM_PROTOCOLS else [])
        methods = dict.fromkeys(installed, methods["all"])
    texts = {name_of(method): _texts(chosen) for method, chosen in methods.items()}
    for name in texts:  # before any of them is imported, which takes seconds
        require_installed(name)
    named = [(name, (*chosen, *device_option(name, options.device))) for name, chosen in texts.items()]
    if protocol in ROOM_PROTOCOLS:
        unknown = {"target carrier": options.targets_ghz, "receiver": receiver, "polarization": polarization}
        for what, value in unknown.items():
            if value is not None:
                raise ProtocolError(f"Protocol {protocol!r} has no {what} to choose, but got {value!r}. Leave it out.")
        rooms = data if isinstance(data, Collection) else open_collection(data)
        return tasks_of(str(rooms.path), rooms, named, options)
    if isinstance(data, Collection):
        raise XFreqBenchError(
            f"Protocol {protocol!r} splits one data set; a collection takes {', '.join(ROOM_PROTOCOLS)}."
        )
    dataset = open_dataset(data, receiver, polarization)
    tested = [dataset]
    if protocol == HELD_OUT_RECEIVER and receiver is None and dataset.file_header.receivers:
        tested = [dataset.at(name) for name in dataset.file_header.receivers]
    return [task for part in tested for task in tasks_of(str(data), part, named, options)]


def run_shown(tasks: Sequence[Task], results_dir: Path, executor: str, progress: bool) -> list[RunRecord]:
    """The records of tasks, run where `executor` says; `progress` is that of `run`, and so are the errors raised."""
    if progress:
        for note in dict.fromkeys(note for task in tasks for note in task.split.notes(task.data)):
            print(f"xfreqbench: {note}", file=sys.stderr, flush=True)
        estimate = estimate_runs(tasks, results_dir, executor)
        if estimate.seconds > 600.0 * (estimate.num_places or 1):  # more than ten minutes
            print(estimate, file=sys.stderr, flush=True)
    with (
        run_bars(not progress, shows_fit=executor in (SERIAL, "1")) as (ended, fitting),
        open_workers(executor, is_fresh=True, imports=imports_of(tasks), on_message=fitting) as workers,
    ):
        try:
            return run_jobs(tasks, results_dir, workers, ended, fitting)
        except RunsFailedError as failed:
            if len(tasks) > 1:
                raise
            (error,) = failed.errors.values()
            raise error from None


def usual_executor(tasks: Iterable[Task]) -> str:
    """`serial` for methods of this package; `1`, a process for each run, where one is not.

    Other code may end its process, or change what the next run uses.
    """
    kinds = {type(getattr(task.method, "built", task.method)) for task in tasks}
    return SERIAL if all(kind.__module__.startswith("xfreqbench.") for kind in kinds) else "1"


def imports_of(tasks: Iterable[Task]) -> list[str]:
    """The modules that processes import to run tasks."""
    return [__name__, *sorted({type(task.method).__module__ for task in tasks})]


def _texts(options: MethodOptions) -> tuple[str, ...]:
    """Options as texts `key=value`, each value as JSON has it unless it is a text already."""
    if not isinstance(options, Mapping):
        return tuple(options)
    return tuple(f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in options.items())


def run_jobs(
    tasks: Sequence[Task],
    results_dir: Path,
    workers: Workers = HERE,
    progress: RunProgress | None = None,
    fitting: FitProgress | None = None,
    keeps_predictions: Callable[[Job], bool] = lambda job: True,
) -> list[RunRecord]:
    """Run jobs and store their records in `results_dir`; returns the records, in the order of the jobs.

    `workers` run as many at a time as they have places; without any, this process runs one after the other. A job
    that is finished in the folder is not run again, and a fit that was killed goes on from its last checkpoint.
    Everything that can be checked is checked before the first fit, and raises the `XFreqBenchError` that it is:
    `InUseError` where another process runs jobs in the folder, `ClusterError` for workers that do not see the data sets
    and `results_dir` as this process does.

    A job that fails stops no other. At the end `RunsFailedError` names those that failed; the records of the others are
    kept. Ctrl-C ends all of it at once.

    Predictions of jobs for which `keeps_predictions` says so stay; others are removed once they are scored, and their
    records say that. `progress` is called whenever a job has ended, and at first for those that are finished.
    `fitting` is called at every step of a fit in this process with how it stands; for other processes, see
    `open_workers`.
    """
    folder = ResultsFolder(results_dir.absolute())
    require_runnable(tasks, folder)
    asked = dict[str, Task]()
    for task in tasks:  # options that say the defaults are the same job
        asked.setdefault(task.id, task)
    records, errors = dict[str, RunRecord](), dict[str, BaseException]()
    done = 0

    def end(task: Task, record: RunRecord | None) -> None:
        nonlocal done
        done += 1
        if record is not None:
            records[task.id] = record
        if progress:
            progress(done, len(asked), task.job, record)

    with folder.alone():
        for task in asked.values():
            if record := folder.finished(task.id):
                with suppress(InUseError), folder.lock(task.id):
                    folder.checkpoints(task.id).remove()  # may be left of a process that was killed
                end(task, record)
        missing = [task for task in asked.values() if task.id not in records]
        if workers is HERE:
            call = partial(run_task, folder=folder, fitting=fitting)
        else:
            call = partial(run_task, folder=ResultsFolder(folder.path), fitting=_send_fit)
            files = {path: sha256 for task in missing for path, sha256 in task.files.items()}
            require_shared(workers, folder.path, files)
        for task, ended in side_by_side(workers, call, missing):
            error = ended.exception()
            if was_interrupted(error):
                raise KeyboardInterrupt from error
            record = None
            if error is None:
                try:
                    record = folder.keep(_of_same_code(task, ended.result()), keeps_predictions(task.job))
                except XFreqBenchError as lost:
                    error = lost
            if error:
                with suppress(InUseError), folder.lock(task.id):
                    pass  # the file of a worker that was killed is removed
                errors[_words(task) if _words(task) not in errors else f"{_words(task)} ({task.id})"] = error
            end(task, record)
    if errors:
        raise RunsFailedError(errors, len(asked))
    return [records[task.id] for task in tasks]


def _words(task: Task) -> str:
    """What a task is called in errors."""
    job = task.job
    return f"{' '.join([job.method, *job.overrides])} on {job.split} of {Path(job.dataset).name}, seed {job.seed}"


def _of_same_code(task: Task, record: RunRecord) -> RunRecord:
    """The record of a task; raises `ClusterError` where its worker had other code or other data than this process."""
    if record.id != task.id:
        raise ClusterError(
            f"A worker has other code of method {task.job.method!r}, or other data at {task.path}. Nothing of it is "
            "recorded; restart it with the same code and data."
        )
    return record


def _send_fit(job: Job, fit: Fit) -> None:
    """Tell the process that this one works for how a fit stands, ten times a second at most."""
    global _sent_s
    if time.perf_counter() - _sent_s > 0.1:
        send_message(job, fit)
        _sent_s = time.perf_counter()


def run_task(task: Task, folder: ResultsFolder, fitting: FitProgress | None = None) -> RunRecord:
    """Fit, store the method, predict, store the predictions, and score what was stored; the record of all that.

    The caller stores the record and then removes what is kept of rooms: a job without a record is unfinished. Raises
    `InUseError` where another process, such as a worker that lost its driver, is at the job for more than a minute.
    """
    path, split = folder.predictions_path(task.id), task.split
    require_no_others(path, ROOM_SCHEMA if isinstance(split, RoomSplit) else SCHEMA)
    with exclusive(folder.run_lock_path(task.id)):
        machine.reset_peak_memory()
        method, fit, curve = fitted(task, folder, fitting)
        counts = dict(fit.counts)
        if isinstance(split, RoomSplit):
            num_rooms, kept = len(task.data.part(split.part)), folder.checkpoints(task.id).path
            answers = _answers_in_rooms(task, method, num_rooms, kept, fitting)
            write_answers(path, split.sha256, answers)
            predict_s = sum(answer.predict_seconds for answer in answers)
            counts[ROOM_SECONDS] = float(np.median([answer.seconds + answer.predict_seconds for answer in answers]))
        else:
            clock, (question,) = Stopwatch(), split.questions(task.data)
            hashes = {"dataset_sha256": task.data.sha256, "split_sha256": split.sha256}
            maps = _predicted(task, method, question, clock, BATCH_SIZE)
            write_predictions(path, maps, len(question.asked), task.data.grid.shape, **hashes)
            predict_s = clock.seconds
        memory_mib = machine.peak_memory_mib()
        with task.method_errors("num_parameters"):
            parameters = checked_num_parameters(method)
        with task.method_errors("findings"):
            findings = checked_findings(method)
        if isinstance(split, RoomSplit):
            scored = scored_in_rooms(task.data, split, path)
        else:
            scored = scored_on_split(task.data, split, path)
    outcome = {
        "config": task.config,
        "step": fit.step,
        "fit_seconds": fit.seconds,
        "fit_processor_seconds": fit.processor_seconds,
        "predict_ms_per_map": predict_s / scored["num_test"] * 1e3,
        "peak_memory_mib": memory_mib,
        "parameters": parameters,
        "counts": counts,
        "curve": curve,
        "code_sha256": task.code_sha256,
        "findings": findings,
    }
    return record_of(task.id, task.job, scored, outcome)


def _answers_in_rooms(
    task: Task, method: Any, num_rooms: int, kept: Path, fitting: FitProgress | None
) -> list[RoomAnswer]:
    """What a method predicts in every room, to which it is adapted; rooms that are done are kept in a folder."""
    started_s, pieces = time.perf_counter(), Pieces(kept, task.id)
    for number, question in enumerate(task.split.questions(task.data)):
        if number not in pieces:
            adapting, predicting = Stopwatch(), Stopwatch()
            with task.method_errors("adapt", question.place), adapting:
                predictor = method.adapt(question.heard, task.job.budget)
            ((_, maps),) = _predicted(task, predictor, question, predicting, len(question.asked))
            pieces.put(number, **vars(answer_of(question.asked, maps, adapting.seconds, predicting.seconds)))
        if fitting:
            fitting(task.job, Fit(number + 1, nan, time.perf_counter() - started_s, (number + 1) / num_rooms))
    kept_arrays: list[dict[str, Any]] = [pieces.get(number) for number in range(num_rooms)]
    return [RoomAnswer(**{name: array[()] for name, array in arrays.items()}) for arrays in kept_arrays]


def _predicted(task: Task, predictor: Any, question: Question, clock: Stopwatch, size: int) -> Iterator[MapBatch]:
    """Rows and predicted maps of what is asked, `size` at a time; `clock` runs within `predict` alone.

    Raises `MethodError` for the first map that no file of predictions may hold.
    """
    asked, position_m, carrier_hz = question.asked, question.asked.tx_position_m, question.asked.carrier_hz
    for start in range(0, len(asked), size):
        part = slice(start, start + size)
        with task.method_errors("predict", question.place), clock:
            maps = predictor.predict(position_m[part].copy(), carrier_hz[part].copy())
        rows = asked.rows[part]
        maps = checked_maps(predictor, maps, (len(rows), *asked.grid.shape))
        if fault := fault_of_maps(maps):
            raise MethodError(
                f"Method {task.job.method!r} failed in predict {question.place}: the map of row {rows[fault[0]]} "
                f"{fault[1]}"
            )
        yield rows, maps


def require_shared(workers: Workers, folder: Path, sha256_by_path: Mapping[Path, str]) -> None:
    """Raise `ClusterError` unless every worker finds what is put into a folder, may write there, and finds data sets.

    These are the same at the same paths, by their sha256.
    """
    token = folder.absolute() / f".shared-{uuid4().hex}"
    with storage_errors(token):
        token.parent.mkdir(parents=True, exist_ok=True)
        token.touch()
    try:
        answers = workers.ask(_found_there, token, [*sha256_by_path])
    finally:
        token.unlink()
    advice = "on a file system that is mounted at the same path on every machine."
    for worker, (sees_folder, found) in answers.items():
        if not sees_folder:
            raise ClusterError(
                f"Worker {worker} does not see {token.parent}, or may not write there. Choose a folder {advice}"
            )
        for sha256, (path, expected) in zip(found, sha256_by_path.items(), strict=True):
            if sha256 != expected:
                raise ClusterError(
                    f"Worker {worker} finds {sha256 or 'no data set'} at {path}, but it is {expected} here. Keep data "
                    f"sets {advice}"
                )


def _found_there(token: Path, paths: Sequence[Path]) -> tuple[bool, list[str | None]]:
    """Whether a file is seen that others may be put beside, and the hash of each data set, None where there is none."""
    found = list[str | None]()
    for path in paths:
        try:
            found.append(open_dataset(path).file_sha256)
        except DataError:
            found.append(None)
    return token.exists() and os.access(token.parent, os.W_OK), found
