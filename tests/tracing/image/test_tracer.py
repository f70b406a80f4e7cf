from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from threading import Event
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support import screened_room
from tests.support.reference import cfr_at_centre, slab_coefficients
from xfreqbench.errors import SceneError
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.facets import Geometry, group_by_plane, planar_facets
from xfreqbench.scene.materials import complex_permittivity
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Antenna, ReceiverArray, Scene, Surface, TransmitterGrid, load_scene
from xfreqbench.scene.placement import choose_transmitters, place_transmitters
from xfreqbench.tracing.image.kernels import compiled
from xfreqbench.tracing.image.kernels.channels import add_channel, paths_to_centre
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer, can_solve
from xfreqbench.tracing.paths import SPECULAR
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.units import PAPER_CARRIERS_GHZ, SPEED_OF_LIGHT_M_S, ghz_to_hz

CARRIERS_HZ = [ghz_to_hz(carrier) for carrier in PAPER_CARRIERS_GHZ]
GRID = TransmitterGrid(min_m=(0.0, 0.0, 0.0), max_m=(1.0, 1.0, 1.0), step_m=(1.0, 1.0, 1.0))
RECEIVER = ReceiverArray(position_m=(0.0, 0.0, 2.0))
PLAIN = TraceSettings(interactions=("specular", "refraction"), rays=2000)


def scene_of(*surfaces: Surface, receiver: ReceiverArray = RECEIVER) -> Scene:
    return Scene(name="test", receiver=receiver, transmitters=GRID, surface=surfaces)


@pytest.mark.parametrize("polarization", ["V", "H"])
def test_a_ray_along_the_vertical_is_the_limit_of_rays_beside_it(polarization: str) -> None:
    receiver = replace(RECEIVER, rows=1, cols=1, polarization=polarization)
    tx = np.array([[0.0, 0.0, 0.5], [1e-7, 0.0, 0.5], [0.0, -1e-7, 0.5]])
    along, *beside = ImageTracer(scene_of(receiver=receiver), [10e9], PLAIN).channel(tx).cfr
    for cfr in beside:
        np.testing.assert_allclose(along, cfr, rtol=1e-9)  # lengths differ by 1e-14, phases by 1e-12 rad


def field_of(antenna: dict[str, Any], direction: np.ndarray) -> np.ndarray:
    """Field of a transmitter towards a direction, along the polar angle's and the azimuth's unit vectors: (2,)."""
    at_m = tuple((np.array([0.0, 0.0, 2.0]) - direction).tolist())  # where the transmitter is
    field = []
    for polarization, sign in (("V", 1), ("H", -1)):  # at the receiver, θ̂ is that of the ray and φ̂ the opposite
        receiver = replace(RECEIVER, rows=1, cols=1, polarization=polarization)
        scene = replace(scene_of(receiver=receiver), transmitters=replace(GRID, **antenna))
        settings = TraceSettings(interactions=("refraction",), rays=1000)
        field.append(sign * ImageTracer(scene, [10e9], settings).paths(np.array(at_m)).gain[0, 0].real)
    return np.array(field) * 4 * np.pi * 10e9 / SPEED_OF_LIGHT_M_S


TILTED = 30.0, -50.0, 20.0  # bearing, downtilt, slant


@pytest.mark.parametrize("polarization", ["V", "H"])
@pytest.mark.parametrize("orientation_deg", [None, TILTED, (0.0, 0.0, 90.0)])
def test_a_dipole_sends_what_of_its_axis_is_across_the_direction(polarization: str, orientation_deg: Any) -> None:
    """The field of a Hertzian dipole: gain 3/2·sin² of the angle to its axis, z (V, downwards) or y (H)."""
    axis = np.array([0.0, 0.0, -1.0] if polarization == "V" else [0.0, 1.0, 0.0])
    if orientation_deg:
        axis = Rotation.from_euler("ZYX", orientation_deg, degrees=True).apply(axis)
    antenna = {"pattern": "dipole", "polarization": polarization, "orientation_deg": orientation_deg}
    for direction in np.array([[0.6, 0.0, 0.8], [-0.36, 0.48, -0.8], [0.28, -0.96, 0.0]]):
        level = np.hypot(*direction[:2])
        theta = np.array([direction[0] * direction[2], direction[1] * direction[2], -(level**2)]) / level
        expected = np.sqrt(1.5) * np.array([axis @ theta, axis @ np.cross(direction, theta)])
        np.testing.assert_allclose(field_of(antenna, direction), expected, atol=1e-9)
    along = axis + 1e-9  # off the pole of the receiver's frame
    assert np.linalg.norm(field_of(antenna, along / np.linalg.norm(along))) < 1e-7


