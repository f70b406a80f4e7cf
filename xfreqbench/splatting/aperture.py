"""Gaussians accumulated at the array's elements instead of on pixels: one path is one Gaussian."""

from __future__ import annotations

import math
from typing import Any

import torch
from jaxtyping import Complex, Float
from torch import Tensor, nn
from torch.nn.functional import normalize

from xfreqbench.dataset import PasDataset
from xfreqbench.splatting.encoding import Scaling
from xfreqbench.splatting.learned import ChannelField
from xfreqbench.splatting.network import NetworkConfig, WideFreqNetwork
from xfreqbench.splatting.view import Beams, View


class ApertureField(ChannelField):
    """h_n = Σ_i S_i a_n(d_i) exp(−2π² |r_n⊥|² σ_i²): the array's response to Gaussians of directions.

    r_n⊥ is the element's position in wavelengths across the direction d_i, σ_i the angle under which the
    receiver sees the Gaussian: a source spread over σ loses coherence across the aperture. The map is the
    Bartlett map of h, so that side lobes, mirror symmetry and band limit are the array's own.

    There are several such sums, and their powers add up: where a carrier's phases are not known, what is
    expected of it is no single channel but a covariance, of as many modes as there are sums.
    """

    def __init__(self, num_gaussians: int, num_modes: int, network: NetworkConfig) -> None:
        super().__init__()
        self.scaling = Scaling()
        self.network = WideFreqNetwork(network, self.scaling, num_modes)
        self.position_m = nn.Parameter(torch.zeros(num_gaussians, 3))
        self.log_angle = nn.Parameter(torch.full((num_gaussians,), math.log(math.radians(5.0))))

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Random points in the box of the data."""
        self.scaling.adapt(train)
        with torch.no_grad():
            self.position_m.copy_(self.scaling.random_positions(len(self.position_m), generator))

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """The network's, and the Gaussians at the same rate: positions are of the order of metres."""
        gaussians = {"params": [self.position_m, self.log_angle], "lr": learning_rate}
        return [*self.network.parameter_groups(learning_rate), gaussians]

    def power(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: View, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Bartlett map of the accumulated channel."""
        tx_m = self.scaling.in_frame(tx_position_m)
        signal = self.network(tx_m, carrier_hz, self.position_m).signal
        element = torch.as_tensor(beams.element_position_wavelengths).to(self.position_m)
        return beams.power(signal.mT @ self.response(element), view)

    def response(self, element: Float[Tensor, "M 3"]) -> Complex[Tensor, "N M"]:
        """Array response of every Gaussian, `element` in wavelengths."""
        along = normalize(self.position_m, dim=-1) @ element.T
        across = (element * element).sum(-1) - along * along
        spread = torch.exp(-2 * math.pi**2 * across * torch.exp(2 * self.log_angle)[:, None])
        return torch.polar(spread, 2 * math.pi * along)

    def counts(self) -> dict[str, float]:
        """Number of Gaussians."""
        return {"gaussians": len(self.position_m)}
