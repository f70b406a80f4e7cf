"""A method to copy and to change: a room as a few plane waves, whose strengths a small network gives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn
from torch.nn.functional import normalize
from typing_extensions import Doc

from xfreqbench import (
    Beams,
    ChannelField,
    GridView,
    LearnedMethod,
    PasDataset,
    Scaling,
    TrainingConfig,
    positional_encoding,
)

Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class PlaneWavesConfig(TrainingConfig):
    """Options that `--set` can change: these, and all fields of `TrainingConfig`."""

    waves: Annotated[Count, Doc("directions that all transmitters and carriers share")] = 24
    modes: Annotated[Count, Doc("channels whose powers add up, as phases are unknown")] = 4
    width: Annotated[Count, Doc("features of the hidden layer")] = 64
    octaves: Annotated[Count, Doc("octaves of sines of the inputs")] = 3


class PlaneWaveField(ChannelField):
    """Channel h = Σ_k s_k(transmitter, carrier) a(d_k); d_0 points to the transmitter, the others are learned."""

    def __init__(self, config: PlaneWavesConfig) -> None:
        super().__init__()
        self.config = config
        self.scaling = Scaling()  # box and band of the training data, saved with the field
        self.direction = nn.Parameter(torch.zeros(config.waves, 3))
        num_inputs = len(positional_encoding(torch.zeros(3), config.octaves)) + 1  # place and carrier
        self.network = nn.Sequential(
            nn.Linear(num_inputs, config.width),
            nn.ReLU(),
            nn.Linear(config.width, config.width),
            nn.ReLU(),
            nn.Linear(config.width, 2 * config.modes * (1 + config.waves)),
        )

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Take scales from the training rows; spread the directions over the room."""
        self.scaling.adapt(train)
        with torch.no_grad():
            self.direction.copy_(self.scaling.random_positions(self.config.waves, generator))

    def power(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Bartlett maps of the sums of all waves, at the directions in view."""
        tx_m = self.scaling.in_frame(tx_position_m)
        cfr = self.strength(tx_m, carrier_hz) @ self.response(tx_m, beams)  # (B, modes, M)
        return beams.power(cfr.movedim(1, 0), view)

    def strength(self, tx_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"]) -> Tensor:
        """Complex strengths s_k of each mode, (B, modes, 1 + waves)."""
        place = positional_encoding(self.scaling.unit_position(tx_m), self.config.octaves)
        outputs = self.network(torch.cat([place, self.scaling.unit_carrier(carrier_hz)], dim=-1))
        return torch.view_as_complex(outputs.unflatten(-1, (self.config.modes, -1, 2)))

    def response(self, tx_m: Float[Tensor, "B 3"], beams: Beams) -> Tensor:
        """Steering vectors a(d_k) = exp(+j2π r_n·d_k / λ), (B, 1 + waves, M), r_n in wavelengths."""
        learned = self.direction.expand(len(tx_m), -1, -1)
        direction = normalize(torch.cat([tx_m[:, None], learned], dim=1), dim=-1)
        element = torch.as_tensor(beams.element_position_wavelengths).to(tx_m)  # (M, 3)
        phase = 2 * math.pi * direction @ element.T
        return torch.polar(torch.ones_like(phase), phase)


class PlaneWaves(LearnedMethod):
    """Plane waves from shared directions, their strengths a network of place and carrier."""

    Config: type[Any] = PlaneWavesConfig

    def field(self) -> PlaneWaveField:
        """The field for the options, before training."""
        return PlaneWaveField(self.config)
