"""Projection of Gaussians onto the receiver's sphere of directions (Eqs. 8–10).

Angles are (azimuth, elevation) in radians, in the receiver's frame. Close to the pole, a small step changes the
azimuth without bound, so the distance from the pole's axis counts as at least `POLE_DISTANCE` times the range. A
footprint wider than the full circle covers it once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from xfreqbench.methods.splatting import projection_kernels
from xfreqbench.methods.splatting.gaussians import covariance
from xfreqbench.methods.splatting.projection_kernels import (
    LEAST_DECORRELATION,
    MIN_RANGE_M,
    MIN_VARIANCE,
    OFF_AXIS_M,
    POLE_DISTANCE,
)


@dataclass(frozen=True, eq=False)
class Projection:
    """Angular centres, covariances and ranges of N Gaussians on the sphere of directions."""

    azimuth_rad: Float[Tensor, "N"]
    elevation_rad: Float[Tensor, "N"]
    covariance: Float[Tensor, "N 2 2"]  # rad², before the frequency's spread
    range_m: Float[Tensor, "N"]


def project_gaussians(gaussians: Float[Tensor, "N 10"]) -> Projection:
    """As `project`, from positions, quaternions and log-scales (Eq. 5) side by side; on a CPU by compiled kernels."""
    if gaussians.device.type != "cpu":
        position_m, quaternion, log_scale = gaussians.split([3, 4, 3], dim=-1)
        return project(position_m, covariance(quaternion, log_scale))
    footprint, range_m = _Kernels.apply(gaussians)  # type: ignore[no-untyped-call]
    azimuth_rad, elevation_rad, a, b, c = footprint.unbind(-1)
    return Projection(azimuth_rad, elevation_rad, torch.stack([a, b, b, c], dim=-1).reshape(-1, 2, 2), range_m)


class _Kernels(torch.autograd.Function):
    """Azimuth, elevation, entries (0,0), (0,1), (1,1) of the covariance (N, 5); and ranges (N,), without gradient."""

    @staticmethod
    def forward(ctx: Any, gaussians: Tensor) -> tuple[Tensor, Tensor]:
        ctx.gaussians = gaussians.detach().contiguous().numpy()
        footprint, range_m = gaussians.new_empty(len(gaussians), 5), gaussians.new_empty(len(gaussians))
        projection_kernels.project(ctx.gaussians, footprint.numpy(), range_m.numpy())
        ctx.mark_non_differentiable(range_m)
        return footprint, range_m

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor, _: Tensor) -> Tensor:
        gradient = slope.new_empty(len(slope), 10)
        projection_kernels.project_backward(ctx.gaussians, slope.contiguous().numpy(), gradient.numpy())
        return gradient


def project(position_m: Float[Tensor, "N 3"], covariance_m2: Float[Tensor, "N 3 3"]) -> Projection:
    """Angular centres (Eq. 8) and projected covariances J Σ Jᵀ (Eq. 9) with `MIN_VARIANCE` added to the diagonal.

    Points on the pole's axis, where the azimuth has no derivative, are moved off it along x by two micrometres.
    """
    x, y, z = position_m.unbind(-1)
    on_axis = x.abs() + y.abs() < OFF_AXIS_M
    position_m = torch.stack([torch.where(on_axis, x + 2 * OFF_AXIS_M, x), y, z], dim=-1)
    azimuth_rad, elevation_rad, range_m = angular_centre(position_m)
    jacobian = projection_jacobian(position_m)
    projected = jacobian @ covariance_m2 @ jacobian.mT
    blurred = projected + MIN_VARIANCE * torch.eye(2, dtype=projected.dtype, device=projected.device)
    return Projection(azimuth_rad, elevation_rad, _invertible(blurred), range_m)


def _invertible(covariance: Float[Tensor, "N 2 2"]) -> Float[Tensor, "N 2 2"]:
    """The same with correlations clipped below 1; float32 rounds those of long needles to 1 or more."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    most = (a * c).sqrt() * (1 - LEAST_DECORRELATION)
    b = b.clamp(-most, most)
    return torch.stack([a, b, b, c], dim=-1).reshape(-1, 2, 2)


def angular_centre(
    position_m: Float[Tensor, "N 3"],
) -> tuple[Float[Tensor, "N"], Float[Tensor, "N"], Float[Tensor, "N"]]:
    """Azimuth, elevation and range of positions off the pole's axis, in the receiver's frame (Eq. 8)."""
    x, y, z = position_m.unbind(-1)
    horizontal = torch.hypot(x, y)
    return torch.atan2(y, x), torch.atan2(z, horizontal), torch.hypot(horizontal, z)


def projection_jacobian(position_m: Float[Tensor, "N 3"]) -> Float[Tensor, "N 2 3"]:
    """∂(azimuth, elevation)/∂(x, y, z) of positions off the pole's axis, in rad/m (Eq. 9)."""
    x, y, z = position_m.unbind(-1)
    range_m = position_m.norm(dim=-1).clamp_min(MIN_RANGE_M)
    horizontal = torch.hypot(x, y)
    cosine, sine = x / horizontal, y / horizontal
    reach = horizontal.maximum(POLE_DISTANCE * range_m)[:, None]
    of_azimuth = torch.stack([-sine, cosine, torch.zeros_like(z)], dim=-1) / reach
    of_elevation = torch.stack([-z * cosine, -z * sine, horizontal], dim=-1) / range_m[:, None] ** 2
    return torch.stack([of_azimuth, of_elevation], dim=-2)
