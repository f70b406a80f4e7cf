"""What `bench load` prints: how much slower fits get beside other busy programs, against the processor they lose."""

from __future__ import annotations

import multiprocessing
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch

from xfreqbench.bench.tables import Bench
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.generate import generate
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.registry import build_method
from xfreqbench.system.workers import LocalProcesses, all_cores

NUM_COMPETITORS = 2
WARM_S, MEASURED_S = 4.0, 8.0
REPEATS = 3
COLUMNS = (
    "method",
    "steps/s alone",
    "beside",
    "cores alone",
    "beside",
    "steps a core second, beside : alone",
    "least",
)


@dataclass(frozen=True)
class Rate:
    """Steps a second of a fit, and the processor time that it got, in cores."""

    steps_per_s: float
    cores: float

    @property
    def steps_per_core_s(self) -> float:
        """Steps in a second of processor time."""
        return self.steps_per_s / self.cores


def bench_load(bench: Bench, methods: Sequence[str]) -> None:
    """Print the speed of fits alone and beside other programs that compute without a pause."""
    bench.introduce()
    note = (
        f"Each fit is a process of its own on all cores, alone and beside {NUM_COMPETITORS} processes that multiply "
        f"matrices in torch with its default number of threads; medians of {REPEATS} fits each, taken in turn. The "
        "last columns compare steps in a second of processor time: 1 where a fit slows by just the processor it loses."
    )
    with tempfile.TemporaryDirectory() as folder, bench.table("Fits under load", note, COLUMNS) as table:
        path = Path(folder) / "data.h5"
        generate("two_rooms", path, (2.4, 24.25, 77.0), tx=64, maps=False)
        for method in methods:
            table.add(method, *_cells(path, method))


def _cells(path: Path, method: str) -> Iterator[str]:
    alone, beside = [], []
    for _ in range(REPEATS):
        alone.append(_fit_rate(path, method))
        with _competitors():
            beside.append(_fit_rate(path, method))
    for name in ("steps_per_s", "cores"):
        for rates in (alone, beside):
            yield f"{statistics.median(getattr(rate, name) for rate in rates):.3g}"
    ratios = [b.steps_per_core_s / a.steps_per_core_s for a, b in zip(alone, beside, strict=True)]
    yield f"{statistics.median(ratios):.2f}"
    yield f"{min(ratios):.2f}"


def _fit_rate(path: Path, method: str) -> Rate:
    with LocalProcesses(all_cores(), is_fresh=True) as processes:
        return processes.submit(_fit, (path, method)).result()


def _fit(asked: tuple[Path, str]) -> Rate:
    """In a new process: fit for some seconds, and count the steps once all has been compiled."""
    path, name = asked
    steps = build_method(name).fit(open_dataset(path), Budget(max_seconds=3600), 0)
    start = time.perf_counter()
    while time.perf_counter() - start < WARM_S:
        next(steps)
    num_steps, start, start_core = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - start < MEASURED_S:
        next(steps)
        num_steps += 1
    seconds = time.perf_counter() - start
    return Rate(num_steps / seconds, (time.process_time() - start_core) / seconds)


@contextmanager
def _competitors() -> Iterator[None]:
    processes = [
        multiprocessing.get_context("spawn").Process(target=_multiply, daemon=True)
        for _ in range(NUM_COMPETITORS)
    ]
    for process in processes:
        process.start()
    time.sleep(WARM_S)  # they import torch
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.join()


def _multiply() -> None:
    matrix = torch.rand(400, 400)
    while True:
        matrix = torch.softmax(matrix @ matrix, 1)
