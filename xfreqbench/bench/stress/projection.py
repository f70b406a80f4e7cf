"""Projection of Gaussians of all places, sizes and shapes onto the sphere of directions (Eqs. 5, 8 and 9)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from xfreqbench.bench.stress.case import Area
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.splatting.composite import PixelLists
from xfreqbench.methods.splatting.footprints import squared_distance
from xfreqbench.methods.splatting.gaussians import covariance, rotation_matrix
from xfreqbench.methods.splatting.projection import project, projection_jacobian

PROJECTION = Area("projection")
_GRID = AngularGrid.hemisphere()
_SINGLE = 1e-6  # some roundings of float32, 6e-8


@PROJECTION.case("Gaussians of all places, sizes, and zero quaternions", limit=0, unit="values")
def _faults_of_strange_gaussians() -> float:
    """Number of results and gradients that are not finite, and of footprints that are no ellipse."""
    leaves = [leaf.requires_grad_() for leaf in _strange_gaussians(torch.float32)]
    projection = project(leaves[0], covariance(leaves[2], leaves[1]))
    lists = PixelLists(
        torch.tensor([0, *[len(leaves[0])] * 32400]), torch.arange(len(leaves[0])), len(leaves[0])
    )
    distance = squared_distance(projection, lists, _GRID)
    torch.exp(-distance / 2).sum().backward()
    gradients = [leaf.grad for leaf in leaves if leaf.grad is not None]
    values = [projection.azimuth_rad, projection.elevation_rad, projection.covariance, distance, *gradients]
    faults = sum((~torch.isfinite(value)).sum() for value in values)
    return float(
        faults + (distance < 0).sum() + (torch.linalg.eigvalsh(projection.covariance.double()) <= 0).sum()
    )


def _strange_gaussians(kind: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """Positions, log-scales and quaternions: at the receiver, on the pole's axis and beside it, from 1e-8 to 1e4 m."""
    places = [
        (0, 0, 0),
        (0, 0, 3),
        (0, 0, -3),
        (1e-7, 0, 3),
        (1e-3, 1e-3, 1),
        (0, -2, 0),
        (-2, 0, 1e-20),
        (-3, 2, 1),
    ]
    scales = [
        (1e-8, 1e-8, 1e-8),
        (1e4, 1e-8, 1e-8),
        (1e4, 1e4, 1e-8),
        (1e4, 1e4, 1e4),
        (10, 1e-3, 1e-3),
        (1, 1, 1),
    ]
    turns = torch.randn(20, 4, generator=torch.Generator().manual_seed(0)).tolist()
    pairs = [(place, scale, turn) for place in places for scale in scales for turn in [(0, 0, 0, 0), *turns]]
    position_m, scale_m, quaternion = (
        torch.tensor(column, dtype=kind) for column in zip(*pairs, strict=True)
    )
    return position_m, scale_m.log(), quaternion


# it is moved by 2 µm to have an azimuth, and seen from 3 m
@PROJECTION.each(
    {"Gaussian exactly at the zenith": (3.0,), "Gaussian exactly at the nadir": (-3.0,)},
    limit=1e-6,
    unit="rad",
)
def _pole(height_m: float) -> float:
    """Angle in radians between the pole and a Gaussian exactly above or below the receiver."""
    position_m = torch.tensor([[0.0, 0.0, height_m]])
    projection = project(position_m, torch.zeros(1, 3, 3))
    return float((projection.elevation_rad - math.copysign(math.pi / 2, height_m)).abs())


