from __future__ import annotations

import hashlib
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.places import ROOT
from tests.support.reference import antenna_field, cfr_at_centre, over_one_slab, slab_coefficients
from tests.support.sionna_scenes import (
    ANTENNAS,
    CARRIERS_HZ,
    CONCRETE_WALL,
    GLASS_PANE,
    METAL_BOX,
    ONE_ELEMENT,
    RECEIVER,
    SETTINGS,
    TRANSMITTERS_M,
    relative_error,
    scene_of,
    simple_scenes,
    sionna_tracer,
)
from xfreqbench.scene.materials import complex_permittivity
from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.tracing.paths import NO_INTERACTION, REFRACTION, SPECULAR, Paths
from xfreqbench.tracing.tracer import Interaction
from xfreqbench.units import SPEED_OF_LIGHT_M_S

pytestmark = pytest.mark.sionna


def distances_m(receiver: ReceiverArray, carrier_hz: float, tx: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz) - tx, axis=1)


def only_path(paths: Paths, *interactions: int) -> tuple[NDArray[np.complex128], float]:
    """Gain and delay of the one path with exactly these interactions."""
    codes = [*interactions, *[NO_INTERACTION] * (paths.interactions.shape[1] - len(interactions))]
    (row,) = np.flatnonzero((paths.interactions == codes).all(axis=1))
    return paths.gain[:, row], float(paths.delay_s[row])


@pytest.mark.parametrize("rows_and_cols", [1, 4])
def test_free_space_obeys_friis_and_its_phase(rows_and_cols: int) -> None:
    receiver = replace(RECEIVER, rows=rows_and_cols, cols=rows_and_cols)
    tx = np.array([9.0, -7.0, 2.0])  # in the equator: the antennas of both ends are parallel
    channel = sionna_tracer(scene_of(receiver=receiver)).channel(tx[None])
    for row, carrier in zip(channel.cfr[0], CARRIERS_HZ, strict=True):
        distance = distances_m(receiver, carrier, tx)
        friis = SPEED_OF_LIGHT_M_S / carrier / (4 * np.pi * distance)
        np.testing.assert_allclose(np.abs(row), friis, rtol=1e-6)  # float32 gains
        phase_error = np.angle(row * np.exp(2j * np.pi * (carrier * distance / SPEED_OF_LIGHT_M_S % 1)))
        assert np.abs(phase_error).max() < 1e-6  # the phase is in double precision
    assert channel.num_paths.tolist() == [[1, 1, 1]]


@pytest.mark.parametrize(("pattern", "polarization"), [*ANTENNAS, ("dipole", "H")])
def test_a_wall_reflects_as_p2040_says(pattern: Any, polarization: Any) -> None:
    receiver = replace(ONE_ELEMENT, pattern=pattern, polarization=polarization)
    tx, normal = TRANSMITTERS_M[0], np.array([1.0, 0.0, 0.0])
    rx = np.array(receiver.position_m)
    path = tx * [-1, 1, 1] - rx  # from the receiver to the transmitter's image behind the wall x = 0
    distance = np.linalg.norm(path)
    outgoing = -path / distance
    incident = outgoing * [-1, 1, 1]
    gain, delay_s = only_path(sionna_tracer(scene_of(CONCRETE_WALL, receiver=receiver)).paths(tx), SPECULAR)
    assert delay_s == pytest.approx(distance / SPEED_OF_LIGHT_M_S, rel=1e-12)
    for carrier, traced in zip(CARRIERS_HZ, gain, strict=True):
        eta = complex_permittivity("concrete", carrier)
        te, tm, *_ = slab_coefficients(eta, 0.2, carrier, float(-incident @ normal))
        field = over_one_slab(antenna_field(incident, pattern, polarization), incident, outgoing, normal, te, tm)
        received = antenna_field(-outgoing, pattern, polarization) @ field
        expected = SPEED_OF_LIGHT_M_S / carrier / (4 * np.pi * distance) * received
        assert traced == pytest.approx(expected, rel=2e-3)  # float32 phase across 0.2 m: 2e3 rad at 94 GHz


@pytest.mark.parametrize(("pattern", "polarization"), ANTENNAS)
def test_a_pane_transmits_as_p2040_says(pattern: Any, polarization: Any) -> None:
    receiver = replace(ONE_ELEMENT, pattern=pattern, polarization=polarization)
    tx, normal = TRANSMITTERS_M[0], np.array([0.0, 1.0, 0.0])
    line = np.array(receiver.position_m) - tx
    distance = np.linalg.norm(line)
    direction = line / distance
    gain, _ = only_path(sionna_tracer(scene_of(GLASS_PANE, receiver=receiver)).paths(tx), REFRACTION)
    for carrier, traced in zip(CARRIERS_HZ, gain, strict=True):
        eta = complex_permittivity("glass", carrier)
        *_, te, tm = slab_coefficients(eta, 0.008, carrier, abs(float(direction @ normal)))
        field = over_one_slab(antenna_field(direction, pattern, polarization), direction, direction, normal, te, tm)
        received = antenna_field(-direction, pattern, polarization) @ field
        expected = SPEED_OF_LIGHT_M_S / carrier / (4 * np.pi * distance) * received
        assert traced == pytest.approx(expected, rel=1e-3)


