from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.furnished_room import furnished_room
from xfreqbench.bench import patches
from xfreqbench.bench.patches import FINEST, PatchErrors, bench_patches, num_patches, plan_patches
from xfreqbench.bench.tables import Bench
from xfreqbench.cli import measure
from xfreqbench.errors import SceneError
from xfreqbench.runs.records import read
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import PatchSize, load_scene
from xfreqbench.tracing.solvers import make_tracer
from xfreqbench.types import ignore_progress

CARRIERS_HZ = [2.4e9, 24.25e9]
SIZES = PatchSize(0.005, 0.1), PatchSize(0.2, 0.2), PatchSize(1.0, 0.5)


def test_each_row_compares_channels_that_are_traced_with_its_own_least_patch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(patches, "SIZES", SIZES)
    scene = furnished_room(tmp_path, subdivisions=1)
    plan = plan_patches(scene, CARRIERS_HZ, 1)
    said: list[str] = []
    bench_patches(
        Bench("patches", "xfreqbench bench patches", said.append, tmp_path / "r.jsonl"), plan, ignore_progress
    )
    (record,) = read(tmp_path / "r.jsonl").benches
    assert record.columns == ("at least", "patches", "2.4 GHz", "24.25 GHz")
    rows = {row[0]: row[1:] for row in record.rows}
    assert len(rows) == len(SIZES)

    def channels(size: PatchSize) -> tuple[int, np.ndarray]:
        asked = replace(scene, least_patch_area_m2=size.area_m2, least_patch_width_m=size.width_m)
        cfr = make_tracer(asked, CARRIERS_HZ).channel(plan.tx_position_m).cfr
        return num_patches(Geometry(surface_meshes(asked))), cfr

    _, expected = channels(FINEST)
    for size, name in ((SIZES[0], "0.005 m², 0.1 m"), (SIZES[-1], "1 m², 0.5 m")):
        count, cfr = channels(size)
        error = np.linalg.norm(cfr - expected, axis=2) / np.linalg.norm(expected, axis=2)
        assert rows[name] == PatchErrors(size, count, error).cells[1:]
    # Both sides of table and screen have 0.99 and 0.48 m²; their edges, and all of cushion and foot, are smaller.
    assert rows["0.2 m², 0.2 m"][0] == "4" and rows["1 m², 0.5 m"][0] == "0"


def test_a_scene_without_meshes_is_refused_before_anything_is_traced() -> None:
    with pytest.raises(SceneError, match=r"Scene 'empty' has no meshes.*such as lounge"):
        measure.bench_patches("empty")
    plan = plan_patches(load_scene("lounge"), CARRIERS_HZ, 1)
    assert num_patches(plan.geometry) > 100
