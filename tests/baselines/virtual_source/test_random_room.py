"""Rooms that no setting was chosen for: seven walls, no upright one along an axis, as a seed makes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source.method import VirtualSource
from xfreqbench.baselines.virtual_source.search.planes import Plane
from xfreqbench.baselines.virtual_source.search.range_profile import find_planes
from xfreqbench.baselines.virtual_source.stored import StoredFindings

from tests.support.random_rooms import CARRIERS_HZ, RandomRoom, found_walls
from xfreqbench.data.splits import make_splits
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within

HZ = 24.25e9


@pytest.mark.parametrize("seed", range(5))
def test_a_random_room_holds_its_array_and_its_transmitters(seed: int, tmp_path: Path) -> None:
    room = RandomRoom.of(seed, 20)
    offset_m = np.vstack([np.zeros(3), room.tx_position_m - room.receiver.position_m])
    assert (offset_m @ room.normal.T < room.distance_m).all()
    assert (room.distance_m > 0).all()
    for wall, normal, distance_m in zip(room.walls, room.normal, room.distance_m, strict=True):
        corners_m = wall.vertices_m - room.receiver.position_m
        np.testing.assert_allclose(corners_m @ normal, distance_m, atol=1e-12)
    upright = room.normal[np.abs(room.normal[:, 2]) < 0.5]
    assert len(upright) == 5
    assert np.abs(upright[:, :2]).max() < 1  # none along an axis
    data = room.traced(tmp_path / "room.h5")
    assert len(data) == 20 * len(CARRIERS_HZ)
    assert data.has_path.all()


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_most_walls_of_random_rooms_are_found_and_intervals_of_95_percent_hold_them(tmp_path: Path) -> None:
    walls = []
    for seed in range(2):
        room = RandomRoom.of(seed, 220)
        walls += found_walls(room, find_planes(room.traced(tmp_path / f"{seed}.h5"), seed))
    found = [wall for wall in walls if wall is not None]
    assert len(found) > 0.85 * len(walls)
    assert np.median([abs(error_m) for error_m, _ in found]) < 2e-4
    assert np.mean([abs(error_m) < 1.96 * std_m for error_m, std_m in found]) > 0.9


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_a_random_room_is_found_and_predicts_a_carrier_that_it_was_not_trained_on(tmp_path: Path) -> None:
    room = RandomRoom.of(201, 200)
    data = room.traced(tmp_path / "room.h5")
    (split,) = make_splits(data, "lofo", [HZ / 1e9])
    method = VirtualSource()
    fit_within(method, data.subset(split.train), Budget(max_maps=5000), 0)
    planes = [
        Plane(np.array(plane.normal), plane.distance_m, plane.distance_std_m, plane.tilt_std_rad, score=0.0)
        for plane in StoredFindings.model_validate(method.findings()).planes
    ]
    assert all(wall is not None and abs(wall[0]) < 2e-3 for wall in found_walls(room, planes))
    tested = data.subset(split.test)
    maps = method.predict(tested.tx_position_m, tested.carrier_hz)
    assert np.median(ssim(maps, tested.pas(), tested.grid)) > 0.955  # measured 0.963
