from __future__ import annotations

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from tests.support import typechecking
from xfreqbench.errors import ArgumentError
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import METRICS, quantiles, score_all, skill
from xfreqbench.scene.array import planar_array

GRID = AngularGrid.hemisphere()


def random_maps(num_maps, seed=0):
    generator = np.random.default_rng(seed)
    beam = BartlettBeam(planar_array(4, 4, 0.5), GRID)
    cfr = generator.normal(size=(num_maps, 16)) + 1j * generator.normal(size=(num_maps, 16))
    return beam.maps(cfr)[0]


def peak_at(elevation, azimuth):
    pas_map = np.full((1, *GRID.shape), 0.01, np.float32)
    pas_map[0, elevation, azimuth] = 1
    return pas_map


def score(name, predicted, truth):
    return METRICS[name].score(predicted, truth, GRID)


@pytest.mark.parametrize("turn", [1, 90, 180])
def test_wrapped_ssim_does_not_notice_a_turn_of_the_scene(turn: int) -> None:
    predicted, truth = random_maps(2, 1), random_maps(2, 2)
    turned = score("ssim_wrapped", np.roll(predicted, turn, axis=2), np.roll(truth, turn, axis=2))
    np.testing.assert_allclose(turned, score("ssim_wrapped", predicted, truth), atol=1e-6)  # float32 filter
    assert abs(score("ssim_wrapped", predicted, truth) - score("ssim", predicted, truth)).max() > 1e-6


def test_scores_made_together_are_those_made_alone_and_ssim_is_scikit_images() -> None:
    predicted, truth = random_maps(3, 1), random_maps(3, 2)
    scores = score_all(predicted, truth, GRID)
    assert list(scores) == list(METRICS)
    for name, values in scores.items():
        np.testing.assert_array_equal(values, score(name, predicted, truth))
    for name, margin in (("ssim", 0), ("ssim_wrapped", 3)):
        around = [np.pad(maps, ((0, 0), (0, 0), (margin, margin)), mode="wrap") for maps in (predicted, truth)]
        theirs = [structural_similarity(*pair, data_range=1) for pair in zip(*around, strict=True)]
        np.testing.assert_allclose(scores[name], theirs, rtol=0, atol=1e-12)


@pytest.mark.parametrize("shape", [(6, 9), (9, 6)])
def test_maps_smaller_than_the_window_have_no_ssim(shape: tuple[int, int]) -> None:
    grid, maps = AngularGrid(*(np.arange(size) / 10 for size in shape)), np.ones((1, *shape), np.float32)
    for name in ("ssim", "ssim_wrapped"):
        with pytest.raises(ArgumentError, match=f"but the maps have {shape[0]} × {shape[1]}"):
            METRICS[name].score(maps, maps, grid)


@pytest.mark.parametrize(
    "maps",
    [random_maps(1), np.zeros((1, 90, 360), np.float32), np.ones((1, 90, 360), np.float32)],
    ids=["random", "zero", "constant"],
)
def test_identical_maps_score_perfectly(maps: np.ndarray) -> None:
    scores = {name: values[0] for name, values in score_all(maps, maps, GRID).items()}
    assert scores == {
        "ssim": pytest.approx(1),
        "ssim_wrapped": pytest.approx(1),
        "psnr": np.inf,
        "power_error": 0,
        "aoa_error": 0,
        "beam_loss": 0,
    }


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_a_flat_prediction_has_no_peak_and_gets_the_worst_scores(level: float) -> None:
    truth = random_maps(1)
    flat = np.full_like(truth, level)
    scores = score_all(flat, truth, GRID)
    assert scores["aoa_error"] == 180
    assert scores["beam_loss"] == 40
    assert all(np.isfinite(values).all() for values in scores.values())


OTHER_RANGES = {
    "bytes": lambda maps: 255 * maps,
    "dB": lambda maps: 10 * np.log10(maps + 1e-4),
    "no numbers": lambda maps: maps * np.float32(np.nan),
}


