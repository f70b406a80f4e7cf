"""This project's method `aperture-gs`: Gaussians add up at the array's elements, and maps are formed from the sum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from typing_extensions import Doc

from xfreqbench.methods.learning.aperture import ApertureField
from xfreqbench.methods.learning.network import NetworkConfig
from xfreqbench.methods.learning.training import ChannelField, Count, LearnedMethod, Positive, TrainingConfig

from .trivial import TRIVIAL


@dataclass(frozen=True)
class ApertureGSConfig(NetworkConfig, TrainingConfig):
    """Options. There are fewer Gaussians than a renderer of pixels needs, and a step sees more maps."""

    num_gaussians: Annotated[Count, Doc("Gaussians, which add up at the array's elements")] = 128
    modes: Annotated[Count, Doc("channels whose powers add up")] = 4
    batch_size: Count = 64
    learning_rate: Positive = 4e-3
    blend: Literal["auto", "none"] = "auto"


class ApertureGS(LearnedMethod):
    """Array-domain Gaussians: a network of all pairs (Eq. 7), accumulated at the elements rather than on pixels."""

    Config = ApertureGSConfig
    trivial = TRIVIAL

    def field(self) -> ChannelField:
        """The field for the options, before training."""
        return ApertureField(self.config.num_gaussians, self.config.modes, self.config)
