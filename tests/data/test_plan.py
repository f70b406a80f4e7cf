from __future__ import annotations

import pickle
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from tests.support.furnished_room import GRID, RECEIVER, plate, write_meshes
from tests.support.plans import CARRIERS_HZ, SETTINGS, plan_generation, small_plan
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.trace import forget_rays, traced
from xfreqbench.errors import (
    ClusterError,
    MaterialBandError,
    OutOfMemoryError,
    PlacementError,
    UnknownNameError,
    XFreqBenchError,
)
from xfreqbench.scene import facets
from xfreqbench.scene.model import Scene, load_scene
from xfreqbench.system import machine
from xfreqbench.tracing.tracer import SolverName, TraceSettings


@pytest.mark.parametrize(
    ("asked", "error", "words"),
    [
        ({"carriers_hz": [1e9, 1e9]}, XFreqBenchError, "once"),
        ({"carriers_hz": [0.9e9]}, MaterialBandError, "from 1 to 100 GHz"),
        ({"pas_kind": "powr"}, UnknownNameError, "PAS kind"),
        ({"tx_positions": np.array([[4.0, 4.5, 1.0]])}, PlacementError, "inside 'cabinet 2'"),
        ({"settings": TraceSettings(max_depth=-1)}, XFreqBenchError, "depth is -1; give a number from 0 to 16"),
        ({"settings": TraceSettings(max_depth=1_000_000)}, XFreqBenchError, "depth is 1,000,000; give a number from 0"),
        ({"settings": TraceSettings(rays=10**12)}, XFreqBenchError, "rays is 1,000,000,000,000; .* 1 to 10,000,000"),
        ({"settings": TraceSettings(seed=2**32)}, XFreqBenchError, "seed is 4,294,967,296; .* 0 to 4,294,967,295"),
    ],
)
def test_bad_input_is_refused_before_any_ray(asked: dict[str, Any], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        plan_generation(load_scene("office"), **{"carriers_hz": [1e9], **asked})


def test_a_plan_says_that_the_maps_of_an_array_without_extent_are_constant() -> None:
    office = load_scene("office")
    alone = replace(office, receiver=replace(office.receiver, rows=1, cols=1))
    summaries = [plan_generation(scene, [1e9], tx=2).summary for scene in (office, alone)]
    assert ["maps are nearly constant" in summary for summary in summaries] == [False, True]


def test_meshes_and_mirrors_are_found_once_where_a_scene_is_planned_and_traced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = [(facets, "surface_meshes"), (facets, "mirror_patches")]
    calls = [Mock(wraps=getattr(module, name)) for module, name in counted]
    for (module, name), call in zip(counted, calls, strict=True):
        monkeypatch.setattr(module, name, call)
    generate_planned(small_plan(num_transmitters=2), tmp_path / "rooms.h5")
    assert [call.call_count for call in calls] == [1, 1]


def test_planning_a_scene_of_many_triangles_does_not_loop_over_them_in_python(tmp_path: Path) -> None:
    def num_calls(pieces: int) -> int:
        xml = write_meshes(tmp_path, {"plate": ("wood", plate(2.0, 0.5, pieces=pieces))})
        scene = Scene("cut", RECEIVER, GRID, scene=xml, folder=tmp_path)
        seen: list[str] = []
        sys.setprofile(lambda frame, event, argument: seen.append(event))
        try:
            plan_generation(scene, [24.25e9], TraceSettings("image", ("specular", "refraction")))
        finally:
            sys.setprofile(None)
        return len(seen)

    num_calls(40)  # fills caches
    few, many = num_calls(40), num_calls(80)
    assert many < 1.1 * few  # of 3,200 and 12,800 triangles


def test_a_worker_is_told_a_scene_and_builds_its_geometry_itself() -> None:
    tracing = small_plan(num_transmitters=2).tracing
    pickled = pickle.dumps(tracing)
    told = pickle.loads(pickled)
    assert told == tracing and hash(told) == hash(tracing)
    assert told.known_geometry is None
    assert len(pickled) < 10_000
    for there, here in zip(told.geometry.meshes, tracing.geometry.meshes, strict=True):
        np.testing.assert_array_equal(there.corners_m, here.corners_m)


def test_a_worker_that_finds_other_meshes_or_software_refuses_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = small_plan(num_transmitters=2)
    told, batch = pickle.loads(pickle.dumps(plan.tracing)), (0, plan.tx_position_m)
    forget_rays()
    with pytest.raises(ClusterError, match=r"other software: numpy .* \(here 1\.0\)"):
        traced(told, batch, {**plan.header.software, "numpy": "1.0"})
    meshes = facets.surface_meshes
    monkeypatch.setattr(facets, "surface_meshes", lambda scene: meshes(scene)[:-1])
    with pytest.raises(ClusterError, match="finds other meshes of scene 'two_rooms'"):
        traced(told, batch, plan.header.software)


@pytest.mark.parametrize(
    ("solver", "left_mib", "needed"), [("image", 0.01, "0"), ("sionna", 50, "143"), ("sionna", 100, "143")]
)
def test_what_does_not_fit_into_memory_is_refused(
    solver: SolverName, left_mib: float, needed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine, "available_memory_mib", lambda processes: left_mib)
    words = rf"triangles of scene 'office' with 500,000 rays needs at least {needed} MiB of memory. .*simpler meshes"
    with pytest.raises(OutOfMemoryError, match=words):
        plan_generation(load_scene("office"), CARRIERS_HZ, TraceSettings(solver))


def test_a_plan_replaces_auto_and_orders_the_carriers() -> None:
    plan = plan_generation(load_scene("two_rooms"), CARRIERS_HZ[::-1], SETTINGS, tx=2)
    assert plan.tracing.carrier_hz == tuple(CARRIERS_HZ)
    assert plan.tracing.settings.solver == plan.header.settings["solver"] == "image"
