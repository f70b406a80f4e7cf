"""A small network that corrects what slabs and cells say of a path's gain."""

from __future__ import annotations

import torch
from jaxtyping import Complex, Float
from torch import Tensor, nn

from xfreqbench.splatting.encoding import Scaling, positional_encoding
from xfreqbench.virtual_source.images import Traces


class PathGain(nn.Module):
    """1 + a correction of a path's gain, by transmitter, arrival and the planes it bounces off; blind to carriers."""

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
        """Factors about 1; `tx_m` is in the receiver's frame."""
        tx = positional_encoding(self.scaling.unit_position(tx_m) / 2, self.num_octaves)
        order = torch.arange(1, traces.bounce.plane.shape[-1] + 1, device=tx.device)
        planes = (self.of_plane(traces.bounce.plane + 1) / order[:, None]).sum(2)
        hidden = self.of_tx(tx)[:, None] + self.of_arrival(traces.arrival) + planes
        return 1 + torch.view_as_complex(self.max_change * self.head(self.layers(hidden)).tanh())
