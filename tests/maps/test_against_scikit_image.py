"""Scores of maps against those of scikit-image."""

from __future__ import annotations

import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import psnr, ssim
from xfreqbench.scene.array import planar_array

GRID = AngularGrid.hemisphere()


def random_maps(num_maps: int, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    beam = BartlettBeam(planar_array(4, 4, 0.5), GRID)
    cfr = generator.normal(size=(num_maps, 16)) + 1j * generator.normal(size=(num_maps, 16))
    return beam.maps(cfr)[0]


def test_ssim_and_psnr_are_those_of_scikit_image() -> None:
    predicted, truth = random_maps(3, 1), random_maps(3, 2)
    wide = [(a.astype(np.float64), b.astype(np.float64)) for a, b in zip(predicted, truth, strict=True)]
    expected_ssim = [structural_similarity(*pair, data_range=1) for pair in wide]
    expected_psnr = [peak_signal_noise_ratio(truth, guess, data_range=1) for guess, truth in wide]
    np.testing.assert_allclose(ssim(predicted, truth, GRID), expected_ssim, atol=1e-6)  # float32 filter
    np.testing.assert_allclose(psnr(predicted, truth, GRID), expected_psnr, rtol=1e-9)
