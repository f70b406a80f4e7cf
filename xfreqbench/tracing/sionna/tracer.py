"""Solver `sionna`: channels of any triangle mesh by Sionna RT."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.materials import check_dispersion
from xfreqbench.scene.model import Scene
from xfreqbench.system.arguments import Position, Positions, checked
from xfreqbench.tracing.paths import Paths
from xfreqbench.tracing.sionna.field import Field
from xfreqbench.tracing.sionna.forward import ForwardRays
from xfreqbench.tracing.sionna.receiver import ReceiverRays
from xfreqbench.tracing.sionna.scene import RadioScene
from xfreqbench.tracing.tracer import Channel, TraceSettings
from xfreqbench.types import FloatArray


class SionnaTracer:
    """Sionna RT on one scene, ready for any transmitter: a `Tracer`.

    With reflections and refraction alone, rays are shot once from the receiver and serve every transmitter and
    carrier. With diffraction or diffuse reflection, which Sionna does not treat reciprocally, they are
    shot from each transmitter at each carrier, which is some fifty times slower.

    Every element of the array is solved at its own position. On one machine with the same libraries, the same
    seed gives the same channel to the last bit, whichever other transmitters are asked for with it. Sionna RT is in
    single precision: it gets coordinates that count from `ReceiverArray.local_origin_m`.
    Raises `MaterialBandError` before any ray is
    shot; the import of this module raises `MissingLLVMError` where there is no LLVM library.
    """

    def __init__(
        self,
        scene: Scene,
        carrier_hz: Sequence[float] | Float[FloatArray, "F"],
        settings: TraceSettings,
        geometry: Geometry | None = None,
    ) -> None:
        carriers, settings = np.asarray(carrier_hz, dtype=np.float64), settings.by("sionna")
        receiver, meshes = scene.receiver, (geometry or Geometry.of(scene)).meshes
        check_dispersion([mesh.slab.homogeneous for mesh in meshes], carriers.tolist(), settings.materials)
        is_one_way = frozenset({"diffraction", "diffuse"}) & set(settings.named_interactions)
        shooting: type[ForwardRays | ReceiverRays] = ForwardRays if is_one_way else ReceiverRays
        self._origin_m = receiver.local_origin_m
        x, y, z = (receiver.position_m - self._origin_m).tolist()
        moved = [replace(mesh, vertices_m=mesh.vertices_m - self._origin_m) for mesh in meshes]
        radio_scene = RadioScene(moved, settings.materials)
        moved_receiver, antenna = replace(receiver, position_m=(x, y, z)), scene.transmitter_antenna
        self._rays = shooting(radio_scene, moved_receiver, antenna, carriers, settings)

    def with_antennas(self, scene: Scene) -> SionnaTracer:
        """A tracer of a scene that differs in its antennas alone, which shares the rays that were shot."""
        other = copy(self)
        other._rays = copy(self._rays)
        other._rays.field = Field(self._rays.radio_scene, scene.transmitter_antenna, scene.receiver.antenna)
        return other

    @checked
    def channel(self, tx_position_m: Positions) -> Channel:
        """Channel (T, F, M) of T transmitters at the array's elements, and the number of paths (T, F)."""
        return self._rays.channel(tx_position_m - self._origin_m)

    @checked
    def paths(self, tx_position_m: Position) -> Paths:
        """Paths of one transmitter to the array centre, the earliest first."""
        paths = self._rays.paths(tx_position_m - self._origin_m)
        return replace(paths, vertices_m=paths.vertices_m - (0.0 - self._origin_m))  # which leaves −0 as it is
