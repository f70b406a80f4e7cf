"""SwiftWRF, reduced: Gaussians on the plane of azimuth and elevation that a network deforms for each transmitter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import torch
from jaxtyping import Float
from pydantic import Field as Limits
from torch import Tensor, nn
from torch.nn.functional import softplus
from typing_extensions import Doc

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.learning.encoding import Scaling, encoded_size, positional_encoding
from xfreqbench.methods.learning.network import PairwiseMLP, Precision
from xfreqbench.methods.learning.targets import Beams, GridView
from xfreqbench.methods.learning.training import ChannelField, Count, LearnedMethod, Positive
from xfreqbench.methods.splatting.bells import bells
from xfreqbench.methods.splatting.field import BandConfig, BandField, SplatTrainingConfig

_LEAST_SIZE_RAD = math.radians(3.0)  # narrower ones fall between the rows of a view; beams are 26° wide
_MOST_SIZE_RAD = math.pi
_MOST_MOVE_RAD = math.radians(45.0)  # or all may leave the hemisphere at once, and have no gradient any more
_PARTS = (2, 2, 1)  # of a deformation: centre, logarithms of sizes, brightness
_BRIGHTNESS = -1.0  # before softplus, at the start


@dataclass(frozen=True)
class SwiftWRFConfig(BandConfig, SplatTrainingConfig):
    """Options. The paper has thousands of Gaussians, and sees no carrier."""

    num_gaussians: Annotated[Count, Doc("Gaussians; their number does not change")] = 256
    angular_size_deg: Annotated[float, Limits(gt=0, le=90), Doc("one deviation at the start")] = 10.0
    width: Annotated[Count, Doc("features of each hidden layer")] = 64
    layers: Annotated[Count, Doc("hidden layers")] = 3
    centre_octaves: Annotated[int, Limits(ge=0), Doc("octaves of sines of a Gaussian's centre")] = 4
    tx_octaves: Annotated[int, Limits(ge=0), Doc("octaves of sines of the transmitter's place")] = 6
    plane_rate: Annotated[Positive, Doc("rate of the Gaussians, of the learning rate")] = 10.0
    precision: Annotated[Precision, Doc("auto: bfloat16 where the processor has it")] = "auto"
    batch_size: Count = 32


class PlaneGaussians(nn.Module):
    """N Gaussians on the plane of azimuth and elevation, with a deviation along both, in radians, and a brightness."""

    def __init__(self, num_gaussians: int) -> None:
        super().__init__()
        self.centre_rad = nn.Parameter(torch.zeros(num_gaussians, 2))
        self.log_size = nn.Parameter(torch.zeros(num_gaussians, 2))
        self.brightness = nn.Parameter(torch.full((num_gaussians, 1), _BRIGHTNESS))

    @torch.no_grad()
    def scatter(self, size_rad: float, generator: torch.Generator) -> None:
        """Move the Gaussians to random centres on the hemisphere's plane, all of one size."""
        unit = torch.rand(self.centre_rad.shape, generator=generator)
        self.centre_rad.copy_(unit * torch.tensor([2 * math.pi, math.pi / 2]))
        self.log_size.fill_(math.log(size_rad))


class SwiftWRFField(BandField):
    """Power Σ_i s_i G_i of Gaussians on the plane, whose centre, shape and brightness a network changes."""

    config: SwiftWRFConfig

    def __init__(self, config: SwiftWRFConfig) -> None:
        super().__init__()
        self.config, self.scaling = config, Scaling()
        self.gaussians = PlaneGaussians(config.num_gaussians)
        sizes = 1 + encoded_size(3, config.tx_octaves), encoded_size(2, config.centre_octaves)
        self.network = PairwiseMLP(*sizes, 0, [config.width] * config.layers, sum(_PARTS), config.precision)

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Take the box and the band of the training data, and place the Gaussians at random."""
        self.scaling.adapt(train)
        self.gaussians.scatter(math.radians(self.config.angular_size_deg), generator)

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Parameters with their learning rates: the network, and the Gaussians."""
        rate = self.config.plane_rate * learning_rate
        return [
            {"params": list(self.network.parameters()), "lr": learning_rate},
            {"params": list(self.gaussians.parameters()), "lr": rate},
        ]

    def counts(self) -> dict[str, float]:
        """Number of Gaussians."""
        return {"gaussians": self.config.num_gaussians}

    def splatted(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Power Σ_i s_i G_i from each direction in view, never negative; azimuths are taken the short way round.

        G_i is a product of a factor of the azimuth and one of the elevation, so that the sum is a matrix product.
        """
        azimuth_rad, elevation_rad = beams.angles_in(view)
        centre_rad, size_rad, brightness = self.deformed(tx_position_m, carrier_hz)
        of_azimuth = bells(azimuth_rad, centre_rad[..., 0], size_rad[..., 0], full_turn=True)  # (B, N, A)
        of_elevation = bells(elevation_rad, centre_rad[..., 1], size_rad[..., 1])  # (B, N, E)
        return (brightness * of_elevation).mT @ of_azimuth

    def deformed(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"]
    ) -> tuple[Float[Tensor, "B N 2"], Float[Tensor, "B N 2"], Float[Tensor, "B N 1"]]:
        """Centres and sizes in radians, and brightnesses of all Gaussians, for each transmitter and carrier."""
        gaussians, scaling = self.gaussians, self.scaling
        place = scaling.unit_position(scaling.in_frame(tx_position_m))
        query = torch.cat(
            [positional_encoding(place, self.config.tx_octaves), scaling.unit_carrier(carrier_hz)], dim=-1
        )
        centre = positional_encoding(gaussians.centre_rad.detach() / math.pi, self.config.centre_octaves)
        outputs = self.network(query, centre, query.new_zeros(len(query), len(centre), 0))
        moved, scaled, brightened = outputs.split(_PARTS, dim=-1)
        log_size = (gaussians.log_size + scaled).clamp_max(math.log(_MOST_SIZE_RAD))
        size_rad = (_LEAST_SIZE_RAD**2 + (2 * log_size).exp()).sqrt()
        brightness = softplus(gaussians.brightness + brightened)
        moved_rad = _MOST_MOVE_RAD * torch.tanh(moved / _MOST_MOVE_RAD)
        return gaussians.centre_rad + moved_rad, size_rad, brightness


class SwiftWRF(LearnedMethod):
    """SwiftWRF (2025), from its paper's idea: 2D Gaussian splatting of the spectrum itself.

    Kept: Gaussians on the plane of azimuth and elevation, powers that add up without order or opacity, a small
    network of the encoded centre and transmitter that shifts, reshapes and brightens each.
    Left out: all but some hundreds of Gaussians, and their slant: axes lie along azimuth and elevation; training in
    two stages, first without deformation; residuals between groups of neighbouring transmitters; noise on positions
    that fades.
    Changed: the carrier is one more input of the network; shifts and sizes are bounded; power is projected on what the
    array can give, as in `xfreq-gs`; maps are normalised and the loss is Eq. 12.
    """

    Config = SwiftWRFConfig

    def field(self) -> ChannelField:
        """The field for the options, before training."""
        return SwiftWRFField(self.config)
