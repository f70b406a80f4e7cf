"""Encodings of carriers and positions for the networks: narrow bands, carriers outside the band, high octaves."""

from __future__ import annotations

import math

import numpy as np
import torch

from xfreqbench.bench.stress.case import Area
from xfreqbench.methods.learning.encoding import Scaling, positional_encoding

ENCODING = Area("encoding")
_BANDS_HZ = {  # lowest and highest carrier of the training band, carriers to be scaled
    "carriers within the training band": (1e9, 94e9, [1e9, 94e9, 24.25e9]),
    "carriers outside the training band": (1e9, 94e9, [0.5e9, 300e9]),
    "band of one carrier": (1e9, 1e9, [1e9, 2e9]),
    "band of 100 kHz at 24.25 GHz": (24.25e9, 24.25e9 + 1e5, [24.25e9, 24.25e9 + 1e5]),
}


# float64 keeps 4e-15 of a logarithm of 24, and 1 Hz is 4e-11 of it
@ENCODING.case(
    "band of 1 Hz at 24.25 GHz",
    *(24.25e9, 24.25e9 + 1, [24.25e9, 24.25e9 + 1]),
    limit=3e-4,
    unit="absolute",
)
@ENCODING.each(_BANDS_HZ, limit=1e-6, unit="absolute")  # some roundings of 6e-8
def _unit_carriers(low_hz: float, high_hz: float, carrier_hz: list[float]) -> float:
    """Error of carriers on the logarithmic axis of a training band, against ratios of logarithms.

    For a band of one carrier, the reference is twice the logarithm of the ratio to it.
    """
    scaling = Scaling()
    scaling.log_band.copy_(torch.tensor([low_hz, high_hz], dtype=torch.float64).log())
    found = scaling.unit_carrier(torch.tensor(carrier_hz, dtype=torch.float64))[:, 0]
    if low_hz == high_hz:
        expected = [2 * math.log(carrier / low_hz) for carrier in carrier_hz]
    else:
        width = math.log1p((high_hz - low_hz) / low_hz)
        expected = [2 * math.log1p((carrier - low_hz) / low_hz) / width - 1 for carrier in carrier_hz]
    return float((found - torch.tensor(expected)).abs().max())


# the finest octave reaches 2⁹π rad, where float32 is 6e-8 of 1608 off
@ENCODING.case("positions in ten octaves", limit=2e-4, unit="absolute")
def _finest_octave() -> float:
    """Error of ten octaves of positions in [−1, 1] in float32, against double precision."""
    x = torch.linspace(-1, 1, 501)[:, None]
    found = positional_encoding(x, 10).double().numpy()
    angle = x.double().numpy() * math.pi * 2.0 ** np.arange(10)
    return float(np.abs(found - np.concatenate([x, np.sin(angle), np.cos(angle)], axis=-1)).max())
