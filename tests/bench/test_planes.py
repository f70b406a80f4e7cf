from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from xfreqbench.bench.planes import FoundWall, bench_planes, found_walls
from xfreqbench.bench.random_rooms import CARRIERS_HZ, RandomRoom
from xfreqbench.bench.tables import Bench
from xfreqbench.cli import measure
from xfreqbench.errors import XFreqBenchError
from xfreqbench.methods.virtual_source.search.planes import Plane
from xfreqbench.runs.records import read
from xfreqbench.types import ignore_progress


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


def test_the_table_counts_walls_by_material(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def found_but_for_glass(data: object, seed: int) -> list[Plane]:
        room = RandomRoom.of(seed, 20)
        kept = [index for index, wall in enumerate(room.walls) if wall.material != "glass"]
        planes = [plane(room.normal[index], float(room.distance_m[index]) + 1e-4, 1e-4) for index in kept]
        return [*planes, plane(room.normal[0], 9.0, 1e-4)]

    monkeypatch.setattr("xfreqbench.bench.planes.find_planes", found_but_for_glass)
    bench = Bench("planes", "xfreqbench bench planes", lambda text: None, tmp_path / "r.jsonl")
    bench_planes(bench, 2, 20, ignore_progress)
    (record,) = read(tmp_path / "r.jsonl").benches
    rows = {row[0]: row[1:] for row in record.rows}
    num_glass = sum(wall.material == "glass" for seed in (0, 1) for wall in RandomRoom.of(seed, 20).walls)
    assert rows["all"] == ("14", str(14 - num_glass), "0.100", "0.100", "0.000", "1.00")
    assert rows["glass"] == (str(num_glass), "0", "—", "—", "—", "—")
    assert "2 more planes" in record.note


@pytest.mark.parametrize(("rooms", "tx", "said"), [(0, 280, "--rooms .* got 0"), (1, 5, "--tx .* got 5")])
def test_numbers_out_of_bounds_are_refused(rooms: int, tx: int, said: str) -> None:
    with pytest.raises(XFreqBenchError, match=said):
        measure.bench_planes(rooms=rooms, tx=tx)
