"""XFreq-GS: 3-D RF Gaussians with the same geometry at all carriers; a network that sees the carrier gives the rest."""

from __future__ import annotations

from dataclasses import dataclass

from xfreqbench.methods.learning.network import NetworkConfig
from xfreqbench.methods.learning.training import ChannelField, LearnedMethod, Positive, TrainingConfig
from xfreqbench.methods.splatting.field import SplatConfig, SplatField


@dataclass(frozen=True)
class XFreqGSConfig(SplatConfig, NetworkConfig, TrainingConfig):
    """Options. Sizes are smaller than the paper's, to train on a processor in minutes."""

    learning_rate: Positive = 5e-3


class XFreqGS(LearnedMethod):
    """WideFreqNetwork and Adaptive Orthographic Splatting (Eqs. 4–12)."""

    Config = XFreqGSConfig

    def field(self) -> ChannelField:
        """The field for the options, before training."""
        return SplatField(self.config, self.config)
