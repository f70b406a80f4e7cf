"""Rays from the receiver against public forward Sionna RT calls, and our materials against Sionna's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.sionna_scenes import (
    ANTENNAS,
    CARRIERS_HZ,
    CONCRETE_WALL,
    METAL_BOX,
    RECEIVER,
    SETTINGS,
    TRANSMITTERS_M,
    relative_error,
    scene_of,
    simple_scenes,
    sionna_tracer,
)
from xfreqbench.scene.materials import materials_defined_at
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Scene, Surface
from xfreqbench.tracing.paths import NO_INTERACTION
from xfreqbench.tracing.tracer import Interaction

pytestmark = pytest.mark.sionna

# The public solver's delays are float32: 6e-8 of 2πfτ ≈ 1.5e4 rad at 94 GHz and 8 m, a few roundings over.
PLAIN_TOLERANCE = {1e9: 1e-3, 10e9: 1e-3, 94e9: 6e-3}


def plain(scene: Scene, carrier_hz: float, tx_position_m: NDArray[np.float64] = TRANSMITTERS_M[:2]) -> Any:
    from xfreqbench.tracing.sionna.plain import plain_channel

    interactions = SETTINGS.interactions
    return plain_channel(scene, carrier_hz, tx_position_m, interactions, SETTINGS.max_depth, SETTINGS.rays, 1)


@pytest.mark.parametrize(
    ("name", "pattern", "polarization"), [(name, *ANTENNAS[n % 3]) for n, name in enumerate(simple_scenes())]
)
def test_rays_from_the_receiver_give_the_channel_of_rays_from_each_transmitter(
    name: str, pattern: Any, polarization: Any
) -> None:
    receiver = replace(RECEIVER, pattern=pattern, polarization=polarization)
    scene = simple_scenes(receiver)[name]
    cfr = sionna_tracer(scene).channel(TRANSMITTERS_M[:2]).cfr
    for index, carrier in enumerate(CARRIERS_HZ):
        for row, truth in zip(cfr[:, index], plain(scene, carrier), strict=True):
            assert relative_error(row, truth) < PLAIN_TOLERANCE[carrier]


def test_a_path_that_only_the_arrays_edge_sees_is_found() -> None:
    """At 1 GHz the array is half a metre wide: a plate can hide the transmitter from its centre alone."""
    plate = Surface(name="plate", material="metal", thickness_m=0.002, min_m=(2.4, 2.5, 1.4), max_m=(2.6, 2.5, 1.75))
    scene = scene_of(plate)
    direct = sionna_tracer(scene).paths(TRANSMITTERS_M[0]).interactions[:, 0] == NO_INTERACTION
    assert not direct.any()
    cfr = sionna_tracer(scene).channel(TRANSMITTERS_M[:1]).cfr[0, 0]
    assert 0 < np.count_nonzero(cfr) < 16
    assert relative_error(cfr, plain(scene, 1e9, TRANSMITTERS_M[:1])[0]) < PLAIN_TOLERANCE[1e9]


def test_diffraction_is_solved_forward_as_the_plain_way_does() -> None:
    from xfreqbench.tracing.sionna.plain import plain_channel

    interactions: tuple[Interaction, ...] = ("specular", "refraction", "diffraction")
    scene, tx = scene_of(METAL_BOX, CONCRETE_WALL), np.array([[1.4, 3.6, 0.4]])
    settings = replace(SETTINGS, interactions=interactions, max_depth=2)
    rays = sionna_tracer(scene, [1e9], settings)
    truth = plain_channel(scene, 1e9, tx, interactions, 2, settings.rays, settings.seed)
    without = sionna_tracer(scene, [1e9], replace(settings, interactions=("specular", "refraction"))).channel(tx)
    cfr = rays.channel(tx).cfr[:, 0]
    assert relative_error(cfr, truth) < 1e-3
    assert relative_error(without.cfr[:, 0], truth) > 0.1  # the transmitter is behind the box
    paths = rays.paths(tx[0])
    assert (paths.interactions == 8).any()
    np.testing.assert_allclose(np.linalg.norm(paths.arrival, axis=1), 1)


def test_our_materials_equal_sionnas_own() -> None:
    from xfreqbench.tracing.sionna.scene import RadioScene, rt

    carrier = 58e9
    defined = [name for name in materials_defined_at([carrier]) if name != "vacuum"]  # theirs has no colour
    (mesh,) = surface_meshes(scene_of(CONCRETE_WALL))
    ours = RadioScene([replace(mesh, name=name, material=name) for name in defined])
    ours.set_carrier(carrier)
    theirs = rt.load_scene()
    theirs.frequency = carrier
    for name in defined:
        theirs.add(rt.ITURadioMaterial(f"their {name}", name, thickness=0.2))
    assert len(ours.sionna.radio_materials) == len(defined)
    for label, material in ours.sionna.radio_materials.items():
        their = theirs.get(f"their {label.rpartition('-')[0]}")
        assert material.relative_permittivity.numpy() == pytest.approx(their.relative_permittivity.numpy(), rel=1e-6)
        assert material.conductivity.numpy() == pytest.approx(their.conductivity.numpy(), rel=1e-6, abs=1e-12)
        assert material.thickness.numpy() == pytest.approx(0.2)
