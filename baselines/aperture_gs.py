"""Ours: RF Gaussians accumulated at the array's elements, the map formed from their sum."""

from __future__ import annotations

from dataclasses import dataclass

from xfreqbench.splatting.aperture import ApertureField
from xfreqbench.splatting.learned import ChannelField, Count, LearnedMethod, TrainingConfig
from xfreqbench.splatting.network import NetworkConfig


@dataclass(frozen=True)
class ApertureGSConfig(NetworkConfig, TrainingConfig):
    """Fewer Gaussians than a renderer of pixels needs."""

    num_gaussians: Count = 128
    modes: Count = 4  # channels whose powers add up


class ApertureGS(LearnedMethod):
    """Array-domain Gaussians: the network of XFreq-GS, accumulated at the elements rather than on pixels."""

    Config = ApertureGSConfig

    def field(self) -> ChannelField:
        """Gaussians of which the receiver sees directions and spreads."""
        return ApertureField(self.config.num_gaussians, self.config.modes, self.config)
