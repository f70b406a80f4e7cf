"""Estimates for large data sets: the cost of one transmitter is measured, and the rest is computed from it."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from xfreqbench.bench.tables import Bench
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import BATCH, Plan, plan_generation
from xfreqbench.data.schema import DatasetHeader
from xfreqbench.runs.records import BenchFigure, BenchPoint
from xfreqbench.scene.model import load_scene
from xfreqbench.system.machine import peak_memory_mib, reset_peak_memory
from xfreqbench.system.workers import HERE, InThisProcess, LocalProcesses, own_cores
from xfreqbench.tracing.solvers import make_tracer
from xfreqbench.tracing.tracer import Channel
from xfreqbench.tracing.versions import software_versions
from xfreqbench.units import PAPER_CARRIERS_GHZ, ghz_to_hz

SCENE = "office"
CARRIER_COUNTS = (1, 10, 100)
PLANNED_TX = (1_000, 10_000, 100_000, 1_000_000)
PLANNED_CARRIERS = (10, 100)
PLANNED_CORES = (1, 4, 16, 64, 256)
TABLED_CORES = (1, 16, 256)
RATE_COLUMNS = (
    "carriers",
    "rays once, CPU s",
    "tracing, CPU ms a transmitter",
    "a sample, CPU ms",
    "worker, MiB",
    "planning, ms a transmitter",
    "keeping batches",
    "writing with maps",
    "without",
    "driver, MiB",
)
PLAN_COLUMNS = (
    "transmitters × carriers",
    "CPU-hours",
    *(f"wall time on {cores} core{'s' if cores > 1 else ''}, with / without maps" for cores in TABLED_CORES),
    "driver, GB",
    "worker, GB",
    "disk with / without maps, GB",
    "batches until written, GB",
    "a reader's memory, GB",
)


@dataclass(frozen=True)
class TracingCost:
    """Cost of tracing on one thread at some number of carriers: CPU time of the rays and per transmitter."""

    rays_s: float
    per_tx_s: float
    peak_memory_mib: float


@dataclass(frozen=True)
class DriverCost:
    """Cost per transmitter of the one process that plans, keeps batches and writes the file (the driver)."""

    plan_s: float
    keep_s: float
    write_s: float
    peak_memory_mib: float


@dataclass(frozen=True)
class TransmitterCost:
    """All measured costs at one number of carriers; sizes of files and arrays follow from `header`."""

    header: DatasetHeader
    tracing: TracingCost
    with_maps: DriverCost
    without_maps: DriverCost


def tabulate_costs(bench: Bench, num_tx: int, folder: Path) -> dict[int, TransmitterCost]:
    """Print and return the cost of a transmitter for each number of carriers."""
    note = (
        f"{SCENE} at the defaults, carriers spread evenly over the logarithm from 1 to 94 GHz. Rays and tracing: CPU "
        f"time of one thread, compiled, over {BATCH} transmitters; memory is the process's peak. The driver plans, "
        "keeps every batch on disk (synced) as it comes and then derives maps and writes the file: wall time over "
        f"{num_tx} transmitters whose channels were at hand, in ms a transmitter (planning: a place of the scene's "
        "grid). Each row is of processes of its own."
    )
    costs = {}
    versions = software_versions("image")
    with bench.table("What a transmitter takes", note, RATE_COLUMNS, versions) as table:
        for number in CARRIER_COUNTS:
            cost = costs[number] = measure_cost(number, num_tx, folder)
            table.add(str(number), *_cost_cells(cost, number))
    return costs


def _cost_cells(cost: TransmitterCost, num_carriers: int) -> tuple[str, ...]:
    """The cells of a row, except the first."""
    tracing, driver = cost.tracing, cost.with_maps
    return (
        f"{tracing.rays_s:.1f}",
        f"{tracing.per_tx_s * 1e3:.1f}",
        f"{tracing.per_tx_s / num_carriers * 1e3:.2f}",
        f"{tracing.peak_memory_mib:.0f}",
        f"{driver.plan_s * 1e3:.2f}",
        f"{driver.keep_s * 1e3:.2f}",
        f"{driver.write_s * 1e3:.2f}",
        f"{cost.without_maps.write_s * 1e3:.2f}",
        f"{driver.peak_memory_mib:.0f}",
    )


def measure_cost(num_carriers: int, num_tx: int, folder: Path) -> TransmitterCost:
    """Measure tracing and driving at some number of carriers, each in a new process on one core."""
    driving = [_Driving(num_carriers, num_tx, has_maps, folder) for has_maps in (True, False)]
    with LocalProcesses(own_cores()[:1], is_fresh=True) as workers:
        tracing = workers.submit(_trace_some, num_carriers)
        with_maps, without = (workers.submit(_drive, each) for each in driving)
        header = office_plan(BATCH, spread_hz(num_carriers)).header
        return TransmitterCost(header, tracing.result(), with_maps.result(), without.result())


def _trace_some(num_carriers: int) -> TracingCost:
    """Measure the tracing of one batch, in this process."""
    plan = office_plan(BATCH, spread_hz(num_carriers))
    tracing = plan.tracing
    make_tracer(tracing.scene, tracing.carrier_hz[:1], replace(tracing.settings, rays=1000))  # compiles
    reset_peak_memory()
    start = time.process_time()
    tracer = make_tracer(tracing.scene, tracing.carrier_hz, tracing.settings)
    shot = time.process_time()
    tracer.channel(plan.tx_position_m[:1])  # compiles
    compiled = time.process_time()
    tracer.channel(plan.tx_position_m)
    return TracingCost(shot - start, (time.process_time() - compiled) / BATCH, peak_memory_mib())


@dataclass(frozen=True)
class _Driving:
    """What the driver is measured on."""

    num_carriers: int
    num_tx: int
    has_maps: bool
    folder: Path


class _AtHand(InThisProcess):
    """Workers that need no time: the same noise for every transmitter, also where it is traced again."""

    def __init__(self, num_carriers: int, num_elements: int) -> None:
        noise = np.random.default_rng(0).standard_normal((2, num_carriers, num_elements))
        self._cfr = noise[0] + 1j * noise[1]

    def submit(self, call: Any, argument: Any) -> Future[Any]:
        """Noise for as many transmitters as the batch has."""
        _, tx_position_m = argument
        return HERE.submit(self._of, len(tx_position_m))

    def _of(self, number: int) -> Channel:
        cfr = np.repeat(self._cfr[None], number, axis=0)
        return Channel(cfr, np.ones(cfr.shape[:2], np.int32))


def _drive(work: _Driving) -> DriverCost:
    """Measure the driver, in this process, with channels at hand."""
    carriers = spread_hz(work.num_carriers)
    start = time.perf_counter()
    plan = office_plan(work.num_tx, carriers, work.has_maps)
    planned = time.perf_counter()
    reached = dict[int, float]()  # when so many transmitters were kept, for the first time
    path = work.folder / f"driven-{work.num_carriers}-{work.has_maps}.h5"
    at_hand = _AtHand(work.num_carriers, plan.header.receiver.num_elements)

    def note(done: int, _: int) -> None:
        reached.setdefault(done, time.perf_counter())

    generate_planned(plan, path, note, workers=at_hand)
    written, kept = time.perf_counter(), reached[work.num_tx]
    path.unlink()
    num_places = len(plan.scene.transmitters.lattice_m)  # all are looked at, whichever are chosen
    return DriverCost(
        (planned - start) / num_places,
        (kept - planned) / work.num_tx,
        (written - kept) / work.num_tx,
        peak_memory_mib(),
    )


@dataclass(frozen=True)
class Expected:
    """Estimates for `num_tx` transmitters from the cost of one."""

    cost: TransmitterCost
    num_tx: int

    @property
    def cpu_s(self) -> float:
        """CPU time of tracing in seconds, without the rays that every process shoots once."""
        return self.num_tx * self.cost.tracing.per_tx_s

    def wall_s(self, num_cores: int, *, maps: bool) -> float:
        """Planning, then tracing while batches are kept, then writing; the driver has a core besides."""
        driver = self.cost.with_maps if maps else self.cost.without_maps
        tracing_s = self.cost.tracing.rays_s + self.cpu_s / num_cores
        return self.num_tx * (driver.plan_s + driver.write_s) + max(tracing_s, self.num_tx * driver.keep_s)

    def speed_up(self, num_cores: int, *, maps: bool) -> float:
        """Wall time on one core over that on `num_cores`."""
        return self.wall_s(1, maps=maps) / self.wall_s(num_cores, maps=maps)

    @property
    def batch_bytes(self) -> int:
        """Size of one transmitter in a batch, as it is sent and kept."""
        header = self.cost.header
        return len(header.carrier_hz) * (16 * header.receiver.num_elements + 4)

    def driver_bytes(self, num_cores: int) -> float:
        """Memory of the driver: as measured, plus positions of transmitters and places, and two batches per core."""
        positions = self.num_tx * (24 + 24 + 1)
        window = 2 * num_cores * BATCH * self.batch_bytes
        return self.cost.with_maps.peak_memory_mib * (1 << 20) + positions + window

    def file_bytes(self, *, maps: bool) -> int:
        """Size of the finished file."""
        return replace(self.cost.header, num_tx=self.num_tx, maps=maps).num_bytes

    @property
    def cells(self) -> tuple[str, ...]:
        """A row of the table."""
        walls = (
            f"{_duration(self.wall_s(cores, maps=True))} / {_duration(self.wall_s(cores, maps=False))}"
            for cores in TABLED_CORES
        )
        return (
            f"{self.num_tx:,} × {len(self.cost.header.carrier_hz)}",
            f"{self.cpu_s / 3600:.3g}",
            *walls,
            _gb(self.driver_bytes(TABLED_CORES[-1])),
            _gb(self.cost.tracing.peak_memory_mib * (1 << 20)),
            f"{_gb(self.file_bytes(maps=True))} / {_gb(self.file_bytes(maps=False))}",
            _gb(self.num_tx * self.batch_bytes),
            _gb(self.file_bytes(maps=False)),
        )

    def points(self) -> Iterator[BenchPoint]:
        """Points of the figure: speed-up against number of cores."""
        for maps in (True, False):
            series = f"{len(self.cost.header.carrier_hz)} carriers, {'with' if maps else 'without'} maps"
            for cores in PLANNED_CORES:
                yield BenchPoint(
                    series=series, label=str(cores), x=float(cores), y=self.speed_up(cores, maps=maps)
                )


def tabulate_plans(bench: Bench, costs: dict[int, TransmitterCost]) -> None:
    """Print the estimates for many transmitters."""
    note = (
        "Extrapolated from the table of what a transmitter takes, not run: tracing divided by the cores, each as fast "
        "as one here; planning and writing in the one driver, which keeps batches while others trace. Measured: "
        f"times a transmitter and the memory of processes. Computed from the format: files, batches ({BATCH} "
        "transmitters in double precision), and what a reader loads at once (all but the maps). On many cores it is "
        f"the driver that takes the time. Its memory is that for {TABLED_CORES[-1]} cores. "
        "A reader's memory is that of every process that opens the file, each run of a method among them: split what "
        "does not fit there into several files by --tx-positions."
    )
    with bench.table("Planning large data sets", note, PLAN_COLUMNS, software_versions("image")) as table:
        points = list[BenchPoint]()
        for carriers in PLANNED_CARRIERS:
            for number in PLANNED_TX:
                expected = Expected(costs[carriers], number)
                table.add(*expected.cells)
            points += expected.points()
        table.figure = BenchFigure(
            x_label="cores that trace",
            y_label=f"speed-up over one core, {PLANNED_TX[-1]:,} transmitters",
            log_x=True,
            points=tuple(points),
        )


def _duration(seconds: float) -> str:
    """A duration in hours, minutes or seconds, whichever needs few digits."""
    for unit, length_s in (("h", 3600), ("min", 60)):
        if seconds >= 2 * length_s:
            return f"{seconds / length_s:.3g} {unit}"
    return f"{seconds:.3g} s"


def _gb(num_bytes: float) -> str:
    """A size in gigabytes."""
    number = num_bytes / 1e9
    return f"{number:.3g}" if number < 1000 else f"{number:,.0f}"


def office_plan(num_tx: int, carrier_hz: Sequence[float], has_maps: bool = True) -> Plan:
    """The generation that is measured: the office at the defaults."""
    return plan_generation(load_scene(SCENE), carrier_hz, num_transmitters=num_tx, maps=has_maps)


@cache
def paper_hz() -> tuple[float, ...]:
    """The paper's carriers in Hz."""
    return tuple(map(ghz_to_hz, PAPER_CARRIERS_GHZ))


def spread_hz(number: int) -> tuple[float, ...]:
    """Carriers in Hz, spread evenly over the logarithm of the paper's band."""
    low, *_, high = paper_hz()
    return tuple(np.geomspace(low, high, number).tolist())
