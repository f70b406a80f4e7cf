"""First-order diffraction against Sommerfeld's half-plane, continuity, reciprocity and mirror images."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import erfc, jv, wofz

from tests.support.reference import cfr_at_centre
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Antenna, ReceiverArray, Scene, Surface, TransmitterGrid, load_scene
from xfreqbench.scene.placement import choose_transmitters, place_transmitters
from xfreqbench.tracing.image.edges import find_edges
from xfreqbench.tracing.image.kernels.wedges import diffract, transition
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.paths import DIFFRACTION, SPECULAR, Paths
from xfreqbench.tracing.tracer import Interaction, TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

GRID = TransmitterGrid(min_m=(0.0, 0.0, 0.0), max_m=(1.0, 1.0, 1.0), step_m=(1.0, 1.0, 1.0))
ALL: tuple[Interaction, ...] = ("specular", "refraction", "diffraction")
NO_TRIANGLES = np.zeros((0, 3, 3)), np.zeros(0, np.int64)
EXACT = ImageSavings(diffraction_floor=0.0)
METAL_BOX = Surface("metal box", "metal", 0.002, (1.0, 1.0, 0.0), (2.0, 2.2, 1.3))
WOODEN_BOX = Surface("wooden box", "wood", 0.02, (3.1, 2.0, 0.1), (4.0, 3.0, 1.0))
PANE = Surface("pane", "glass", 0.008, (2.5, -1.0, 0.5), (2.5, 1.8, 1.9))
FLOOR = Surface("floor", "concrete", 0.2, (-3.0, -3.0, 0.0), (8.0, 8.0, 0.0))


def scene_of(*surfaces: Surface, at_m: tuple[float, ...] = (2.0, 0.0, 1.5), **receiver: Any) -> Scene:
    array = ReceiverArray(**{"position_m": at_m, "rows": 1, "cols": 1, **receiver})
    return Scene(name="test", receiver=array, transmitters=GRID, surface=surfaces)


def tracer(
    scene: Scene,
    carrier_hz: list[float],
    max_depth: int = 1,
    savings: ImageSavings = EXACT,
    interactions: tuple[Interaction, ...] = ALL,
) -> ImageTracer:
    settings = TraceSettings(interactions=interactions, max_depth=max_depth, rays=20_000)
    return ImageTracer(scene, carrier_hz, settings, savings)


def num_edges(*surfaces: Surface) -> dict[float, int]:
    """How many edges there are, by the angle that they leave free in half turns."""
    edges = find_edges(Geometry(surface_meshes(scene_of(*surfaces))).facets, *NO_TRIANGLES)
    angles = [round(edge.angle_rad / np.pi, 6) for edge in edges]
    return {angle: angles.count(angle) for angle in sorted(set(angles))}


def diffracted(paths: Paths) -> np.ndarray:
    return (paths.interactions == DIFFRACTION).any(axis=1)


def test_edges_are_a_box_s_twelve_and_a_screens_rim_but_no_joint_and_no_corner_of_a_room() -> None:
    left = Surface("left", "glass", 0.01, (0.0, 0.0, 0.0), (0.0, 1.0, 1.0))
    right = Surface("right", "wood", 0.01, (0.0, 1.0, 0.0), (0.0, 2.0, 1.0))
    across = Surface("across", "wood", 0.01, (0.0, 1.0, 0.0), (1.0, 1.0, 1.0))
    assert num_edges(METAL_BOX) == {1.5: 12}
    assert num_edges(left) == {2.0: 4}
    assert num_edges(left, right) == {2.0: 6}
    assert num_edges(left, right, across) == {2.0: 9}  # where three walls meet, no angle of more than π is free
    assert num_edges(left, across) == {1.5: 1, 2.0: 6}  # a corner diffracts on its outside alone
    assert num_edges(METAL_BOX, FLOOR) == {1.5: 8, 2.0: 4}  # a box that stands on the floor
    assert num_edges() == {}


def test_an_edge_that_a_box_hides_in_part_diffracts_where_it_is_free() -> None:
    wall = Surface("wall", "concrete", 0.2, (0.0, 0.0, 0.0), (0.0, 4.0, 2.0))
    box = Surface("box", "metal", 0.01, (0.0, 1.0, 1.0), (1.0, 2.0, 2.0))  # its top is level with the wall's rim
    edges = find_edges(Geometry(surface_meshes(scene_of(wall, box))).facets, *NO_TRIANGLES)
    top = [edge for edge in edges if abs(edge.along[1]) > 0.9 and np.allclose(edge.start_m[[0, 2]], [0.0, 2.0])]
    angles = sorted((edge.angle_rad / np.pi, edge.length_m) for edge in top)
    np.testing.assert_allclose(angles, [(1.5, 1.0), (2.0, 1.0), (2.0, 2.0)])


def test_the_transition_function_is_scipys() -> None:
    for y in (0.0, 1e-9, 0.01, 0.5, 1.0, 3.0, 30.0, 1e4):
        expected = wofz(1j * np.exp(0.25j * np.pi) * y)
        assert abs(transition(y) - expected) < 1e-10 * abs(expected)


@pytest.mark.parametrize("is_soft", [True, False])
def test_a_plane_wave_at_a_metal_half_plane_gives_sommerfelds_solution(is_soft: bool) -> None:
    sheet = Surface("sheet", "metal", 0.01, (0.0, -9.0, -9.0), (0.0, 9.0, 1.0))
    found = tracer(scene_of(sheet), [1e9, 10e9]).diffraction
    assert found is not None
    wedges, media = found.room.wedges, found.room.scene.media
    media.permittivity[:] = -1e20j  # metal of P.2040 is no perfect conductor at grazing incidence
    (e,) = np.flatnonzero(np.isclose(wedges.start[:, 2] + wedges.length / 2 * wedges.along[:, 2], 1.0))
    along, work, distance_m = wedges.along[e], np.zeros((6, 3)), 3.0
    for f, carrier_hz in enumerate((1e9, 10e9)):
        travel = 2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S * distance_m
        for source_rad in (0.4, 1.2, 2.5):
            for phi_rad in np.linspace(0.011, 2 * np.pi - 0.011, 96):
                towards = [
                    np.cos(angle) * wedges.tangent[e] + np.sin(angle) * wedges.normal[e]
                    for angle in (source_rad, phi_rad)
                ]
                fields = [along if is_soft else np.cross(k, along) for k in (-towards[0], towards[1])]
                waves, angles = (-towards[0], -towards[1]), (source_rad, phi_rad)
                complex_fields = tuple(field.astype(np.complex128) for field in fields)
                factor = diffract(wedges, media, int(e), f, waves, complex_fields, angles, np.sqrt(2 * travel), 9, work)
                total, expected = factor * np.exp(-1j * travel), 0j
                for angle, sign in ((phi_rad - source_rad, 1), (phi_rad + source_rad, -1 if is_soft else 1)):
                    argument = -np.exp(0.25j * np.pi) * np.sqrt(2 * travel) * np.cos(angle / 2)
                    expected += sign * np.exp(1j * travel * np.cos(angle)) * erfc(argument) / 2
                    total += sign * np.exp(1j * travel * np.cos(angle)) * (abs(angle) < np.pi)
                assert abs(total - expected) < 1e-8


@pytest.mark.parametrize(  # beside a screen's edge, and beside a box's
    ("polarization", "half_turns_free", "distance_m", "azimuth_rad"),
    [("V", 2.0, 0.5, 1.0), ("H", 2.0, 0.3, 2.1), ("V", 1.5, 1.0, 2.6), ("H", 1.5, 0.5, 1.0)],
)
def test_what_leaves_through_a_far_circle_is_the_power_radiated_beside_the_edge(
    polarization: str, half_turns_free: float, distance_m: float, azimuth_rad: float
) -> None:
    """The mean of |h·4πR/λ|² over a far circle is, by the wedge's exact series of Bessel functions, what a line source
    at that distance from the edge radiates over what it does in free space.

    Without diffraction it errs by 5e-3 or more; metal that is not perfect takes 5e-4.
    """
    extent_m, radius_m, carrier_hz = 1e4, 2e3, 1e9
    block = Surface("block", "metal", 0.01, (0.0, -extent_m, -extent_m), (extent_m, 0.0, extent_m))
    screen = replace(block, min_m=(0.0, 0.0, -extent_m))
    free_rad = half_turns_free * np.pi
    turn_rad = (np.arange(1500) + 0.5) * free_rad / 1500
    circle_m = radius_m * np.stack([np.cos(turn_rad), np.sin(turn_rad), 0 * turn_rad], axis=1)
    at_m = distance_m * np.cos(azimuth_rad), distance_m * np.sin(azimuth_rad), 0.0
    scene = scene_of(screen if half_turns_free == 2.0 else block, at_m=at_m, polarization=polarization)
    wavelength_m = SPEED_OF_LIGHT_M_S / carrier_hz
    with_edges, without = (
        np.mean(np.abs(channel.cfr * 4 * np.pi * radius_m / wavelength_m) ** 2) * half_turns_free / 2
        for asked in (ALL, ALL[:2])
        for channel in [tracer(scene, [carrier_hz], 2, interactions=asked).channel(circle_m)]
    )
    order = np.arange(200) / half_turns_free
    bessel2 = jv(order, 2 * np.pi * distance_m / wavelength_m) ** 2
    angular = np.sin(order * azimuth_rad) ** 2 if polarization == "V" else np.cos(order * azimuth_rad) ** 2
    expected = 4 / half_turns_free * (bessel2 @ angular)
    if polarization == "H":
        expected -= 2 / half_turns_free * bessel2[0]
    assert abs(with_edges - expected) < 1e-3
    assert abs(without - expected) > 5e-3


@pytest.mark.parametrize("material", ["metal", "glass"])
@pytest.mark.parametrize("side", [-3.0, 3.0])  # behind the sheet, at the shadow; before it, where it ceases to reflect
def test_the_field_is_continuous_where_another_path_ends(material: str, side: float) -> None:
    """Of horizontal antennas; `bench stress` has the vertical ones."""
    sheet = Surface("sheet", material, 0.008, (0.0, -20.0, -20.0), (0.0, 20.0, 1.0))
    scene = scene_of(sheet, polarization="H")
    beside_m = (-1e-6, -1e-9, 0.0, 1e-9, 1e-6)
    tx_m = np.array([(side, 0.0, 0.25 + beside) for beside in beside_m])  # on the line over the edge, or its image
    with_edges, without = (
        tracer(scene, [1e9, 10e9], max_depth=2, interactions=asked).channel(tx_m).cfr[..., 0]
        for asked in (ALL, ALL[:2])
    )
    jump_db = 20 * np.log10(np.abs(with_edges / with_edges[2]))
    assert np.abs(jump_db).max() < 1e-3  # within a micrometre; 0.1 dB are asked for
    assert np.abs(without[0] - without[-1]).min() > 0.1 * np.abs(without[-1]).min()


UPRIGHT = 0.0, 0.0, 0.0


@pytest.mark.parametrize(
    "antennas",
    [
        (("iso", "V", UPRIGHT), ("iso", "V", UPRIGHT)),
        (("iso", "V", UPRIGHT), ("iso", "H", UPRIGHT)),
        (("dipole", "H", (20.0, 40.0, -30.0)), ("tr38901", "V", (150.0, 30.0, 10.0))),
    ],
)
def test_the_two_ends_of_a_path_may_change_places(antennas: tuple[Any, Any]) -> None:
    surfaces = METAL_BOX, WOODEN_BOX, PANE, FLOOR
    ends = tuple(zip([(-0.3, 0.7, 1.9), (4.4, 1.3, 0.8)], antennas, strict=True))

    def paths_between(receiver: tuple[Any, Any], transmitter: tuple[Any, Any]) -> Paths:
        pattern, polarization, turned = receiver[1]
        antenna = {"pattern": pattern, "polarization": polarization, "antenna_orientation_deg": turned}
        scene = scene_of(*surfaces, at_m=receiver[0], **antenna)
        antenna = dict(zip(Antenna._fields, transmitter[1], strict=True))
        scene = replace(scene, transmitters=replace(GRID, **antenna))
        return tracer(scene, [1e9, 10e9], max_depth=4).paths(np.array(transmitter[0]))

    there, back = paths_between(*ends), paths_between(*ends[::-1])
    gains = [paths.gain[:, diffracted(paths)] for paths in (there, back)]
    assert gains[0].shape[1] >= 20
    np.testing.assert_allclose(gains[0], gains[1], rtol=0, atol=1e-12 * np.abs(gains[0]).max())


def test_a_metal_floor_doubles_the_paths_over_an_edge_by_the_transmitters_image() -> None:
    screen = Surface("screen", "metal", 0.002, (0.0, -4.0, 1.0), (0.0, 4.0, 1.6))
    floor = Surface("floor", "metal", 0.002, (-20.0, -20.0, 0.0), (20.0, 20.0, 0.0))
    tx_m, image_m = np.array([-2.0, 0.3, 0.8]), np.array([-2.0, 0.3, -0.8])
    paths = tracer(scene_of(screen, floor, polarization="H"), [10e9], max_depth=2).paths(tx_m)
    mirrored = tracer(scene_of(screen, polarization="H"), [10e9]).paths(image_m)
    first = np.flatnonzero(paths.interactions[:, 0] == SPECULAR)
    first = first[paths.interactions[first, 1] == DIFFRACTION]
    over = np.flatnonzero(diffracted(mirrored))
    assert len(first) == len(over) == 2
    np.testing.assert_allclose(paths.delay_s[first], mirrored.delay_s[over], rtol=1e-12)
    np.testing.assert_allclose(paths.vertices_m[first, 1], mirrored.vertices_m[over, 0], atol=1e-12)
    ratio = np.abs(paths.gain[0, first] / mirrored.gain[0, over])
    np.testing.assert_allclose(ratio, 1, rtol=1e-3)  # what the metal does not reflect


def test_sums_of_paths_equal_channels_and_elements_solved_alone() -> None:
    surfaces, carriers_hz, tx_m = (METAL_BOX, PANE, FLOOR), [1e9, 24e9], np.array([3.3, 1.1, 0.6])
    scene = scene_of(*surfaces, at_m=(0.4, 0.3, 2.0), rows=2, cols=2)
    savings = replace(EXACT, field_nodes_per_axis=2)
    channel = tracer(scene, carriers_hz, max_depth=3, savings=savings).channel(tx_m[None])
    for cfr, carrier_hz in zip(channel.cfr[0], carriers_hz, strict=True):
        places_m = scene.receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz)
        lone = (tracer(scene_of(*surfaces, at_m=tuple(place_m)), [carrier_hz], max_depth=3) for place_m in places_m)
        alone = [cfr_at_centre(of_element.paths(tx_m))[0] for of_element in lone]
        np.testing.assert_allclose(cfr, alone, rtol=0, atol=1e-9 * np.abs(alone).max())


def test_what_is_shared_and_skipped_hardly_changes_the_field_over_edges() -> None:
    scene = load_scene("office")
    tx_m = choose_transmitters(place_transmitters(scene, surface_meshes(scene)), 3, seed=1)
    plain = ImageSavings(share_visibility=False, field_nodes_per_axis=4, diffraction_floor=0.0)
    carriers_hz, settings = [1e9, 24.25e9], TraceSettings(interactions=ALL, max_depth=3, rays=2000)

    def over_edges(savings: ImageSavings) -> np.ndarray:
        whole, rest = (
            ImageTracer(scene, carriers_hz, replace(settings, interactions=asked), savings).channel(tx_m).cfr
            for asked in (ALL, ALL[:2])
        )
        return whole - rest

    exact = over_edges(plain)
    for savings, limit_db in (
        (replace(plain, share_visibility=True), -200),  # roundings
        (replace(plain, share_visibility=True, field_nodes_per_axis=2), -40),
        (replace(plain, diffraction_floor=1e-4), -60),
    ):
        error = np.linalg.norm(over_edges(savings) - exact, axis=2) / np.linalg.norm(exact, axis=2)
        assert 20 * np.log10(error.max() + 1e-30) < limit_db


def test_a_channel_does_not_depend_on_what_else_is_asked_for() -> None:
    """Neither on other carriers nor on other transmitters; 7e-3 at 2.4 GHz where the lowest carrier decided for all."""
    scene, settings = load_scene("office"), TraceSettings(max_depth=3, rays=20_000)
    tx_m = choose_transmitters(place_transmitters(scene, surface_meshes(scene)), 3, seed=1)
    whole = ImageTracer(scene, [1e9, 2.4e9, 94e9], settings).channel(tx_m)
    some = ImageTracer(scene, [2.4e9, 94e9], settings).channel(tx_m[::-2])
    same = whole.cfr[::-2][:, 1:]
    assert (np.linalg.norm(some.cfr - same, axis=2) / np.linalg.norm(same, axis=2)).max() < 1e-6
    np.testing.assert_array_equal(some.num_paths, whole.num_paths[::-2][:, 1:])


WALL_A = Surface("wall a", "concrete", 0.11, (1.5, 2.1, 0.0), (2.6, 2.1, 2.7))
WALL_B = Surface("wall b", "concrete", 0.12, (2.6, 2.1, 0.0), (2.6, 7.0, 2.7))
PANES = Surface("panes", "glass", 0.006, (0.0, 0.0, -20.0), (1.0, 1.0, 20.0))


@pytest.mark.parametrize("polarization", ["V", "H"])
@pytest.mark.parametrize(
    ("surfaces", "receiver_m", "over_m", "is_mirrored"),
    [
        # from inside a corner of two walls to outside: reflected at one wall on its way through the other, or not
        ((WALL_A, WALL_B), (5.5, 2.4, 2.1), (2.6, 2.1, 1.6), True),
        # through one pane of a box or through the other, both of which the transmitter lights
        ((PANES,), (2.0, 2.5, 0.0), (0.0, 0.0, 0.1), False),
        # beside a box or through two of its panes
        ((PANES,), (2.0, 2.5, 0.0), (1.0, 0.0, 0.1), False),
    ],
)
def test_the_field_is_continuous_where_paths_through_a_corner_end(
    surfaces: tuple[Surface, ...],
    receiver_m: tuple[float, float, float],
    over_m: tuple[float, float, float],
    is_mirrored: bool,
    polarization: str,
) -> None:
    """The line from the receiver to the edge goes on to the transmitter, mirrored at wall a or straight."""
    scene, edge_m = scene_of(*surfaces, at_m=receiver_m, polarization=polarization), np.array(over_m)
    towards_m = (edge_m - receiver_m) * [1.0, -1.0 if is_mirrored else 1.0, 1.0]
    aside_m = np.array([-towards_m[1], towards_m[0], 0.0]) / np.hypot(*towards_m[:2])
    beside_m = np.array([-1e-6, -3e-8, 3e-8, 1e-6])
    tx_m = edge_m + 0.8 * towards_m + beside_m[:, None] * aside_m
    with_edges, without = (
        tracer(scene, [2.4e9, 24.25e9], 3, interactions=asked).channel(tx_m).cfr[..., 0] for asked in (ALL, ALL[:2])
    )
    assert (np.abs(with_edges - with_edges[0]) / np.abs(with_edges[0])).max() < 2e-3  # a micrometre turns by 5e-4
    assert (np.abs(without[-1] - without[0]) / np.abs(with_edges[0])).min() > 0.02


def moved(surface: Surface, shift_m: np.ndarray, is_turned: bool) -> Surface:
    """A surface turned by 90° about the z axis, or not, and then shifted."""
    corners_m = np.array([surface.min_m, surface.max_m])
    corners_m = (corners_m[:, [1, 0, 2]] * [-1, 1, 1] if is_turned else corners_m) + shift_m
    low_m, high_m = corners_m.min(axis=0).tolist(), corners_m.max(axis=0).tolist()
    return replace(surface, min_m=tuple(low_m), max_m=tuple(high_m))


def test_a_channel_depends_neither_on_the_place_of_its_scene_nor_on_its_array() -> None:
    """To a thousandth, with the savings of all users; 7e-3 where weak paths were left out by the array's strongest."""
    surfaces, at_m = (METAL_BOX, WOODEN_BOX, PANE, FLOOR, WALL_A), np.array([-0.3, 0.7, 1.9])
    rng, carriers_hz = np.random.default_rng(3), [2.4e9, 24.25e9]
    tx_m = rng.uniform([0.0, -1.0, 0.2], [5.0, 4.0, 1.8], (12, 3))

    def channels(is_turned: bool, shift_m: np.ndarray, **receiver: Any) -> np.ndarray:
        places_m = np.vstack([at_m, tx_m])
        places_m = (places_m[:, [1, 0, 2]] * [-1, 1, 1] if is_turned else places_m) + shift_m
        turned = [moved(surface, shift_m, is_turned) for surface in surfaces]
        scene = scene_of(*turned, at_m=tuple(places_m[0].tolist()), **receiver)
        return tracer(scene, carriers_hz, 4, ImageSavings()).channel(places_m[1:]).cfr

    nowhere, there = np.zeros(3), np.array([31.4, -27.2, 0.6])
    lone, shifted, turned = channels(False, nowhere), channels(False, there), channels(True, nowhere)
    largest = np.abs(lone).max(axis=(1, 2), keepdims=True)
    assert (np.abs(shifted - lone) / largest).max() < 1e-3
    assert (np.abs(turned - lone) / largest).max() < 1e-3
    array = channels(False, nowhere, rows=3, cols=3)
    assert (np.abs(array[..., 4:5] - lone) / largest).max() < 1e-3  # the array's middle element is at its centre


def test_an_edge_seen_end_on_and_an_end_on_its_line_diffract_nothing() -> None:
    sheet = Surface("sheet", "metal", 0.002, (0.0, -1.0, 0.0), (0.0, 1.0, 1.0))
    scene = scene_of(sheet, at_m=(0.0, 3.0, 1.0))  # on the line of the sheet's upper rim
    tx_m = np.array([[0.0, -2.0, 1.0], [2.0, -2.0, 0.5]])
    channel = tracer(scene, [1e9]).channel(tx_m)
    assert np.isfinite(channel.cfr).all()
    over = tracer(scene, [1e9]).paths(tx_m[1])
    upper = np.isclose(over.vertices_m[:, 0], [0.0, np.nan, 1.0], equal_nan=True)[:, [0, 2]].all(axis=1)
    assert not (upper & diffracted(over)).any()
