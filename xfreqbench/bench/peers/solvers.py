"""Solvers in one form: made for a scene, carriers and a number of reflections, then asked for any transmitter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from xfreqbench.bench.peers.differt import DiffeRTSolver
from xfreqbench.scene.model import Scene
from xfreqbench.tracing.sionna import plain
from xfreqbench.tracing.solvers import make_tracer
from xfreqbench.tracing.tracer import Interaction, SolverName, TraceSettings
from xfreqbench.types import FloatArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

RAYS = 1_000_000  # of solvers that shoot them
CONVERGED_RAYS = 8_000_000
SPECULAR_ALONE: tuple[Interaction, ...] = ("specular",)
BATCH = 16  # transmitters of one batched call
Channels = Complex[NDArray[np.complex128], "T FM"]


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
        self,
        scene: Scene,
        carriers_hz: Sequence[float],
        order: int,
        solver: SolverName = "image",
        rays: int = RAYS,
    ) -> None:
        settings = TraceSettings(solver=solver, interactions=SPECULAR_ALONE, max_depth=order, rays=rays)
        self._tracer = make_tracer(scene, carriers_hz, settings)

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
        return np.concatenate([_channels(paths) for paths in found])

    def lengths_m(self, tx_position_m: Float[FloatArray, "3"]) -> Float[FloatArray, "P"]:
        """As `PeerSolver` says."""
        delay_s = self._paths(tx_position_m[None]).cir(normalize_delays=False, out_type="numpy")[1]
        first = np.asarray(delay_s, np.float64)[0, 0, 0, 0]
        return np.sort(first[first > 0] * SPEED_OF_LIGHT_M_S)

    def _paths(self, tx_position_m: Float[FloatArray, "T 3"]) -> Any:
        return plain.solve(self._scene, tx_position_m, SPECULAR_ALONE, self._order, self._rays, seed=1)


def _channels(paths: Any) -> Channels:
    """Sums over paths of gains (1, M, T, 1, paths, 1)."""
    gain, _ = paths.cir(normalize_delays=False, out_type="numpy")
    return np.asarray(gain, np.complex128).sum(axis=(0, 3, 4, 5)).T


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
