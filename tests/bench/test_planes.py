from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from xfreqbench.bench.planes import FoundWall, found_walls
from xfreqbench.bench.random_rooms import CARRIERS_HZ, RandomRoom
from xfreqbench.cli import measure
from xfreqbench.errors import XFreqBenchError
from xfreqbench.methods.virtual_source.search.planes import Plane


def plane(normal: np.ndarray, distance_m: float, std_m: float) -> Plane:
    return Plane(normal, distance_m, std_m, 1e-4, score=50.0)


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


def test_a_wall_is_the_nearest_plane_that_is_about_there() -> None:
    room = RandomRoom.of(0, 20)
    towards, distance_m = room.normal[3], float(room.distance_m[3])
    good, coarse = plane(towards, distance_m + 1e-3, 6e-4), plane(towards, distance_m - 1.9e-2, 1e-2)
    elsewhere = plane(-towards, distance_m, 1e-3)
    found = list(found_walls(room, [coarse, elsewhere, good]))
    assert [each.plane for each in found] == [None, None, None, good, None, None, None]
    assert found[3].error_m == pytest.approx(1e-3)
    assert found[3].is_covered
    assert not FoundWall("glass", replace(good, distance_std_m=4e-4), 1e-3, 0.0).is_covered
    assert not found[0].is_covered


@pytest.mark.parametrize(("rooms", "tx", "said"), [(0, 280, "--rooms .* got 0"), (1, 5, "--tx .* got 5")])
def test_numbers_out_of_bounds_are_refused(rooms: int, tx: int, said: str) -> None:
    with pytest.raises(XFreqBenchError, match=said):
        measure.bench_planes(rooms=rooms, tx=tx)
