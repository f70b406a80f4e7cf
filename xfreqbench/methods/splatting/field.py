"""Fields of Gaussians splatted on the sphere of directions (Adaptive Orthographic Splatting, Eqs. 8–11)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import torch
from jaxtyping import Bool, Float
from pydantic import Field as Limits
from torch import Tensor, nn

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import MethodError
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.learning.encoding import Scaling
from xfreqbench.methods.learning.network import Attributes, NetworkConfig, WideFreqNetwork
from xfreqbench.methods.learning.targets import Beams, GridView
from xfreqbench.methods.learning.training import ChannelField, Count
from xfreqbench.methods.splatting.composite import PixelLists, composite
from xfreqbench.methods.splatting.density import DensityConfig, DensityControl
from xfreqbench.methods.splatting.footprints import bin_footprints, squared_distance
from xfreqbench.methods.splatting.gaussians import RFGaussians
from xfreqbench.methods.splatting.projection import Projection, project

SUPPORT = 9.0  # squared Mahalanobis distance at which a footprint ends: three deviations
_GAUSSIAN_RATE = 10.0  # of the learning rate: positions in metres may change faster than weights


@dataclass(frozen=True)
class GaussianConfig(DensityConfig):
    """Options of Gaussians: their number at the start, and how it changes."""

    num_gaussians: Count = 256


@dataclass(frozen=True)
class SplatConfig(GaussianConfig):
    """Options of the Gaussians' footprints."""

    angular_size_deg: Annotated[float, Limits(gt=0, le=90)] = 6.0  # of one deviation, at the start
    footprint: Literal["projected", "circular"] = "projected"  # circular: fixed at the starting size


class GaussianField(ChannelField):
    """Complex Gaussians accumulated along each direction, nearest first; subclasses give their `attributes`.

    `network` is what `attributes` uses; it belongs to the parameters. `max_spread` is the upper bound of λ.
    """

    def __init__(
        self, config: GaussianConfig, scaling: Scaling, network: nn.Module, max_spread: float = 1.0
    ) -> None:
        super().__init__()
        if config.num_gaussians > config.max_gaussians:
            raise MethodError(
                f"num_gaussians={config.num_gaussians} is more than max_gaussians={config.max_gaussians}; raise "
                "the latter too."
            )
        self.config = config
        self.scaling = scaling
        self.network = network
        self.gaussians = self.new_gaussians(config.num_gaussians)
        self.density = DensityControl(config)
        self._support = SUPPORT * max_spread

    def attributes(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], seen: Bool[Tensor, "N"]
    ) -> Attributes:
        """Signal, attenuation and spread of the Gaussians `seen`, for each transmitter and carrier."""
        raise NotImplementedError

    def new_gaussians(self, number: int) -> RFGaussians:
        """New Gaussians, all zero.

        They may be of a subclass of `RFGaussians`, whose parameters are divided and dropped with the Gaussians.
        """
        return RFGaussians(number)

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Parameters with their learning rates: the network, and the Gaussians, which learn faster."""
        network = {"params": list(self.network.parameters()), "lr": learning_rate}
        gaussians = {"params": list(self.gaussians.parameters()), "lr": _GAUSSIAN_RATE * learning_rate}
        return [network, gaussians]

    def power(
        self,
        tx_position_m: Float[Tensor, "B 3"],
        carrier_hz: Float[Tensor, "B"],
        view: GridView,
        beams: Beams,
    ) -> Float[Tensor, "B E A"]:
        """Power |R_k|² from each direction in view."""
        grid = view.of_grid(beams.grid)
        projection = self.projection()
        lists = self.lists(projection, grid)
        distance = squared_distance(projection, lists, grid)
        seen = seen_of(lists)
        attributes = self.attributes(tx_position_m, carrier_hz, seen)
        self.density.watch(seen, attributes.signal)
        spread, signal, attenuation = attributes.inverse_spread, attributes.signal[0], attributes.attenuation
        response = composite(renumbered(lists, seen), distance, spread, signal, attenuation)
        return torch.view_as_real(response).square().sum(-1).reshape(-1, *grid.shape)

    def projection(self) -> Projection:
        """The footprints before the frequency spread λ."""
        return project(self.gaussians.position_m, self.gaussians.covariance)

    def lists(self, projection: Projection, grid: AngularGrid) -> PixelLists:
        """Which directions see which Gaussians where these are widest."""
        return bin_footprints(projection, grid, self._support)

    def after_step(self, optimizer: torch.optim.Adam, step: int, share: float) -> None:
        """Divide and drop Gaussians when it is time."""
        self.density.after_step(self.gaussians, optimizer, step, share)

    def counts(self) -> dict[str, float]:
        """Number of Gaussians."""
        return {"gaussians": len(self.gaussians)}

    def match(self, tensors: Mapping[str, Tensor]) -> None:
        """Take the number of stored Gaussians, so that they can be loaded."""
        self.gaussians = self.new_gaussians(len(tensors["gaussians.position_m"]))
        self.density.resize(len(tensors["density.contribution"]))  # zero where nothing was summed yet


class SplatField(GaussianField):
    """Gaussians whose attributes come from the paper's network."""

    config: SplatConfig
    network: WideFreqNetwork

    def __init__(self, config: SplatConfig, network: NetworkConfig) -> None:
        scaling = Scaling()
        super().__init__(config, scaling, WideFreqNetwork(network, scaling), network.max_spread)

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Place the Gaussians at random points in the box of the training data."""
        self.scaling.adapt(train)
        self.gaussians.scatter(self.scaling, math.radians(self.config.angular_size_deg), generator)

    def projection(self) -> Projection:
        """The footprints before the frequency spread λ, or circles of fixed size, as the options say."""
        projection = super().projection()
        if self.config.footprint == "projected":
            return projection
        size = math.radians(self.config.angular_size_deg) ** 2
        circle = size * torch.eye(2).to(projection.covariance)
        return Projection(
            projection.azimuth_rad,
            projection.elevation_rad,
            circle.expand_as(projection.covariance),
            projection.range_m,
        )

    def attributes(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], seen: Bool[Tensor, "N"]
    ) -> Attributes:
        """The network's outputs for the Gaussians `seen`."""
        position_m = self.gaussians.position_m.detach()[seen]
        return self.network(self.scaling.in_frame(tx_position_m), carrier_hz, position_m)

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Parameters with their learning rates: those of the network as it says, and the Gaussians."""
        *_, gaussians = super().parameter_groups(learning_rate)
        return [*self.network.parameter_groups(learning_rate), gaussians]


def seen_of(lists: PixelLists) -> Bool[Tensor, "N"]:
    """Whether each Gaussian is seen from any direction."""
    return torch.bincount(lists.gaussian, minlength=lists.num_gaussians) > 0


def renumbered(lists: PixelLists, seen: Bool[Tensor, "N"]) -> PixelLists:
    """The same lists with indices that count only the Gaussians `seen`, for which alone there are attributes."""
    return PixelLists(lists.start, (seen.cumsum(0) - 1)[lists.gaussian], int(seen.sum()))
