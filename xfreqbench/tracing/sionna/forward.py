"""Diffracted and diffusely reflected paths by Sionna RT, shot from each transmitter.

Sionna's diffraction is not reciprocal (2.2.0: the gain of a reversed path differs by 0.74 in the median),
and a diffuse path is found for one transmitter only. So nothing is shared here between transmitters, and
little between carriers. It is as slow as one public call for each transmitter and carrier.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from xfreqbench.scene.model import Antenna, ReceiverArray
from xfreqbench.tracing.paths import Paths
from xfreqbench.tracing.sionna.field import Rays, path_interactions, with_travel_phase
from xfreqbench.tracing.sionna.scene import RadioScene, dr, point3f, roomy_hash_table, rt
from xfreqbench.tracing.tracer import MAX_DIFFUSE_PATHS, Channel, TraceSettings
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

Generator = rt.path_solvers.sb_deterministic.SBDeterministicCandidateGenerator

MAX_LANES = 30_000_000  # rays × depth × targets in one call of the deterministic generator: about 1.5 GB


class ForwardRays(Rays):
    """Rays of one scene, shot again for every transmitter and carrier, with each array element a target.

    A diffuse path stands for all directions into which its ray might have been scattered: its gain holds the solid
    angle 4π/rays, over the probability that the ray took this way, so that the sum of powers does not depend on
    the number of rays. All elements see the same points of the surfaces, so that the field is coherent between them.
    """

    def __init__(
        self,
        radio_scene: RadioScene,
        receiver: ReceiverArray,
        transmitter: Antenna,
        carrier_hz: Float[FloatArray, "F"],
        settings: TraceSettings,
    ) -> None:
        super().__init__(radio_scene, receiver, transmitter, carrier_hz)
        self.settings = settings
        self._diffraction = "diffraction" in settings.named_interactions
        self._diffuse = "diffuse" in settings.named_interactions

    def channel(self, tx_position_m: Float[FloatArray, "T 3"]) -> Channel:
        """Channel (T, F, M) at every element's own position, and the number of paths (T, F)."""
        shape = len(tx_position_m), len(self.carrier_hz), self.receiver.num_elements
        cfr = np.zeros(shape, dtype=np.complex128)
        num_paths = np.zeros(shape[:2], dtype=np.int32)
        for row, position_m in enumerate(tx_position_m):
            for column, carrier in enumerate(self.carrier_hz.tolist()):
                cfr[row, column], num_paths[row, column] = self._channel_at(carrier, position_m[None, :])
        return Channel(cfr, num_paths)

    def paths(self, tx_position_m: Float[FloatArray, "3"]) -> Paths:
        """Paths to the array centre, the earliest first.

        They are sampled with the materials of the lowest carrier. Gains of diffuse paths are weighted by the
        probabilities of that sampling, so that the mean of their powers is right at the other carriers too.
        """
        tx, centre = tx_position_m[None, :], np.array([self.receiver.position_m])
        buffer = self._trace(float(self.carrier_hz.min()), tx, centre)
        gain = [self._gains(carrier, buffer, tx, centre) for carrier in self.carrier_hz.tolist()]
        interactions, vertices_m = path_interactions(buffer, max(1, self.settings.max_depth))
        length_m = _lengths_m(vertices_m, tx[0], np.repeat(centre, len(vertices_m), axis=0))
        arrival = _arrivals(vertices_m, tx[0], centre[0])
        return self.sorted_paths(buffer, gain, length_m, arrival, interactions, vertices_m)

    def _channel_at(
        self, carrier_hz: float, tx: Float[FloatArray, "1 3"]
    ) -> tuple[Complex[NDArray[np.complex128], "M"], int]:
        """Channel of one transmitter, and the largest number of paths to one element."""
        element_m = self.receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz)
        cfr = np.zeros(len(element_m), dtype=np.complex128)
        num_paths = np.zeros(len(element_m), dtype=np.int64)
        lanes = self.settings.rays * max(1, self.settings.max_depth)
        step = max(1, (MAX_DIFFUSE_PATHS if self._diffuse else MAX_LANES) // lanes)
        for start in range(0, len(element_m), step):
            target_m = element_m[start : start + step]
            buffer = self._trace(carrier_hz, tx, target_m)
            gain = self._gains(carrier_hz, buffer, tx, target_m)
            element = buffer.target_indices.numpy().astype(np.int64)
            _, vertices_m = path_interactions(buffer, max(1, self.settings.max_depth))
            length_m = _lengths_m(vertices_m, tx[0], target_m[element])
            np.add.at(cfr, start + element, with_travel_phase(gain, length_m, carrier_hz))
            np.add.at(num_paths, start + element, gain != 0)
        return cfr, int(num_paths.max())

    def _trace(self, carrier_hz: float, tx: Float[FloatArray, "1 3"], target_m: FloatArray) -> Any:
        """Buffer of the paths of one transmitter, sampled with the materials of one carrier."""
        self.radio_scene.set_carrier(carrier_hz)
        with roomy_hash_table():
            buffer = self._candidates(tx, target_m)
        self.field.find_paths(buffer, tx, target_m, self._diffraction)
        return buffer

    def _candidates(self, tx: Float[FloatArray, "1 3"], target_m: FloatArray) -> Any:
        interactions = self.settings.named_interactions
        num_diffuse = len(target_m) * self.settings.rays * self.settings.max_depth if self._diffuse else 0
        buffer = Generator()(
            mi_scene=self.radio_scene.mitsuba,
            src_positions=point3f(tx),
            tgt_positions=point3f(target_m),
            samples_per_src=self.settings.rays,
            max_num_paths_per_src=1_000_000 + num_diffuse,
            max_depth=self.settings.max_depth,
            los=True,
            specular_reflection="specular" in interactions,
            diffuse_reflection="diffuse" in interactions,
            refraction="refraction" in interactions,
            diffraction=self._diffraction,
            edge_diffraction=False,
            seed=self.settings.seed,
        )
        buffer.schedule()
        dr.eval()
        buffer.shrink()
        buffer.detach_geometry()
        return buffer

    def _gains(
        self, carrier_hz: float, buffer: Any, tx: FloatArray, target_m: FloatArray
    ) -> Complex[NDArray[np.complex128], "P"]:
        return self.field.gains(carrier_hz, buffer, tx, target_m, self._diffraction, self.settings.rays)


def _lengths_m(
    vertices_m: Float[FloatArray, "P D 3"], tx_m: Float[FloatArray, "3"], target_m: Float[FloatArray, "P 3"]
) -> Float[FloatArray, "P"]:
    """Lengths in metres of paths through their vertices, in double precision; NaN vertices count as the target."""
    filled = np.where(np.isnan(vertices_m), target_m[:, None, :], vertices_m)
    first = np.broadcast_to(tx_m, (len(filled), 1, 3))
    line = np.concatenate([first, filled, target_m[:, None, :]], axis=1)
    return np.linalg.norm(np.diff(line, axis=1), axis=2).sum(axis=1)


def _arrivals(
    vertices_m: Float[FloatArray, "P D 3"], tx_m: Float[FloatArray, "3"], centre_m: Float[FloatArray, "3"]
) -> Float[FloatArray, "P 3"]:
    """Unit vectors from the receiver towards the last interaction, or the transmitter where there is none."""
    last = np.broadcast_to(tx_m, (len(vertices_m), 3)).copy()
    for depth in range(vertices_m.shape[1]):
        there = ~np.isnan(vertices_m[:, depth, 0])
        last[there] = vertices_m[there, depth]
    return (last - centre_m) / np.linalg.norm(last - centre_m, axis=1, keepdims=True)
