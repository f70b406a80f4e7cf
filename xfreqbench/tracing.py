"""One interface over the solvers: what is asked of rays, what comes back, and which solver serves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, get_args, runtime_checkable

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.materials import MaterialPolicy
from xfreqbench.paths import Paths

Interaction = Literal["specular", "refraction", "diffraction", "diffuse"]
INTERACTIONS: tuple[Interaction, ...] = get_args(Interaction)
SolverName = Literal["auto", "image", "sionna"]


@dataclass(frozen=True)
class TraceSettings:
    """What is asked of the rays; the defaults are the converged ones of `xfreqbench bench generate`."""

    solver: SolverName = "auto"
    interactions: tuple[Interaction, ...] = ("specular", "refraction")
    max_depth: int = 6
    rays: int = 500_000
    seed: int = 1
    materials: MaterialPolicy = "error"


@dataclass(frozen=True)
class Channel:
    """The channel of T transmitters at F carriers and M elements, with the number of paths behind it.

    `cfr` is h_n(f) of Eq. (1), time running as exp(+j2πft), one transmitted volt per received volt.
    `num_paths` counts the paths that reach at least one element.
    """

    cfr: Complex[NDArray[np.complex128], "T F M"]
    num_paths: Int[NDArray[np.int32], "T F"]


@runtime_checkable
class Tracer(Protocol):
    """A scene whose rays have been shot: every transmitter and carrier is a matter of evaluation."""

    def channel(self, tx_position_m: Float[FloatArray, "T 3"]) -> Channel:
        """Channel of transmitters at the array's elements."""
        ...

    def paths(self, tx_position_m: Float[FloatArray, "3"]) -> Paths:
        """Paths of one transmitter to the array centre."""
        ...
