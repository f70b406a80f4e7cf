"""Jobs with everything that they name at hand. Whatever is wrong with one is found here, before the first fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.data.fingerprint import require_fingerprint
from xfreqbench.data.splits import Split, make_splits
from xfreqbench.data.unseen_rooms import RoomSplit, room_splits
from xfreqbench.errors import MethodError
from xfreqbench.maps.metrics import METRICS_VERSION
from xfreqbench.methods.config import as_json
from xfreqbench.methods.contract import Budget, ReceiverMethod, RoomMethod, parse_budget
from xfreqbench.methods.guard import method_code
from xfreqbench.methods.registry import build_method, code_sha256
from xfreqbench.methods.rooms import build_room_method
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.options import RunOptions
from xfreqbench.runs.records import Job
from xfreqbench.system.files import json_sha256


@dataclass(frozen=True, eq=False)
class Task:
    """A job with its split, its data, and its method, which stays untrained; see `new_method`.

    `rooms` is None where the split is one of a data set. A task is pickled without data set and method; where it
    arrives, they are opened and built when they are asked for.
    """

    job: Job
    split: Split | RoomSplit
    path: Path
    rooms: Collection | None = None

    @classmethod
    def of(cls, job: Job, opened: PasDataset | Collection, split: Split | RoomSplit) -> Task:
        """The task of a job on opened data; raises what `build_method` raises, and `MethodError`."""
        task = cls(job, split, opened.path, opened if isinstance(opened, Collection) else None)
        task.__dict__["data"] = opened
        if task.rooms is None and isinstance(task.method, RoomMethod):
            raise MethodError(
                f"Method {job.method!r} learns across rooms, and has no `predict` of its own. Run it on a collection "
                "of rooms, with --protocol unseen-rooms."
            )
        takes_others = isinstance(task.method, ReceiverMethod) and task.method.takes_other_receivers
        if isinstance(split, Split) and split.receivers and not takes_others:
            raise MethodError(
                f"Method {job.method!r} can only predict the receiver that it was trained at, but protocol "
                f"{split.protocol!r} tests another. Run methods that set takes_other_receivers, as line-of-sight "
                "and nearest do."
            )
        return task

    def __reduce__(self) -> tuple[Any, ...]:
        return Task, (self.job, self.split, self.path, self.rooms)

    @cached_property
    def data(self) -> Any:
        """What was split, a `PasDataset` or a `Collection`; raises `DataError`."""
        return self.rooms or open_dataset(self.path, self.job.receiver, self.job.polarization)

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
        if self.rooms is not None:
            return self._hash(more=[self.split.sha256, METRICS_VERSION])
        return self._hash([self.data.sha256], [self.job.protocol, self.split.sha256], [METRICS_VERSION])

    @cached_property
    def fit_id(self) -> str:
        """The same for the fit: `id`, but for rooms, where several jobs share one."""
        if self.rooms is not None:
            return self._hash(more=["fit", *(room.sha256 for room in self.rooms.part("train").rooms)])
        return self.id

    def _hash(self, data: Sequence[str] = (), split: Sequence[str] = (), more: Sequence[str] = ()) -> str:
        method = self.job.method, self.code_sha256, self.config
        return json_sha256([*data, *method, *split, self.job.seed, asdict(self.job.budget), *more])[:16]

    @property
    def files(self) -> dict[Path, str]:
        """The data sets that every worker has to find, with their hashes; rooms are compared when they are opened."""
        return {self.path: self.data.file_sha256} if self.rooms is None else {}

    def new_method(self) -> Any:
        """Another untrained method, to be fitted: what it learns is freed with it, while tasks live longer."""
        build = build_method if self.rooms is None else build_room_method
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
    options; of `options`, protocol, targets, rows to score, seeds and budget are used. Trivial predictors, which are
    not fitted, have no budget. Raises `UnknownNameError`, `ProtocolError` and `MethodError`.
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
                alike.append(Task.of(replace(job, budget=Budget()) if job.is_trivial else job, opened, split))
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
    for path, dataset in {path: task.data for task in tasks for path in task.files}.items():
        verify(path)
        require_fingerprint(dataset)
