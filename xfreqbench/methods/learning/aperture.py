"""A field of Gaussians that are accumulated at the array's elements, not on pixels: one Gaussian is one path."""

from __future__ import annotations

import math
from typing import Any

import torch
from jaxtyping import Complex, Float
from torch import Tensor, nn
from torch.nn.functional import normalize

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.learning.encoding import Scaling
from xfreqbench.methods.learning.network import NetworkConfig, WideFreqNetwork
from xfreqbench.methods.learning.targets import Beams, GridView
from xfreqbench.methods.learning.training import ChannelField


class ApertureField(ChannelField):
    """h_n = Σ_i S_i a_n(d_i) exp(−2π² |r_n⊥|² σ_i²): the array's response to Gaussians of directions.

    r_n⊥ is the position of element n across the direction d_i, in wavelengths, and σ_i the angle under which the
    receiver sees the Gaussian: a source spread over σ loses coherence across the aperture. The map is the Bartlett
    map of h, so it has the side lobes, the mirror symmetry and the band limit of the array.

    The field has several such sums, the modes, and their powers add up. The phases at an unseen carrier are not
    known, so the expectation is not a single channel but a covariance, of as many modes as there are sums.
    """

    def __init__(self, num_gaussians: int, num_modes: int, network: NetworkConfig) -> None:
        super().__init__()
        self.scaling = Scaling()
        self.network = WideFreqNetwork(network, self.scaling, num_modes)
        self.position_m = nn.Parameter(torch.zeros(num_gaussians, 3))
        self.log_angle = nn.Parameter(torch.full((num_gaussians,), math.log(math.radians(5.0))))

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Place the Gaussians at random points in the box of the training data."""
        self.scaling.adapt(train)
        with torch.no_grad():
            self.position_m.copy_(self.scaling.random_positions(len(self.position_m), generator))

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Parameters of the network and of the Gaussians, which have the same rate: positions are some metres."""
        gaussians = {"params": [self.position_m, self.log_angle], "lr": learning_rate}
        return [*self.network.parameter_groups(learning_rate), gaussians]

    def power(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Bartlett maps of the accumulated channels, in view."""
        tx_m = self.scaling.in_frame(tx_position_m)
        signal = self.network(tx_m, carrier_hz, self.position_m).signal
        element = torch.as_tensor(beams.element_position_wavelengths).to(self.position_m)
        return beams.power(signal.mT @ self.response(element), view)

    def response(self, element: Float[Tensor, "M 3"]) -> Complex[Tensor, "N M"]:
        """Array response of every Gaussian at elements whose positions are given in wavelengths."""
        along = normalize(self.position_m, dim=-1) @ element.T
        across = (element * element).sum(-1) - along * along
        spread = torch.exp(-2 * math.pi**2 * across * torch.exp(2 * self.log_angle)[:, None])
        return torch.polar(spread, 2 * math.pi * along)

    def counts(self) -> dict[str, float]:
        """Number of Gaussians."""
        return {"gaussians": len(self.position_m)}
