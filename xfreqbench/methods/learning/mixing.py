"""Mixes of learned maps with others, and how near they are to the truth, from which weights are chosen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.methods.learning.loss import ssim_of_each
from xfreqbench.types import FloatArray, Maps

WEIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the learned maps; one of them is chosen
_STRIDE, _WINDOW = 3, 3  # of the SSIM that compares maps
_AT_ONCE = 64
_TINY = 1e-12  # peak of a map where no path arrives

Predict = Callable[[Float[FloatArray, "B 3"], Float[FloatArray, "B"]], Maps]


def mixed(
    weight: float | Float[NDArray[np.float32], "B"],
    learned: Float[Maps, "B E A"],
    other: Float[Maps, "B E A"],
) -> Float[Maps, "B E A"]:
    """Weighted means of learned and other maps, scaled to peak 1; the weight is one for all maps or one for each."""
    weights = np.asarray(weight, np.float32).reshape(-1, 1, 1)
    sums = weights * learned + (1 - weights) * other
    return np.asarray(sums / sums.max(axis=(1, 2), keepdims=True).clip(_TINY), dtype=np.float32)


def similarities(maps: Float[Maps, "n E A"], truth: Float[Maps, "n E A"]) -> Float[FloatArray, "n"]:
    """SSIM of each of n maps, coarsely."""
    compared = (np.ascontiguousarray(of_all[:, ::_STRIDE, ::_STRIDE]) for of_all in (maps, truth))
    parts = (torch.as_tensor(coarse).split(_AT_ONCE) for coarse in compared)
    similar = [ssim_of_each(shown, true, _WINDOW, _STRIDE) for shown, true in zip(*parts, strict=True)]
    return torch.cat(similar).numpy().astype(np.float64)


def similarities_by_weight(
    learned: Float[Maps, "n E A"], other: Float[Maps, "n E A"], truth: Float[Maps, "n E A"]
) -> Float[FloatArray, "W n"]:
    """SSIM of n mixed maps, coarsely, for each of `WEIGHTS`."""
    return np.array([similarities(mixed(weight, learned, other), truth) for weight in WEIGHTS])
