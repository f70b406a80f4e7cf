"""Jobs with everything that they name at hand. Whatever is wrong with one is found here, before the first fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.data.fingerprint import require_fingerprint
from xfreqbench.data.splits import ScoredOn, Split, TargetsGhz, left_out, make_splits
from xfreqbench.errors import MethodError
from xfreqbench.maps.metrics import METRICS_VERSION
from xfreqbench.methods.config import as_json
from xfreqbench.methods.contract import Budget, Method, ReceiverMethod, RoomMethod
from xfreqbench.methods.guard import method_code
from xfreqbench.methods.registry import build_method, code_sha256
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.records import Job
from xfreqbench.system.files import json_sha256


@dataclass(frozen=True, eq=False)
class Task:
    """A job with its split, its data set, and its method, which stays untrained; see `new_method`.

    It is pickled without data set and method; where it arrives, they are opened and built when they are asked for.
    """

    job: Job
    split: Split
    dataset_path: Path

    @classmethod
    def of(cls, job: Job, dataset: PasDataset, split: Split) -> Task:
        """The task of a job on an opened data set; raises what `build_method` raises, and `MethodError`."""
        task = cls(job, split, dataset.path)
        task.__dict__.update(dataset=dataset, method=task.new_method())
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
        return Task, (self.job, self.split, self.dataset_path)

    @cached_property
    def dataset(self) -> PasDataset:
        """The data set; raises `DataError`."""
        return open_dataset(self.dataset_path, self.job.receiver, self.job.polarization)

    @cached_property
    def method(self) -> Method:
        """The method, untrained; raises what `build_method` raises."""
        return self.new_method()

    @cached_property
    def config(self) -> dict[str, Any]:
        """The method's configuration as JSON has it."""
        return as_json(self.method.config)

    @cached_property
    def code_sha256(self) -> str:
        """Hash of the code that the method's results depend on."""
        return code_sha256(self.method)

    @cached_property
    def id(self) -> str:
        """Hash of everything that determines the result, 16 hexadecimal digits: the id of the record."""
        content = [
            self.dataset.sha256,
            self.job.method,
            self.code_sha256,
            self.config,
            self.job.protocol,
            self.split.sha256,
            self.job.seed,
            asdict(self.job.budget),
            METRICS_VERSION,
        ]
        return json_sha256(content)[:16]

    @property
    def notes(self) -> list[str]:
        """What a user may not expect: tested carriers outside of the training band, absent splits, one link of many."""
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
        """The files that every worker has to find, with their hashes."""
        return {self.dataset_path: self.dataset.file_sha256}

    def require_data(self) -> None:
        """Check every byte of the data set, and the fingerprints of its recipe; raises `XFreqBenchError`."""
        verify(self.dataset_path)
        require_fingerprint(self.dataset)

    def new_method(self) -> Any:
        """Another untrained `Method`, to be fitted: what it learns is freed with it, while tasks live longer."""
        return build_method(self.job.method, self.job.overrides)

    @contextmanager
    def method_errors(self, part: str) -> Iterator[None]:
        """Turn whatever the method raises in `part`, such as "fit", into a `MethodError` that says where."""
        failed = f"Method {self.job.method!r} failed in {part} on split {self.split.name!r}:"
        with method_code(failed, "Fix it and run the same command again; finished jobs are kept."):
            yield


def protocol_tasks(
    data: str,
    dataset: PasDataset,
    methods: Sequence[tuple[str, tuple[str, ...]]],
    protocol: str,
    targets_ghz: TargetsGhz,
    seeds: Sequence[int],
    budget: Budget,
    on: ScoredOn = "test",
) -> list[Task]:
    """One task for each method, seed and split, in that order of nesting; the splits are made once.

    `data` is the path of `dataset` as the records name it. `methods` are names with `key=value` texts for their
    options; `targets_ghz` and `on` are those of `make_splits`. Raises `UnknownNameError`, `ProtocolError` and
    `MethodError`.
    """
    splits = make_splits(dataset, protocol, targets_ghz, on)
    return [
        Task.of(Job(data, name, split.protocol, split.name, options, seed, budget, *dataset.link), dataset, split)
        for name, options in methods
        for seed in seeds
        for split in splits
    ]


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
        folder.checkpoints(task.id).read()
    folder.require_writable()
    for task in {task.dataset_path: task for task in tasks}.values():
        task.require_data()
