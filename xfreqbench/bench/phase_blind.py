"""The map that is most like the truth on average, when of the truth everything is known but the phases of its paths."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Complex, Float
from numpy.typing import NDArray
from torch import Tensor

from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.metrics import SSIM_WINDOW
from xfreqbench.methods.learning.loss import SSIM_C1, SSIM_C2
from xfreqbench.methods.learning.targets import element_lags
from xfreqbench.types import Maps

MAX_STEPS = 25  # of L-BFGS; with 100 the expected SSIM of maps of the office is the same to 1e-4
STRIDE = 10  # of the windows' rows and columns; with 7 the expected SSIM is the same to 1e-5
_LEAST_STRENGTH = 1e-4  # singular value of a function of the band, as a share of the largest
_LEAST_DETAIL = 1e-3  # the same for a pattern in windows; some nine of 49 are larger


def random_phase_maps(
    waves: Complex[NDArray[np.complex128], "P M"],
    beam: BartlettBeam,
    kind: PasKind,
    number: int,
    generator: np.random.Generator,
) -> Float[Maps, "D E A"]:
    """So many maps, peak 1, of P waves at M array elements, each wave turned by a random phase of its own."""
    turns = (np.exp(2j * np.pi * generator.random(len(waves))) for _ in range(number))
    return beam.maps(np.array([turn @ waves for turn in turns]), kind)[0]


class BandOfArray:
    """Functions of the direction d that an array's maps of power are sums of, orthonormal on the grid.

    They are mixtures of cos 2π d·l and sin 2π d·l for all lags l between elements; a 4×4 array has 49.
    """

    def __init__(self, beam: BartlettBeam) -> None:
        self.shape = beam.grid.shape
        lags = np.unique(element_lags(beam.element_position_wavelengths), axis=0)
        phase = 2 * np.pi * beam.grid.directions.reshape(-1, 3) @ lags.T
        functions = np.hstack([np.cos(phase), np.sin(phase)])  # dependent, for −l is a lag too
        strength, mixture = np.linalg.eigh(functions.T @ functions)
        kept = strength > _LEAST_STRENGTH**2 * strength[-1]
        waves = (functions @ mixture[:, kept] / np.sqrt(strength[kept])).T
        self.waves = torch.as_tensor(waves, dtype=torch.float32)  # (K, E·A)
        self._in_windows = _windows(self.waves.reshape(-1, *self.shape))  # (K, W, S)

    def best_map(self, drawn: Float[Maps, "D E A"]) -> Float[Maps, "E A"]:
        """The map with the largest mean SSIM to D maps, in [0, 1]: their mean and what L-BFGS adds of the functions.

        SSIM is taken on the windows of every tenth row and column: neighbouring windows of such smooth maps are alike.
        """
        mean = torch.from_numpy(drawn.mean(axis=0))
        expected, mean_in_windows = _ExpectedSsim(_windows(torch.from_numpy(drawn))), _windows(mean[None])[0]
        coefficient = torch.zeros(len(self.waves), requires_grad=True)
        optimizer = torch.optim.LBFGS([coefficient], max_iter=MAX_STEPS, line_search_fn="strong_wolfe")

        def loss() -> float:
            optimizer.zero_grad()
            added = torch.einsum("k,kws->ws", coefficient, self._in_windows)
            value = -expected(mean_in_windows + added)
            value.backward()
            return value.item()

        optimizer.step(loss)
        best = mean + (coefficient.detach() @ self.waves).reshape(self.shape)
        return best.clamp(0, 1).numpy()


class _ExpectedSsim:
    """Mean SSIM to D maps over W windows of S pixels, as `metrics.ssim` computes it in each.

    What the maps hold beside their mean in a window is projected on the few patterns in which they differ.
    """

    def __init__(self, truth: Float[Tensor, "D W S"]) -> None:
        self._mean = truth.mean(dim=-1)
        rest = truth - self._mean[..., None]
        self._variance = _sample_mean(rest * rest)
        strength, pattern = torch.linalg.eigh((rest.flatten(0, 1).T @ rest.flatten(0, 1)).double())
        self._pattern = pattern[:, strength > _LEAST_DETAIL**2 * strength[-1]].float()
        self._rest = rest @ self._pattern

    def __call__(self, maps: Float[Tensor, "W S"]) -> Float[Tensor, ""]:
        mean = maps.mean(dim=-1)
        rest = maps - mean[:, None]
        covariance = torch.einsum("wr,dwr->dw", rest @ self._pattern, self._rest) / (maps.shape[-1] - 1)
        luminance = (2 * mean * self._mean + SSIM_C1) / (mean**2 + self._mean**2 + SSIM_C1)
        structure = (2 * covariance + SSIM_C2) / (_sample_mean(rest * rest) + self._variance + SSIM_C2)
        return (luminance * structure).mean()


def _sample_mean(squares: Float[Tensor, "*B S"]) -> Float[Tensor, "*B"]:
    """Sample variance from squared deviations."""
    return squares.sum(dim=-1) / (squares.shape[-1] - 1)


def _windows(maps: Float[Tensor, "N E A"]) -> Float[Tensor, "N W S"]:
    """The windows of SSIM at every `STRIDE`-th row and column, S pixels each."""
    rows = maps.unfold(1, SSIM_WINDOW, STRIDE)
    return rows.unfold(2, SSIM_WINDOW, STRIDE).flatten(3).flatten(1, 2)
