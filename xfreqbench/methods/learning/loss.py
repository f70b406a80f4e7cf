"""The loss that training minimises (Eq. 12)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from xfreqbench.maps.metrics import SSIM_WINDOW

SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2  # for a data range of 1


def map_loss(
    predicted: Float[Tensor, "B E A"],
    truth: Float[Tensor, "B E A"],
    ssim_weight: float,
    window: int,
    stride: int = 1,
) -> Float[Tensor, ""]:
    """(1 − w) · L1 + w · (1 − SSIM) (Eq. 12), averaged over maps and directions; w is `ssim_weight`.

    `window` is the side of the SSIM's window in rows and columns, `stride` their distance on the whole grid.
    """
    l1 = (predicted - truth).abs().mean()
    if ssim_weight == 0:
        return l1
    return (1 - ssim_weight) * l1 + ssim_weight * (1 - mean_ssim(predicted, truth, window, stride))


def mean_ssim(
    predicted: Float[Tensor, "B E A"],
    truth: Float[Tensor, "B E A"],
    window: int = SSIM_WINDOW,
    stride: int = 1,
) -> Float[Tensor, ""]:
    """Mean SSIM as `metrics.ssim` scores it, but differentiable: uniform window, range 1, sample covariances.

    On maps of which a view keeps every `stride`-th row and column, a slope varies (stride · window / 7)² times as
    much within the window as within the score's window of 7 × 7. C₂ is multiplied by that, where it is above 1, so
    that slopes are weighed against it as the score weighs them.
    """
    c2 = SSIM_C2 * max(1.0, (stride * window / SSIM_WINDOW) ** 2)
    unbiased = window**2 / (window**2 - 1)
    mean_x, mean_y = _box(predicted, window), _box(truth, window)
    variance_x = unbiased * (_box(predicted * predicted, window) - mean_x * mean_x)
    variance_y = unbiased * (_box(truth * truth, window) - mean_y * mean_y)
    covariance = unbiased * (_box(predicted * truth, window) - mean_x * mean_y)
    luminance = (2 * mean_x * mean_y + SSIM_C1) / (mean_x * mean_x + mean_y * mean_y + SSIM_C1)
    structure = (2 * covariance + c2) / (variance_x + variance_y + c2)
    return (luminance * structure).mean()


def _box(maps: Float[Tensor, "B E A"], window: int) -> Float[Tensor, "B E2 A2"]:
    """Means over the square windows that lie within the map, as two products with banded matrices.

    On small maps this is several times faster than pooling, forward and backward.
    """
    of_rows, of_columns = (
        maps.new_full((size - window + 1, size), 1 / window).triu().tril(window - 1)  # averages neighbours
        for size in maps.shape[1:]
    )
    return of_rows @ (maps @ of_columns.T)
