"""The loss that training minimises (Eq. 12)."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import avg_pool2d

from xfreqbench.maps.metrics import SSIM_WINDOW
from xfreqbench.methods.learning.loss_kernels import SSIM_C1, c2_of_view, ssim_and_l1


def map_loss(
    predicted: Float[Tensor, "B E A"],
    truth: Float[Tensor, "B E A"],
    ssim_weight: float | Tensor,
    window: int,
    stride: int = 1,
) -> Float[Tensor, ""]:
    """(1 − w) · L1 + w · (1 − SSIM) (Eq. 12), averaged over maps and directions; w is `ssim_weight`.

    `window` is the side of the SSIM's window in rows and columns, `stride` their distance on the whole grid.
    """
    if predicted.device.type == "cpu" and predicted.dtype == truth.dtype == torch.float32:
        return _MapLoss.apply(predicted, truth, ssim_weight, window, stride)  # type: ignore[no-untyped-call]
    l1 = (predicted - truth).abs().mean()
    return (1 - ssim_weight) * l1 + ssim_weight * (1 - mean_ssim(predicted, truth, window, stride))


def mean_ssim(
    predicted: Float[Tensor, "B E A"], truth: Float[Tensor, "B E A"], window: int = SSIM_WINDOW, stride: int = 1
) -> Float[Tensor, ""]:
    """Mean over maps of `ssim_of_each`."""
    return ssim_of_each(predicted, truth, window, stride).mean()


def ssim_of_each(
    predicted: Float[Tensor, "B E A"], truth: Float[Tensor, "B E A"], window: int = SSIM_WINDOW, stride: int = 1
) -> Float[Tensor, "B"]:
    """SSIM of B maps as `metrics.ssim` scores it, but differentiable: uniform window, range 1, sample covariances.

    On maps of which a view keeps every `stride`-th row and column, a slope varies (stride · window / 7)² times as
    much within the window as within the score's window of 7 × 7. C₂ is multiplied by that, where it is above 1, so
    that slopes are weighed against it as the score weighs them.
    """
    c2 = c2_of_view(window, stride)
    unbiased = window**2 / (window**2 - 1)
    mean_x, mean_y = _box(predicted, window), _box(truth, window)
    variance_x = unbiased * (_box(predicted * predicted, window) - mean_x * mean_x)
    variance_y = unbiased * (_box(truth * truth, window) - mean_y * mean_y)
    covariance = unbiased * (_box(predicted * truth, window) - mean_x * mean_y)
    luminance = (2 * mean_x * mean_y + SSIM_C1) / (mean_x * mean_x + mean_y * mean_y + SSIM_C1)
    structure = (2 * covariance + c2) / (variance_x + variance_y + c2)
    return (luminance * structure).mean(dim=(1, 2))


class _MapLoss(torch.autograd.Function):
    """`map_loss` on a processor: the loss and its slope by `predicted` in one pass, by a compiled kernel."""

    @staticmethod
    def forward(ctx: Any, predicted: Tensor, truth: Tensor, ssim_weight: float, window: int, stride: int) -> Tensor:
        maps = predicted.detach().contiguous()
        slope = torch.empty_like(maps)
        arrays = maps.numpy(), truth.detach().contiguous().numpy()
        c2 = c2_of_view(window, stride)
        ssim, l1 = ssim_and_l1(*arrays, window, SSIM_C1, c2, ssim_weight, slope.numpy())
        ctx.save_for_backward(slope)
        return predicted.new_tensor((1 - ssim_weight) * l1 + ssim_weight * (1 - ssim))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_loss: Tensor) -> tuple[Tensor | None, ...]:
        (slope,) = ctx.saved_tensors
        return grad_loss * slope, None, None, None, None


def _box(maps: Float[Tensor, "B E A"], window: int) -> Float[Tensor, "B E2 A2"]:
    """Means over the square windows that lie within the map.

    On a CPU they are two products with banded matrices, several times faster on small maps than pooling.
    """
    if maps.device.type != "cpu":
        return avg_pool2d(avg_pool2d(maps[:, None], (window, 1), stride=1), (1, window), stride=1)[:, 0]
    of_rows, of_columns = (
        maps.new_full((size - window + 1, size), 1 / window).triu().tril(window - 1)  # averages neighbours
        for size in maps.shape[1:]
    )
    return of_rows @ (maps @ of_columns.T)
