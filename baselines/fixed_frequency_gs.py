"""Reduced baseline: attributes depend on transmitter and place, not on the carrier (as in WRF-GS+ and GSRF)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .xfreq_gs import XFreqGS, XFreqGSConfig


@dataclass(frozen=True)
class FixedFrequencyGSConfig(XFreqGSConfig):
    """Options: no carrier as input, no latent, and no spread of footprints by the carrier."""

    sees_carrier: bool = False
    latent: int = 0
    max_spread: float = 1.0
    blend: Literal["auto", "none"] = "none"


class FixedFrequencyGS(XFreqGS):
    """Gaussian splatting blind to the carrier: one map for all of them."""

    Config = FixedFrequencyGSConfig
