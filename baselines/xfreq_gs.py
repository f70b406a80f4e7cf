"""XFreq-GS: 3-D RF Gaussians, geometry shared by all carriers, attributes from a network told the carrier."""

from __future__ import annotations

from dataclasses import dataclass

from xfreqbench.splatting.learned import ChannelField, LearnedMethod, Positive, TrainingConfig
from xfreqbench.splatting.network import NetworkConfig
from xfreqbench.splatting.splat import SplatConfig, SplatField


@dataclass(frozen=True)
class XFreqGSConfig(SplatConfig, NetworkConfig, TrainingConfig):
    """Smaller than the paper's, to be trained on a processor in minutes."""

    learning_rate: Positive = 5e-3


class XFreqGS(LearnedMethod):
    """WideFreqNetwork and Adaptive Orthographic Splatting (Eqs. 4–12)."""

    Config = XFreqGSConfig

    def field(self) -> ChannelField:
        """Gaussians splatted on the sphere of directions."""
        return SplatField(self.config, self.config)
