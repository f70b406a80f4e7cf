"""The rays that `xfreqbench view` draws, against the geometry of the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.support.screened_room import ONE_LIT_TX, ONE_SHADOWED_TX, SCENE, store
from xfreqbench.data.dataset import PasDataset
from xfreqbench.report.view.plan import MAX_RAYS, RAY_RANGE_DB, Ray, ViewPlan, plan_view
from xfreqbench.scene.model import Surface

DEVIATION_RAD = 1e-9  # mirror points are exact to some roundings in float64


def turns_rad(ray: Ray) -> list[float]:
    """By how much a ray turns at each point it meets."""
    steps = np.diff(ray.points_m, axis=0)
    along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    pairs = pairwise(along)
    return [float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)) for a, b in pairs]


def reflections(rays: Sequence[Ray]) -> list[tuple[np.ndarray, np.ndarray, Surface]]:
    """Unit vectors into and out of each mirror point, with the surface that is said to be there."""
    surfaces = {surface.name: surface for surface in SCENE.surface}
    found = []
    for ray in rays:
        steps = np.diff(ray.points_m, axis=0)
        along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        for number, event in enumerate(ray.events):
            if event.startswith("reflected by "):
                surface = surfaces[event.removeprefix("reflected by ")]
                found.append((along[number], along[number + 1], surface))
    return found


def test_rays_run_from_the_transmitter_to_the_array_centre(view: ViewPlan) -> None:
    assert view.room.rays
    for ray in view.room.rays:
        np.testing.assert_array_equal(ray.points_m[0], view.room.tx_position_m[ONE_LIT_TX])
        np.testing.assert_array_equal(ray.points_m[-1], SCENE.receiver.position_m)
        length_m = np.linalg.norm(np.diff(ray.points_m, axis=0), axis=1).sum()
        assert ray.delay_s * 299_792_458 == pytest.approx(length_m, rel=1e-12)  # float64
        assert len(ray.points_m) == len(ray.events) + 2


def test_reflections_have_equal_angles_at_the_surface_they_are_said_to_be_at(view: ViewPlan) -> None:
    found = reflections(view.room.rays)
    assert {surface.name for *_, surface in found} >= {"floor", "ceiling", "screen, metal"}
    for towards, away, surface in found:
        normal = np.equal(surface.min_m, surface.max_m).astype(float)
        mirrored = towards - 2 * (towards @ normal) * normal
        assert np.linalg.norm(mirrored - away) < DEVIATION_RAD


def test_what_goes_through_a_surface_does_not_turn(dataset: PasDataset) -> None:
    wooden = replace(SCENE, surface=(Surface("pane", "glass", 0.008, (5.5, 0.0, 0.0), (5.5, 6.0, 2.8)),))
    path = store(wooden, dataset.path.parent / "pane.h5").path
    behind = plan_view(str(path), ONE_SHADOWED_TX).with_rays()
    (ray,) = behind.room.rays
    assert ray.label == "through pane"
    assert max(turns_rad(ray)) < DEVIATION_RAD


def test_rays_are_ordered_and_weak_ones_left_out(view: ViewPlan) -> None:
    levels = [ray.level_db for ray in view.room.rays]
    assert levels == sorted(levels, reverse=True)
    assert levels[0] == 0 and levels[-1] >= -RAY_RANGE_DB
    assert view.room.rays[0].label == "line of sight"
    assert 1 < len(levels) <= MAX_RAYS


def test_a_shadowed_transmitter_has_no_line_of_sight(dataset: PasDataset) -> None:
    shadowed = plan_view(str(dataset.path), ONE_SHADOWED_TX)
    assert shadowed.room.in_sight is not None and not shadowed.room.in_sight[ONE_SHADOWED_TX]
    rays = shadowed.with_rays().room.rays
    assert rays and all(ray.label != "line of sight" for ray in rays)


def test_the_strongest_ray_depends_on_the_carrier_asked_for(dataset: PasDataset) -> None:
    low, high = (plan_view(str(dataset.path), ONE_LIT_TX, carrier).with_rays() for carrier in (2.4, 77.0))
    assert (low.carrier_hz, high.carrier_hz) == (2.4e9, 77e9)
    assert [ray.level_db for ray in low.room.rays] != [ray.level_db for ray in high.room.rays]
