"""What `bench peers` prints: the paths of every solver compared, then time, error and memory, and how time grows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

import numpy as np

from xfreqbench.bench.peers.differt import require_differt
from xfreqbench.bench.peers.measure import (
    CARRIERS_HZ,
    LEAST_TX,
    Measured,
    PeerTask,
    differences_db,
    measured,
    missed,
)
from xfreqbench.bench.peers.solvers import BATCH, CONVERGED, CONVERGED_RAYS, RAYS, SOLVERS
from xfreqbench.bench.tables import Bench
from xfreqbench.errors import UnknownNameError
from xfreqbench.runs.records import BenchFigure, BenchPoint
from xfreqbench.units import format_ghz

TRIANGLES, NUM_TX = 40, 64
SAME_M = 1e-4  # a pair of paths whose lengths differ by less is one path in two solvers
MAX_ORDER = 6
GROWTH_ORDER = 3
TRIANGLE_COUNTS, TX_COUNTS, CARRIER_COUNTS = (40, 100, 200, 400, 800), (10, 100, 1000, 10_000), (1, 10, 100)
OURS = "image"
PATH_COLUMNS = ("reflections", "solver", f"paths of {OURS}", "missed", "more", "greatest difference, m")
TIME_COLUMNS = ("reflections", "solver", "set-up, s", "ms a transmitter", f": {OURS}", "dB", "peak MiB")
GROWTH_COLUMNS = (
    "varied",
    "number",
    "set-up, s",
    "ms a transmitter",
    "ms a transmitter and carrier",
    "exponent",
)
Results = Mapping[tuple[int, str], Measured]


def bench_peers(bench: Bench, solvers: Sequence[str], orders: Sequence[int], seconds: float) -> None:
    """Print how `solvers` compare with `image` for each number of reflections, and how the time of `image` grows.

    Each may run for that many seconds after its set-up. Raises `UnknownNameError` for a solver or `XFreqBenchError`
    where an extra is missing, before anything is timed.
    """
    others = [name for name in SOLVERS if name not in (OURS, CONVERGED)]
    for name in solvers:
        if name not in others:
            raise UnknownNameError("solver", name, others)
    if any(name.startswith("DiffeRT") for name in solvers):
        require_differt()
    bench.introduce()
    results = {
        (order, solver): measured(PeerTask(solver, TRIANGLES, order, NUM_TX, seconds))
        for order in orders
        for solver in (OURS, CONVERGED, *solvers)
    }
    _tabulate_paths(bench, results)
    _tabulate_times(bench, results)
    _tabulate_growth(bench, seconds)


def _tabulate_paths(bench: Bench, results: Results) -> None:
    note = (
        f"A room of {TRIANGLES} triangles; reflections alone, every surface opaque; {LEAST_TX} transmitters, one "
        f"element. Paths are the same if their lengths differ by at most {SAME_M:g} m. Missed: paths of `{OURS}` that "
        f"the solver has not; more: those that `{OURS}` has not. Solvers that shoot rays have {RAYS:,}."
    )
    with bench.table("Paths of the solvers", note, PATH_COLUMNS) as table:
        for (order, solver), result in results.items():
            pairs = list(zip(results[order, OURS].lengths_m, result.lengths_m, strict=True))
            if solver != OURS:
                found = [missed(theirs, ours, SAME_M) for ours, theirs in pairs]
                num_more = sum(missed(ours, theirs, SAME_M)[0] for ours, theirs in pairs)
                numbers = sum(len(ours) for ours, _ in pairs), sum(number for number, _ in found), num_more
                table.add(str(order), solver, *map(str, numbers), f"{max(apart for _, apart in found):.0e}")


def _tabulate_times(bench: Bench, results: Results) -> None:
    note = (
        f"The same room, an array of 4 × 4 elements at {format_ghz(CARRIERS_HZ[0])}, one core, each solver in a "
        f"process of its own; batched: {BATCH} transmitters a call. Set-up ends with the first answers, compilation "
        "included; DiffeRT compiles anew whenever the number of candidates changes, as it does from transmitter to "
        f"transmitter with `hybrid`. dB: channels against `{OURS}` with {CONVERGED_RAYS:,} rays, median over as many "
        f"of {NUM_TX} transmitters as were solved in the time."
    )
    with bench.table("Time of the solvers", note, TIME_COLUMNS) as table:
        for (order, solver), result in results.items():
            if solver != CONVERGED:
                ratio = result.tx_s / results[order, OURS].tx_s
                error_db = median(differences_db(result.channel, results[order, CONVERGED].channel).tolist())
                times = f"{result.setup_s:.2f}", f"{result.tx_s * 1e3:.3g}", f"{ratio:.3g}"
                table.add(str(order), solver, *times, f"{error_db:.0f}", f"{result.peak_mib:.0f}")


def _tabulate_growth(bench: Bench, seconds: float) -> None:
    note = (
        f"`{OURS}` with {GROWTH_ORDER} reflections on one core; of triangles, transmitters and carriers one grows, the "
        f"others stay at {TRIANGLES}, {NUM_TX} and 1. Exponent: slope of the logarithm of the whole time after set-up."
    )
    with bench.table("Growth of the time", note, GROWTH_COLUMNS) as table:
        points = []
        for varied, numbers in (
            ("triangles", TRIANGLE_COUNTS),
            ("transmitters", TX_COUNTS),
            ("carriers", CARRIER_COUNTS),
        ):
            totals_s: list[float] = []
            for number in numbers:
                task = _task(varied, number, seconds)
                result = measured(task)
                totals_s.append(result.tx_s * (number if varied == "transmitters" else 1))
                times_ms = 1e3 * result.tx_s, 1e3 * result.tx_s / len(task.carriers_hz)
                cells = f"{result.setup_s:.2f}", *(f"{each:.3g}" for each in times_ms)
                table.add(varied, f"{number:,}", *cells, _exponent(numbers[: len(totals_s)], totals_s))
                points.append(BenchPoint(series=varied, label=f"{number:,}", x=number, y=times_ms[0]))
        table.figure = BenchFigure(
            x_label="number", y_label="ms a transmitter", log_x=True, points=tuple(points)
        )


def _task(varied: str, number: int, seconds: float) -> PeerTask:
    triangles, num_tx, num_carriers = (
        number if varied == name else default
        for name, default in (("triangles", TRIANGLES), ("transmitters", NUM_TX), ("carriers", 1))
    )
    carriers_hz = tuple(np.linspace(1e9, 94e9, num_carriers)) if num_carriers > 1 else CARRIERS_HZ
    return PeerTask(OURS, triangles, GROWTH_ORDER, num_tx, seconds, carriers_hz)


def _exponent(numbers: Sequence[int], totals_s: Sequence[float]) -> str:
    if len(numbers) < 2:
        return "–"
    return f"{np.polyfit(np.log(numbers), np.log(totals_s), 1)[0]:.2f}"
