"""Runs methods through a protocol: every method on every split, with every seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.splits import Targets, make_splits
from xfreqbench.errors import XFreqBenchError
from xfreqbench.methods.contract import Budget, parse_budget
from xfreqbench.methods.registry import method_names
from xfreqbench.runs.on_workers import run_on
from xfreqbench.runs.records import Job, RunRecord
from xfreqbench.runs.run import run_jobs
from xfreqbench.system.workers import SERIAL, open_workers
from xfreqbench.units import ghz_to_hz


def protocol_jobs(
    data: str,
    overrides: Mapping[str, Sequence[str]],
    protocol: str,
    targets_hz: Targets,
    seeds: Sequence[int],
    budget: Budget,
) -> list[Job]:
    """One job for each method, seed and split, in that order of nesting.

    `data` is the path of a data set; `overrides` has the methods' names, each with `key=value` texts for its
    options; `targets_hz` is that of `make_splits`. Raises `DataError`, `UnknownNameError` and `ProtocolError`.
    """
    splits = make_splits(open_dataset(data), protocol, targets_hz)
    return [
        Job(data, method, protocol, split.name, tuple(options), seed, budget)
        for method, options in overrides.items()
        for seed in seeds
        for split in splits
    ]


def run(
    data: str | Path | PasDataset,
    methods: str | Sequence[str] | Mapping[str, Sequence[str]] = "all",
    protocol: str = "lofo",
    results: str | Path = "results",
    *,
    targets_ghz: Sequence[float] | None = None,
    seeds: Sequence[int] = (0,),
    budget: str | None = "5m",
    executor: str = SERIAL,
) -> list[RunRecord]:
    """Fit methods on a protocol's training rows, store and score their predictions; returns a record for each run.

    `data` is a whole data set or its path. `methods` is one name, several, or `all` for every installed method; as
    a mapping it gives each name its options, as in `{"nearest": [], "xfreq-gs": ["width=64"]}`. `targets_ghz` are
    the held-out carriers of `lofo` and `lofo-unseen-tx`, the paper's unless given. `budget` ends every fit, as in
    `300s`, `5m` or `2000steps`; None leaves the end to the method. `executor` is `serial`, a number of processes,
    or `dask://host:port`.

    Records and predictions go to the folder `results`. What is finished there is not run again, and a fit that was
    killed goes on from its last checkpoint. Raises `XFreqBenchError`, before the first fit where that is possible;
    runs that were finished before it are kept.
    """
    if isinstance(methods, str):
        methods = method_names() if methods == "all" else [methods]
    overrides = methods if isinstance(methods, Mapping) else dict.fromkeys(methods, ())
    targets_hz = None if targets_ghz is None else [ghz_to_hz(target) for target in targets_ghz]
    jobs = protocol_jobs(_path_of(data), overrides, protocol, targets_hz, seeds, parse_budget(budget))
    if executor == SERIAL:
        return run_jobs(jobs, Path(results))
    with open_workers(executor, is_fresh=True) as workers:
        outcome = run_on(workers, jobs, Path(results), lambda done, total, job: None)
    if outcome.failures:
        raise XFreqBenchError("\n".join([f"{len(outcome.failures)} runs failed.", *outcome.failures]))
    return outcome.records


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
