"""Inputs of the networks: positions and carriers, scaled to [−1, 1] and encoded."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import grid_sample

from xfreqbench.data.dataset import PasDataset

# share by which the box of training positions grows, so that Gaussians may stand behind the outermost
_MARGIN = 0.1
_REACH = math.log(1.2)  # how far beyond an end of the band what was learned there still serves


def positional_encoding(x: Float[Tensor, "... D"], num_octaves: int) -> Float[Tensor, "... C"]:
    """x, then sin(2^k π x) and cos(2^k π x) for k < num_octaves: C = D (1 + 2 num_octaves)."""
    angle = x[..., None, :] * _frequencies(num_octaves, x.device)
    return torch.cat([x, angle.sin().flatten(-2), angle.cos().flatten(-2)], dim=-1)


@cache
def _frequencies(num_octaves: int, device: torch.device) -> Float[Tensor, "K 1"]:
    return (math.pi * 2.0 ** torch.arange(num_octaves, device=device))[:, None]


def encoded_size(num_inputs: int, num_octaves: int) -> int:
    """Number of outputs C of `positional_encoding` for D inputs."""
    return num_inputs * (1 + 2 * num_octaves)


class Scaling(nn.Module):
    """The receiver's frame and the box and band of the training data, scaled to [−1, 1].

    Positions are relative to the array, in its frame. The box holds all training transmitters and the array, with
    a margin of `_MARGIN`. The band is that of the rows that are trained on now: what is learned on a part of an axis
    is far too large at its far end. A carrier a fifth and more outside the band is taken for the middle of
    it, and one nearer to it for something between: nothing extrapolates, and what was learned at an end of the band is
    of that carrier alone, so that it serves others worse than what is in the middle of all.
    """

    receiver_m: Tensor
    rotation: Tensor
    center_m: Tensor
    half_size_m: Tensor
    log_band: Tensor

    def __init__(self) -> None:
        super().__init__()
        for name, shape in (("receiver_m", 3), ("rotation", (3, 3)), ("center_m", 3), ("half_size_m", 3)):
            self.register_buffer(name, torch.zeros(shape))
        # float64 as carriers are: float32 rounds their logarithm by 2e-6, and a band may be as narrow
        self.register_buffer("log_band", torch.zeros(2, dtype=torch.float64))

    def adapt(self, train: PasDataset) -> None:
        """Take the box, the band and the receiver's frame from training rows."""
        self.receiver_m.copy_(torch.as_tensor(train.header.receiver.position_m))
        self.rotation.copy_(torch.as_tensor(train.header.receiver.rotation))
        tx_m = self.in_frame(torch.as_tensor(train.tx_position_m, dtype=torch.float32))
        low = tx_m.amin(dim=0).minimum(torch.zeros(3))
        high = tx_m.amax(dim=0).maximum(torch.zeros(3))
        self.center_m.copy_((low + high) / 2)
        self.half_size_m.copy_((high - low) / 2 * (1 + _MARGIN) + 0.05)
        self.hear(train)

    def hear(self, train: PasDataset) -> None:
        """Take the band from the rows that are trained on now, of which the outermost carriers may be held out."""
        log_carrier = torch.as_tensor(train.carrier_hz).log()
        self.log_band.copy_(torch.stack([log_carrier.min(), log_carrier.max()]))

    def in_frame(self, position_m: Float[Tensor, "B 3"]) -> Float[Tensor, "B 3"]:
        """Positions relative to the array in its frame, from world positions, in metres."""
        return (position_m - self.receiver_m) @ self.rotation

    def random_positions(self, number: int, generator: torch.Generator) -> Float[Tensor, "N 3"]:
        """Random points of the box in the receiver's frame, in metres."""
        unit = 2 * torch.rand(number, 3, generator=generator) - 1
        return unit.to(self.center_m) * self.half_size_m + self.center_m

    def unit_position(self, position_m: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
        """Positions in the receiver's frame, scaled so that the box is [−1, 1]."""
        return (position_m - self.center_m) / self.half_size_m

    def unit_carrier(self, carrier_hz: Float[Tensor, "B"]) -> Float[Tensor, "B 1"]:
        """Logarithms of carriers, scaled so that the band is [−1, 1]; for a band of one carrier, it is 0."""
        return self._unit(carrier_hz.log(), self.log_band) * self._nearness(carrier_hz)

    def root_carrier(self, carrier_hz: Float[Tensor, "B"]) -> Float[Tensor, "B 1"]:
        """Square roots of carriers, scaled so that the band is [−1, 1]; for a band of one carrier, it is 0.

        Carriers stand more evenly on this axis than on a logarithm, where the lowest have most to say.
        """
        return self._unit(carrier_hz.sqrt(), (self.log_band / 2).exp()) * self._nearness(carrier_hz)

    def _nearness(self, carrier_hz: Float[Tensor, "B"]) -> Float[Tensor, "B 1"]:
        """1 for carriers in the band, and 0 for those far beyond it."""
        log_carrier, (low, high) = carrier_hz.log(), self.log_band
        beyond = (low - log_carrier).maximum(log_carrier - high).clamp(min=0)
        return (1 - beyond / _REACH).clamp(min=0)[:, None].float()

    @staticmethod
    def _unit(carrier: Float[Tensor, "B"], band: Float[Tensor, "2"]) -> Float[Tensor, "B 1"]:
        """Carriers of the band on an axis, scaled to [−1, 1]; those outside it are −1 or 1."""
        low, high = band
        width = torch.where(high > low, high - low, 1.0)
        return ((2 * carrier.clamp(low, high) - low - high) / width)[:, None].float()


class FeatureGrid(nn.Module):
    """Learned features of places, interpolated from grids of 4, 8, 16, … points an axis and fewer in height.

    A network of sines learns differences between neighbouring places slowly; a grid has own numbers for each place
    (multi-resolution grids: Müller et al., Instant Neural Graphics Primitives, 2022).
    """

    _NUM_FEATURES = 4  # on each level
    _COARSEST = 4

    def __init__(self, num_levels: int) -> None:
        super().__init__()
        sizes = [self._COARSEST << level for level in range(num_levels)]
        shapes = [(1, self._NUM_FEATURES, max(2, size // 4), size, size) for size in sizes]
        self.levels = nn.ParameterList([nn.Parameter(1e-2 * torch.randn(shape)) for shape in shapes])
        self.num_outputs = self._NUM_FEATURES * num_levels

    def forward(self, unit_position: Float[Tensor, "B 3"]) -> Float[Tensor, "B C"]:
        """Features at positions in [−1, 1]; positions outside have the features of the border."""
        points = unit_position[None, None, None]
        features = [unit_position[:, :0]]
        features += [
            grid_sample(level, points, padding_mode="border", align_corners=True)[0, :, 0, 0].T for level in self.levels
        ]
        return torch.cat(features, dim=-1)


def rated_with_grid(network: nn.Module, grid: FeatureGrid | None, learning_rate: float) -> list[dict[str, Any]]:
    """A network's parameters with their rates; features of places learn faster, because few transmitters use each."""
    grids = list(grid.parameters()) if grid is not None else []
    known = {id(parameter) for parameter in grids}
    rest = [parameter for parameter in network.parameters() if id(parameter) not in known]
    return [{"params": rest, "lr": learning_rate}, {"params": grids, "lr": 5.0 * learning_rate}]