def test_a_wall_in_coplanar_pieces_reflects_once() -> None:
    low = replace(CONCRETE_WALL, name="low", max_m=(0.0, 6.0, 1.3))
    high = replace(CONCRETE_WALL, name="high", min_m=(0.0, -4.0, 1.3))
    whole = sionna_tracer(scene_of(CONCRETE_WALL)).channel(TRANSMITTERS_M)
    pieces = sionna_tracer(scene_of(low, high)).channel(TRANSMITTERS_M)
    assert pieces.num_paths.tolist() == whole.num_paths.tolist()
    assert relative_error(pieces.cfr, whole.cfr) < 1e-5


def test_planes_are_one_whichever_way_their_triangles_face() -> None:
    from xfreqbench.tracing.sionna.chains import planes_of

    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.3, 0.1], [0.2, 1.0, -0.4], [1.2, 1.3, -0.3]])
    mesh = SurfaceMesh("tilted", "concrete", 0.1, corners, np.array([[0, 1, 2], [1, 2, 3], [2, 1, 3]]))
    shifted = replace(mesh, vertices_m=corners + np.array([0.0, 0.0, 0.01]))
    plane = planes_of([mesh, shifted]).index
    assert len(set(plane[:3])) == len(set(plane[3:])) == 1
    assert plane[0] != plane[3]


def test_paths_and_channel_agree_at_the_array_centre() -> None:
    receiver = replace(RECEIVER, rows=3, cols=3)  # its fifth element is at the centre
    rays = sionna_tracer(scene_of(CONCRETE_WALL, METAL_BOX, receiver=receiver))
    at_centre = rays.channel(TRANSMITTERS_M[:1]).cfr[0, :, 4]
    np.testing.assert_allclose(cfr_at_centre(rays.paths(TRANSMITTERS_M[0])), at_centre, rtol=1e-5)


def test_a_channel_does_not_depend_on_the_transmitters_asked_for_with_it() -> None:
    rays = sionna_tracer(scene_of(CONCRETE_WALL, METAL_BOX))
    tx = np.array([3.1, 4.2, 1.1]) + np.linspace(0, 0.7, 11)[:, None] * [0.5, 0.3, 0.2]
    together = rays.channel(tx)
    for row in (0, 4, 10):
        np.testing.assert_array_equal(rays.channel(tx[row : row + 1]).cfr[0], together.cfr[row])


def two_boxes_sha256() -> list[str]:
    """Digests of the channels of two transmitters among two boxes, without diffraction and with it."""
    plain: tuple[Interaction, ...] = ("specular", "refraction")
    settings = (replace(SETTINGS, interactions=asked, rays=20_000) for asked in (plain, (*plain, "diffraction")))
    rays = (sionna_tracer(simple_scenes()["two boxes"], [1e9, 94e9], asked) for asked in settings)
    return [hashlib.sha256(one.channel(TRANSMITTERS_M).cfr.tobytes()).hexdigest() for one in rays]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_in_every_process() -> None:
    program = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
from tests.tracing.sionna.test_tracer import two_boxes_sha256
print(*two_boxes_sha256())
"""
    other = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert len(set(other)) == 2
    assert other == two_boxes_sha256()


def test_extrapolated_materials_are_traced() -> None:
    brick = replace(CONCRETE_WALL, material="brick")
    settings = replace(SETTINGS, materials="extrapolate")
    assert sionna_tracer(scene_of(brick), [1e9, 94e9], settings).channel(TRANSMITTERS_M).num_paths.min() == 2


def test_a_material_undefined_at_sionnas_default_carrier_is_traced() -> None:
    floorboard = replace(CONCRETE_WALL, material="floorboard")
    assert (sionna_tracer(scene_of(floorboard), [60e9]).channel(TRANSMITTERS_M).num_paths == 2).all()


def test_a_shut_metal_box_lets_nothing_through() -> None:
    tx = np.array([[1.4, 2.6, 0.4]])
    rays = sionna_tracer(scene_of(METAL_BOX))
    channel = rays.channel(tx)
    assert not channel.cfr.any() and not channel.num_paths.any()
    assert len(rays.paths(tx[0]).delay_s) == 0