@PROJECTION.case("Jacobian up to 1.1° from the pole", limit=_SINGLE, unit="relative")
def _jacobian() -> float:
    """Error of the Jacobian in float32 against differences, relative to its largest entry."""
    elevation = torch.tensor([0.0, 30.0, -45.0, 80.0, 88.0, 88.9]).double().deg2rad()
    azimuth = torch.tensor([0.0, 1.0, 2.0, 3.0, -1.0, -3.1]).double()
    horizontal = 5 * elevation.cos()
    position_m = torch.stack(
        [horizontal * azimuth.cos(), horizontal * azimuth.sin(), 5 * elevation.sin()], -1
    )

    def angles(at: Tensor) -> Tensor:
        return torch.stack([torch.atan2(at[:, 1], at[:, 0]), torch.asin(at[:, 2] / at.norm(dim=-1))], -1)

    step_m = 1e-5 * torch.eye(3, dtype=torch.float64)
    expected = torch.stack([(angles(position_m + e) - angles(position_m - e)) / 2e-5 for e in step_m], dim=-1)
    found = projection_jacobian(position_m.float()).double()
    return float(((found - expected).abs().amax((1, 2)) / expected.abs().amax((1, 2))).max())


@PROJECTION.case("Jacobian within 1° of the pole", limit=_SINGLE, unit="relative")
def _jacobian_at_the_pole() -> float:
    """Within 1° of the pole the azimuth changes by 1/(sin 1° · range) per metre, the elevation by 1/range."""
    position_m = torch.tensor([[1e-12, 0, 5], [1e-6, 1e-6, 5], [0.01, -0.01, -5], [0.08, 0, 5]])
    found = projection_jacobian(position_m).double().norm(dim=-1)
    range_m = position_m.double().norm(dim=-1, keepdim=True)
    expected = torch.tensor([1 / math.sin(math.pi / 180), 1.0]).double() / range_m
    return float((found / expected - 1).abs().max())


@PROJECTION.case("covariances of 1e-8 to 1e4 m", limit=5 * _SINGLE, unit="relative")
def _extreme_scales() -> float:
    """Σ of a needle turned so that its axes change places is the diagonal matrix with exchanged entries.

    After a turn by 90° about z the error is relative to the largest entry. After a turn by 120° about all three
    axes, whose quaternion and products are exact, it is relative to each entry of the diagonal.
    """
    scale = torch.tensor([[1e-8, 1e4, 1.0], [1e4, 1e-8, 1e-8], [1e4, 1e4, 1e-8]])
    half = math.sqrt(0.5)
    found = covariance(torch.tensor([[half, 0.0, 0.0, half]]).expand(3, 4), scale.log()).double()
    expected = torch.diag_embed(scale.double()[:, [1, 0, 2]] ** 2)
    off = (found - expected).abs() / expected.amax((1, 2), keepdim=True)
    exact = covariance(torch.full((3, 4), 0.5), scale.log()).double()
    entries = scale.double()[:, [2, 0, 1]] ** 2
    beside = (exact - torch.diag_embed(exact.diagonal(dim1=1, dim2=2))).abs()
    return max(
        float(off.max()),
        float((exact.diagonal(dim1=1, dim2=2) / entries - 1).abs().max()),
        float(beside.max()),
    )


@PROJECTION.case("quaternions of length 0, 1e-6, 1e6", limit=_SINGLE, unit="absolute")
def _quaternions() -> float:
    """Quaternions of length 1e-6, 1 and 1e6 give the same rotation; one of length 0 gives the identity."""
    unit = torch.nn.functional.normalize(
        torch.randn(10, 4, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    still = rotation_matrix(torch.zeros(1, 4)) - torch.eye(3)
    others = [rotation_matrix(length * unit) - rotation_matrix(unit) for length in (1e-6, 1e6)]
    product = rotation_matrix(unit).double()
    return max(
        float(off.abs().max()) for off in (still, *others, product @ product.mT - torch.eye(3).double())
    )


@PROJECTION.case("Gaussian without extent", limit=_SINGLE, unit="relative")
def _smallest_footprint() -> float:
    """A Gaussian without extent has a circular footprint with a deviation of half a degree."""
    found = project(torch.tensor([[1.0, 2.0, 1.0]]), torch.zeros(1, 3, 3)).covariance
    return float((found / math.radians(0.5) ** 2 - torch.eye(2)).abs().max())
