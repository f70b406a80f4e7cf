from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source.findings.residual import HELD_MARGIN_M, PathKinds, path_kinds
from xfreqbench.baselines.virtual_source.stored import StoredFindings

from tests.support.found_box import ALL_PLANES, ARRAY_M, SCENE, SETTINGS, findings_of, plane
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.paths import Paths


@pytest.fixture(scope="module")
def tracer() -> ImageTracer:
    surfaces = [surface for surface in SCENE.surface if surface.name in ("floor", "east")]
    return ImageTracer(replace(SCENE, surface=tuple(surfaces)), [2.4e9], SETTINGS)


TX_M = np.array([1.1, 2.9, 0.9])


def kinds_with(tracer: ImageTracer, *planes: dict[str, object]) -> tuple[Paths, PathKinds]:
    paths = tracer.paths(TX_M)
    return paths, path_kinds(paths, TX_M, StoredFindings.model_validate(findings_of(*planes)))


def test_a_corner_has_four_paths_and_those_off_a_missing_plane_are_not_found(tracer: ImageTracer) -> None:
    paths, none = kinds_with(tracer)
    assert none.num_reflections.tolist() == [0, 1, 1, 2]  # direct, floor, east wall, both
    assert none.is_found.tolist() == [True, False, False, False]
    assert not none.num_transmissions.any()
    floor_is_first = abs(paths.vertices_m[1, 0, 2]) < 1e-9
    assert floor_is_first
    assert kinds_with(tracer, plane("z", 0.0))[1].is_found.tolist() == [True, True, False, False]
    assert kinds_with(tracer, plane("x", 5.0))[1].is_found.tolist() == [True, False, True, False]
    assert kinds_with(tracer, plane("z", 0.0), plane("x", 5.0))[1].is_found.all()


FOOT_M = 2.3 / (2.3 + 0.9) * (TX_M - ARRAY_M)[:2] + ARRAY_M[:2]  # where the floor reflects: similar triangles


def rectangle_m(low: np.ndarray, high: np.ndarray) -> list[list[float]]:
    return [[low[0], low[1], 0.0], [high[0], low[1], 0.0], [high[0], high[1], 0.0], [low[0], high[1], 0.0]]


@pytest.mark.parametrize(
    ("found", "is_found"),
    [
        (plane("z", 0.0, error_m=4.9e-3), True),
        (plane("z", 0.0, error_m=-4.9e-3), True),
        (plane("z", 0.0, error_m=5.1e-3), False),
        (plane("z", 0.0, error_m=7.9e-3, distance_std_m=1e-3), True),
        (plane("z", 0.0, error_m=8.1e-3, distance_std_m=1e-3), False),
        (plane("z", 0.0, tilt_rad=1.9e-3), True),
        (plane("z", 0.0, tilt_rad=2.1e-3), False),
        (plane("z", 0.0, corners_m=None), False),
        (plane("z", 0.0, corners_m=rectangle_m(FOOT_M, FOOT_M)), True),
        (plane("z", 0.0, corners_m=rectangle_m(FOOT_M + np.array([0.9 * HELD_MARGIN_M, -1]), FOOT_M + 1)), True),
        (plane("z", 0.0, corners_m=rectangle_m(FOOT_M + np.array([1.1 * HELD_MARGIN_M, -1]), FOOT_M + 1)), False),
    ],
)
def test_a_plane_counts_as_found_where_it_runs_through_the_reflection_and_holds_something(
    tracer: ImageTracer, found: dict[str, object], is_found: bool
) -> None:
    paths, kinds = kinds_with(tracer, found)
    np.testing.assert_allclose(paths.vertices_m[1, 0], [*FOOT_M, 0.0], atol=1e-9)
    assert kinds.is_found[1] == is_found


def test_refraction_before_a_reflection_does_not_hide_its_plane() -> None:
    tracer = ImageTracer(SCENE, [2.4e9], SETTINGS)
    tx_m = np.array([4.4, 1.0, 0.9])
    paths = tracer.paths(tx_m)
    kinds = path_kinds(paths, tx_m, StoredFindings.model_validate(ALL_PLANES))
    assert (kinds.num_transmissions[kinds.num_reflections > 0] > 0).any()
    assert kinds.is_found.all()
