"""The loss: the score's own SSIM, differentiable, and L1."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor

from xfreqbench.maps import metrics
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.learning.loss import map_loss, mean_ssim

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = AngularGrid.hemisphere(30, 60)


def smooth_maps(seed: int, num_maps: int = 6) -> Tensor:
    """Random maps as an array draws them: broad lobes, peak 1."""
    white = np.random.default_rng(seed).standard_normal((num_maps, *GRID.shape))
    power = gaussian_filter(white, (0, 3, 3)) ** 2
    return torch.as_tensor(power / power.max(axis=(1, 2), keepdims=True))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_losss_ssim_is_the_one_that_scores(dtype: torch.dtype) -> None:
    predicted, truth = smooth_maps(0), smooth_maps(1)
    scores = []
    for maps in (predicted, 0.9 * truth + 0.1 * predicted):
        scores.append(metrics.ssim(maps.float().numpy(), truth.float().numpy(), GRID).mean())
        # float32 rounds variances at 1e-7, against the 9e-4 that SSIM adds to them
        assert float(mean_ssim(maps.to(dtype), truth.to(dtype))) == pytest.approx(scores[-1], abs=1e-5)
    assert 0 < scores[0] < 0.5 < scores[1] < 1


@pytest.mark.parametrize("window", [3, 7])
def test_the_gradient_of_ssim_is_its_derivative(window: int) -> None:
    predicted = smooth_maps(0, 1)[:, 5:13, 5:14].clone().requires_grad_()
    truth = smooth_maps(1, 1)[:, 5:13, 5:14]
    torch.autograd.gradcheck(lambda maps: mean_ssim(maps, truth, window), (predicted,))


def test_a_map_is_like_itself() -> None:
    for maps in (torch.zeros(2, *GRID.shape), torch.ones(2, *GRID.shape), smooth_maps(0).float()):
        assert float(mean_ssim(maps, maps)) == pytest.approx(1, abs=1e-6)
        assert float(map_loss(maps, maps, 0.4, 7)) == pytest.approx(0, abs=1e-6)


def test_the_weight_goes_from_l1_to_ssim() -> None:
    predicted, truth = smooth_maps(0), smooth_maps(1)
    l1, unlikeness = float((predicted - truth).abs().mean()), 1 - float(mean_ssim(predicted, truth))
    for weight in (0.0, 0.4, 1.0):
        expected = (1 - weight) * l1 + weight * unlikeness
        assert float(map_loss(predicted, truth, weight, 7)) == pytest.approx(expected, abs=1e-12)


def test_a_slope_costs_in_a_coarse_view_what_it_costs_in_the_score() -> None:
    """Of two maps with other slopes, SSIM is the same on all directions in 7 × 7 as on every sixth in 2 × 2."""
    rows, columns = torch.meshgrid(torch.arange(84.0), torch.arange(84.0), indexing="ij")
    steep, flat = (0.5 + slope * (rows + columns - 83)[None].double() for slope in (2e-3, 1e-3))
    whole = float(mean_ssim(steep, flat))
    coarse = float(mean_ssim(steep[:, ::6, ::6], flat[:, ::6, ::6], 2, 6))
    assert 0 < 1 - whole < 0.2
    assert 1 - coarse == pytest.approx(1 - whole, rel=0.15)
    assert 1 - float(mean_ssim(steep[:, ::6, ::6], flat[:, ::6, ::6], 2)) > 1.5 * (1 - whole)


@pytest.mark.parametrize(("window", "stride"), [(2, 6), (3, 5), (7, 1)])
@pytest.mark.parametrize("weight", [0.0, 0.7, 1.0])
def test_the_kernel_has_the_value_and_the_slope_of_its_twin(weight: float, window: int, stride: int) -> None:
    predicted, truth = smooth_maps(0), smooth_maps(1)
    truth[0], predicted[1], truth[2] = predicted[0], 0.0, 0.0  # alike, and dark
    predicted[3], truth[3] = 0.0, 0.0
    of_kind = {}
    for kind in (torch.float32, torch.float64):  # the kernel takes float32 alone
        maps = predicted.to(kind).requires_grad_()
        loss = map_loss(maps, truth.to(kind), weight, window, stride)
        of_kind[kind] = loss.detach().double(), torch.autograd.grad(loss, maps)[0].double()
    (value, slope), (expected, expected_slope) = of_kind.values()
    assert float(value) == pytest.approx(float(expected), abs=1e-6)
    # float32 rounds sums over a window, of which small differences are taken, at 1e-7
    torch.testing.assert_close(slope, expected_slope, rtol=0, atol=2e-5 * float(expected_slope.abs().max()))


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_a_value_that_is_not_finite_shows_in_the_kernels_loss(value: float) -> None:
    predicted, truth = smooth_maps(0).float(), smooth_maps(1).float()
    predicted[3, 4, 5] = value
    assert not bool(map_loss(predicted, truth, 0.5, 3).isfinite())
