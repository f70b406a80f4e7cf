"""Reduced baseline: Gaussians that know transmitter and place but not the carrier (family of WRF-GS+, GSRF)."""

from __future__ import annotations

from dataclasses import dataclass

from .xfreq_gs import XFreqGS, XFreqGSConfig


@dataclass(frozen=True)
class FixedFrequencyGSConfig(XFreqGSConfig):
    """No carrier in, no latent, and footprints that no carrier widens."""

    sees_carrier: bool = False
    latent: int = 0
    max_spread: float = 1.0


class FixedFrequencyGS(XFreqGS):
    """Gaussian splatting blind to the carrier: one map for all of them."""

    Config = FixedFrequencyGSConfig
