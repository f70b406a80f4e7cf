"""Solvers in one form: made for a scene, carriers and a number of reflections, then asked for any transmitter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np
from jaxtyping import Complex, Float

from xfreqbench.bench.peers.differt import DiffeRTSolver
from xfreqbench.errors import XFreqBenchError
from xfreqbench.scene.model import ReceiverArray, Scene, Surface
from xfreqbench.tracing.sionna import plain
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import Interaction, SolverName, TraceSettings
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

RAYS = 1_000_000  # of solvers that shoot them
CONVERGED_RAYS = 8_000_000
SPECULAR_ALONE: tuple[Interaction, ...] = ("specular",)
BATCH = 8  # transmitters of one batched call
Channels = Complex[NDArray[np.complex128], "T FM"]
ROOM_M = (8.0, 6.0, 3.0)
_RECEIVER_M = (4.1, 2.9, 2.7)
_MARGIN_M = 0.3  # of panels and transmitters from the walls; panels hang below the receiver


class PeerSolver(Protocol):
    """Specular reflections alone, each surface opaque."""

    def channels(self, tx_position_m: Float[FloatArray, "T 3"]) -> Channels:
        """Channel of T transmitters at F carriers and M elements, which stand in one axis."""
        ...

    def lengths_m(self, tx_position_m: Float[FloatArray, "3"]) -> Float[FloatArray, "P"]:
        """Lengths of the paths of one transmitter to the first element, ascending."""
        ...


class OurSolver:
    """One of this package."""

    def __init__(
        self, scene: Scene, carriers_hz: Sequence[float], order: int, solver: SolverName = "image", rays: int = RAYS
    ) -> None:
        settings = TraceSettings(solver=solver, interactions=SPECULAR_ALONE, max_depth=order, rays=rays)
        self._tracer = tracer_of(scene, carriers_hz, settings)

    def channels(self, tx_position_m: Float[FloatArray, "T 3"]) -> Channels:
        """As `PeerSolver` says."""
        return self._tracer.channel(tx_position_m).cfr.reshape(len(tx_position_m), -1)

    def lengths_m(self, tx_position_m: Float[FloatArray, "3"]) -> Float[FloatArray, "P"]:
        """As `PeerSolver` says, to the array's centre."""
        return np.sort(self._tracer.paths(tx_position_m).delay_s * SPEED_OF_LIGHT_M_S)


class PathSolver:
    """Sionna RT by its public interface at one carrier, one call for `batch` transmitters."""

    def __init__(
        self, scene: Scene, carriers_hz: Sequence[float], order: int, batch: int = 1, rays: int = RAYS
    ) -> None:
        (carrier_hz,) = carriers_hz
        self._scene = plain.loaded(scene, carrier_hz)
        self._order, self._batch, self._rays = order, batch, rays

    def channels(self, tx_position_m: Float[FloatArray, "T 3"]) -> Channels:
        """As `PeerSolver` says."""
        starts = range(0, len(tx_position_m), self._batch)
        found = [self._paths(tx_position_m[start : start + self._batch]) for start in starts]
        gains = [paths.cir(normalize_delays=False, out_type="numpy")[0] for paths in found]
        # each of shape (1, M, T, 1, paths, 1), summed over its paths
        return np.concatenate([np.asarray(gain, np.complex128).sum(axis=(0, 3, 4, 5)).T for gain in gains])

    def lengths_m(self, tx_position_m: Float[FloatArray, "3"]) -> Float[FloatArray, "P"]:
        """As `PeerSolver` says."""
        delay_s = self._paths(tx_position_m[None]).cir(normalize_delays=False, out_type="numpy")[1]
        first = np.asarray(delay_s, np.float64)[0, 0, 0, 0]
        return np.sort(first[first > 0] * SPEED_OF_LIGHT_M_S)

    def _paths(self, tx_position_m: Float[FloatArray, "T 3"]) -> Any:
        return plain.solve(self._scene, tx_position_m, SPECULAR_ALONE, self._order, self._rays, seed=1)


CONVERGED = "image, converged"
SOLVERS: dict[str, Callable[[Scene, Sequence[float], int], PeerSolver]] = {
    "image": OurSolver,
    CONVERGED: partial(OurSolver, rays=CONVERGED_RAYS),
    "sionna": partial(OurSolver, solver="sionna"),
    "PathSolver": PathSolver,
    "PathSolver-batched": partial(PathSolver, batch=BATCH),
    "DiffeRT-exhaustive": partial(DiffeRTSolver, candidates="exhaustive"),
    "DiffeRT-hybrid": partial(DiffeRTSolver, candidates="hybrid"),
}


def panel_room(num_triangles: int, num_elements_a_side: int = 4) -> Scene:
    """A room of `num_triangles` triangles, an even number from 12 on: six walls, and panels in random places.

    Walls and panels are rectangles along the axes; panels may cross each other. Raises `XFreqBenchError`.
    """
    if num_triangles < 12 or num_triangles % 2:
        raise XFreqBenchError(f"A room of rectangles has 12, 14, 16, … triangles, but {num_triangles} are asked for.")
    surfaces = list[Surface]()
    for axis in range(3):
        for side in (0.0, ROOM_M[axis]):
            low_m, high_m = np.zeros(3), np.array(ROOM_M)
            low_m[axis] = high_m[axis] = side
            surfaces.append(_rectangle(f"wall {len(surfaces)}", low_m, high_m))
    rng = np.random.default_rng(0)
    for number in range((num_triangles - 12) // 2):
        size_m = rng.uniform(0.3, 1.2, 3)
        size_m[rng.integers(3)] = 0.0
        highest_m = np.array([ROOM_M[0], ROOM_M[1], _RECEIVER_M[2]]) - _MARGIN_M - size_m
        low_m = rng.uniform(np.full(3, _MARGIN_M), highest_m)
        surfaces.append(_rectangle(f"panel {number}", low_m, low_m + size_m))
    return Scene(
        name=f"room of {num_triangles} triangles",
        receiver=ReceiverArray(_RECEIVER_M, rows=num_elements_a_side, cols=num_elements_a_side),
        surface=tuple(surfaces),
    )


def transmitters(number: int) -> Float[FloatArray, "T 3"]:
    """Random positions in the room."""
    low, high = np.full(3, _MARGIN_M), np.array(ROOM_M) - _MARGIN_M
    return np.random.default_rng(1).uniform(low, high, (number, 3))


def _rectangle(name: str, low_m: Float[FloatArray, "3"], high_m: Float[FloatArray, "3"]) -> Surface:
    # so thick that nothing comes through
    return Surface(name, "concrete", 1.0, tuple(low_m.tolist()), tuple(high_m.tolist()))