def test_the_element_of_3gpp_has_the_gains_of_its_table() -> None:
    receiver = replace(RECEIVER, rows=1, cols=1, pattern="tr38901", boresight=(0.0, 1.0, 0.0))
    scene = scene_of(receiver=receiver)
    assert scene.transmitter_antenna == Antenna("iso", "V")  # not directive where nothing is stated
    tracer = ImageTracer(scene, [10e9], PLAIN)
    for off_deg, gain_dbi in ((0, 8.0), (32.5, 5.0), (65, -4.0), (180, -22.0)):
        turn = np.radians(off_deg)
        gain = tracer.paths(np.array([np.sin(turn), np.cos(turn), 2.0])).gain[0, 0]
        amplitude = abs(gain) * 4 * np.pi * 10e9 / SPEED_OF_LIGHT_M_S
        assert 20 * np.log10(amplitude) == pytest.approx(gain_dbi, abs=1e-6)


def in_polygons(surfaces: Sequence[Surface], turn: np.ndarray) -> list[Surface]:
    """Every facet of some surfaces as a polygon of its own, turned about the origin."""
    return [
        Surface(f"facet {n}", surfaces[i].material, surfaces[i].thickness_m, vertices_m=tuple(map(tuple, m @ turn.T)))
        for n, (m, i, _) in enumerate(planar_facets(surface_meshes(scene_of(*surfaces))))
    ]


def test_a_turned_room_of_polygons_is_the_room_of_boxes() -> None:
    cabinet = Surface("cabinet", "wood", 0.02, (1.0, 4.0, 0.0), (2.0, 4.5, 1.8))
    surfaces, receiver = (*screened_room.SCENE.surface, cabinet), screened_room.SCENE.receiver
    about_z = Rotation.from_euler("z", 33, degrees=True)
    turn = about_z.as_matrix()
    orientation = tuple((about_z * Rotation.from_quat(receiver.quaternion_xyzw)).as_quat().tolist())
    turned = replace(receiver, position_m=tuple(turn @ receiver.position_m), orientation=orientation)
    settings = TraceSettings(interactions=("specular", "refraction", "diffraction"), max_depth=3, rays=5000)
    tx_m = np.array([[1.0, 1.0, 1.0], [6.0, 3.0, 1.0], [1.5, 4.9, 0.7]])
    upright, aslant = scene_of(*surfaces, receiver=receiver), scene_of(*in_polygons(surfaces, turn), receiver=turned)
    boxes = ImageTracer(upright, [1e9, 24.25e9], settings).channel(tx_m)
    polygons = ImageTracer(aslant, [1e9, 24.25e9], settings).channel(tx_m @ turn.T)
    np.testing.assert_array_equal(polygons.num_paths, boxes.num_paths)
    np.testing.assert_allclose(polygons.cfr, boxes.cfr, rtol=0, atol=1e-9 * np.abs(boxes.cfr).max())


