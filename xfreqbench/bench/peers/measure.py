"""One solver timed in a process of its own, on one core: what it finds, how long it takes, and how much memory."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from xfreqbench.bench.peers.rooms import panel_room, transmitters
from xfreqbench.errors import ClusterError
from xfreqbench.system.machine import peak_memory_mib, reset_peak_memory
from xfreqbench.system.workers import LocalProcesses, own_cores
from xfreqbench.types import FloatArray

CARRIERS_HZ = (24.25e9,)
LEAST_TX = 3  # a solver that is too slow for more is timed on these, or on as many as fit into the time


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


def measured(task: PeerTask) -> Measured | None:
    """Do a task in a new process that is kept to one core; None where it is stopped, or its process dies."""
    try:
        with LocalProcesses(own_cores()[:1], is_fresh=True) as processes:
            return processes.submit(_measured, task).result(task.limit_s)
    except (TimeoutError, ClusterError):
        return None


def _measured(task: PeerTask) -> Measured:
    from xfreqbench.bench.peers.solvers import SOLVERS

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
        nearest = min(left, key=lambda each: abs(each - length), default=np.inf)
        if abs(nearest - length) <= tolerance_m:
            left.remove(nearest)
            largest = max(largest, abs(nearest - length))
        else:
            num_missed += 1
    return num_missed, largest
