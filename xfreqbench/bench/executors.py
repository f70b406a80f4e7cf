"""What `bench scale-out` prints: the cost of executors on the same work."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np

from xfreqbench.bench.tables import Bench
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.plan import BATCH, Plan, plan_generation
from xfreqbench.data.splits import LOFO_TARGETS_GHZ
from xfreqbench.errors import XFreqBenchError
from xfreqbench.methods.trivial import NEEDED_TRIVIAL
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.jobs import tasks_of
from xfreqbench.runs.options import RunOptions
from xfreqbench.runs.records import BenchFigure, BenchPoint
from xfreqbench.runs.run import run_jobs
from xfreqbench.system.cluster import dask_workers, is_installed, local_cluster
from xfreqbench.system.processes import SERIAL, open_workers
from xfreqbench.system.workers import Workers, side_by_side
from xfreqbench.tracing.tracer import Channel
from xfreqbench.tracing.versions import software_versions

SCENE = "office"
NUM_WORKERS = 2
NUM_SPLITS = 2  # of protocol lofo, for the runs


def bench_scale_out(bench: Bench, num_tx: int) -> None:
    """Print what each executor costs beside the work: generation of `num_tx` transmitters, and runs on them."""
    if num_tx < BATCH:
        raise XFreqBenchError(f"--tx is {num_tx}; give at least {BATCH}, which is one batch.")
    bench.introduce()
    with tempfile.TemporaryDirectory() as folder:
        generate_planned(_office_plan(1), Path(folder) / "compiled.h5")  # compiles kernels for all measurements
        _tabulate_executors(bench, num_tx, Path(folder))


def _office_plan(num_tx: int) -> Plan:
    """The generation that is measured: the office at the defaults and the paper's carriers."""
    return plan_generation(SCENE, GenerateOptions(tx=num_tx))


@contextmanager
def _own_cluster() -> Iterator[Workers]:
    """Workers of a Dask cluster that is started for the measurement."""
    with local_cluster(NUM_WORKERS) as address, dask_workers(address) as workers:
        yield workers


# how to open each executor, by its name in the table; the argument says whether its processes are new
WAYS: dict[str, Callable[[bool], AbstractContextManager[Workers]]] = {
    SERIAL: lambda is_fresh: open_workers(SERIAL),
    f"{NUM_WORKERS} processes": lambda is_fresh: open_workers(str(NUM_WORKERS), is_fresh=is_fresh),
    f"Dask, {NUM_WORKERS} workers": lambda is_fresh: _own_cluster(),
}


def _tabulate_executors(bench: Bench, num_tx: int, folder: Path) -> None:
    plan, points, first = _office_plan(num_tx), [], dict[str, str]()
    note = (
        f"Generation: {num_tx} transmitters × {len(plan.header.carrier_hz)} carriers of {SCENE} at the defaults, "
        f"batches of {BATCH}, every process shooting its own rays, maps stored. Runs: {', '.join(NEEDED_TRIVIAL)} on "
        f"{NUM_SPLITS} lofo splits of those data, in new processes where they are of this machine. Serial tracing has "
        "a thread a core; processes and workers have one each. Start-up: until every place has answered one call, "
        "that of the cluster included. An empty call returns a batch of zeros (100 of them, wall time "
        "over their number), or for runs nothing. Same bytes: the data set's sha256, or all predictions', is that of "
        "the serial row. Everything was measured, once, with kernels compiled before."
        + ("" if is_installed() else " The extra `cluster` is not installed here: no row of Dask.")
    )
    columns = "work", "executor", "start-up, s", "wall, s", "rate", "an empty call, ms", "same bytes"
    with bench.table("What an executor costs", note, columns, software_versions("image")) as table:
        for work in (_Generation(plan, folder), _Runs(folder)):
            for way in list(WAYS)[: None if is_installed() else -1]:
                start_up_s, wall_s, empty_call_s, sha256 = _measured(way, work)
                same = "yes" if sha256 == first.setdefault(work.name, sha256) else "NO"
                rate = work.amount / wall_s
                cells = f"{start_up_s:.1f}", f"{wall_s:.1f}", f"{rate:.3g} {work.unit}/s", f"{empty_call_s * 1e3:.2f}"
                table.add(work.name, way, *cells, same)
                points.append(BenchPoint(series=work.name, label=way, x=start_up_s, y=rate))
        table.figure = BenchFigure(
            x_label="start-up, s", y_label="transmitters or runs a second", log_x=False, points=tuple(points)
        )


class _Generation:
    """Generation of the same data set by any workers."""

    name, unit, is_fresh = "generation", "transmitters", False

    def __init__(self, plan: Plan, folder: Path) -> None:
        self._plan, self._folder = plan, folder
        self.amount = len(plan.tx_position_m)
        self.batch_shape = BATCH, len(plan.header.carrier_hz), plan.header.receiver.num_elements
        self.num_empty_calls = 100

    def do(self, workers: Workers, way: str) -> str:
        """Generate the data set; return its sha256."""
        return open_dataset(generate_planned(self._plan, self._folder / f"{way}.h5", workers=workers)).sha256


class _Runs:
    """The same runs by any workers, on the data set of the serial generation."""

    name, unit, is_fresh = "runs", "runs", True
    batch_shape = 0, 0, 0
    num_empty_calls = NUM_WORKERS

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.amount = len(NEEDED_TRIVIAL) * NUM_SPLITS

    def do(self, workers: Workers, way: str) -> str:
        """Do the runs; return the sha256 of all prediction files with their names."""
        data, results = self._folder / f"{SERIAL}.h5", self._folder / f"runs of {way}"
        dataset, methods = open_dataset(data), [(method, ()) for method in NEEDED_TRIVIAL]
        asked = RunOptions("lofo", targets_ghz=LOFO_TARGETS_GHZ[:NUM_SPLITS], budget=None)
        run_jobs(tasks_of(str(data), dataset, methods, asked), results, workers)
        digest = hashlib.sha256()
        for path in ResultsFolder(results).predictions_paths():
            digest.update(path.name.encode() + path.read_bytes())
        return digest.hexdigest()


Work = _Generation | _Runs


def _measured(way: str, work: Work) -> tuple[float, float, float, str]:
    """Seconds of an executor's start-up, of its work and of an empty call, and the digest of the work's results."""
    start = time.perf_counter()
    with WAYS[way](work.is_fresh) as workers:
        _call_empty(workers, (0, 0, 0), workers.num_places)
        ready = time.perf_counter()
        _call_empty(workers, work.batch_shape, work.num_empty_calls)
        begun = time.perf_counter()
        sha256 = work.do(workers, way)
        wall_s = time.perf_counter() - begun
    return ready - start, wall_s, (begun - ready) / work.num_empty_calls, sha256


def _call_empty(workers: Workers, shape: tuple[int, int, int], number: int) -> None:
    """Let workers return a batch of zeros of this shape, several times."""
    for _, ended in side_by_side(workers, _zeros, [shape] * number, ahead=1):
        ended.result()


def _zeros(shape: tuple[int, int, int]) -> Channel:
    """A batch without channels; a function of the module, so that other processes can import it."""
    return Channel(np.zeros(shape, np.complex128), np.zeros(shape[:2], np.int32))
