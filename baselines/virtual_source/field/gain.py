"""A small network that corrects the gain of a path, which slabs and cells give."""

from __future__ import annotations

import torch
from jaxtyping import Complex, Float
from torch import Tensor, nn

from xfreqbench.methods.learning.encoding import Scaling, positional_encoding

from .images import Traces


class PathGain(nn.Module):
    """A factor 1 + correction for the gain of a path.

    It depends on the transmitter, the arrival and the planes that the path bounces off, and not on the carrier.
    """

    def __init__(
        self, num_planes: int, width: int, num_octaves: int, max_change: float, scaling: Scaling
    ) -> None:
        super().__init__()
        self.num_octaves, self.max_change, self.scaling = num_octaves, max_change, scaling
        self.of_plane = nn.Embedding(num_planes + 1, width)
        self.of_tx = nn.Linear(3 * (1 + 2 * num_octaves), width)
        self.of_arrival = nn.Linear(3, width)
        self.layers = nn.Sequential(
            nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.head = nn.Linear(width, 2)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, tx_m: Float[Tensor, "B 3"], traces: Traces) -> Complex[Tensor, "B K"]:
        """Complex factors close to 1 for K paths of B transmitters; `tx_m` is in the receiver's frame."""
        tx = positional_encoding(self.scaling.unit_position(tx_m) / 2, self.num_octaves)
        order = torch.arange(1, traces.bounce.plane.shape[-1] + 1, device=tx.device)
        planes = (self.of_plane(traces.bounce.plane + 1) / order[:, None]).sum(2)
        hidden = self.of_tx(tx)[:, None] + self.of_arrival(traces.arrival) + planes
        return 1 + torch.view_as_complex(self.max_change * self.head(self.layers(hidden)).tanh())
