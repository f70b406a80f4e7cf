"""Gaussians splatted on the sphere of directions (Adaptive Orthographic Splatting, Eqs. 8–11)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import torch
from jaxtyping import Bool, Complex, Float
from pydantic import Field as Limits
from torch import Tensor, nn

from xfreqbench.angles import AngularGrid
from xfreqbench.dataset import PasDataset
from xfreqbench.errors import MethodError
from xfreqbench.splatting.composite import PixelLists, composite
from xfreqbench.splatting.density import DensityConfig, DensityControl
from xfreqbench.splatting.encoding import Scaling
from xfreqbench.splatting.footprints import bin_footprints, squared_distance
from xfreqbench.splatting.gaussians import RFGaussians
from xfreqbench.splatting.learned import ChannelField, Count
from xfreqbench.splatting.network import Attributes, NetworkConfig, WideFreqNetwork
from xfreqbench.splatting.projection import Projection, project
from xfreqbench.splatting.view import Beams, View

SUPPORT = 9.0  # squared Mahalanobis distance at which a footprint ends: three deviations
_GAUSSIAN_RATE = 10.0  # of the learning rate: a metre matters less than a weight


@dataclass(frozen=True)
class GaussianConfig(DensityConfig):
    """How many Gaussians there are to start with."""

    num_gaussians: Count = 256


@dataclass(frozen=True)
class SplatConfig(GaussianConfig):
    """The Gaussians' footprints."""

    angular_size_deg: Annotated[float, Limits(gt=0, le=90)] = 6.0  # one deviation, to start with
    footprint: Literal["projected", "circular"] = "projected"  # circular: fixed at the starting size


class GaussianField(ChannelField):
    """Complex Gaussians accumulated along every direction, nearest first; who derives says what each of them is.

    `network` is what `attributes` asks, kept among the parameters; `max_spread` bounds the 1/λ it answers.
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
        """Signal, attenuation and spread of some of the Gaussians."""
        raise NotImplementedError

    def new_gaussians(self, number: int) -> RFGaussians:
        """Gaussians of zeros; whatever a subclass of `RFGaussians` holds of each is divided and dropped with it."""
        return RFGaussians(number)

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """The network's, and one for the Gaussians, which move faster than weights."""
        network = {"params": list(self.network.parameters()), "lr": learning_rate}
        gaussians = {"params": list(self.gaussians.parameters()), "lr": _GAUSSIAN_RATE * learning_rate}
        return [network, gaussians]

    def power(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: View, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """|R_k|² of every direction in view."""
        grid = view.of_grid(beams.grid)
        projection = self.projection()
        lists = self.lists(projection, grid)
        distance = squared_distance(projection, lists, grid)
        seen = seen_of(lists)
        attributes = self.attributes(tx_position_m, carrier_hz, seen)
        self.density.watch(seen, attributes.signal)
        response = _accumulate(renumbered(lists, seen), distance, attributes)
        return torch.view_as_real(response).square().sum(-1).reshape(-1, *grid.shape)

    def projection(self) -> Projection:
        """The footprints before the frequency's spread."""
        return project(self.gaussians.position_m, self.gaussians.covariance)

    def lists(self, projection: Projection, grid: AngularGrid) -> PixelLists:
        """Which directions see which Gaussians, at the widest spread."""
        return bin_footprints(projection, grid, self._support)

    def after_step(self, optimizer: torch.optim.Adam, step: int, share: float) -> None:
        """Densify and prune."""
        self.density.after_step(self.gaussians, optimizer, step, share)

    def counts(self) -> dict[str, float]:
        """Number of Gaussians."""
        return {"gaussians": len(self.gaussians)}

    def match(self, tensors: Mapping[str, Tensor]) -> None:
        """Take the number of Gaussians that were stored."""
        self.gaussians = self.new_gaussians(len(tensors["gaussians.position_m"]))
        self.density.resize(len(tensors["density.contribution"]))  # none where nothing was summed yet


class SplatField(GaussianField):
    """Gaussians whose attributes the paper's network gives."""

    config: SplatConfig
    network: WideFreqNetwork

    def __init__(self, config: SplatConfig, network: NetworkConfig) -> None:
        scaling = Scaling()
        super().__init__(config, scaling, WideFreqNetwork(network, scaling), network.max_spread)

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Random points in the box of the data."""
        self.scaling.adapt(train)
        self.gaussians.scatter(self.scaling, math.radians(self.config.angular_size_deg), generator)

    def projection(self) -> Projection:
        """The footprints before the frequency's spread, or circles in their place."""
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
        """The network's answer for some of the Gaussians."""
        position_m = self.gaussians.position_m.detach()[seen]
        return self.network(self.scaling.in_frame(tx_position_m), carrier_hz, position_m)

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """The network's own, and that of the Gaussians."""
        *_, gaussians = super().parameter_groups(learning_rate)
        return [*self.network.parameter_groups(learning_rate), gaussians]


def seen_of(lists: PixelLists) -> Bool[Tensor, "N"]:
    """Which Gaussians any direction sees."""
    return torch.bincount(lists.gaussian, minlength=lists.num_gaussians) > 0


def renumbered(lists: PixelLists, seen: Bool[Tensor, "N"]) -> PixelLists:
    """Lists of the Gaussians that are seen, which alone have attributes."""
    return PixelLists(lists.start, (seen.cumsum(0) - 1)[lists.gaussian], int(seen.sum()))


def _accumulate(
    lists: PixelLists, distance: Float[Tensor, "P"], attributes: Attributes
) -> Complex[Tensor, "B K"]:
    return composite(lists, distance, attributes.inverse_spread, attributes.signal[0], attributes.attenuation)
