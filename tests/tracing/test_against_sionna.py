"""Both solvers against public forward Sionna RT calls, and against each other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.support.sionna_scenes import (
    CARRIERS_HZ,
    CONCRETE_WALL,
    GRID,
    ONE_ELEMENT,
    RECEIVER,
    SETTINGS,
    TRANSMITTERS_M,
    moved,
    scene_of,
    simple_scenes,
)
from xfreqbench.bench.reference import read_reference
from xfreqbench.bench.solvers import map_errors
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import SurfaceMesh, surface_meshes, write_mitsuba
from xfreqbench.scene.model import POLARIZATION_PAIRS, ReceiverArray, Scene, TransmitterGrid, load_scene
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.paths import Paths
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import SolverName, Tracer, TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

pytestmark = pytest.mark.sionna

SOLVERS: tuple[SolverName, ...] = ("sionna", "image")
POLARIZATIONS = ("V", "H")
DIPOLE_H = replace(GRID, pattern="dipole", polarization="H")
TILTED = replace(GRID, pattern="dipole", orientation_deg=(20.0, 40.0, -30.0))
SECTOR = replace(GRID, pattern="tr38901", polarization="H", orientation_deg=(-100.0, -20.0, 10.0))
LOOKING = replace(ONE_ELEMENT, pattern="tr38901", boresight=(0.4, 1.0, -0.5))


def public_paths(scene: Scene, carrier_hz: float, tx: NDArray[np.float64]) -> Any:
    from xfreqbench.tracing.sionna.plain import loaded, solve

    loaded_scene, antenna = loaded(scene, carrier_hz), scene.transmitter_antenna
    return solve(loaded_scene, tx[None], SETTINGS.interactions, 3, SETTINGS.rays, 1, antenna)


def tracers(scene: Scene) -> list[Tracer]:
    return [tracer_of(scene, CARRIERS_HZ, replace(SETTINGS, solver=solver)) for solver in SOLVERS]


@pytest.mark.parametrize("polarization", POLARIZATIONS)
@pytest.mark.parametrize("name", simple_scenes())
def test_tracing_once_equals_a_public_solve_at_each_carrier_path_by_path(name: str, polarization: Any) -> None:
    scene = simple_scenes(replace(ONE_ELEMENT, polarization=polarization))[name]
    both = tracers(scene)
    for tx in TRANSMITTERS_M:
        found = [tracer.paths(tx) for tracer in both]
        for f, carrier_hz in enumerate(CARRIERS_HZ):
            public = public_paths(scene, carrier_hz, tx)
            gain = (public.a[0].numpy() + 1j * public.a[1].numpy()).reshape(-1)
            delay_s = public.tau.numpy().reshape(-1)
            order = np.argsort(delay_s)
            for paths in found:
                traced = paths.gain[f]
                heard = np.abs(traced) > 1e-6 * np.abs(traced).max()  # Sionna drops what has vanished
                np.testing.assert_allclose(paths.delay_s[heard], delay_s[order], rtol=1e-6)
                # The carrier phase is in neither gain, so float32 delays do not blur the comparison:
                # measured 1e-4 of the strongest path (Sionna's slab runs in float32).
                np.testing.assert_allclose(traced[heard], gain[order], rtol=0, atol=1e-3 * np.abs(gain).max())


@pytest.mark.parametrize(
    ("receiver", "transmitters"),
    [(ONE_ELEMENT, GRID), (ONE_ELEMENT, DIPOLE_H), (ONE_ELEMENT, TILTED), (LOOKING, GRID), (LOOKING, SECTOR)],
    ids=["equal antennas", "H to V", "tilted to V", "iso to sector", "sector to sector"],
)
def test_the_channel_is_the_public_channel_with_the_carrier_phase_counted_once(
    receiver: ReceiverArray, transmitters: TransmitterGrid
) -> None:
    scene = replace(simple_scenes(receiver)["a wall and a pane between"], transmitters=transmitters)
    both = [tracer.channel(TRANSMITTERS_M).cfr[..., 0] for tracer in tracers(scene)]
    for t, tx in enumerate(TRANSMITTERS_M):
        for f, carrier_hz in enumerate(CARRIERS_HZ):
            gain, _ = public_paths(scene, carrier_hz, tx).cir(normalize_delays=False, out_type="numpy")
            for cfr in both:
                # one float32 rounding of τ is 6e-8 · 2πfτ: at most 1e-3 rad at 94 GHz and 5 m
                assert abs(gain.sum() - cfr[t, f]) / np.abs(gain).sum() < 1e-3
                assert abs(cfr[t, f]) > 1e-7


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    ("interactions", "max_depth", "num_paths"),
    [
        (("specular", "refraction"), 3, 2),  # through the pane, and by the wall and the pane
        (("refraction",), 3, 1),
        (("specular",), 3, 0),  # the pane stands between
        (("specular", "refraction"), 0, 0),
        (("specular", "refraction"), 1, 1),
        ((), 3, 0),
    ],
)
def test_interactions_that_are_off_do_not_happen(
    interactions: Any, max_depth: int, num_paths: int, solver: SolverName
) -> None:
    scene = simple_scenes(ONE_ELEMENT)["a wall and a pane between"]
    settings = TraceSettings(solver=solver, interactions=interactions, max_depth=max_depth, rays=50_000)
    in_sight_m = np.array([3.1, 1.2, 1.1])
    tx_m = np.array([TRANSMITTERS_M[0], in_sight_m])
    behind, beside = tracer_of(scene, [1e9], settings).channel(tx_m).num_paths.ravel().tolist()
    assert behind == num_paths
    if not (interactions and max_depth):
        assert beside == 1  # the line of sight


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_defaults_meet_the_convergence_bar_on_the_office(solver: SolverName) -> None:
    office = load_scene("office")
    reference = read_reference(office)
    settings = TraceSettings(solver, ("specular", "refraction"))
    tracer = tracer_of(office, reference.carrier_hz.tolist(), settings)
    for error in map_errors(office, tracer.channel(reference.tx_position_m).cfr, reference.cfr):
        assert error.meets_bar and error.median_ssim > 0.99


def shortest_stretch_m(paths: Paths, tx_m: np.ndarray, receiver_m: np.ndarray) -> float:
    """The shortest stretch of any path between successive interactions, and its ends."""
    shortest = np.inf
    for points in paths.vertices_m:
        way = np.vstack([tx_m, points[np.isfinite(points[:, 0])], receiver_m])
        shortest = min(shortest, np.linalg.norm(np.diff(way, axis=0), axis=1).min())
    return float(shortest)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("offset_m", [(100.25, -70.5, 0.0), (691608.25, 5334762.5, 519.0)])  # the second is in UTM
def test_channels_do_not_depend_on_where_the_origin_is(
    offset_m: tuple[float, float, float], solver: SolverName
) -> None:
    scene, settings = simple_scenes()["a wall and a pane between"], replace(SETTINGS, solver=solver)
    here, there = (tracer_of(placed, CARRIERS_HZ, settings) for placed in (scene, moved(scene, offset_m)))
    channel, same = here.channel(TRANSMITTERS_M), there.channel(TRANSMITTERS_M + offset_m)
    np.testing.assert_array_equal(same.num_paths, channel.num_paths)
    error = np.linalg.norm(same.cfr - channel.cfr, axis=2) / np.linalg.norm(channel.cfr, axis=2)
    assert error.max() < 2e-4  # float32 within some metres of the receiver
    paths, shifted = here.paths(TRANSMITTERS_M[1]), there.paths(TRANSMITTERS_M[1] + offset_m)
    np.testing.assert_allclose(shifted.vertices_m - offset_m, paths.vertices_m, atol=1e-5)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("polarization", POLARIZATIONS)
@pytest.mark.parametrize("elements_per_side", [1, 3])
def test_the_field_right_below_an_element_is_that_beside_it(
    elements_per_side: int, polarization: Any, solver: SolverName
) -> None:
    floor = replace(CONCRETE_WALL, name="floor", min_m=(-4.0, -4.0, 0.0), max_m=(6.0, 6.0, 0.0))
    receiver = replace(RECEIVER, rows=elements_per_side, cols=elements_per_side, polarization=polarization)
    scene = scene_of(CONCRETE_WALL, floor, receiver=receiver)
    tx = np.array([[2.0, 1.5 + aside, z] for z in (0.7, 2.9) for aside in (0.0, 1e-7, 5e-6)])
    beside = np.array([[2.0, 1.5 + 1e-4, z] for z in (0.7, 2.9) for _ in range(3)])  # paths as long but for 1e-8
    truth = tracer_of(scene, CARRIERS_HZ, replace(SETTINGS, solver="image")).channel(beside).cfr
    tracer = tracer_of(scene, CARRIERS_HZ, replace(SETTINGS, solver=solver))
    largest = np.abs(truth).max(axis=(0, 2), keepdims=True)
    np.testing.assert_allclose(tracer.channel(tx).cfr / largest, truth / largest, atol=1e-3)
    assert (tracer.paths(tx[0]).gain[:, 1].real > 0).all()  # by the floor


def tilted(mesh: SurfaceMesh) -> SurfaceMesh:
    """The mesh turned about an axis that no plane is square to."""
    return replace(mesh, vertices_m=Rotation.from_rotvec([0.072, 0.096, 0.16]).apply(mesh.vertices_m))


def test_a_users_tilted_mesh_scene_is_traced_alike_by_both_solvers(tmp_path: Path) -> None:
    scene = simple_scenes()["two boxes"]
    wall, pane = surface_meshes(simple_scenes()["a wall and a pane between"])
    write_mitsuba([tilted(mesh) for mesh in (*surface_meshes(scene), wall, pane)], tmp_path)
    imported = replace(scene, surface=(), scene="scene.xml", folder=tmp_path)
    settings = TraceSettings(interactions=("specular", "refraction"), rays=400_000, max_depth=3)
    geometry = Geometry.of(imported)
    carriers_hz = CARRIERS_HZ[::2]
    image = (
        ImageTracer(imported, carriers_hz, settings, ImageSavings(field_nodes_per_axis=4)).channel(TRANSMITTERS_M).cfr
    )
    sionna = tracer_of(imported, carriers_hz, replace(settings, solver="sionna")).channel(TRANSMITTERS_M).cfr
    is_short = np.zeros(image.shape, bool)  # where Sionna RT drops a path
    for f, carrier_hz in enumerate(carriers_hz):
        for m, place_m in enumerate(scene.receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz)):
            receiver = replace(scene.receiver, rows=1, cols=1, position_m=tuple(place_m.tolist()))
            alone = replace(imported, receiver=receiver)
            tracer = ImageTracer(alone, [carrier_hz], replace(settings, rays=50_000), geometry=geometry)
            is_short[:, f, m] = [shortest_stretch_m(tracer.paths(tx), tx, place_m) < 0.011 for tx in TRANSMITTERS_M]
    assert 0 < is_short.mean() < 0.25
    # float32 vertices, and paths along an edge that one of the two misses
    error = np.where(is_short, 0, np.abs(sionna - image))
    assert error.max() < 5e-3 * np.abs(image).max()
    relative = np.linalg.norm(error, axis=2) / np.linalg.norm(image, axis=2)
    assert np.median(relative) < 5e-3


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("boresight", [(0.0, 0.0, -1.0), (1.0, 2.0, -2.0), (1.0, 0.0, 0.0), (-1.0, 3.0, 0.5)])
def test_a_traced_direct_path_peaks_where_the_transmitter_stands_in_the_receivers_frame(
    boresight: tuple[float, float, float], solver: SolverName
) -> None:
    receiver = replace(load_scene("empty").receiver, boresight=boresight, polarization="H")
    scene = replace(load_scene("empty"), receiver=receiver)
    pole = np.array(boresight) / np.linalg.norm(boresight)
    towards = pole + 0.4 * np.array([0.48, -0.6, 0.64])  # within the hemisphere, off every axis
    tx = np.asarray(receiver.position_m) + 3.0 * towards[None]
    channel = tracer_of(scene, CARRIERS_HZ, replace(SETTINGS, solver=solver)).channel(tx)
    grid = AngularGrid.hemisphere()
    maps, _ = BartlettBeam(receiver.element_position_wavelengths, grid).maps(channel.cfr[0])
    for pas_map in maps:
        peak = receiver.rotation @ grid.directions[np.unravel_index(pas_map.argmax(), grid.shape)]
        angle_deg = np.degrees(np.arccos(peak @ towards / np.linalg.norm(towards)))
        assert angle_deg < 2.5  # one degree of the grid, and the curved wave front at 1 GHz


@pytest.mark.parametrize("solver", SOLVERS)
def test_all_pairs_of_polarizations_are_those_of_a_public_solve_with_two_polarizations(solver: SolverName) -> None:
    from xfreqbench.tracing.sionna.plain import loaded, solve
    from xfreqbench.tracing.sionna.scene import rt

    scene, tx, carrier_hz = simple_scenes(ONE_ELEMENT)["two boxes"], TRANSMITTERS_M[:1], 10e9
    public = loaded(scene, carrier_hz)
    public.tx_array = public.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="VH")
    gain, _ = solve(public, tx, SETTINGS.interactions, 3, SETTINGS.rays, 1).cir(
        normalize_delays=False, out_type="numpy"
    )
    expected = gain[0, :, 0].sum(axis=(2, 3))  # heard by, sent by
    first = tracer_of(scene, [carrier_hz], replace(SETTINGS, solver=solver))
    for pair in POLARIZATION_PAIRS:
        traced = first.with_antennas(scene.with_polarization(pair)).channel(tx).cfr.item()
        sent, heard = ("VH".index(letter) for letter in pair)
        assert abs(traced - expected[heard, sent]) < 1e-3 * np.abs(expected).max(), pair
