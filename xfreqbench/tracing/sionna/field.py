"""Geometry and field of paths in Sionna RT, one step of its `PathSolver` at a time.

These steps are private names of the pinned version. They are used here, in `receiver` and in `forward` only, and
tests compare them with the public solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from xfreqbench.errors import SceneError
from xfreqbench.scene.model import Antenna, ReceiverArray
from xfreqbench.tracing.paths import NO_INTERACTION, SPECULAR, Paths
from xfreqbench.tracing.sionna.scene import RadioScene, antenna_array, dr, mi, orientation_rad, point3f, rt
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, format_ghz

FieldCalculator = rt.path_solvers.field_calculator.FieldCalculator
ImageMethod = rt.path_solvers.image_method.ImageMethod

BESIDE_M = 1e-4  # a ray this far off the vertical has an azimuth in Sionna RT, if it is no longer than some 30 m


class Field:
    """Solves buffers of paths from T transmitters to R targets, by the antennas of either."""

    def __init__(self, radio_scene: RadioScene, transmitter: Antenna, receiver: Antenna) -> None:
        self.radio_scene = radio_scene
        self._antennas = transmitter, receiver
        arrays = (antenna_array(antenna, np.zeros((1, 3))) for antenna in self._antennas)
        self._sent, self._received = (array.antenna_pattern.patterns for array in arrays)

    def find_paths(
        self,
        buffer: Any,
        tx_position_m: Float[FloatArray, "T 3"],
        target_m: Float[FloatArray, "R 3"],
        diffraction: bool = False,
    ) -> Int[NDArray[np.int64], "P"]:
        """Indices of the rows of a buffer that are paths, by the image method; the buffer keeps these only.

        A path that is reflected by a triangle that does not mirror is none.
        """
        ImageMethod()(
            scene=self.radio_scene.mitsuba,
            paths=buffer,
            diffraction=diffraction,
            diffraction_lit_region=True,
            src_positions=_sources(tx_position_m, target_m),
            tgt_positions=point3f(target_m),
        )
        if not self.radio_scene.mirrors.all():
            buffer.valid &= mi.Bool(self._are_by_mirrors(buffer))
        row = np.flatnonzero(buffer.valid.numpy())
        buffer.discard_invalid()
        return row

    def _are_by_mirrors(self, buffer: Any) -> Bool[NDArray[np.bool_], "P"]:
        """Whether every specular reflection of each of a buffer's paths is by a triangle that mirrors."""
        pointer, meshes = self.radio_scene.shape_pointer, self.radio_scene.meshes
        first_triangle = np.zeros(int(pointer.max()) + 1, dtype=np.int64)
        first_triangle[pointer] = np.cumsum([0, *(len(mesh.triangles) for mesh in meshes)])[:-1]
        is_specular = buffer.interaction_types.numpy() == SPECULAR
        shape, primitive = (np.where(is_specular, column.numpy(), 0) for column in (buffer.shapes, buffer.primitives))
        mirrors = self.radio_scene.mirrors[first_triangle[shape] + primitive]
        return (mirrors | ~is_specular).reshape(buffer.buffer_size, -1).all(axis=1)

    def gains(
        self,
        carrier_hz: float,
        buffer: Any,
        tx_position_m: Float[FloatArray, "T 3"],
        target_m: Float[FloatArray, "R 3"],
        diffraction: bool = False,
        rays: int = 1,
    ) -> Complex[NDArray[np.complex128], "P"]:
        """Gain of each of a buffer's P paths at one carrier, spreading included, without its travel phase.

        `rays` is the number that the paths were sampled with; only diffuse reflections depend on it. Raises
        `SceneError` where a gain is not a number.
        """
        if buffer.buffer_size == 0:
            return np.zeros(0, dtype=np.complex128)
        self.radio_scene.set_carrier(carrier_hz)
        FieldCalculator()(
            wavelength=self.radio_scene.sionna.wavelength,
            paths=buffer,
            samples_per_src=rays,
            diffraction=diffraction,
            src_positions=_sources(tx_position_m, target_m),
            tgt_positions=point3f(target_m),
            src_orientations=orientation_rad(self._antennas[0], len(tx_position_m)),
            tgt_orientations=orientation_rad(self._antennas[1], len(target_m)),
            src_antenna_patterns=self._sent,
            tgt_antenna_patterns=self._received,
        )
        gain = buffer.a[0][0]
        dr.eval(gain)
        # a path that vanishes at one carrier may not at another
        buffer.valid = dr.full(mi.Bool, True, buffer.buffer_size)
        gains = gain.real.numpy().astype(np.complex128) + 1j * gain.imag.numpy()
        num_lost = np.count_nonzero(~np.isfinite(gains))
        if num_lost:
            raise SceneError(
                f"At {format_ghz(carrier_hz)} Sionna RT gives {num_lost:,} of {len(gains):,} paths a "
                "field that is not a number: a slab of the scene is too thick, or conducts too well, for its single "
                "precision. Make thick ones thinner; through a metre of metal nothing passes either."
            )
        return gains


