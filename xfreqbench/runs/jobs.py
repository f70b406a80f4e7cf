"""Jobs with everything that they name looked up. Whatever is wrong with one is found here, before the first fit."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.data.fingerprint import require_fingerprint
from xfreqbench.data.protocols import find_split
from xfreqbench.data.splits import Split
from xfreqbench.maps.metrics import METRICS_VERSION
from xfreqbench.methods.config import as_json
from xfreqbench.methods.contract import Method
from xfreqbench.methods.guard import method_code
from xfreqbench.methods.registry import build_method, code_sha256
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.records import Job


@dataclass(frozen=True)
class Task:
    """A job with its data set, its split and its method, which stays untrained; see `new_method`."""

    job: Job
    dataset: PasDataset
    split: Split
    method: Method

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
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    def new_method(self) -> Method:
        """Another untrained method, to be fitted: what it learns is freed with it, while tasks live longer."""
        return build_method(self.job.method, self.job.overrides)

    @contextmanager
    def method_errors(self, part: str) -> Iterator[None]:
        """Turn whatever the method raises in `part`, such as "fit", into a `MethodError` that says where."""
        failed = f"Method {self.job.method!r} failed in {part} on split {self.split.name!r}:"
        with method_code(failed, "Mend it and run the same command again; finished jobs are kept."):
            yield


def look_up(job: Job, dataset: PasDataset) -> Task:
    """The task of a job on its opened data set; raises `XFreqBenchError` for a name that there is not."""
    split = find_split(dataset, job.protocol, job.split)
    return Task(job, dataset, split, build_method(job.method, job.overrides))


def look_up_all(jobs: Sequence[Job], folder: ResultsFolder) -> list[Task]:
    """The tasks of jobs, in their order, once everything that can stop one of them has been checked.

    That is: every name, every byte of the data sets and the fingerprints of their recipes, every checkpoint, and
    whether `folder` takes results.
    Raises the `XFreqBenchError` that says what is wrong.
    """
    datasets = {path: open_dataset(path) for path in dict.fromkeys(job.dataset for job in jobs)}
    tasks = [look_up(job, datasets[job.dataset]) for job in jobs]
    for task in tasks:
        folder.checkpoints(task.id).read()
    folder.require_writable()
    for path, dataset in datasets.items():
        verify(path)
        require_fingerprint(dataset)
    return tasks
