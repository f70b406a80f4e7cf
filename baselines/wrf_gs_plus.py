"""WRF-GS+, reduced: static Gaussians that a network moves, turns, rescales and brightens for each transmitter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Float
from pydantic import Field as Limits
from torch import Tensor, nn
from typing_extensions import Doc

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.learning.encoding import Scaling, encoded_size, positional_encoding
from xfreqbench.methods.learning.network import PairwiseMLP, Precision
from xfreqbench.methods.learning.targets import Beams, GridView
from xfreqbench.methods.learning.training import ChannelField, Count, LearnedMethod
from xfreqbench.methods.splatting.composite_maps import composite_maps
from xfreqbench.methods.splatting.field import GaussianConfig, GaussianField, SplatTrainingConfig
from xfreqbench.methods.splatting.gaussians import RFGaussians

_SIGNAL, _OPACITY = 0.5, 0.1  # of each Gaussian at the start
_PARTS = (10, 2)  # of a deformation: position, quaternion and log-scale; real and imaginary part of the signal


@dataclass(frozen=True)
class WRFGSPlusConfig(GaussianConfig, SplatTrainingConfig):
    """Options. The paper has 8 layers of 256 with a skip, 10 octaves of positions and 6 of transmitters.

    It has tens of thousands of Gaussians.
    """

    angular_size_deg: Annotated[float, Limits(gt=0, le=90), Doc("one deviation at the start")] = 4.0
    width: Annotated[Count, Doc("features of each hidden layer")] = 64
    layers: Annotated[Count, Doc("hidden layers")] = 4
    position_octaves: Annotated[int, Limits(ge=0), Doc("octaves of sines of a Gaussian's place")] = 4
    tx_octaves: Annotated[int, Limits(ge=0), Doc("octaves of sines of the transmitter's place")] = 6
    precision: Annotated[Precision, Doc("auto: bfloat16 where the processor has it")] = "auto"
    batch_size: Count = 32  # each map has its own footprints


class DeformationNetwork(nn.Module):
    """Changes of each Gaussian for each transmitter: one network with inputs E(μ) and E(p_tx)."""

    def __init__(self, config: WRFGSPlusConfig, scaling: Scaling) -> None:
        super().__init__()
        self.config, self.scaling = config, scaling
        sizes = encoded_size(3, config.tx_octaves), encoded_size(3, config.position_octaves)
        hidden = [config.width] * config.layers
        self.mlp = PairwiseMLP(*sizes, 0, hidden, sum(_PARTS), config.precision)

    def forward(
        self, tx_m: Float[Tensor, "B 3"], position_m: Float[Tensor, "N 3"]
    ) -> tuple[Float[Tensor, "B N 10"], Float[Tensor, "B N 2"]]:
        """What to add to shapes (position in metres, quaternion, log-scale), and complex signals to add."""
        query = positional_encoding(self.scaling.unit_position(tx_m), self.config.tx_octaves)
        gaussian = positional_encoding(self.scaling.unit_position(position_m), self.config.position_octaves)
        outputs = self.mlp(query, gaussian, query.new_zeros(len(query), len(gaussian), 0))
        shape, signal = outputs.split(_PARTS, dim=-1)
        return shape, signal


class BrightGaussians(RFGaussians):
    """Gaussians with a real signal and an opacity each."""

    def __init__(self, num_gaussians: int) -> None:
        super().__init__(num_gaussians)
        self.signal = nn.Parameter(torch.full((num_gaussians,), _SIGNAL))
        self.opacity_logit = nn.Parameter(torch.full((num_gaussians,), math.log(_OPACITY / (1 - _OPACITY))))


class WRFGSPlusField(GaussianField):
    """R_k = Σ_i o_i G_i s_i Π_{m<i} (1 − o_m G_m), all real, with Gaussians that are deformed for each transmitter."""

    config: WRFGSPlusConfig
    network: DeformationNetwork
    gaussians: BrightGaussians

    def __init__(self, config: WRFGSPlusConfig) -> None:
        scaling = Scaling()
        super().__init__(config, scaling, DeformationNetwork(config, scaling))

    def new_gaussians(self, number: int) -> BrightGaussians:
        """New Gaussians, all with the same signal and opacity."""
        return BrightGaussians(number)

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Place the Gaussians at random points in the box of the training data."""
        self.scaling.adapt(train)
        self.gaussians.scatter(self.scaling, math.radians(self.config.angular_size_deg), generator)

    def splatted(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Power R_k² of what is accumulated from each direction in view; each transmitter has its own footprints."""
        grid = view.of_grid(beams.grid)
        shapes, amplitude = self.deformed(tx_position_m)
        opacity = torch.sigmoid(self.gaussians.opacity_logit).expand_as(amplitude)
        signal = (opacity * amplitude).T[None]
        self.density.watch(slice(None), signal)
        field = composite_maps(shapes, grid, self._support, signal[0].T, opacity)
        return field.square().reshape(-1, *grid.shape)

    def deformed(self, tx_position_m: Float[Tensor, "B 3"]) -> tuple[Float[Tensor, "B N 10"], Float[Tensor, "B N"]]:
        """Positions, quaternions and log-scales of all Gaussians, and their signals' amplitudes, by transmitters."""
        gaussians, tx_m = self.gaussians, self.scaling.in_frame(tx_position_m)
        changes, signal = self.network(tx_m, gaussians.position_m.detach())
        return self.shapes + changes, torch.relu(gaussians.signal + torch.view_as_complex(signal).abs())


class WRFGSPlus(LearnedMethod):
    """WRF-GS+, from its paper's idea, on this renderer: blind to the carrier, no interference.

    Kept: static Gaussians with an opacity, a network of encoded place and transmitter that shifts, turns and
    rescales them and adds |s e^{jφ}| to their signal, footprints projected and sorted again for each transmitter.
    Left out: the network's skip, four of its eight layers and three quarters of its width; all but a few hundred
    Gaussians; spherical harmonics of the signal, for one receiver sees a Gaussian from one side.
    Changed: what it shifts is shifted (the released renderer leaves positions alone); sizes are multiplied, not
    added to; Gaussians are divided by their pull, dropped by their contribution; maps are normalised, and the
    loss is Eq. 12.
    """

    Config = WRFGSPlusConfig

    def field(self) -> ChannelField:
        """The field for the options, before training."""
        return WRFGSPlusField(self.config)
