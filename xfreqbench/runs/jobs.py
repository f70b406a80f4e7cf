"""Jobs with everything that they name at hand. Whatever is wrong with one is found here, before the first fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.data.fingerprint import require_fingerprint
from xfreqbench.data.splits import Split, left_out, make_splits
from xfreqbench.data.unseen_rooms import RoomSplit, room_splits
from xfreqbench.errors import MethodError
from xfreqbench.maps.metrics import METRICS_VERSION
from xfreqbench.methods.config import as_json
from xfreqbench.methods.contract import ReceiverMethod, RoomMethod, parse_budget
from xfreqbench.methods.guard import method_code
from xfreqbench.methods.registry import build_method, code_sha256
from xfreqbench.methods.rooms import build_room_method
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.options import RunOptions
from xfreqbench.runs.records import Job
from xfreqbench.system.files import json_sha256


@dataclass(frozen=True)
class Question:
    """What a fitted method is asked: the maps of the samples `asked`, given the samples `heard` of the same room.

    `heard` is None where the method was fitted to that room. `place` says in errors where it is.
    """

    asked: PasDataset
    heard: PasDataset | None
    place: str


@dataclass(frozen=True, eq=False)
class Task:
    """A job with its split, its data, and its method, which stays untrained; see `new_method`.

    It is pickled without data set and method; where it arrives, they are opened and built when they are asked for.
    """

    job: Job
    split: Split | RoomSplit
    path: Path

    @classmethod
    def of(cls, job: Job, opened: PasDataset | Collection, split: Split | RoomSplit) -> Task:
        """The task of a job on opened data; raises what `build_method` raises, and `MethodError`."""
        task = cls(job, split, opened.path)
        _ = task.method  # or what is wrong with it
        if isinstance(split, RoomSplit):
            return task
        task.__dict__["dataset"] = opened
        if isinstance(task.method, RoomMethod):
            raise MethodError(
                f"Method {job.method!r} learns across rooms, and has no `predict` of its own. Run it on a collection "
                "of rooms, with --protocol unseen-rooms."
            )
        takes_others = isinstance(task.method, ReceiverMethod) and task.method.takes_other_receivers
        if split.receivers and not takes_others:
            raise MethodError(
                f"Method {job.method!r} can only predict the receiver that it was trained at, but protocol "
                f"{split.protocol!r} tests another. Run methods that set takes_other_receivers, as line-of-sight "
                "and nearest do."
            )
        return task

    def __reduce__(self) -> tuple[Any, ...]:
        return Task, (self.job, self.split, self.path)

    @cached_property
    def dataset(self) -> PasDataset:
        """The data set, where the split is one of a data set; raises `DataError`."""
        return open_dataset(self.path, self.job.receiver, self.job.polarization)

    @cached_property
    def method(self) -> Any:
        """The method, untrained; raises what `build_method` raises."""
        return self.new_method()

    @cached_property
    def config(self) -> dict[str, Any]:
        """The method's configuration as JSON has it."""
        return as_json(self.method.config)

    @cached_property
    def code_sha256(self) -> str:
        """Hash of the code that the method's results depend on."""
        return code_sha256(getattr(self.method, "built", self.method))

    @cached_property
    def id(self) -> str:
        """Hash of everything that determines the result, 16 hexadecimal digits: the id of the record."""
        if isinstance(self.split, RoomSplit):
            return self._hash(self.split.sha256, METRICS_VERSION)
        method = self.job.method, self.code_sha256, self.config
        split = self.job.protocol, self.split.sha256
        content = [self.dataset.sha256, *method, *split, self.job.seed, asdict(self.job.budget), METRICS_VERSION]
        return json_sha256(content)[:16]

    @cached_property
    def fit_id(self) -> str:
        """The same for the fit: `id`, but for rooms, where several jobs share one."""
        if isinstance(self.split, RoomSplit):
            return self._hash("fit", *(room.sha256 for room in self.split.collection.part("train").rooms))
        return self.id

    def _hash(self, *more: str) -> str:
        content = [self.job.method, self.code_sha256, self.config, self.job.seed, asdict(self.job.budget), *more]
        return json_sha256(content)[:16]

    @property
    def notes(self) -> list[str]:
        """What a user may not expect: tested carriers outside of the training band, absent splits, one link of many."""
        if isinstance(self.split, RoomSplit):
            return []
        known = self.dataset.file_header
        names = (() if self.split.receivers else known.receivers), known.polarizations
        axes = zip(("receiver", "polarization"), self.dataset.link, names, strict=True)
        links = [
            f"methods see {axis} {shown} of {', '.join(names)}; option {axis} chooses another"
            for axis, shown, names in axes
            if names
        ]
        absent = left_out(self.dataset) if self.split.protocol.startswith("sparse") else None
        return [*links, *filter(None, (absent, self.split.extrapolation(self.dataset)))]

    @property
    def files(self) -> dict[Path, str]:
        """The data sets that every worker has to find, with their hashes; rooms are compared when they are opened."""
        return {} if isinstance(self.split, RoomSplit) else {self.path: self.dataset.file_sha256}

    def training_part(self) -> PasDataset | Collection:
        """What the method is fitted to, as copies that it may change."""
        if isinstance(self.split, RoomSplit):
            return deepcopy(self.split.collection.part("train"))
        return self.split.training_part(self.dataset)

    def questions(self) -> Iterator[Question]:
        """What the fitted method is asked: the test rows of a data set, or what is asked in each room in turn."""
        if isinstance(self.split, RoomSplit):
            for question in self.split.questions():
                yield Question(question.asked, question.heard, f"in room {question.room.path.name}")
        else:
            yield Question(self.dataset[self.split.test], None, f"on split {self.split.name!r}")

    def new_method(self) -> Any:
        """Another untrained method, to be fitted: what it learns is freed with it, while tasks live longer."""
        build = build_room_method if isinstance(self.split, RoomSplit) else build_method
        return build(self.job.method, self.job.overrides)

    @contextmanager
    def method_errors(self, part: str, place: str = "") -> Iterator[None]:
        """Turn whatever the method raises in `part`, such as "fit", into a `MethodError` that says where."""
        failed = f"Method {self.job.method!r} failed in {part} {place or f'on split {self.split.name!r}'}:"
        with method_code(failed, "Fix it and run the same command again; finished jobs are kept."):
            yield


