"""The call that workers make: the channels of some transmitters in a scene whose rays are shot once a process."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.errors import ClusterError, XFreqBenchError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import meshes_sha256
from xfreqbench.scene.model import Scene
from xfreqbench.scene.prepared import PreparedScene
from xfreqbench.system.cluster import UnfitWorkerError, differences
from xfreqbench.tracing.paths import RaggedPaths
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import Channel, Tracer, TraceSettings
from xfreqbench.tracing.versions import software_versions
from xfreqbench.types import FloatArray


@dataclass(frozen=True)
class Tracing:
    """What a worker has to know to trace: equal where the channels are equal, and some kilobytes when pickled.

    `known_geometry` is the scene's geometry in the process that made the plan, so that it is built once there.
    It is not pickled: another process reads the meshes itself. `paths` says whether paths are asked for.
    """

    scene: Scene
    scene_sha256: str
    carrier_hz: tuple[float, ...]
    settings: TraceSettings
    paths: bool = False
    known_geometry: Geometry | None = field(default=None, compare=False, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        return Tracing, (self.scene, self.scene_sha256, self.carrier_hz, self.settings, self.paths)

    def prepared(self) -> PreparedScene:
        """The scene with its geometry; raises `ClusterError` where a worker finds other meshes than planned."""
        if self.known_geometry is not None:
            return PreparedScene(self.scene, self.known_geometry)
        prepared = PreparedScene.of(self.scene)
        if meshes_sha256(prepared.geometry.meshes) != self.scene_sha256:
            raise ClusterError(
                f"A worker on {platform.node()} finds other meshes of scene {self.scene.name!r} in "
                f"{self.scene.folder}. Keep them on a file system that all workers share."
            )
        return prepared


def traced(tracing: Tracing, batch: tuple[int, Float[FloatArray, "T 3"]]) -> Channel:
    """Channel of a batch of transmitters; the batch's index is for the caller, who finds the result by it."""
    _, tx_position_m = batch
    return channel_by(_tracer(tracing), tracing, tx_position_m)


def traced_alike(tracing: Tracing, software: Mapping[str, str], batch: tuple[int, Float[FloatArray, "T 3"]]) -> Channel:
    """As `traced`, for a driver with some versions of software.

    Raises `UnfitWorkerError` where this process has others, or cannot prepare the scene, which the driver could.
    """
    if differing := differences(software, _software(tracing.settings.solver)):
        raise UnfitWorkerError(f"traces with other software: {differing}.")
    try:
        _tracer(tracing)
    except XFreqBenchError as error:
        raise UnfitWorkerError(f"cannot prepare scene {tracing.scene.name!r}: {error}") from error
    return traced(tracing, batch)


_software = cache(software_versions)


def channel_by(tracer: Tracer, tracing: Tracing, tx_position_m: Float[FloatArray, "T 3"]) -> Channel:
    """Channel of T transmitters by a tracer of that scene, with the paths where they are asked for."""
    channel = tracer.channel(tx_position_m)
    if not tracing.paths:
        return channel
    paths = [tracer.paths(position_m) for position_m in tx_position_m]
    receiver_m = np.asarray(tracing.scene.receiver.position_m, dtype=np.float64)
    return replace(channel, paths=RaggedPaths.of(paths, tx_position_m, receiver_m))


def forget_rays() -> None:
    """Free the rays that this process has shot; in a worker they stay for the next batch."""
    _tracer.cache_clear()


@lru_cache(maxsize=1)
def _tracer(tracing: Tracing) -> Tracer:
    return tracer_of(tracing.prepared(), tracing.carrier_hz, tracing.settings)
