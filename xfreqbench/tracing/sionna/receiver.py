"""Specular and transmitted paths by Sionna RT, from rays that are shot once from the receiver.

For each transmitter those chains are kept of which it sees the last point of some ray, and of these the ones
that may reach some element (`reach`). Each of them is then solved at every carrier for every element's own
position, from the transmitter to the element as in a forward solve: nothing here assumes that Sionna's field is
reciprocal.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex, Float, Int

from xfreqbench.scene.meshes import triangle_corners_m
from xfreqbench.scene.model import Antenna, ReceiverArray
from xfreqbench.system.bars import report
from xfreqbench.tracing.paths import NO_INTERACTION, Paths
from xfreqbench.tracing.sionna.chains import Chains, opaque_meshes, planes_of, shoot
from xfreqbench.tracing.sionna.field import Rays, path_interactions, with_travel_phase
from xfreqbench.tracing.sionna.reach import PlaneBoxes, Reach
from xfreqbench.tracing.sionna.scene import RadioScene, dr, mi, point3f, rt
from xfreqbench.tracing.tracer import Channel, TraceSettings
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

PathsBuffer = rt.path_solvers.paths_buffer.PathsBuffer

RAY_OFFSET = 1e-5  # of the largest coordinate: keeps a ray off the surface from which it starts


@dataclass(frozen=True)
class _Candidates:
    """C pairs of a transmitter and a chain, and the receiver's image under each chain."""

    tx: Int[IntArray, "C"]
    chain: Int[IntArray, "C"]
    rotation: Float[FloatArray, "C 3 3"]
    shift_m: Float[FloatArray, "C 3"]

    def lengths_m(
        self, pair: IntArray, tx_position_m: Float[FloatArray, "T 3"], target_m: Float[FloatArray, "R 3"]
    ) -> Float[FloatArray, "R"]:
        """Lengths of the given pairs' paths to R targets, from the receiver's images.

        They are in double precision: float32 would turn the phase at 94 GHz by up to 0.07 rad.
        """
        image_m = np.einsum("rab,rb->ra", self.rotation[pair], target_m) + self.shift_m[pair]
        return np.linalg.norm(image_m - tx_position_m[self.tx[pair]], axis=1)


