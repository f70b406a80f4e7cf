"""Mixes of learned maps with others, and how near they are to the truth, from which weights are chosen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from xfreqbench.methods.learning import loss_kernels
from xfreqbench.types import FloatArray, Maps, NDArray

WEIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the learned maps; one of them is chosen
STRIDE, _WINDOW = 3, 3  # of the SSIM that compares maps
_TINY = 1e-12  # peak of a map where no path arrives

Predict = Callable[[Float[FloatArray, "B 3"], Float[FloatArray, "B"]], Maps]


def mixed(
    weight: float | Float[NDArray[np.float32], "B"], learned: Float[Maps, "B E A"], other: Float[Maps, "B E A"]
) -> Float[Maps, "B E A"]:
    """Weighted means of learned and other maps, scaled to peak 1; the weight is one for all maps or one for each."""
    weights = np.asarray(weight, np.float32).reshape(-1, 1, 1)
    return scaled(weights * learned + (1 - weights) * other)


def scaled(maps: Float[Maps, "B E A"]) -> Float[Maps, "B E A"]:
    """Maps scaled to peak 1; those without any power stay at 0."""
    return np.asarray(maps / maps.max(axis=(1, 2), keepdims=True).clip(_TINY), dtype=np.float32)


def similarities(
    maps: Float[Maps, "n E A"], truth: Float[Maps, "n E A"], stride: int = STRIDE
) -> Float[FloatArray, "n"]:
    """SSIM of each of n maps, coarsely: on every `stride`-th row and column, 1 for maps of every third one."""
    shown, true = (np.ascontiguousarray(of_all[:, ::stride, ::stride], np.float32) for of_all in (maps, truth))
    return loss_kernels.similarities(shown, true, _WINDOW, STRIDE)


def similarities_by_weight(
    learned: Float[Maps, "n E A"], other: Float[Maps, "n E A"], truth: Float[Maps, "n E A"], stride: int = STRIDE
) -> Float[FloatArray, "W n"]:
    """SSIM of n mixed maps, coarsely as by `similarities`, for each of `WEIGHTS`."""
    return np.array([similarities(mixed(weight, learned, other), truth, stride) for weight in WEIGHTS])
