"""The call that workers make: the channels of some transmitters in a scene; each process shoots rays once."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.errors import ClusterError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import meshes_sha256
from xfreqbench.scene.model import PolarizationPair, Scene
from xfreqbench.system.cluster import differences
from xfreqbench.tracing.paths import Paths, RaggedPaths
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import Channel, Tracer, TraceSettings
from xfreqbench.tracing.versions import software_versions
from xfreqbench.types import FloatArray, NDArray


@dataclass(frozen=True)
class Tracing:
    """All that a worker needs to trace: equal if the channels are equal, and some kilobytes when pickled.

    `known_geometry` is the scene's geometry in the process that made the plan, so that it is built only once there.
    It is not pickled: another process reads the meshes itself. `paths` says whether paths are asked for. Every receiver
    of the scene is traced, at each pair of `polarizations`, or at that of the scene if there are none.
    """

    scene: Scene
    scene_sha256: str
    carrier_hz: tuple[float, ...]
    settings: TraceSettings
    paths: bool = False
    polarizations: tuple[PolarizationPair, ...] = ()
    known_geometry: Geometry | None = field(default=None, compare=False, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        fields = self.scene, self.scene_sha256, self.carrier_hz, self.settings, self.paths, self.polarizations
        return Tracing, fields

    @property
    def geometry(self) -> Geometry:
        """The scene's geometry; raises `ClusterError` if a worker finds other meshes than planned."""
        if self.known_geometry is not None:
            return self.known_geometry
        geometry = Geometry.of(self.scene)
        if meshes_sha256(geometry.meshes) != self.scene_sha256:
            raise ClusterError(
                f"A worker on {platform.node()} finds other meshes of scene {self.scene.name!r} in "
                f"{self.scene.folder}. Keep them on a file system that all workers share."
            )
        return geometry


def traced(
    tracing: Tracing, batch: tuple[int, Float[FloatArray, "T 3"]], software: Mapping[str, str] | None = None
) -> Channel:
    """Channel of a batch of transmitters, with the paths if they are asked for.

    An axis of receivers and one of pairs of polarizations follow the transmitters, if there are several. The batch's
    index is for the caller, who finds the result by it. A driver in another process gives its versions of `software`:
    raises `ClusterError` if this process has others.
    """
    if software is not None and (differing := differences(software, _software(tracing.settings.solver))):
        raise ClusterError(
            f"A worker on {platform.node()} traces with other software: {differing}. Install the same versions on both."
        )
    tracers = _tracers(tracing)
    _, tx_position_m = batch
    found = [[tracer.channel(tx_position_m) for tracer in of_receiver] for of_receiver in tracers]
    counts = [len(tracers)] * (len(tracers) > 1) + [len(tracers[0])] * (len(tracers[0]) > 1)

    def joined(name: str) -> NDArray[Any]:
        """A field of the channels, with the axes transmitters, links, and its own."""
        of_links = np.moveaxis(np.array([[getattr(channel, name) for channel in row] for row in found]), 2, 0)
        return of_links.reshape(len(tx_position_m), *counts, *of_links.shape[3:])

    channel = Channel(joined("cfr"), joined("num_paths"))
    if not tracing.paths:
        return channel
    receivers_m = np.array([receiver.position_m for receiver in tracing.scene.receivers], dtype=np.float64)
    paths = [Paths.joined([tracer.paths(at) for tracer in row]) for at in tx_position_m for row in tracers]
    ends = np.repeat(tx_position_m, len(tracers), axis=0), np.tile(receivers_m, (len(tx_position_m), 1))
    ragged = RaggedPaths.of(paths, *ends)
    gain = ragged.gain.reshape(len(ragged.gain), *counts[len(tracers) > 1 :], len(tracing.carrier_hz))
    return replace(channel, paths=replace(ragged, gain=gain))


def forget_rays() -> None:
    """Free the rays that this process has shot; in a worker they stay for the next batch."""
    _tracers.cache_clear()


_software = cache(software_versions)


@lru_cache(maxsize=1)
def _tracers(tracing: Tracing) -> list[list[Tracer]]:
    """A tracer for each pair of polarizations of every receiver: those of one receiver share what rays have found."""
    geometry, tracers = tracing.geometry, []
    for receiver in tracing.scene.receivers:
        scene = replace(tracing.scene, receiver=receiver, other_receivers=())
        first, *others = [scene.with_polarization(pair) for pair in tracing.polarizations] or [scene]
        tracer = tracer_of(first, tracing.carrier_hz, tracing.settings, geometry)
        tracers.append([tracer, *map(tracer.with_antennas, others)])
    return tracers
