"""What `bench scale-out` prints: what executors cost on the same work, and what large data sets will take."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from xfreqbench.cluster import dask_workers, is_installed, local_cluster
from xfreqbench.dataset import open_dataset
from xfreqbench.errors import XFreqBenchError
from xfreqbench.generate import BATCH, Plan, generate
from xfreqbench.many_runs import run_on
from xfreqbench.method import TRIVIAL, Budget
from xfreqbench.parallel import (
    SERIAL,
    Workers,
    open_workers,
    side_by_side,
)
from xfreqbench.protocols import make_splits
from xfreqbench.provenance import software_versions
from xfreqbench.records import BenchFigure, BenchPoint, Job
from xfreqbench.scale_planning import SCENE, office_plan, paper_hz, tabulate_costs, tabulate_plans
from xfreqbench.scoring import PREDICTIONS_FOLDER
from xfreqbench.tables import Bench
from xfreqbench.tracing import Channel

Argument = TypeVar("Argument")
Result = TypeVar("Result")
NUM_WORKERS = 2
NUM_SPLITS = 2  # of lofo, in the bag of runs
NUM_EMPTY_CALLS = 100
EXECUTOR_COLUMNS = ("work", "executor", "start-up, s", "wall, s", "rate", "an empty call, ms", "same bytes")


def bench_scale_out(bench: Bench, num_tx: int) -> None:
    """Print what executors cost, what a transmitter takes, and what is to be expected of many."""
    if num_tx < BATCH:
        raise XFreqBenchError(f"--tx is {num_tx}; give at least {BATCH}, which is one batch.")
    bench.introduce()
    with tempfile.TemporaryDirectory() as folder:
        generate(office_plan(1, paper_hz()), Path(folder) / "compiled.h5")  # kernels, for all that follows
        _tabulate_executors(bench, num_tx, Path(folder))
        costs = tabulate_costs(bench, num_tx, Path(folder))
    tabulate_plans(bench, costs)


@dataclass(frozen=True)
class Way:
    """An executor as the table names it, and how it is opened for batches or, with processes anew, for runs."""

    name: str
    open: Callable[[bool], AbstractContextManager[Workers]]


@contextmanager
def _cluster_of_our_own() -> Iterator[Workers]:
    with local_cluster(NUM_WORKERS) as address, dask_workers(address) as workers:
        yield workers


WAYS = (
    Way(SERIAL, lambda is_fresh: open_workers(SERIAL)),
    Way(f"{NUM_WORKERS} processes", lambda is_fresh: open_workers(str(NUM_WORKERS), is_fresh=is_fresh)),
    Way(f"Dask, {NUM_WORKERS} workers", lambda is_fresh: _cluster_of_our_own()),
)


def _tabulate_executors(bench: Bench, num_tx: int, folder: Path) -> None:
    plan, points, first = office_plan(num_tx, paper_hz()), [], dict[str, str]()
    note = (
        f"Generation: {num_tx} transmitters × {len(plan.header.carrier_hz)} carriers of {SCENE} at the defaults, "
        f"batches of {BATCH}, every process shooting its own rays, maps stored. Runs: {', '.join(TRIVIAL)} on "
        f"{NUM_SPLITS} lofo splits of those data, in new processes where they are of this machine. Serial tracing has "
        "a thread a core; processes and workers have one each. Start-up: until every place has answered one call, "
        f"that of the cluster included. An empty call returns a batch of zeros ({NUM_EMPTY_CALLS} of them, wall time "
        "over their number), or for runs nothing. Same bytes: the data set's sha256, or all predictions', is that of "
        "the serial row. Everything was measured, once, with kernels compiled before."
        + ("" if is_installed() else " The extra `cluster` is not installed here: no row of Dask.")
    )
    with bench.table("What an executor costs", note, EXECUTOR_COLUMNS, software_versions("image")) as table:
        for work in (_Generation(plan, folder), _Runs(folder)):
            for way in WAYS if is_installed() else WAYS[:-1]:
                took = _measured(way, work)
                same = took.sha256 == first.setdefault(work.name, took.sha256)
                table.add(work.name, way.name, *took.cells(work.unit), "yes" if same else "NO")
                points.append(took.point(work, way.name))
        table.figure = BenchFigure(
            x_label="start-up, s",
            y_label="transmitters or runs a second",
            log_x=False,
            points=tuple(points),
        )


@dataclass(frozen=True)
class Took:
    """One work on one executor: seconds, amount of work, and a digest of what came out."""

    start_up_s: float
    wall_s: float
    amount: int
    empty_call_s: float
    sha256: str

    @property
    def rate(self) -> float:
        """Work a second."""
        return self.amount / self.wall_s

    def cells(self, unit: str) -> tuple[str, ...]:
        """As a table shows it."""
        rate = f"{self.rate:.3g} {unit}/s"
        return f"{self.start_up_s:.1f}", f"{self.wall_s:.1f}", rate, f"{self.empty_call_s * 1e3:.2f}"

    def point(self, work: Work, way: str) -> BenchPoint:
        """Of a figure: rate against start-up."""
        return BenchPoint(series=work.name, label=way, x=self.start_up_s, y=self.rate)


class _Generation:
    """The same data set, by whichever workers."""

    name, unit, is_fresh = "generation", "transmitters", False

    def __init__(self, plan: Plan, folder: Path) -> None:
        self._plan, self._folder = plan, folder
        self.amount = len(plan.tx_position_m)
        self.batch_shape = BATCH, len(plan.header.carrier_hz), plan.header.receiver.num_elements
        self.num_empty_calls = NUM_EMPTY_CALLS

    def do(self, workers: Workers, way: str) -> str:
        """The data set's sha256."""
        return open_dataset(generate(self._plan, self._folder / f"{way}.h5", workers=workers)).sha256