def tasks_of(
    data: str, opened: PasDataset | Collection, methods: Sequence[tuple[str, tuple[str, ...]]], options: RunOptions
) -> list[Task]:
    """One task for each method, seed and split, in that order of nesting; the splits are made once.

    `data` is the path of `opened` as the records name it. `methods` are names with `key=value` texts for their
    options; of `options`, protocol, targets, rows to score, seeds and budget are used. Raises `UnknownNameError`,
    `ProtocolError` and `MethodError`.
    """
    budget = parse_budget(options.budget)
    if isinstance(opened, Collection):
        splits: Sequence[Split | RoomSplit] = room_splits(opened, options.protocol, options.on)
        link: tuple[str | None, ...] = ()
    else:
        splits, link = make_splits(opened, options.protocol, options.targets_ghz, options.on), opened.link
    tasks = list[Task]()
    for name, overrides in methods:
        alike = list[Task]()
        for seed in options.seeds:
            for split in splits:
                job = Job(data, name, split.protocol, split.name, overrides, seed, budget, *link)
                alike.append(Task.of(job, opened, split))
                alike[-1].__dict__["code_sha256"] = alike[0].code_sha256  # its files are read once
        tasks += alike
    return tasks


def require_importable(tasks: Sequence[Task]) -> None:
    """Raise `MethodError` for a method that other processes cannot import, as it is defined in the running program."""
    for name in {task.job.method for task in tasks}:
        if name.startswith("__main__:"):
            raise MethodError(
                f"Method {name!r} is defined in the running program, where workers do not see it. Put the class into a "
                "module and import it from there, or run with executor='serial'."
            )


def require_runnable(tasks: Sequence[Task], folder: ResultsFolder) -> None:
    """Check whatever can stop one of the tasks: checkpoints, whether `folder` takes results, and the data sets.

    Of the data sets every byte is checked, and the fingerprints of their recipes. Raises the `XFreqBenchError` that
    says what is wrong.
    """
    for task in tasks:
        folder.checkpoints(task.fit_id).read()
    folder.require_writable()
    for path, dataset in {path: task.dataset for task in tasks for path in task.files}.items():
        verify(path)
        require_fingerprint(dataset)
