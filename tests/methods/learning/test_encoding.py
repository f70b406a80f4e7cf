"""Encodings of carriers and positions: in single precision as in double."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from xfreqbench.methods.learning.encoding import Scaling, positional_encoding


@pytest.mark.parametrize(
    ("low_hz", "high_hz", "carrier_hz", "tolerance"),
    [
        (1e9, 94e9, [1e9, 94e9, 24.25e9], 1e-6),  # some roundings of 6e-8
        (1e9, 94e9, [0.5e9, 0.9e9, 100e9, 300e9], 1e-6),
        (1e9, 1e9, [1e9, 2e9], 1e-6),
        (24.25e9, 24.25e9 + 1e5, [24.25e9, 24.25e9 + 1e5], 1e-6),
        (24.25e9, 24.25e9 + 1, [24.25e9, 24.25e9 + 1], 3e-4),
    ],
)
def test_carriers_lie_on_the_logarithmic_axis_of_the_training_band(
    low_hz: float, high_hz: float, carrier_hz: list[float], tolerance: float
) -> None:
    """Carriers beyond the band are nearer to its middle, and in it from a fifth beyond its end."""
    scaling = Scaling()
    scaling.log_band.copy_(torch.tensor([low_hz, high_hz], dtype=torch.float64).log())
    found = scaling.unit_carrier(torch.tensor(carrier_hz, dtype=torch.float64))[:, 0]
    width, inside = math.log1p((high_hz - low_hz) / low_hz), np.clip(carrier_hz, low_hz, high_hz)
    expected = [2 * math.log1p((carrier - low_hz) / low_hz) / width - 1 if width else 0.0 for carrier in inside]
    nearness = (1 - np.abs(np.log(carrier_hz / inside)) / math.log(1.2)).clip(min=0)
    np.testing.assert_allclose(found.numpy(), expected * nearness, rtol=0, atol=tolerance)


def test_ten_octaves_of_positions_are_those_of_double_precision() -> None:
    x = torch.linspace(-1, 1, 501)[:, None]
    angle = x.double().numpy() * math.pi * 2.0 ** np.arange(10)
    expected = np.concatenate([x, np.sin(angle), np.cos(angle)], axis=-1)
    # the finest octave reaches 2⁹π rad, where float32 is 6e-8 of 1608 off
    np.testing.assert_allclose(positional_encoding(x, 10).double().numpy(), expected, rtol=0, atol=2e-4)
