"""Mixes of maps, and how near they are to the truth."""

from __future__ import annotations

import numpy as np

from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.learning.mixing import WEIGHTS, mixed, similarities, similarities_by_weight

GRID = AngularGrid.hemisphere(30, 60)


def maps(seed: int, number: int = 5) -> np.ndarray:
    rows, columns = np.mgrid[: GRID.shape[0], : GRID.shape[1]] / 6
    phase = np.random.default_rng(seed).uniform(0, 6, (2, number, 1, 1))
    power = (2 + np.sin(rows + phase[0]) + np.cos(columns + phase[1])).astype(np.float32)
    return power / power.max(axis=(1, 2), keepdims=True)


def test_a_mix_has_peak_1_and_each_map_its_own_weight() -> None:
    learned, other = maps(0), maps(1)
    weight = np.array([0, 0.25, 0.5, 0.75, 1.0])
    result = mixed(weight, learned, other)
    np.testing.assert_allclose(result.max(axis=(1, 2)), 1)
    np.testing.assert_array_equal(result[[0, 4]], [other[0], learned[4]])
    np.testing.assert_allclose(mixed(0.5, learned, other)[2], result[2])


def test_maps_are_compared_as_the_score_does_and_coarse_ones_as_fine_ones() -> None:
    shown, truth = maps(2), maps(3)
    alike = similarities(shown, truth)
    scores = ssim(shown, truth, GRID)
    assert np.abs(alike - scores).max() < 0.15  # every third row and column
    assert np.corrcoef(alike, scores)[0, 1] > 0.95
    np.testing.assert_array_equal(similarities(shown[:, ::3, ::3], truth[:, ::3, ::3], 1), alike)


def test_mixes_are_compared_at_every_weight() -> None:
    learned, other, truth = maps(4), maps(5), maps(4)
    similar = similarities_by_weight(learned, other, truth)
    assert similar.shape == (len(WEIGHTS), len(truth))
    np.testing.assert_allclose(similar[-1], 1, atol=2e-4)  # float32 rounds variances
    np.testing.assert_allclose(similar[0], similarities(other, truth), atol=1e-6)


def test_a_map_without_any_path_mixes_to_nothing_and_not_to_a_fault() -> None:
    nothing = np.zeros_like(maps(0))
    np.testing.assert_array_equal(mixed(0.0, maps(0), nothing), nothing)
    np.testing.assert_allclose(mixed(0.5, maps(0), nothing), maps(0), rtol=1e-6)
