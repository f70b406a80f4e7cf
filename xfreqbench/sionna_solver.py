"""Solver `sionna`: channels of any triangle mesh by Sionna RT."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from xfreqbench.angles import FloatArray
from xfreqbench.materials import check_dispersion
from xfreqbench.mesh import surface_meshes
from xfreqbench.paths import Paths
from xfreqbench.scene import Scene
from xfreqbench.sionna_forward import ForwardRays
from xfreqbench.sionna_receiver import ReceiverRays
from xfreqbench.sionna_scene import RadioScene
from xfreqbench.tracing import Channel, TraceSettings

ONE_WAY = frozenset({"diffraction", "diffuse"})


class SionnaTracer:
    """Rays of one scene, ready for any transmitter: a `Tracer`.

    With reflections and refraction rays are shot once from the receiver and serve every transmitter and
    carrier. With diffraction or diffuse reflection, which Sionna does not treat reciprocally, they are
    shot from each transmitter at each carrier: some fifty times slower.

    Every element of the array is solved at its own position. The same seed gives the same channel to the
    last bit on the same machine and libraries, whichever other transmitters are asked for with it.
    Raises `MaterialBandError` before any ray is shot, and `MissingLLVMError` on import of this module.
    """

    def __init__(
        self, scene: Scene, carrier_hz: Sequence[float] | Float[FloatArray, "F"], settings: TraceSettings
    ) -> None:
        carriers = np.asarray(carrier_hz, dtype=np.float64)
        meshes = surface_meshes(scene)
        check_dispersion([mesh.material for mesh in meshes], carriers.tolist(), settings.materials)
        shooting = ForwardRays if ONE_WAY & set(settings.interactions) else ReceiverRays
        self._rays = shooting(RadioScene(meshes, settings.materials), scene.receiver, carriers, settings)

    def channel(self, tx_position_m: Float[FloatArray, "T 3"]) -> Channel:
        """Channel of transmitters at the array's elements."""
        return self._rays.channel(tx_position_m)

    def paths(self, tx_position_m: Float[FloatArray, "3"]) -> Paths:
        """Paths of one transmitter to the array centre, the earliest first."""
        return self._rays.paths(tx_position_m)
