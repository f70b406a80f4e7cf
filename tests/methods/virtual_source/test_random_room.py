"""A room that no setting was chosen for: seven walls, no upright one along an axis, as a seed makes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source import VirtualSource

from xfreqbench.bench.planes import found_walls
from xfreqbench.bench.random_rooms import RandomRoom
from xfreqbench.data.splits import make_splits
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within
from xfreqbench.methods.virtual_source.search.planes import Plane
from xfreqbench.methods.virtual_source.told import StoredFindings

HZ = 24.25e9


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_a_random_room_is_found_and_predicts_a_carrier_that_it_was_not_trained_on(tmp_path: Path) -> None:
    room = RandomRoom.of(201, 240)
    data = room.traced(tmp_path / "room.h5")
    (split,) = make_splits(data, "lofo", [HZ / 1e9])
    method = VirtualSource()
    fit_within(method, data.subset(split.train), Budget(max_maps=12_000), 0)
    told = StoredFindings.model_validate(method.findings()).planes
    planes = [
        Plane(np.array(each.normal), each.distance_m, each.distance_std_m, each.tilt_std_rad, score=0.0)
        for each in told
    ]
    walls = list(found_walls(room, planes))
    assert all(wall.plane is not None and abs(wall.error_m) < 2e-3 for wall in walls)
    tested = data.subset(split.test)
    maps = method.predict(tested.tx_position_m, tested.carrier_hz)
    assert np.median(ssim(maps, tested.pas(), tested.grid)) > 0.96