class ReceiverRays(Rays):
    """Chains of rays from the receiver of one scene, ready to be solved for any transmitter."""

    def __init__(
        self,
        radio_scene: RadioScene,
        receiver: ReceiverArray,
        transmitter: Antenna,
        carrier_hz: Float[FloatArray, "F"],
        settings: TraceSettings,
    ) -> None:
        super().__init__(radio_scene, receiver, transmitter, carrier_hz)
        self.planes = planes_of(radio_scene.meshes)
        opaque = opaque_meshes(radio_scene.meshes, carrier_hz.tolist(), radio_scene.policy)
        wavelength_m = SPEED_OF_LIGHT_M_S / float(carrier_hz.min())
        aperture_m = _aperture_points(receiver, wavelength_m)
        self.chains = shoot(radio_scene, self.planes, aperture_m, opaque, radio_scene.mirrors, settings)
        self._reach = Reach(
            self.chains,
            self.planes,
            PlaneBoxes.of(self.planes, triangle_corners_m(radio_scene.meshes)),
            np.asarray(receiver.position_m),
            radius_m=float(np.linalg.norm(receiver.element_position_wavelengths, axis=1).max()) * wavelength_m,
        )
        self._buffer = _forward_buffer(self.chains, radio_scene)
        self._hits = _LastPoints(self.chains)

    def channel(self, tx_position_m: Float[FloatArray, "T 3"]) -> Channel:
        """Channel (T, F, M) at every element's own position, and the number of paths (T, F)."""
        shape = len(tx_position_m), len(self.carrier_hz), self.receiver.num_elements
        cfr = np.zeros(shape, dtype=np.complex128)
        num_paths = np.zeros(shape[:2], dtype=np.int32)
        for start in range(0, len(tx_position_m), 8):
            report("transmitters", start, len(tx_position_m))
            batch = slice(start, start + 8)
            candidates = self._candidates(tx_position_m[batch])
            for index, carrier in enumerate(self.carrier_hz.tolist()):
                solved = self._channel_at(carrier, tx_position_m[batch], candidates)
                cfr[batch, index], num_paths[batch, index] = solved
        return Channel(cfr, num_paths)

    def paths(self, tx_position_m: Float[FloatArray, "3"]) -> Paths:
        """Paths to the array centre, the earliest first."""
        tx = tx_position_m[None, :]
        centre = np.array([self.receiver.position_m])
        candidates = self._candidates(tx)
        pair, buffer = self._solve(tx, centre, candidates.tx, candidates.chain, np.zeros_like(candidates.tx))
        gain = [self.field.gains(carrier, buffer, tx, centre) for carrier in self.carrier_hz.tolist()]
        length_m = candidates.lengths_m(pair, tx, np.repeat(centre, len(pair), axis=0))
        image_m = candidates.rotation[pair] @ centre[0] + candidates.shift_m[pair]
        arrival = np.einsum("rab,ra->rb", candidates.rotation[pair], tx - image_m) / length_m[:, None]
        interactions, vertices_m = path_interactions(buffer, self.chains.interaction.shape[1])
        return self.sorted_paths(buffer, gain, length_m, arrival, interactions, vertices_m)

    def _candidates(self, tx_position_m: Float[FloatArray, "T 3"]) -> _Candidates:
        """Pairs of a transmitter and a chain whose path may reach some element at some carrier."""
        seen = [self._hits.chains_seen_from(self.radio_scene, position) for position in tx_position_m]
        tx = np.repeat(np.arange(len(seen)), [len(chain) for chain in seen])
        chain = np.concatenate(seen)
        keep = self._reach.may_reach(tx_position_m[tx], chain)
        rotation, shift_m = self.chains.receiver_images(chain[keep], self.planes)
        return _Candidates(tx[keep], chain[keep], rotation, shift_m)

    def _channel_at(
        self, carrier_hz: float, tx_position_m: Float[FloatArray, "T 3"], candidates: _Candidates
    ) -> tuple[Complex[NDArray[np.complex128], "T M"], Int[NDArray[np.int32], "T"]]:
        """Channel of every transmitter at one carrier, and how many paths reach at least one element."""
        element_m = self.receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz)
        cfr = np.zeros((len(tx_position_m), len(element_m)), dtype=np.complex128)
        reached = np.zeros(len(candidates.tx), dtype=bool)
        for pair, element, buffer in self._reached(tx_position_m, element_m, candidates.tx, candidates.chain):
            gain = self.field.gains(carrier_hz, buffer, tx_position_m, element_m)
            length_m = candidates.lengths_m(pair, tx_position_m, element_m[element])
            response = with_travel_phase(gain, length_m, carrier_hz)
            np.add.at(cfr, (candidates.tx[pair], element), response)
            reached[pair[gain != 0]] = True
        num_paths = np.bincount(candidates.tx[reached], minlength=len(tx_position_m))
        return cfr, num_paths.astype(np.int32)

    def _reached(
        self, tx_position_m: FloatArray, target_m: FloatArray, tx: IntArray, chain: IntArray
    ) -> Iterator[tuple[IntArray, IntArray, Any]]:
        """Solve every pair of transmitter and chain at every target, some at a time.

        Yields the pair and the target of each path that exists, and Sionna's buffer of these paths.
        """
        num_targets = len(target_m)
        # paths solved in one call: about 400 bytes each
        pairs_at_once = max(1, 500_000 // num_targets)
        for start in range(0, len(tx), pairs_at_once):
            pair = np.repeat(np.arange(start, min(start + pairs_at_once, len(tx))), num_targets)
            target = np.tile(np.arange(num_targets), len(pair) // num_targets)
            row, buffer = self._solve(tx_position_m, target_m, tx[pair], chain[pair], target)
            yield pair[row], target[row], buffer

    def _solve(
        self, tx_position_m: FloatArray, target_m: FloatArray, tx: IntArray, chain: IntArray, target: IntArray
    ) -> tuple[IntArray, Any]:
        """Rows of (transmitter, chain, target) that are paths, by the image method, and their buffer."""
        buffer = self._buffer.gather(mi.UInt(chain.astype(np.uint32)))
        buffer._src_indices = mi.UInt(tx.astype(np.uint32))
        buffer._tgt_indices = mi.UInt(target.astype(np.uint32))
        return self.field.find_paths(buffer, tx_position_m, target_m), buffer


class _LastPoints:
    """The last points of rays on their chains, held by Dr.Jit; a transmitter that sees one may use its chain."""

    def __init__(self, chains: Chains) -> None:
        self.num_chains = len(chains.interaction)
        reach = 1 + np.abs(chains.hit_m).max(axis=1, keepdims=True, initial=0.0)
        self.start = point3f(chains.hit_m + RAY_OFFSET * reach * chains.hit_side)
        self.side = mi.Vector3f(point3f(chains.hit_side))
        self.chain = mi.UInt(chains.hit_chain)

    def chains_seen_from(self, radio_scene: RadioScene, position_m: Float[FloatArray, "3"]) -> IntArray:
        """Chains of which some ray's last point is seen, from the side to which the ray went on.

        The line of sight, chain 0, is always among them: it may be free for an element of the array where
        it is blocked for the centre.
        """
        seen = dr.zeros(mi.UInt, self.num_chains)
        if dr.width(self.chain):
            position = mi.Point3f(point3f(position_m[None, :]))
            towards = mi.Vector3f(position - self.start)
            ray = mi.Ray3f(self.start, towards, maxt=1 - RAY_OFFSET, time=0.0, wavelengths=mi.Color0f())
            ahead = dr.dot(self.side, towards) > 0
            blocked = radio_scene.mitsuba.ray_test(ray, active=ahead)
            dr.scatter(seen, mi.UInt(1), self.chain, ahead & ~blocked)
        return np.union1d([0], np.flatnonzero(seen.numpy()))


def _aperture_points(receiver: ReceiverArray, wavelength_m: float) -> Float[FloatArray, "K 3"]:
    """World positions of nine points across the aperture: corners, middles of sides, centre.

    A line has three of them, a single element one.
    """
    positions = receiver.element_position_wavelengths
    low, high = positions.min(axis=0), positions.max(axis=0)
    steps = np.stack(np.meshgrid(*[np.linspace(0, 1, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    offset_m = np.unique(low + steps * (high - low), axis=0) @ receiver.rotation.T * wavelength_m
    return np.asarray(receiver.position_m) + offset_m


def _forward_buffer(chains: Chains, radio_scene: RadioScene) -> Any:
    """Sionna's buffer of all chains, turned round: from a transmitter, index still open, to the receiver."""
    num_chains, max_depth = chains.interaction.shape
    num_interactions = (chains.interaction != NO_INTERACTION).sum(axis=1, keepdims=True)
    depth = np.arange(max_depth)
    turned = np.where(depth < num_interactions, num_interactions - 1 - depth, depth)
    interaction = np.take_along_axis(chains.interaction, turned, axis=1)
    triangle = np.take_along_axis(chains.triangle, turned, axis=1)
    vertex_m = np.take_along_axis(chains.vertex_m, turned[:, :, None], axis=1)
    buffer = PathsBuffer(num_chains, max_depth, False)
    buffer._interaction_types = mi.TensorXu(interaction)
    if radio_scene.meshes:
        num_triangles = [len(mesh.triangles) for mesh in radio_scene.meshes]
        shape = np.repeat(radio_scene.shape_pointer, num_triangles)  # Dr.Jit's pointer to that of each triangle
        primitive = np.concatenate([np.arange(number, dtype=np.uint32) for number in num_triangles])
        buffer._shapes, buffer._primitives = mi.TensorXu(shape[triangle]), mi.TensorXu(primitive[triangle])
    x, y, z = np.moveaxis(vertex_m, -1, 0)
    buffer._vertices_x, buffer._vertices_y, buffer._vertices_z = (mi.TensorXf(x), mi.TensorXf(y), mi.TensorXf(z))
    return buffer
