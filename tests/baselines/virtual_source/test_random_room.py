"""Rooms that no setting was chosen for: seven walls, no upright one along an axis, as a seed makes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source.field import field as field_module
from xfreqbench.baselines.virtual_source.method import VirtualSource
from xfreqbench.baselines.virtual_source.search.planes import Plane
from xfreqbench.baselines.virtual_source.search.range_profile import find_planes
from xfreqbench.baselines.virtual_source.stored import StoredFindings

from tests.support.random_rooms import RandomRoom, found_walls
from xfreqbench.data.splits import make_splits
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within

HZ = 24.25e9


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_most_walls_of_random_rooms_are_found_and_one_predicts_a_carrier_that_it_was_not_trained_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Intervals of 95 % hold the walls; what is found in the last room is what the method is fitted with there."""
    walls = []
    for seed in (0, 201):
        room = RandomRoom.of(seed, 200)
        data = room.traced(tmp_path / f"{seed}.h5")
        (split,) = make_splits(data, "lofo", [HZ / 1e9])
        planes = find_planes(data[split.train], 0)
        walls += found_walls(room, planes)
    found = [wall for wall in walls if wall is not None]
    assert len(found) > 0.85 * len(walls)
    assert np.median([abs(error_m) for error_m, _ in found]) < 2e-4
    assert np.mean([abs(error_m) < 1.96 * std_m for error_m, std_m in found]) > 0.9

    monkeypatch.setattr(field_module, "find_planes", lambda *_: planes)
    method = VirtualSource()
    fit_within(method, data[split.train], Budget(max_maps=3000), 0)
    learned = [
        Plane(np.array(plane.normal), plane.distance_m, plane.distance_std_m, plane.tilt_std_rad, score=0.0)
        for plane in StoredFindings.model_validate(method.findings()).planes
    ]
    assert all(wall is not None and abs(wall[0]) < 2e-3 for wall in found_walls(room, learned))
    tested = data[split.test]
    maps = method.predict(tested.tx_position_m, tested.carrier_hz)
    assert np.median(ssim(maps, tested.pas(), tested.grid)) > 0.925  # measured 0.932
