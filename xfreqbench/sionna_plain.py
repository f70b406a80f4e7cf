"""The plain way to a channel: one public `PathSolver` call per transmitter and carrier.

Slow, and Sionna's public names only: what every saving is tested and timed against.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.mesh import surface_meshes
from xfreqbench.scene import Scene
from xfreqbench.sionna_scene import RadioScene, antenna_array, mi, rt
from xfreqbench.tracing import Interaction


def plain_channel(
    scene: Scene,
    carrier_hz: float,
    tx_position_m: Float[FloatArray, "T 3"],
    interactions: Collection[Interaction],
    max_depth: int,
    rays: int,
    seed: int,
) -> Complex[NDArray[np.complex128], "T M"]:
    """h_n(f) of Eq. (1): rays shot from every transmitter, with each element a receiver of its own.

    Raises `MaterialBandError` for a carrier outside a material's band.
    """
    sionna_scene = _loaded(scene, carrier_hz)
    solved = (_solve(sionna_scene, tx, interactions, max_depth, rays, seed) for tx in tx_position_m)
    channels = [_sum_of_paths(paths) for paths in solved]
    return np.array(channels).reshape(len(tx_position_m), scene.receiver.num_elements)


def public_paths(
    scene: Scene,
    carrier_hz: float,
    tx_position_m: Float[FloatArray, "3"],
    interactions: Collection[Interaction],
    max_depth: int,
    rays: int,
    seed: int,
) -> Any:
    """Sionna's own paths of one transmitter, to compare with one by one."""
    return _solve(_loaded(scene, carrier_hz), tx_position_m, interactions, max_depth, rays, seed)


def _loaded(scene: Scene, carrier_hz: float) -> Any:
    radio_scene = RadioScene(surface_meshes(scene))
    radio_scene.set_carrier(carrier_hz)
    sionna_scene, receiver = radio_scene.sionna, scene.receiver
    sionna_scene.tx_array = antenna_array(receiver, np.zeros((1, 3)))
    elements = receiver.element_position_wavelengths @ receiver.rotation.T
    sionna_scene.rx_array = antenna_array(receiver, elements)
    sionna_scene.add(rt.Receiver(name="receiver", position=mi.Point3f(*receiver.position_m)))
    return sionna_scene


def _solve(
    sionna_scene: Any,
    position_m: Float[FloatArray, "3"],
    interactions: Collection[Interaction],
    max_depth: int,
    rays: int,
    seed: int,
) -> Any:
    sionna_scene.remove("transmitter")
    sionna_scene.add(rt.Transmitter(name="transmitter", position=mi.Point3f(*map(float, position_m))))
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


def _sum_of_paths(paths: Any) -> Complex[NDArray[np.complex128], "M"]:
    """`cir` carries the carrier phase already; its frequency axis would count baseband offsets."""
    gain, _ = paths.cir(normalize_delays=False, out_type="numpy")
    return gain.astype(np.complex128).sum(axis=(0, 2, 3, 4, 5))
