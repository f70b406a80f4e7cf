"""What `bench peers` prints: the paths of every solver compared, then time, error and memory, and how time grows."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
from jaxtyping import Complex, Float

from xfreqbench.bench.peers.differt import has_differt
from xfreqbench.bench.peers.solvers import BATCH, CONVERGED, CONVERGED_RAYS, RAYS, SOLVERS, panel_room, transmitters
from xfreqbench.bench.tables import Bench
from xfreqbench.errors import ClusterError, UnknownNameError, XFreqBenchError
from xfreqbench.runs.records import BenchFigure, BenchPoint
from xfreqbench.system.machine import peak_memory_mib, reset_peak_memory
from xfreqbench.system.processes import LocalProcesses, own_cores
from xfreqbench.tracing.image.tracer import MAX_MIRRORS
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import format_ghz

CARRIERS_HZ = (24.25e9,)
LEAST_TX = 3  # a solver that is too slow for more is timed on these, or on as many as fit into the time
TRIANGLES, NUM_TX = 40, 64
SAME_M = 1e-4  # a pair of paths whose lengths differ by less is one path in two solvers
MAX_ORDER = 6
OURS = "image"
OTHERS = tuple(name for name in SOLVERS if name not in (OURS, CONVERGED))


@dataclass(frozen=True)
class PeerTask:
    """What a solver is asked: a room and a number of reflections.

    It may run for `seconds` once it is warm, and is stopped after `limit_s` in all.
    """

    solver: str
    num_triangles: int
    order: int
    num_tx: int
    seconds: float
    carriers_hz: tuple[float, ...] = CARRIERS_HZ
    limit_s: float = 300.0


@dataclass(frozen=True)
class Measured:
    """What came out: seconds before the first answer, compilation included, and for each transmitter after it.

    `channel` and `lengths_m` are those of the first transmitters; lengths are to a single element at the centre.
    """

    setup_s: float
    tx_s: float
    peak_mib: float
    channel: Complex[NDArray[np.complex128], "T M"]
    lengths_m: Sequence[Float[FloatArray, "P"]]


Results = Mapping[tuple[int, str], Measured]


def measured(task: PeerTask) -> Measured | None:
    """Do a task in a new process that is kept to one core; None where it is stopped, or its process dies."""
    try:
        with LocalProcesses(own_cores()[:1], is_fresh=True) as processes:
            return processes.submit(_measured, task).result(task.limit_s)
    except (TimeoutError, ClusterError):
        return None


def _measured(task: PeerTask) -> Measured:
    positions_m = transmitters(task.num_tx)
    reset_peak_memory()
    start = time.perf_counter()
    solver = SOLVERS[task.solver](panel_room(task.num_triangles), task.carriers_hz, task.order)
    solver.channels(positions_m[:LEAST_TX])
    setup_s, start, num_solved = time.perf_counter() - start, time.perf_counter(), 0
    channels = []
    while num_solved < task.num_tx and time.perf_counter() - start < task.seconds:
        asked = positions_m[num_solved : num_solved + max(LEAST_TX, task.num_tx // 8)]
        channels.append(solver.channels(asked))
        num_solved += len(asked)
    tx_s, peak_mib = (time.perf_counter() - start) / num_solved, peak_memory_mib()
    single = SOLVERS[task.solver](panel_room(task.num_triangles, 1), task.carriers_hz, task.order)
    lengths_m = [single.lengths_m(position) for position in positions_m[:LEAST_TX]]
    return Measured(setup_s, tx_s, peak_mib, np.concatenate(channels), lengths_m)


def differences_db(
    channel: Complex[NDArray[np.complex128], "T M"], reference: Complex[NDArray[np.complex128], "R M"]
) -> Float[FloatArray, "N"]:
    """20·log₁₀ ‖h_ref‖ / ‖h − h_ref‖ of the transmitters that both have."""
    number = min(len(channel), len(reference))
    apart = np.linalg.norm(channel[:number] - reference[:number], axis=1)
    return 20 * np.log10(np.linalg.norm(reference[:number], axis=1) / np.maximum(apart, 1e-30))


def missed(
    lengths_m: Float[FloatArray, "P"], others_m: Float[FloatArray, "Q"], tolerance_m: float
) -> tuple[int, float]:
    """How many of the other paths have no partner of the same length here, and the largest difference of partners."""
    left, num_missed, largest = lengths_m.tolist(), 0, 0.0
    for length in others_m.tolist():
        nearest = min(left, key=lambda value: abs(value - length), default=np.inf)
        if abs(nearest - length) <= tolerance_m:
            left.remove(nearest)
            largest = max(largest, abs(nearest - length))
        else:
            num_missed += 1
    return num_missed, largest


def installed_peers() -> list[str]:
    """Every solver but `image` that can run here."""
    return [name for name in OTHERS if has_differt() or not name.startswith("DiffeRT")]


def bench_peers(bench: Bench, solvers: Sequence[str], orders: Sequence[int], seconds: float, limit_s: float) -> None:
    """Print how `solvers` compare with `image` for each number of reflections, and how the time of `image` grows.

    Each may run for `seconds` after its set-up and is stopped after `limit_s` in all; it is not asked for more
    reflections then. Raises `UnknownNameError` for a solver or `XFreqBenchError` where an extra is missing, before
    anything is timed.
    """
    for name in solvers:
        if name not in OTHERS:
            raise UnknownNameError("solver", name, list(OTHERS))
    if any(name.startswith("DiffeRT") for name in solvers) and not has_differt():
        raise XFreqBenchError('DiffeRT needs the extra "peers". Run: pip install "xfreqbench[peers]"')
    if not (seconds > 0 and limit_s > 0):
        raise XFreqBenchError(f"--seconds and --limit are seconds above 0, but {seconds:g} and {limit_s:g} are given.")
    bench.introduce()
    results: dict[tuple[int, str], Measured] = {}
    stopped: dict[str, int] = {}
    for order in sorted(orders):
        for solver in (OURS, CONVERGED, *solvers):
            if not stopped.keys() & {OURS, CONVERGED, solver}:  # all are compared with the first two
                found = measured(PeerTask(solver, TRIANGLES, order, NUM_TX, seconds, limit_s=limit_s))
                if found:
                    results[order, solver] = found
                else:
                    stopped[solver] = order
    _tabulate_paths(bench, results)
    names = ", ".join(f"`{solver}` with {order}" for solver, order in stopped.items())
    end = f" Stopped after {limit_s:g} s, or died, and not asked for more reflections: {names}."
    _tabulate_times(bench, results, end if stopped else "")
    _tabulate_growth(bench, seconds, limit_s)


def _tabulate_paths(bench: Bench, results: Results) -> None:
    note = (
        f"A room of {TRIANGLES} triangles; reflections alone, every surface opaque; {LEAST_TX} transmitters, one "
        f"element. Paths are the same if their lengths differ by at most {SAME_M:g} m. Missed: paths of `{OURS}` that "
        f"the solver has not; more: those that `{OURS}` has not. Solvers that shoot rays have {RAYS:,}."
    )
    columns = ("reflections", "solver", f"paths of {OURS}", "missed", "more", "greatest difference, m")
    with bench.table("Paths of the solvers", note, columns) as table:
        for (order, solver), result in results.items():
            pairs = list(zip(results[order, OURS].lengths_m, result.lengths_m, strict=True))
            if solver != OURS:
                found = [missed(theirs, ours, SAME_M) for ours, theirs in pairs]
                num_more = sum(missed(ours, theirs, SAME_M)[0] for ours, theirs in pairs)
                numbers = sum(len(ours) for ours, _ in pairs), sum(number for number, _ in found), num_more
                table.add(str(order), solver, *map(str, numbers), f"{max(apart for _, apart in found):.0e}")


def _tabulate_times(bench: Bench, results: Results, stopped: str) -> None:
    note = (
        f"The same room, an array of 4 × 4 elements at {format_ghz(CARRIERS_HZ[0])}, one core, each solver in a "
        f"process of its own; batched: {BATCH} transmitters a call. Set-up ends with the first answers, compilation "
        "included; DiffeRT compiles anew whenever the number of candidates changes, as it does from transmitter to "
        f"transmitter with `hybrid`. dB: channels against `{OURS}` with {CONVERGED_RAYS:,} rays, median over as many "
        f"of {NUM_TX} transmitters as were solved in the time. Paths a second: those to the array's centre, each with "
        f"its field at every element.{stopped}"
    )
    begin = "reflections", "solver", "set-up, s", "ms a transmitter"
    columns = (*begin, f"time : {OURS}", "paths a second", "dB", "peak MiB")
    with bench.table("Time of the solvers", note, columns) as table:
        points = []
        for (order, solver), result in results.items():
            if solver != CONVERGED and (order, CONVERGED) in results:
                ratio = result.tx_s / results[order, OURS].tx_s
                error_db = median(differences_db(result.channel, results[order, CONVERGED].channel).tolist())
                times = f"{result.setup_s:.2f}", f"{result.tx_s * 1e3:.3g}", f"{ratio:.3g}"
                paths_s = np.mean([len(lengths) for lengths in result.lengths_m]) / result.tx_s
                costs = f"{paths_s:,.3g}", f"{error_db:.0f}", f"{result.peak_mib:.0f}"
                table.add(str(order), solver, *times, *costs)
                points.append(BenchPoint(series=solver, label=str(order), x=1e3 * result.tx_s, y=order))
        table.figure = BenchFigure(x_label="ms a transmitter", y_label="reflections", log_x=True, points=tuple(points))


def _tabulate_growth(bench: Bench, seconds: float, limit_s: float) -> None:
    note = (
        f"3 reflections on one core; of triangles, transmitters and carriers one grows, the others stay "
        f"at {TRIANGLES}, {NUM_TX} and 1. Exponent: slope of the logarithm of the whole time after set-up over that of "
        f"the number, up to the row. `{OURS}` mirrors at {MAX_MIRRORS:,} triangles at most; for more `auto` takes "
        "`sionna`."
    )
    times = "set-up, s", "ms a transmitter", "ms a transmitter and carrier"
    columns = ("varied", "solver", "number", *times, "exponent", "peak MiB")
    with bench.table("Growth of the time", note, columns) as table:
        points = list[BenchPoint]()
        for varied, solver, numbers in (  # what is varied, for which solver
            ("triangles", OURS, (40, 100, 400, 1000)),  # MAX_MIRRORS is 1,000
            ("triangles", "sionna", (40, 400, 4000)),
            ("transmitters", OURS, (10, 100, 1000, 10_000)),
            ("carriers", OURS, (1, 10, 100)),
        ):
            totals_s = dict[int, float]()
            for number in numbers:
                size = {"triangles": TRIANGLES, "transmitters": NUM_TX, "carriers": 1, varied: number}
                carriers_hz = tuple(np.linspace(1e9, 94e9, size["carriers"])) if size["carriers"] > 1 else CARRIERS_HZ
                task = PeerTask(solver, size["triangles"], 3, size["transmitters"], seconds, carriers_hz, limit_s)
                result = measured(task)
                if result is None:  # what is greater would not end either
                    table.add(varied, solver, f"{number:,}", f"over {limit_s:g} in all", *["–"] * 4)
                    break
                totals_s[number] = result.tx_s * task.num_tx
                logs = np.log(list(totals_s)), np.log(list(totals_s.values()))
                exponent = f"{np.polyfit(*logs, 1)[0]:.2f}" if len(totals_s) > 1 else "–"
                tx_ms = 1e3 * result.tx_s
                times = f"{result.setup_s:.2f}", f"{tx_ms:.3g}", f"{tx_ms / len(task.carriers_hz):.3g}"
                table.add(varied, solver, f"{number:,}", *times, exponent, f"{result.peak_mib:.0f}")
                points.append(BenchPoint(series=f"{varied}, {solver}", label=f"{number:,}", x=number, y=tx_ms))
        table.figure = BenchFigure(
            x_label="number", y_label="ms a transmitter", log_x=True, points=tuple(points), x_is_cost=False
        )
