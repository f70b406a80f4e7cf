"""3-D RF Gaussians (Eqs. 4–6): position, orientation and size, the same for all carriers and transmitters."""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import normalize

from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.learning.encoding import Scaling
from xfreqbench.methods.learning.low_rank import NUM_SHAPES, Codes

Seen = Bool[Tensor, "N"] | slice  # whether each Gaussian is seen, or the slice of all
CODES = ("signal_code", "shape_code", "shape_start", "shape_trend")


def covariance(quaternion: Float[Tensor, "N 4"], log_scale: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3 3"]:
    """Σ = R S Sᵀ Rᵀ (Eq. 5) in m², from quaternions (w, x, y, z) of any length and logarithms of sizes in metres."""
    w, x, y, z = normalize(quaternion, dim=-1).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    axes = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2) * log_scale.exp()[:, None, :]
    return axes @ axes.mT


class RFGaussians(nn.Module):
    """N Gaussians in the receiver's frame, in metres."""

    def __init__(self, num_gaussians: int) -> None:
        super().__init__()
        self.position_m = nn.Parameter(torch.zeros(num_gaussians, 3))
        self.quaternion = nn.Parameter(torch.zeros(num_gaussians, 4))
        self.log_scale = nn.Parameter(torch.zeros(num_gaussians, 3))

    def __len__(self) -> int:
        return len(self.position_m)

    @property
    def covariance(self) -> Float[Tensor, "N 3 3"]:
        """Σ of every Gaussian, in square metres (Eq. 5)."""
        return covariance(self.quaternion, self.log_scale)

    @torch.no_grad()
    def scatter(self, scaling: Scaling, angular_size_rad: float, generator: torch.Generator) -> None:
        """Move the Gaussians to random points in the box of the data, turned at random.

        Each is as large as the receiver sees under `angular_size_rad`.
        """
        self.position_m.copy_(scaling.random_positions(len(self), generator))
        self.quaternion.copy_(torch.randn(len(self), 4, generator=generator))
        size_m = self.position_m.norm(dim=-1, keepdim=True).clamp_min(0.1) * angular_size_rad
        self.log_scale.copy_(size_m.log().expand(-1, 3))

    @torch.no_grad()
    def spread_out(
        self, scaling: Scaling, angular_size_rad: float, grid: AngularGrid, generator: torch.Generator
    ) -> None:
        """Scatter the Gaussians, then turn them to a Fibonacci lattice of directions over the elevations of a grid.

        So no direction is left without a Gaussian. Their ranges remain as they were drawn.
        """
        self.scatter(scaling, angular_size_rad, generator)
        lowest, highest = (math.sin(float(end)) for end in (grid.elevation_rad.min(), grid.elevation_rad.max()))
        nth = torch.arange(len(self)) + 0.5
        z = highest - (highest - lowest) * nth / len(self)
        azimuth_rad, across = nth * (math.pi * (3 - math.sqrt(5))), (1 - z * z).clamp_min(0).sqrt()
        direction = torch.stack([across * azimuth_rad.cos(), across * azimuth_rad.sin(), z], dim=-1)
        self.position_m.copy_(direction.to(self.position_m) * self.position_m.norm(dim=-1, keepdim=True))


class CodedGaussians(RFGaussians):
    """Gaussians with a learned code each: the latent z_i of Eq. 4, from which `LowRankNetwork` has S, δ and λ."""

    def __init__(self, num_gaussians: int, rank: int) -> None:
        super().__init__(num_gaussians)
        self.signal_code = nn.Parameter(0.5 * torch.randn(num_gaussians, 2, rank))
        self.shape_code = nn.Parameter(torch.zeros(num_gaussians, NUM_SHAPES, rank))
        self.shape_start = nn.Parameter(torch.zeros(num_gaussians, NUM_SHAPES))
        self.shape_trend = nn.Parameter(torch.zeros(num_gaussians, NUM_SHAPES))

    def codes(self, seen: Seen) -> Codes:
        """The codes of the Gaussians `seen`."""
        every = isinstance(seen, slice) or bool(seen.all())
        return Codes(*(getattr(self, name) if every else getattr(self, name)[seen] for name in CODES))
