"""Directions of reflecting planes found in power maps: free-standing rooms of plane waves, nothing traced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source.search.cross_terms import CrossTerms, aligned
from xfreqbench.baselines.virtual_source.search.planes import mirrored, plane_of
from xfreqbench.baselines.virtual_source.search.selection import mirrored_receivers_m

from tests.support.mirrored_room import RECEIVER, Room, Wall, tilt_rad
from xfreqbench.data.dataset import PasDataset
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

UPRIGHT_RECEIVER = ReceiverArray(position_m=(3.1, 2.4, 2.5), plane="yz", boresight=(0.0, 0.0, 1.0))
CARRIER_HZ = np.array([1e9, 2.4e9, 5e9, 10e9, 24.25e9])
SLANTED_WALL = Wall(azimuth_deg=17.0, elevation_deg=0.0, distance_m=4.63)
LEANING_WALL = Wall(azimuth_deg=-94.0, elevation_deg=2.0, distance_m=3.1, reflection=-0.4)
LEANING_FLOOR = Wall(azimuth_deg=30.0, elevation_deg=-87.0, distance_m=2.45, reflection=-0.5j)
WALLS = SLANTED_WALL, LEANING_WALL, LEANING_FLOOR
ROOM = Room(WALLS, CARRIER_HZ, num_tx=160)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return ROOM.stored(tmp_path_factory.mktemp("room"))


def found_in(data: PasDataset, seed: int = 0) -> np.ndarray:
    return mirrored_receivers_m(CrossTerms.of(data), seed)


def assert_found(images_m: np.ndarray, walls: Sequence[Wall]) -> None:
    """Exactly the walls: carriers one by one tell lengths but for a constant, up to two wavelengths of 24 GHz."""
    assert len(images_m) == len(walls)
    for wall in walls:
        image_m = max(images_m, key=lambda image_m: image_m @ wall.normal / np.linalg.norm(image_m))
        twice_m = float(np.linalg.norm(image_m))
        assert abs(twice_m / 2 - wall.distance_m) < 2 * SPEED_OF_LIGHT_M_S / CARRIER_HZ[-1]
        assert tilt_rad(image_m / twice_m, wall) < 3e-3  # a wavelength over the room


def test_a_slanted_wall_a_leaning_wall_and_a_leaning_floor_are_found_and_nothing_else(room: PasDataset) -> None:
    assert_found(found_in(room), WALLS)


@pytest.mark.slow
def test_planes_are_found_without_the_lowest_carrier_and_some_rows_too(room: PasDataset) -> None:
    is_kept = (room.carrier_hz > 2e9) & ((room.tx_index % 7 > 0) | (room.carrier_hz != 5e9))
    assert_found(found_in(room[np.flatnonzero(is_kept)]), WALLS)


def test_free_space_has_no_planes(tmp_path: Path) -> None:
    assert not len(found_in(replace(ROOM, walls=()).stored(tmp_path)))


def test_maps_do_not_tell_which_way_delays_run() -> None:
    """P = |B₀ + g B_p exp(−jφ)|², and beams B of a centred array are real: only cos φ is left for a real g."""
    beam = BartlettBeam(RECEIVER.element_position_wavelengths, AngularGrid.hemisphere(18, 72))
    upright = replace(ROOM, walls=(SLANTED_WALL, LEANING_WALL))
    forwards, backwards = (beam.maps(upright.cfr(sign)[:, 2])[0] for sign in (1, -1))
    np.testing.assert_allclose(forwards, backwards, atol=1e-5)  # single precision


@pytest.mark.slow
def test_two_walls_at_a_corner_are_not_taken_for_a_third_one(tmp_path: Path) -> None:
    walls = Wall(0.0, 0.0, 4.2), Wall(90.0, 0.0, 3.3)
    corner = replace(ROOM, walls=walls)
    twice_m = walls[0].mirrored(walls[1].mirrored(corner.offset_m))
    assert_found(found_in(corner.stored(tmp_path, corner.cfr() + corner.path(twice_m, 0.3))), walls)


def test_maps_without_amplitudes_tell_the_planes_too(tmp_path: Path) -> None:
    assert_found(found_in(ROOM.stored_maps(tmp_path, "phase-only", 65535)), WALLS)


@pytest.mark.slow
def test_a_vertical_array_finds_the_planes_too(tmp_path: Path) -> None:
    assert_found(found_in(replace(ROOM, receiver=UPRIGHT_RECEIVER).stored(tmp_path)), WALLS)


def test_few_transmitters_and_none_give_no_planes_and_no_errors(tmp_path: Path, room: PasDataset) -> None:
    assert not len(found_in(room[np.flatnonzero(room.tx_index < 5)]))
    assert not len(found_in(room[[]]))
    assert not len(found_in(ROOM.stored(tmp_path, np.zeros_like(ROOM.cfr()))))


@pytest.mark.slow
def test_one_carrier_is_searched_too(room: PasDataset) -> None:
    one = room[np.flatnonzero(room.carrier_hz == 2.4e9)]
    found = found_in(one)
    assert len(found)
    for image_m in found:
        # ten times the wavelength, ten times the tilt
        assert any(tilt_rad(image_m / np.linalg.norm(image_m), wall) < 2e-2 for wall in WALLS)


def test_channels_of_other_places_have_no_planes(tmp_path: Path) -> None:
    dealt_anew = np.random.default_rng(1).permutation(ROOM.cfr())
    assert not len(found_in(ROOM.stored(tmp_path, dealt_anew)))


def test_evidence_peaks_at_the_wall_at_every_carrier_and_is_chance_elsewhere(room: PasDataset) -> None:
    reference = CrossTerms.of(room)
    at_wall = aligned(reference, 2 * SLANTED_WALL.distance_m * SLANTED_WALL.normal).evidence
    places_m = 2 * np.linspace(6.0, 7.5, 301)[:, None] * SLANTED_WALL.normal
    elsewhere = np.array([aligned(reference, place_m).evidence for place_m in places_m])
    assert (at_wall > 10).all()
    assert max(at_wall.max(), elsewhere.max()) <= ROOM.num_tx * (1 + 1e-5)  # summed in single precision
    # independent phases would give 1; neighbours in distance share theirs at low carriers
    assert elsewhere[:, 2:].mean() == pytest.approx(1, abs=0.6)


@pytest.mark.filterwarnings("error")
def test_a_transmitter_where_the_receivers_image_is_says_nothing_of_the_plane(room: PasDataset) -> None:
    reference = CrossTerms.of(room)
    there = aligned(reference, reference.offset_m[3])
    assert not there.term[3].any()
    assert np.isfinite(there.gradient).all() and np.isfinite(there.evidence).all()


def test_a_plane_mirrors_points_at_equal_distances_along_its_normal() -> None:
    normal = np.array([2.0, -1.0, 2.0]) / 3
    mirrored_receiver_m = 2 * 1.7 * normal
    plane = plane_of(mirrored_receiver_m, np.eye(3) * 1e-6, 1.0)
    offset_m = np.random.default_rng(0).normal(size=(5, 3))
    image_m = mirrored(offset_m, mirrored_receiver_m)
    np.testing.assert_allclose((offset_m + image_m) @ normal / 2, 1.7, atol=1e-12)
    np.testing.assert_allclose(np.cross(image_m - offset_m, normal), 0, atol=1e-12)
    assert plane.distance_m == pytest.approx(1.7)
    assert plane.distance_std_m == pytest.approx(0.5e-3)  # half of the mirrored receiver's
    assert plane.tilt_std_rad == pytest.approx(1e-3 / 3.4)
    np.testing.assert_allclose(2 * plane.distance_m * plane.normal, mirrored_receiver_m, atol=1e-12)
