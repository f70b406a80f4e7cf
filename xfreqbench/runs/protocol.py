"""Runs methods through a protocol: every method on every split, with every seed."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import InstanceOf

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.protocols import ScoredOn, Targets, make_splits
from xfreqbench.errors import XFreqBenchError
from xfreqbench.methods.contract import Budget, parse_budget
from xfreqbench.methods.registry import device_option, method_names
from xfreqbench.runs.on_workers import run_on
from xfreqbench.runs.outlook import may_be_long, outlook
from xfreqbench.runs.progress import run_bars, worker_bar
from xfreqbench.runs.records import Job, RunRecord
from xfreqbench.runs.run import run_jobs
from xfreqbench.system.arguments import FilePath, Numbers, Texts, WholeNumbers, Word, checked
from xfreqbench.system.workers import SERIAL, open_workers
from xfreqbench.units import ghz_to_hz

Options = Texts | Mapping[str, Any]  # of a method: texts `key=value`, or values by key


def protocol_jobs(
    data: str,
    overrides: Mapping[str, Sequence[str]],
    protocol: str,
    targets_hz: Targets,
    seeds: Sequence[int],
    budget: Budget,
    on: ScoredOn = "test",
) -> list[Job]:
    """One job for each method, seed and split, in that order of nesting.

    `data` is the path of a data set; `overrides` has the methods' names, each with `key=value` texts for its
    options; `targets_hz` and `on` are those of `make_splits`. Raises `DataError`, `UnknownNameError` and
    `ProtocolError`.
    """
    splits = make_splits(open_dataset(data), protocol, targets_hz, on)
    return [
        Job(data, method, split.protocol, split.name, tuple(options), seed, budget)
        for method, options in overrides.items()
        for seed in seeds
        for split in splits
    ]


@checked
def run(
    data: FilePath | InstanceOf[PasDataset],
    methods: Texts | Mapping[str, Options] = ("all",),
    protocol: str = "lofo",
    results: FilePath = "results",
    *,
    targets_ghz: Literal["all"] | Numbers | None = None,
    on: ScoredOn = "test",
    seeds: WholeNumbers = (0,),
    budget: str | Budget | None = "5m",
    device: Literal["cpu", "cuda"] = "cpu",
    executor: Word = SERIAL,
    progress: bool = False,
) -> list[RunRecord]:
    """Fit methods on a protocol's training rows, store and score their predictions; returns a record for each run.

    `data` is a whole data set or its path. `methods` is one name, several, or `all` for every installed method; as
    a mapping it gives each name its options, as in `{"nearest": {}, "xfreq-gs": {"width": 64}}`, or as texts
    `["width=64"]`. `targets_ghz` are the held-out carriers of `lofo` and `lofo-unseen-tx`, the paper's unless given.
    `on="validation"` is for choosing settings: the test rows are left alone, some of the training rows are scored and
    the others trained on, under a protocol of their own such as `lofo-validation`; see `make_splits`.
    `budget` ends every fit, as in `300s`, `5m`, `2000steps`, `64000maps` or `quick`; None leaves the end to the
    method. `device` is where methods that have the choice compute. `executor` is `serial`, a number of processes, or `dask://host:port`.
    `progress` draws bars on stderr, or prints a line for each run where that is no terminal.

    Records and predictions go to the folder `results`. What is finished there is not run again, and a fit that was
    killed goes on from its last checkpoint. Raises `XFreqBenchError`, before the first fit where that is possible;
    runs that were finished before it are kept.
    """
    if not isinstance(methods, Mapping):
        methods = dict.fromkeys(method_names() if list(methods) == ["all"] else methods, ())
    overrides = {name: (*_texts(given), *device_option(name, device)) for name, given in methods.items()}
    targets_hz = targets_ghz if isinstance(targets_ghz, str | None) else list(map(ghz_to_hz, targets_ghz))
    limit = budget if isinstance(budget, Budget) else parse_budget(budget)
    jobs = protocol_jobs(_path_of(data), overrides, protocol, targets_hz, seeds, limit, on)
    return run_shown(jobs, Path(results), executor, progress)


def run_shown(jobs: Sequence[Job], results_dir: Path, executor: str, progress: bool) -> list[RunRecord]:
    """The records of the jobs of a protocol, run where `executor` says.

    If `progress` is true, bars or lines on stderr tell of it, and before the first run what the runs will take, where
    that may be more than ten minutes. Raises as `run` does; where workers run the jobs, the `XFreqBenchError` names
    those that failed.
    """
    if progress and may_be_long(jobs, executor):
        ahead = outlook(jobs, results_dir, executor)
        if ahead.is_long:
            print(ahead, file=sys.stderr, flush=True)
    if executor == SERIAL:
        with run_bars(not progress) as callbacks:
            return run_jobs(jobs, results_dir, *callbacks)
    with open_workers(executor, is_fresh=True) as workers, worker_bar(not progress) as finished:
        outcome = run_on(workers, jobs, results_dir, finished)
    if outcome.failures:
        number = f"{len(outcome.failures)} of {len(jobs)} runs failed; run the same again, and they are tried again."
        raise XFreqBenchError("\n".join([number, *outcome.failures]))
    return outcome.records


def _texts(options: Options) -> tuple[str, ...]:
    """Options as texts `key=value`, each value as JSON has it unless it is a text already."""
    if not isinstance(options, Mapping):
        return tuple(options)
    return tuple(
        f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in options.items()
    )


def _path_of(data: str | Path | PasDataset) -> str:
    if not isinstance(data, PasDataset):
        return str(data)
    num_samples = data.header.num_tx * data.num_carriers
    if len(data) != num_samples:
        raise XFreqBenchError(
            f"Protocols split whole data sets, but a subset of {len(data)} of the {num_samples} samples of {data.path} "
            "was given. Give the whole data set, or its path."
        )
    return str(data.path)
