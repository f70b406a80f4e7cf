"""XFreq-GS: 3-D RF Gaussians with the same geometry at all carriers; a network that sees the carrier gives the rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field as Limits

from xfreqbench.methods.learning.low_rank import LowRankConfig
from xfreqbench.methods.learning.training import ChannelField, Count, LearnedMethod, Positive
from xfreqbench.methods.splatting.field import SplatConfig, SplatField, SplatTrainingConfig

from .trivial import TRIVIAL


@dataclass(frozen=True)
class XFreqGSConfig(SplatConfig, LowRankConfig, SplatTrainingConfig):
    """Options. Few, wide Gaussians, so that a step sees many maps. They start on a lattice, and move from there."""

    num_gaussians: Count = 128
    densify_every: Annotated[int, Limits(ge=0)] = 0
    position_rate: Positive = 0.4
    blend: Literal["auto", "none"] = "auto"


class XFreqGS(LearnedMethod):
    """WideFreqNetwork of low rank and Adaptive Orthographic Splatting within the array's band (Eqs. 4–12)."""

    Config = XFreqGSConfig
    trivial = TRIVIAL

    def field(self) -> ChannelField:
        """The field for the options, before training."""
        return SplatField(self.config, self.config)
