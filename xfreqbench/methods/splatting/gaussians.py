"""3-D RF Gaussians (Eqs. 4–6): position, orientation and size, the same for all carriers and transmitters."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import normalize

from xfreqbench.methods.learning.encoding import Scaling


def covariance(quaternion: Float[Tensor, "N 4"], log_scale: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3 3"]:
    """Σ = R S Sᵀ Rᵀ (Eq. 5) in m², from quaternions (w, x, y, z) of any length and logarithms of sizes in metres."""
    axes = rotation_matrix(quaternion) * log_scale.exp()[:, None, :]
    return axes @ axes.mT


def rotation_matrix(quaternion: Float[Tensor, "N 4"]) -> Float[Tensor, "N 3 3"]:
    """Rotation matrices of quaternions (w, x, y, z), which are scaled to length 1."""
    w, x, y, z = normalize(quaternion, dim=-1).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


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