class _Runs:
    """The same bag of runs, on what the serial generation left."""

    name, unit, is_fresh = "runs", "runs", True
    batch_shape = 0, 0, 0
    num_empty_calls = NUM_WORKERS

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.amount = len(TRIVIAL) * NUM_SPLITS

    def do(self, workers: Workers, way: str) -> str:
        """The sha256 of all predictions, by their names."""
        data, results = self._folder / f"{SERIAL}.h5", self._folder / f"runs of {way}"
        splits = make_splits(open_dataset(data), "lofo", None)[:NUM_SPLITS]
        jobs = [
            Job(str(data), method, "lofo", split.name, budget=Budget())
            for method in TRIVIAL
            for split in splits
        ]
        failures = run_on(workers, jobs, results, lambda done, total, job: None)
        if failures:
            raise XFreqBenchError("\n".join(failures))
        digest = hashlib.sha256()
        for path in sorted((results / PREDICTIONS_FOLDER).glob("*.h5")):
            digest.update(path.name.encode() + path.read_bytes())
        return digest.hexdigest()


Work = _Generation | _Runs


def _measured(way: Way, work: Work) -> Took:
    start = time.perf_counter()
    with way.open(work.is_fresh) as workers:
        _call_empty(workers, (0, 0, 0), workers.num_places)
        ready = time.perf_counter()
        _call_empty(workers, work.batch_shape, work.num_empty_calls)
        begun = time.perf_counter()
        sha256 = work.do(workers, way.name)
        wall_s = time.perf_counter() - begun
    return Took(ready - start, wall_s, work.amount, (begun - ready) / work.num_empty_calls, sha256)


def _call_empty(workers: Workers, shape: tuple[int, int, int], number: int) -> None:
    for _, ended in side_by_side(workers, _zeros, [shape] * number, ahead=1):
        ended.result()


def _zeros(shape: tuple[int, int, int]) -> Channel:
    return Channel(np.zeros(shape, np.complex128), np.zeros(shape[:2], np.int32))
