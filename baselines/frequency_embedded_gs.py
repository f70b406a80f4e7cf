"""Reduced baseline: the carrier is one more encoded input of the network (as in Wideband3DGS)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from xfreqbench.methods.learning.low_rank import Trend

from .xfreq_gs import XFreqGS, XFreqGSConfig


@dataclass(frozen=True)
class FrequencyEmbeddedGSConfig(XFreqGSConfig):
    """Options: the carrier is an input, but there is no latent and no spread of footprints by the carrier."""

    latent: int = 0
    trend: Trend = "none"
    max_spread: float = 1.0
    blend: Literal["auto", "none"] = "none"


class FrequencyEmbeddedGS(XFreqGS):
    """Gaussian splatting with attributes from transmitter, place and embedded carrier."""

    Config = FrequencyEmbeddedGSConfig
