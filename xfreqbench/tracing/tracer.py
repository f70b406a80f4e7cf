"""The interface of the solvers: what is asked of the rays, and what comes back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol, get_args, runtime_checkable

import numpy as np
from jaxtyping import Complex, Float, Int

from xfreqbench.scene.materials import MaterialPolicy
from xfreqbench.scene.model import Scene
from xfreqbench.tracing.paths import Paths, RaggedPaths
from xfreqbench.types import FloatArray, NDArray

Interaction = Literal["specular", "refraction", "diffraction", "diffuse"]
INTERACTIONS: tuple[Interaction, ...] = get_args(Interaction)
SolverName = Literal["auto", "image", "sionna"]
MAX_DEPTH, MAX_RAYS = 16, 10_000_000  # with both at once, paths fill some gigabytes of memory
MAX_DIFFUSE_PATHS = 4_000_000  # each ray may leave one at each depth, of some 300 bytes
MAX_SEED = 2**32 - 1  # Sionna's are of 32 bits
WITHOUT_DIFFRACTION: tuple[Interaction, ...] = ("specular", "refraction")


@dataclass(frozen=True)
class TraceSettings:
    """What is asked of the rays. With the defaults channels have converged (`xfreqbench bench generate`).

    `interactions` that are None are those of ground truth: specular reflection and refraction, and with solver `image`
    diffraction. `max_depth` counts reflections and transmissions together; `rays` is the number shot in all;
    `materials` says what happens at carriers at which ITU-R P.2040 does not define a material.
    """

    solver: SolverName = "auto"
    interactions: tuple[Interaction, ...] | None = None
    max_depth: int = 6
    rays: int = 500_000
    seed: int = 1
    materials: MaterialPolicy = "error"

    def by(self, solver: SolverName) -> TraceSettings:
        """These settings with a solver, and its interactions by name."""
        asked = replace(self, solver=solver)
        return replace(asked, interactions=asked.named_interactions)

    @property
    def named_interactions(self) -> tuple[Interaction, ...]:
        """The interactions, where they are None those of ground truth by name.

        By Sionna RT that is without diffraction, which there is neither reciprocal nor continuous, and a hundred times
        as slow.
        """
        if self.interactions is not None:
            return self.interactions
        return WITHOUT_DIFFRACTION if self.solver == "sionna" else (*WITHOUT_DIFFRACTION, "diffraction")


@dataclass(frozen=True)
class Channel:
    """The channel of T transmitters at F carriers and M array elements, and the number of its paths.

    `cfr` is h_n(f) of Eq. (1), the received over the transmitted complex amplitude, time running as exp(+j2πft):
    |h|² is received over transmitted power. `num_paths` counts the paths that reach at least one element. `paths`
    are those to the array centre, where they were asked for. A tracer gives that of one receiver; that of several
    links of a file has their axes, receivers and pairs of polarizations, behind the transmitters.
    """

    cfr: Complex[NDArray[np.complex128], "T *L F M"]
    num_paths: Int[NDArray[np.int32], "T *L F"]
    paths: RaggedPaths | None = None


@runtime_checkable
class Tracer(Protocol):
    """A scene whose rays have been shot; for transmitters and carriers they need only be evaluated."""

    def channel(self, tx_position_m: Float[FloatArray, "T 3"]) -> Channel:
        """Channel (T, F, M) of T transmitters at the array's elements, and the number of paths (T, F)."""
        ...

    def paths(self, tx_position_m: Float[FloatArray, "3"]) -> Paths:
        """Paths of one transmitter to the array centre, the earliest first."""
        ...

    def with_antennas(self, scene: Scene) -> Tracer:
        """A tracer of a scene that differs in its antennas alone, which shares what was found of the scene's rays."""
        ...
