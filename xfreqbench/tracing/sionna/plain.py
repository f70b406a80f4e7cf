"""Channels by one public `PathSolver` call per transmitter and carrier, without any saving.

This is slow and uses Sionna's public names only: every saving is tested and timed against it.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Antenna, Scene
from xfreqbench.tracing.sionna.scene import RadioScene, antenna_array, mi, orientation_rad, rt
from xfreqbench.tracing.tracer import Interaction
from xfreqbench.types import FloatArray, NDArray

UPRIGHT = Antenna("iso", "V")


def plain_channel(
    scene: Scene,
    carrier_hz: float,
    tx_position_m: Float[FloatArray, "T 3"],
    interactions: Collection[Interaction],
    max_depth: int,
    rays: int,
    seed: int,
) -> Complex[NDArray[np.complex128], "T M"]:
    """h_n(f) of Eq. (1) for T transmitters: rays are shot from each, and each element is a receiver of its own.

    Raises `MaterialBandError` for a carrier outside a material's band.
    """
    sionna_scene, antenna = loaded(scene, carrier_hz), scene.transmitter_antenna
    channels = []
    for tx in tx_position_m:
        paths = solve(sionna_scene, tx[None], interactions, max_depth, rays, seed, antenna)
        gain, _ = paths.cir(normalize_delays=False, out_type="numpy")  # which holds the carrier phase already
        channels.append(gain.astype(np.complex128).sum(axis=(0, 2, 3, 4, 5)))
    return np.array(channels).reshape(len(tx_position_m), scene.receiver.num_elements)


def loaded(scene: Scene, carrier_hz: float) -> Any:
    """The scene in Sionna RT at one carrier, with its receiver array and no transmitter yet."""
    radio_scene = RadioScene(surface_meshes(scene))
    radio_scene.set_carrier(carrier_hz)
    sionna_scene, receiver = radio_scene.sionna, scene.receiver
    sionna_scene.tx_array = antenna_array(scene.transmitter_antenna, np.zeros((1, 3)))
    elements = receiver.element_position_wavelengths @ receiver.rotation.T
    sionna_scene.rx_array = antenna_array(receiver.antenna, elements)
    orientation = orientation_rad(receiver.antenna)
    sionna_scene.add(rt.Receiver(name="receiver", position=mi.Point3f(*receiver.position_m), orientation=orientation))
    return sionna_scene


def solve(
    sionna_scene: Any,
    tx_position_m: Float[FloatArray, "T 3"],
    interactions: Collection[Interaction],
    max_depth: int,
    rays: int,
    seed: int,
    antenna: Antenna = UPRIGHT,
) -> Any:
    """Sionna's own paths of T transmitters, turned as the `antenna` says, to every element of the array."""
    for name in list(sionna_scene.transmitters):
        sionna_scene.remove(name)
    for number, position_m in enumerate(tx_position_m.tolist()):
        name, orientation = f"transmitter {number}", orientation_rad(antenna)
        sionna_scene.add(rt.Transmitter(name=name, position=mi.Point3f(*position_m), orientation=orientation))
    return rt.PathSolver()(
        sionna_scene,
        max_depth=max_depth,
        samples_per_src=rays,
        synthetic_array=False,
        specular_reflection="specular" in interactions,
        diffuse_reflection="diffuse" in interactions,
        refraction="refraction" in interactions,
        diffraction="diffraction" in interactions,
        seed=seed,
    )
