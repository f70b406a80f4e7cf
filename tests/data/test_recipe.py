"""Data of one recipe have one name on every machine; what changes a channel changes the recipe."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from tests.support.furnished_room import GRID, RECEIVER, SHELL, write_meshes
from tests.support.plans import plan_generation, wall_moved
from tests.support.synthetic import append_all, make_header
from xfreqbench.data.dataset import isolated, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import Plan
from xfreqbench.data.recipe import Recipe, job_of, recipe_name
from xfreqbench.data.writer import PasWriter
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.materials import Scattering, SceneMaterial
from xfreqbench.scene.model import Scene, load_scene
from xfreqbench.tracing.tracer import TraceSettings

TRANSMITTERS_M = np.array([[1.0, 1.0, 1.2], [2.0, 1.0, 1.2]])
CARRIERS_HZ = [1e9, 24.25e9]
ROOMS = load_scene("two_rooms")
GRID_OF_MAPS = AngularGrid.hemisphere()


def planned(
    scene: Scene = ROOMS, carrier_hz: list[float] = CARRIERS_HZ, tx_position_m: Any = TRANSMITTERS_M, **changes: Any
) -> Plan:
    of_plan = {name: changes.pop(name) for name in ("pas_kind", "maps", "paths") if name in changes}
    settings = TraceSettings(**{"interactions": ("specular", "refraction"), **changes})
    return plan_generation(scene, carrier_hz, settings, tx_positions=tx_position_m, **of_plan)


def recipe_of(plan: Plan, grid: AngularGrid = GRID_OF_MAPS) -> Recipe:
    return Recipe.of_scene(plan.tracing.scene, plan.tracing.settings, plan.header, plan.tx_position_m, grid)


@pytest.fixture(scope="module")
def usual() -> Recipe:
    return recipe_of(planned())


def with_surface(number: int = 0, **changes: Any) -> Scene:
    surfaces = list(ROOMS.surface)
    surfaces[number] = replace(surfaces[number], **changes)
    return replace(ROOMS, surface=tuple(surfaces))


def with_grid(**changes: Any) -> Scene:
    assert ROOMS.transmitters
    return replace(ROOMS, transmitters=replace(ROOMS.transmitters, **changes))


@pytest.mark.parametrize(
    "changes",
    [
        {"solver": "sionna"},
        {"rays": 1000},
        {"seed": 9},
        {"materials": "extrapolate"},  # and no material is
        {"interactions": ("refraction", "specular")},
        {"maps": False},
        {"paths": True},
        {"scene": replace(with_grid(clearance_m=0.3), description="")},
        {"scene": with_grid(pattern="iso", polarization="V")},  # as the receiver has them
        {"scene": with_surface(0, name="the floor")},
        {"tx_position_m": TRANSMITTERS_M + 1e-9},
    ],
    ids=str,
)
def test_what_changes_no_channel_leaves_the_recipe_as_it_is(usual: Recipe, changes: dict[str, Any]) -> None:
    assert recipe_of(planned(**changes)).id == usual.id


def test_versions_of_software_and_references_are_in_no_recipe(usual: Recipe) -> None:
    plan = planned()
    newer = replace(plan, header=replace(plan.header, software={"numpy": "9"}, references="other"))
    assert recipe_of(newer) == usual
    assert job_of(newer.header, TRANSMITTERS_M) == job_of(plan.header, TRANSMITTERS_M)


@pytest.mark.parametrize(
    "changes",
    [
        {"scene": wall_moved(ROOMS, 1e-3)},
        {"scene": with_surface(0, thickness_m=0.21)},
        {"scene": with_surface(0, material="wood")},
        {"scene": replace(ROOMS, receiver=replace(ROOMS.receiver, polarization="H"))},
        {"scene": with_grid(polarization="H")},
        {"scene": with_grid(orientation_deg=(0, 45, 0))},
        {"scene": replace(ROOMS, receiver=replace(ROOMS.receiver, antenna_orientation_deg=(0, 45, 0)))},
        {"max_depth": 5},
        {"interactions": ("specular",)},
        {"interactions": ("specular", "refraction", "diffraction")},
    ],
    ids=str,
)
def test_what_changes_channels_changes_the_recipe_and_its_physics(usual: Recipe, changes: dict[str, Any]) -> None:
    changed = recipe_of(planned(**changes))
    assert changed.physics_sha256 != usual.physics_sha256
    assert changed.id != usual.id


@pytest.mark.parametrize(
    "changes",
    [
        {"carrier_hz": [1e9, 24e9]},
        {"tx_position_m": TRANSMITTERS_M[::-1].copy()},
        {"tx_position_m": TRANSMITTERS_M[:1]},
        {"pas_kind": "amplitude"},
    ],
    ids=str,
)
def test_other_samples_of_the_same_physics_are_another_recipe(usual: Recipe, changes: dict[str, Any]) -> None:
    changed = recipe_of(planned(**changes))
    assert changed.physics_sha256 == usual.physics_sha256
    assert changed.id != usual.id


def test_a_name_is_one_line_that_steers_no_terminal() -> None:
    assert recipe_name("a\n```\x1b[31m é", "2-12345678ff") == r"a\n```\x1b[31m é@2-12345678"


def test_another_grid_of_maps_is_another_recipe(usual: Recipe) -> None:
    coarse = AngularGrid(GRID_OF_MAPS.elevation_rad[::2].copy(), GRID_OF_MAPS.azimuth_rad)
    assert recipe_of(planned(), coarse).id != usual.id


def test_the_next_physics_is_another_recipe_and_its_version_is_told(usual: Recipe) -> None:
    plan = planned()
    later = recipe_of(replace(plan, header=replace(plan.header, physics="4")))
    assert later.sha256 != usual.sha256
    assert re.fullmatch("two_rooms@3-[0-9a-f]{8}", usual.name)
    assert re.fullmatch("two_rooms@4-[0-9a-f]{8}", str(later))
    assert plan.header.attributes()["physics"] == "3"
    assert "physics" not in replace(plan.header, physics="1").attributes()  # files of version 1 do not tell it


def test_extrapolated_materials_are_in_the_recipe_and_in_the_header() -> None:
    brick, stated = with_surface(0, material="brick"), "extrapolated_materials"  # P.2040 has it from 1 to 40 GHz
    inside, outside = (planned(brick, [1e9, high_hz], materials="extrapolate") for high_hz in (24.25e9, 60e9))
    assert recipe_of(inside).physics_sha256 != recipe_of(outside).physics_sha256
    assert (inside.header.settings[stated], outside.header.settings[stated]) == ([], ["brick"])


def test_diffuse_reflection_is_drawn_so_that_its_seed_is_in_the_recipe() -> None:
    rough = replace(ROOMS, material=(SceneMaterial("concrete", scattering=Scattering(0.3)),))
    asked = {"interactions": ("specular", "diffuse"), "rays": 1000}
    for solver in ("image", "sionna"):
        one, other = (recipe_of(planned(rough, seed=seed, solver=solver, **asked)) for seed in (1, 2))
        assert one.id != other.id
    more, drawn = (recipe_of(planned(rough, solver=solver, **asked | {"rays": 2000})) for solver in ("image", "sionna"))
    assert more.id == recipe_of(planned(rough, solver="image", **asked)).id  # no ray is drawn
    assert drawn.id != recipe_of(planned(rough, solver="sionna", **asked)).id


def test_meshes_are_in_the_recipe_by_what_they_are_and_not_by_their_file(tmp_path: Path) -> None:
    def furnished(name: str, height_m: float, **changes: Any) -> Recipe:
        (tmp_path / name).mkdir()
        board = trimesh.creation.box((1.2, 0.8, 0.03)).apply_translation((2.0, 1.5, height_m))
        xml = write_meshes(tmp_path / name, {"table": ("wood", board)})
        (tmp_path / name / xml).rename(tmp_path / name / f"{name}.xml")
        scene = Scene("furnished", RECEIVER, GRID, surface=SHELL, scene=f"{name}.xml", folder=tmp_path / name)
        return recipe_of(planned(replace(scene, **changes)))

    low, again, high = furnished("low", 0.7), furnished("again", 0.7), furnished("high", 0.701)
    assert low.id == again.id != high.id
    assert furnished("facets", 0.7, mirrors="facets").id != low.id
    assert furnished("told", 0.7, mirrors="patches", least_patch_area_m2=0.05).id == low.id


def test_a_file_has_the_recipe_of_its_plan(tmp_path: Path, usual: Recipe) -> None:
    dataset = open_dataset(generate_planned(planned(), tmp_path / "rooms.h5"))
    assert dataset.recipe == usual
    assert isolated(dataset)[:1].recipe == usual


def test_data_that_do_not_say_how_they_were_made_are_named_by_their_content(tmp_path: Path) -> None:
    def stored(name: str, num_tx: int = 4, **changes: Any) -> Recipe:
        header = replace(make_header(num_tx), **changes)
        with PasWriter(tmp_path / f"{name}.h5", header) as writer:
            append_all(writer, header)
        return open_dataset(tmp_path / f"{name}.h5").recipe

    first = stored("first")
    assert re.fullmatch("synthetic@data-[0-9a-f]{8}", first.name)
    assert first.physics_sha256 is None
    assert stored("newer", software={"numpy": "9"}) == first
    assert stored("fewer", 3).id != first.id
    assert stored("amplitude", pas_kind="amplitude").id != first.id