class Rays:
    """What rays from the receiver and rays from transmitters have in common: scene, array, carriers and fields."""

    def __init__(
        self, radio_scene: RadioScene, receiver: ReceiverArray, sent_by: Antenna, carrier_hz: Float[FloatArray, "F"]
    ) -> None:
        self.radio_scene, self.receiver, self.carrier_hz = radio_scene, receiver, carrier_hz
        self.field = Field(radio_scene, sent_by, receiver.antenna)

    def sorted_paths(
        self,
        buffer: Any,
        gain: Sequence[Complex[NDArray[np.complex128], "P"]],
        length_m: Float[FloatArray, "P"],
        arrival: Float[FloatArray, "P 3"],
        interactions: Int[NDArray[np.int64], "P D"],
        vertices_m: Float[FloatArray, "P D 3"],
    ) -> Paths:
        """The P paths of a buffer with their gains at each carrier, the earliest first."""
        order = np.argsort(length_m, kind="stable")
        return Paths(
            carrier_hz=self.carrier_hz,
            gain=np.array(gain).reshape(len(self.carrier_hz), -1)[:, order],
            delay_s=length_m[order] / SPEED_OF_LIGHT_M_S,
            arrival=arrival[order],
            interactions=interactions[order],
            surfaces=_surfaces_met(self.radio_scene, buffer, interactions)[order],
            vertices_m=vertices_m[order],
        )


def _sources(tx_position_m: Float[FloatArray, "T 3"], target_m: Float[FloatArray, "R 3"]) -> Any:
    """Transmitters as Sionna RT gets them: those right above or below a target stand twice `BESIDE_M` aside.

    Sionna RT takes 0 as the azimuth of both ends of a vertical ray. They are opposite, as those of all rays beside it,
    and the field would have the wrong sign.
    """
    offset_m = np.linalg.norm(tx_position_m[:, None, :2] - target_m[:, :2], axis=2)
    is_aligned = offset_m.min(axis=1, keepdims=True) < BESIDE_M
    return point3f(tx_position_m + is_aligned * 2 * BESIDE_M * np.array([0.8, 0.6, 0.0]))


def with_travel_phase(
    gain: Complex[NDArray[np.complex128], "P"], length_m: Float[FloatArray, "P"], carrier_hz: float
) -> Complex[NDArray[np.complex128], "P"]:
    """gain · exp(−j2πf·length/c), in real arithmetic.

    NumPy's complex product rounds differently at the end of an array, so that the last bit of a channel would
    depend on the transmitters that it was computed with.
    """
    angle_rad = 2 * np.pi * ((carrier_hz / SPEED_OF_LIGHT_M_S * length_m) % 1.0)
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    turned = np.empty_like(gain)
    turned.real = gain.real * cosine + gain.imag * sine
    turned.imag = gain.imag * cosine - gain.real * sine
    return turned


def path_interactions(buffer: Any, max_depth: int) -> tuple[Int[NDArray[np.int64], "P D"], Float[FloatArray, "P D 3"]]:
    """Interactions along each path from its transmitter, and where they happen, padded with NaN."""
    interactions = buffer.interaction_types.numpy().reshape(-1, max_depth).astype(np.int64)
    columns = (buffer.vertices_x, buffer.vertices_y, buffer.vertices_z)
    vertices_m = np.stack([column.numpy().reshape(-1, max_depth) for column in columns], axis=-1)
    vertices_m = vertices_m.astype(np.float64)
    vertices_m[interactions == NO_INTERACTION] = np.nan
    return interactions, vertices_m


def _surfaces_met(
    radio_scene: RadioScene, buffer: Any, interactions: Int[NDArray[np.int64], "P D"]
) -> Int[NDArray[np.int64], "P D"]:
    """Index of the mesh that each path of a buffer meets at each interaction, −1 where there is none."""
    if not radio_scene.meshes:
        return np.full(interactions.shape, -1)
    pointer = radio_scene.shape_pointer
    mesh = np.full(int(pointer.max()) + 2, -1)
    mesh[pointer] = np.arange(len(pointer))
    shape = buffer.shapes.numpy().reshape(interactions.shape)
    return mesh[np.where(interactions == NO_INTERACTION, len(mesh) - 1, shape)]