def test_a_concave_polygon_is_the_rectangles_that_make_it_up() -> None:
    """An L of one piece or of two: the joint between them neither reflects nor diffracts."""
    corners = [(-4, -4), (4, -4), (4, 0), (0.5, 0), (0.5, 3), (-4, 3)]
    whole = Surface("L", "glass", 0.01, vertices_m=tuple((float(x), float(y), 1.0) for x, y in corners))
    rectangles = [((-4.0, -4.0, 1.0), (4.0, 0.0, 1.0)), ((-4.0, 0.0, 1.0), (0.5, 3.0, 1.0))]
    parts = [Surface(f"part {n}", "glass", 0.01, *corners_m) for n, corners_m in enumerate(rectangles)]
    settings = TraceSettings(interactions=("specular", "refraction", "diffraction"), max_depth=2, rays=5000)
    tx_m = np.array([[0.3, 0.2, 0.1], [0.6, 0.1, 1.9], [3.0, -1.0, 1.8]])
    found, expected = (
        ImageTracer(scene_of(*surfaces), [10e9], settings).channel(tx_m).cfr for surfaces in ([whole], parts)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("material", ["plasterboard", "concrete", "glass", "metal"])
@pytest.mark.parametrize("polarization", ["V", "H"])
def test_a_walls_reflection_equals_the_fresnel_slab(material: str, polarization: str) -> None:
    floor = Surface("floor", material, 0.02, (-50.0, -50.0, 0.0), (50.0, 50.0, 0.0))
    receiver = replace(RECEIVER, polarization=polarization)
    tracer = ImageTracer(scene_of(floor, receiver=receiver), CARRIERS_HZ, replace(PLAIN, max_depth=1, rays=1000))
    tx = np.array([3.0, 0.0, 1.0])
    paths = tracer.paths(tx)
    reflected = np.flatnonzero(paths.interactions[:, 0] == SPECULAR)
    assert len(paths.delay_s) == 2
    distance_m = np.hypot(3.0, 3.0)
    assert paths.delay_s[reflected[0]] == pytest.approx(distance_m / SPEED_OF_LIGHT_M_S)
    for carrier_hz, gain in zip(CARRIERS_HZ, paths.gain[:, reflected[0]], strict=True):
        te, tm, *_ = slab_coefficients(complex_permittivity(material, carrier_hz), 0.02, carrier_hz, np.sqrt(0.5))
        # horizontal antennas see TE alone. Vertical ones see TM, with the sign of θ̂ before and after:
        # k = (1, 0, −1)/√2 → θ̂ = (−1, 0, −1)/√2; after reflection θ̂ of −k' is (−1, 0, −1)/√2 as well
        coefficient = te if polarization == "H" else tm
        expected = abs(coefficient) * SPEED_OF_LIGHT_M_S / carrier_hz / (4 * np.pi * distance_m)
        assert abs(gain) == pytest.approx(expected, rel=1e-6)


def test_every_saving_leaves_the_answer_as_it_is() -> None:
    scene = load_scene("office")
    tx = choose_transmitters(place_transmitters(scene, surface_meshes(scene)), 4, seed=1)
    carriers = [1e9, 10e9, 94e9]
    settings = replace(PLAIN, max_depth=4, rays=20_000)
    plain = ImageSavings(prune=False, share_visibility=False, field_nodes_per_axis=4)
    reference = ImageTracer(scene, carriers, settings, plain).channel(tx)
    for savings in (replace(plain, prune=True), replace(plain, share_visibility=True)):
        saved = ImageTracer(scene, carriers, settings, savings).channel(tx)
        np.testing.assert_allclose(saved.cfr, reference.cfr, rtol=0, atol=1e-12 * np.abs(reference.cfr).max())
        np.testing.assert_array_equal(saved.num_paths, reference.num_paths)
    interpolated = ImageTracer(scene, carriers, settings, replace(plain, field_nodes_per_axis=2)).channel(tx)
    beam = BartlettBeam(scene.receiver.element_position_wavelengths, AngularGrid.hemisphere())
    for f in range(len(carriers)):
        error = beam.maps(interpolated.cfr[:, f])[0] - beam.maps(reference.cfr[:, f])[0]
        assert np.sqrt((error**2).mean(axis=(1, 2))).max() < 10 ** (-70 / 20)  # 70 dB; measured 79 dB or more


def test_paths_of_more_reflections_are_left_out_and_no_others() -> None:
    scene, carriers_hz = load_scene("office"), [1e9, 94e9]
    settings = replace(PLAIN, max_depth=4, rays=50_000)
    tx = choose_transmitters(place_transmitters(scene, surface_meshes(scene)), 3, seed=1)
    everything = [ImageTracer(scene, carriers_hz, settings).paths(position_m) for position_m in tx]
    for most, rays in ((0, 50_000), (1, 50_000), (2, 50_000), (2, 600)):
        few = ImageTracer(scene, carriers_hz, replace(settings, rays=rays), ImageSavings(max_reflections=most))
        for whole, some in zip(everything, map(few.paths, tx), strict=True):
            kept = (whole.interactions == SPECULAR).sum(axis=1) <= most
            assert 0 < kept.sum() < len(kept)
            if rays == settings.rays:
                np.testing.assert_allclose(some.delay_s, whole.delay_s[kept], rtol=1e-12)
                np.testing.assert_allclose(some.gain, whole.gain[:, kept], rtol=1e-9)
            else:  # more sequences of planes than rays, so that rays find them
                assert ((some.interactions == SPECULAR).sum(axis=1) <= most).all()


def visibility_apart(scene: Scene, tx: np.ndarray, max_depth: int) -> float:
    """Largest difference of channels decided by corners from those of every element, relative to each sample's norm."""
    settings = replace(PLAIN, max_depth=max_depth, rays=2000)
    by_corners, by_elements = (
        ImageTracer(scene, [1e9, 94e9], settings, ImageSavings(share_visibility=share, field_nodes_per_axis=4))
        .channel(tx)
        .cfr
        for share in (True, False)
    )
    return float((np.linalg.norm(by_corners - by_elements, axis=2) / np.linalg.norm(by_elements, axis=2)).max())


@pytest.mark.parametrize("apart_m", [2e-4, 6e-3, 12e-3])  # of 6 mm: a pane as a closed box
def test_two_slabs_as_near_as_they_may_be_pass_what_each_of_them_passes(apart_m: float) -> None:
    faces = (Surface("pane", "glass", 0.003, (-apart_m / 2, -20.0, -20.0), (apart_m / 2, 20.0, 20.0)),)
    receiver = ReceiverArray(position_m=(3.0, 0.0, 1.5), rows=1, cols=1, boresight=(-1.0, 0.0, 0.0))
    tx_m = np.array([[-3.0, y, 1.5] for y in (0.0, 2.0, 6.0, 12.0)])
    settings = replace(PLAIN, max_depth=2)
    cfr = ImageTracer(scene_of(*faces, receiver=receiver), [5e9], settings).channel(tx_m).cfr[:, 0, 0]
    distance_m = np.linalg.norm(tx_m - receiver.position_m, axis=1)
    eta, turns = complex_permittivity("glass", 5e9), distance_m * 5e9 / SPEED_OF_LIGHT_M_S
    alone = np.array([slab_coefficients(eta, 0.003, 5e9, 6 / length_m)[2] for length_m in distance_m])  # TE
    np.testing.assert_allclose(cfr, np.exp(-2j * np.pi * turns) / (4 * np.pi * turns) * alone**2, rtol=1e-9)


def test_an_array_across_the_plane_of_a_sheet_is_not_judged_by_its_corners_alone() -> None:
    receiver = ReceiverArray(position_m=(0.245, -0.275, 1.5), rows=2, cols=12, boresight=(1.45, 0.51, 0.0))
    sheet = Surface("sheet", "glass", 0.005, (0.0, 0.0, 0.0), (1.0, 0.0, 3.0))
    tx = np.array([(-1.0, 1.0, 1.5), (-0.8, 1.2, 1.4), (-1.3, 0.9, 1.6)])
    scene = scene_of(sheet, receiver=receiver)  # in the way of some elements, but of no corner
    assert visibility_apart(scene, tx, max_depth=1) < 1e-12


def test_the_first_of_two_facets_that_overlap_in_a_plane_reflects_where_it_is() -> None:
    small = Surface("small", "glass", 0.005, (1.0, -2.0, 0.6), (1.5, 2.0, 0.6))
    large = Surface("large", "metal", 0.005, (0.0, -2.0, 0.6), (3.0, 2.0, 0.6))
    tx = np.array([(3.0, 0.1, 2.0), (2.9, -0.2, 2.1)])  # half of the elements' reflections lie on the small one
    assert visibility_apart(scene_of(small, large), tx, max_depth=1) < 1e-12  # roundings of a sum of paths


def test_a_plane_crossed_twice_over_counts_once() -> None:
    sheets = (
        Surface("left", "glass", 0.01, (-5.0, -5.0, 1.5), (2.0, 5.0, 1.5)),
        Surface("right, over the left", "glass", 0.01, (0.2, -5.0, 1.5), (5.0, 5.0, 1.5)),
    )
    tx = np.array([[3.0, 0.3, 1.0]])
    settings = replace(PLAIN, max_depth=1, rays=1000)
    for savings in (ImageSavings(), ImageSavings(prune=False, share_visibility=False, field_nodes_per_axis=4)):
        assert ImageTracer(scene_of(*sheets), [10e9], settings, savings).channel(tx).num_paths == 1


def test_a_path_whose_field_vanishes_on_the_way_is_not_counted() -> None:
    slab = Surface("slab", "concrete", 0.4, (-9.0, -9.0, 1.5), (9.0, 9.0, 1.5))
    tracer = ImageTracer(scene_of(slab), [1e9, 94e9], replace(PLAIN, max_depth=1, rays=1000))
    channel = tracer.channel(np.array([[1.0, 0.3, 1.0]]))
    assert channel.num_paths.tolist() == [[1, 0]]
    assert channel.cfr[0, 0].all()
    assert not channel.cfr[0, 1].any()


def test_wide_arrays_get_the_field_at_every_element() -> None:
    scene = load_scene("office")
    scene = replace(scene, receiver=replace(scene.receiver, rows=1, cols=8))
    tx = choose_transmitters(place_transmitters(scene, surface_meshes(scene)), 4, seed=1)
    settings = replace(PLAIN, max_depth=3, rays=50_000)
    exact = ImageTracer(scene, [1e9], settings, ImageSavings(field_nodes_per_axis=64)).channel(tx).cfr
    np.testing.assert_array_equal(ImageTracer(scene, [1e9], settings).channel(tx).cfr, exact)


def test_path_sums_equal_channels() -> None:
    scene = load_scene("two_rooms")
    scene = replace(scene, receiver=replace(scene.receiver, rows=1, cols=1))
    tx = choose_transmitters(place_transmitters(scene, surface_meshes(scene)), 3, seed=1)
    tracer, other = (ImageTracer(scene, CARRIERS_HZ[::3], TraceSettings(max_depth=4, rays=20_000)) for _ in range(2))
    channel = tracer.channel(tx)
    np.testing.assert_array_equal(other.paths(tx[0]).gain, tracer.paths(tx[0]).gain)  # skipped alike, asked for first
    for position_m, cfr in zip(tx, channel.cfr, strict=True):
        paths = tracer.paths(position_m)
        np.testing.assert_allclose(cfr_at_centre(paths), cfr[:, 0], rtol=1e-7, atol=1e-12)
        assert (np.diff(paths.delay_s) >= 0).all()
        np.testing.assert_allclose(np.linalg.norm(paths.arrival, axis=1), 1)
        first = np.where(np.isnan(paths.vertices_m[:, 0]), position_m, paths.vertices_m[:, 0])
        assert np.isfinite(first).all()


def test_a_metal_box_around_the_receiver_leaves_a_channel_of_zeros() -> None:
    box = Surface("box", "metal", 0.01, (-0.5, -0.5, 1.5), (0.5, 0.5, 2.5))
    tracer = ImageTracer(scene_of(box), [94e9], replace(PLAIN, rays=1000))
    channel = tracer.channel(np.array([[3.1, 0.23, 0.9]]))
    assert not channel.cfr.any()
    assert not channel.num_paths.any()
    assert tracer.paths(np.array([3.1, 0.23, 0.9])).gain.shape == (1, 0)


def test_depth_counts_reflections_and_transmissions_alike() -> None:
    sheets = [Surface(f"sheet {x}", "glass", 0.01, (x, -9.0, -9.0), (x, 9.0, 9.0)) for x in (1.0, 2.0)]
    tx = np.array([[3.0, 0.3, 1.0]])
    counts = [
        int(ImageTracer(scene_of(*sheets), [5e9], replace(PLAIN, max_depth=d, rays=2000)).channel(tx).num_paths[0, 0])
        for d in range(5)
    ]
    # none sees through two sheets with less than two transmissions; two more reflections between the
    # sheets take a depth of four
    assert counts == [0, 0, 1, 1, 2]


def test_boxes_become_six_parallelograms_and_walls_in_one_plane_share_it() -> None:
    box = Surface("box", "metal", 0.01, (0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    left = Surface("left", "glass", 0.01, (1.0, 5.0, 0.0), (1.0, 6.0, 1.0))
    facets = planar_facets(surface_meshes(scene_of(box, left)))
    assert [len(facet.corners_m) for facet in facets] == [4] * 7
    planes, plane = group_by_plane(facets)
    assert len(planes) == 6
    assert len(set(plane.tolist())) == 6


def test_the_solver_declines_what_it_cannot_do() -> None:
    office = Geometry(surface_meshes(load_scene("office")))
    assert can_solve(office, PLAIN)
    assert can_solve(office, TraceSettings(interactions=("specular", "diffraction")))
    assert not can_solve(office, TraceSettings(interactions=("specular", "diffuse")))
    with pytest.raises(SceneError, match="Use --solver sionna"):
        ImageTracer(load_scene("office"), [1e9], TraceSettings(interactions=("specular", "diffuse")))


def test_one_carrier_and_positions_of_a_file_are_traced_by_the_kernels_of_others() -> None:
    """Numba compiles a kernel for every order of axes of its arrays, and for read-only ones, in half a minute each."""
    positions_m = np.array([[1.0, 1.0, 1.0]])
    wall = Surface("wall", "concrete", 0.2, (-3.0, -3.0, 0.0), (-3.0, 3.0, 3.0))
    pane = Surface("pane", "glass", 0.01, (3.0, -3.0, 0.0), (3.0, 3.0, 3.0))
    for carriers_hz in CARRIERS_HZ[:1], CARRIERS_HZ[:2]:
        tracer = ImageTracer(scene_of(wall, pane), carriers_hz, TraceSettings(rays=2000))
        tracer.channel(positions_m)
        tracer.paths(positions_m[0])
        positions_m.flags.writeable = False
    for kernel in (add_channel, paths_to_centre):
        assert len(kernel.signatures) == 1  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_in_every_process_and_on_any_number_of_threads() -> None:
    program = """
import hashlib, sys
import numba
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.tracer import TraceSettings
import numpy as np
numba.set_num_threads(int(sys.argv[1]))
tx = np.array([[1.0, 1.0, 1.0], [7.0, 2.0, 1.3], [6.1, 3.3, 1.0]])
tracer = ImageTracer(load_scene("two_rooms"), [1e9, 60e9], TraceSettings(max_depth=4, rays=20_000))
print(hashlib.sha256(tracer.channel(tx[:int(sys.argv[2])]).cfr[:2].tobytes()).hexdigest())
"""
    commands = ([sys.executable, "-c", program, threads, number] for threads, number in (("1", "3"), ("2", "2")))
    digests = {subprocess.run(command, capture_output=True, text=True, check=True).stdout for command in commands}
    assert len(digests) == 1


def test_an_interruption_does_not_wait_for_threads_that_compile_or_compute(monkeypatch: pytest.MonkeyPatch) -> None:
    computes, may_end = Event(), Event()

    def call(number: int) -> None:
        if number == 0:
            computes.wait()
            raise KeyboardInterrupt
        computes.set()
        may_end.wait()

    monkeypatch.setattr(compiled, "num_threads", lambda: 2)
    with pytest.raises(KeyboardInterrupt):
        compiled.on_threads(call, 2)
    may_end.set()


def test_lengths_of_paths_between_two_plates_over_100_m_are_those_of_unfolded_lines() -> None:
    plates = [Surface(f"at {z}", "metal", 0.01, (-20.0, -60.0, z), (120.0, 60.0, z)) for z in (0.0, 4.0)]
    scene = scene_of(*plates, receiver=replace(RECEIVER, rows=1, cols=1))
    paths = ImageTracer(scene, [94e9], replace(PLAIN, max_depth=5, rays=200_000)).paths(np.array([100.0, 0.0, 1.0]))
    assert sorted((paths.interactions == SPECULAR).sum(axis=1)) == [0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    image_m = np.array([8.0 * turn + side for turn in range(-3, 4) for side in (1, -1)])
    length_m = np.hypot(np.longdouble(100), image_m - RECEIVER.position_m[2])
    # some roundings of 100 m
    assert np.abs(paths.delay_s[:, None] * SPEED_OF_LIGHT_M_S - length_m).min(axis=1).max() < 1e-12