@pytest.mark.parametrize("change", OTHER_RANGES)
def test_no_metric_takes_maps_of_another_range(change: str) -> None:
    truth = random_maps(2)
    changed = OTHER_RANGES[change](truth)
    for metric in METRICS.values():
        for predicted, true, name in ((changed, truth, "predicted"), (truth, changed, "truth")):
            with pytest.raises(ArgumentError, match=f"peak 1, but those of {name} run from .* to"):
                metric.score(predicted, true, GRID)
        small = truth * np.float32([[[1]], [[1e-7]]])
        for predicted, true, name in ((small, truth, "predicted"), (truth, small, "truth")):
            with pytest.raises(ArgumentError, match=rf"those of {name} run from 0 to 1e-07\."):
                metric.score(predicted, true, GRID)


@pytest.mark.parametrize("dtype", [complex, bool, object])
def test_no_metric_takes_what_is_no_real_number(dtype: type, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(typechecking, "NUM_CHECKED", 0)  # as for a user
    truth = random_maps(1)
    for metric in METRICS.values():
        for maps in ((truth.astype(dtype), truth), (truth, truth.astype(dtype))):
            with pytest.raises(ArgumentError, match="compares maps of real numbers, but those of"):
                metric.score(*maps, GRID)


def test_every_metric_prefers_the_truth_to_another_map() -> None:
    truth, other = random_maps(1, 1), random_maps(1, 2)
    for metric in METRICS.values():
        sign = 1 if metric.higher_is_better else -1
        assert sign * metric.score(truth, truth, GRID) > sign * metric.score(other, truth, GRID)


def test_the_angle_between_peaks_is_the_great_circle() -> None:
    assert score("aoa_error", peak_at(0, 10), peak_at(0, 350))[0] == pytest.approx(20)
    assert score("aoa_error", peak_at(89, 0), peak_at(89, 180))[0] == pytest.approx(2)
    assert score("aoa_error", peak_at(0, 5), peak_at(60, 5))[0] == pytest.approx(60)


def test_beam_loss_is_the_truth_at_the_predicted_peak() -> None:
    truth = peak_at(10, 10)
    truth[0, 40, 40] = 0.5
    assert score("beam_loss", peak_at(40, 40), truth)[0] == pytest.approx(10 * np.log10(2))
    truth[0, 40, 40] = 0
    assert score("beam_loss", peak_at(40, 40), truth)[0] == 40


def test_power_error_counts_the_strongest_thirty_decibels() -> None:
    truth = np.full((1, 90, 360), 0.9e-3, np.float32)  # 0.5 dB too weak to count
    truth[0, 0, :2] = (1.0, 0.1)
    predicted = np.full_like(truth, 0.5)
    predicted[0, 0, :2] = (0.1, 0.1)
    assert score("power_error", predicted, truth)[0] == pytest.approx(5)  # 10 and 0 dB


def test_power_error_floors_predictions_at_minus_forty_decibels() -> None:
    truth = np.zeros((1, 90, 360), np.float32)
    truth[0, 0, 0] = 1
    assert score("power_error", np.zeros_like(truth), truth)[0] == pytest.approx(40)


def test_skill_is_the_share_closed_of_what_the_trivial_leaves_open() -> None:
    assert skill(0.95, 0.9) == pytest.approx(0.5)
    assert skill(0.9, 0.9) == 0
    assert skill(1.0, 0.9) == 1
    assert skill(0.8, 0.9) == pytest.approx(-1)
    assert np.isnan(skill(1.0, 1.0))


def test_quantiles_of_infinite_scores_are_scores() -> None:
    np.testing.assert_array_equal(quantiles(np.array([1.0, np.inf]), [0.0, 0.5, 0.51, 1.0]), [1, 1, np.inf, np.inf])


def test_scores_in_decibel_are_those_of_power_for_every_kind() -> None:
    rng = np.random.default_rng(0)
    predicted, truth = rng.uniform(size=(2, 3, 90, 360)).astype(np.float32) ** 4
    of_power = score_all(predicted, truth, AngularGrid.hemisphere(), "power")
    of_amplitude = score_all(np.sqrt(predicted), np.sqrt(truth), AngularGrid.hemisphere(), "amplitude")
    for name in ("power_error", "beam_loss", "aoa_error"):
        np.testing.assert_allclose(of_amplitude[name], of_power[name], atol=1e-4)
