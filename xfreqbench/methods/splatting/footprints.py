"""Which directions of a grid lie inside which Gaussian's footprint, computed once for a minibatch.

A footprint is the ellipse of squared Mahalanobis distance at most `support` around the angular centre. It continues
across the azimuth's seam, holds no direction twice, and ends at the grid's first and last rows.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.splatting.composite import Backend, PixelLists
from xfreqbench.methods.splatting.footprint_kernels import HIGHEST_RAD, LOWEST_RAD, fill_lists, footprint_runs
from xfreqbench.methods.splatting.projection import Projection


@torch.no_grad()
def bin_footprints(projection: Projection, grid: AngularGrid, support: float, backend: Backend = "auto") -> PixelLists:
    """The Gaussians that each direction sees, nearest first; directions are numbered row by row.

    The azimuths of the grid have to be evenly spaced over one turn at most; the first may be repeated at the end.
    """
    order = projection.range_m.argsort(stable=True)
    centre = torch.stack([projection.azimuth_rad, projection.elevation_rad], dim=-1)[order].double()
    conic = inverse(projection.covariance.double())[order]
    if backend == "torch" or centre.device.type != "cpu":
        start, nth = _bin_torch(centre, conic, grid, support)
    else:
        runs = footprint_runs(centre.numpy(), conic.numpy(), grid.elevation_rad, grid.azimuth_rad, support)
        start, nth = map(torch.from_numpy, fill_lists(*runs[:2], math.prod(grid.shape)))
    return PixelLists(start, order[nth], len(order))


def squared_distance(projection: Projection, lists: PixelLists, grid: AngularGrid) -> Float[Tensor, "P"]:
    """Squared Mahalanobis distance of each pair of a direction and a Gaussian, azimuths taken the short way round."""
    azimuth_rad = torch.as_tensor(grid.azimuth_rad).to(projection.azimuth_rad)
    elevation_rad = torch.as_tensor(grid.elevation_rad).to(projection.azimuth_rad)
    pixel = torch.repeat_interleave(lists.start.diff())
    conic = inverse(projection.covariance)
    of_gaussian = torch.column_stack([projection.azimuth_rad, projection.elevation_rad, conic])
    # index_select adds its gradients in order; plain indexing adds them in any order, and runs would differ
    u, v, a, b, c = of_gaussian.T.index_select(1, lists.gaussian)
    across = azimuth_rad[pixel % len(azimuth_rad)] - u
    across = torch.remainder(across + math.pi, 2 * math.pi) - math.pi
    along = elevation_rad[pixel // len(azimuth_rad)] - v
    return a * across * across + 2 * b * across * along + c * along * along


def inverse(covariance: Float[Tensor, "N 2 2"]) -> Float[Tensor, "N 3"]:
    """Entries (0,0), (0,1), (1,1) of the inverse of symmetric positive matrices."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    return torch.stack([c, -b, a], dim=-1) / (a * c - b * b)[:, None]


def _bin_torch(
    centre: Float[Tensor, "N 2"], conic: Float[Tensor, "N 3"], grid: AngularGrid, support: float
) -> tuple[Int[Tensor, "K1"], Int[Tensor, "P"]]:
    """Starts of the lists and their Gaussians, on any device: all rows of all footprints, then their directions."""
    gaussian, row, first, count = _spans(centre, conic, grid, support)
    span = torch.repeat_interleave(count)
    nth = torch.arange(len(span), device=span.device) - (count.cumsum(0) - count)[span]
    pixel = (row * len(grid.azimuth_rad) + first)[span] + nth
    by_pixel = pixel.argsort(stable=True)
    counts = torch.bincount(pixel, minlength=len(grid.azimuth_rad) * len(grid.elevation_rad))
    start = torch.cat([counts.new_zeros(1), counts.cumsum(0)])
    return start, gaussian[span][by_pixel]


def _spans(
    centre: Float[Tensor, "N 2"], conic: Float[Tensor, "N 3"], grid: AngularGrid, support: float
) -> tuple[Int[Tensor, "S"], Int[Tensor, "S"], Int[Tensor, "S"], Int[Tensor, "S"]]:
    """Gaussian, row, first column and number of columns wherever a footprint meets a row, for each turn."""
    elevation_rad = torch.as_tensor(grid.elevation_rad, device=centre.device)
    num_azimuths, first_azimuth_rad = len(grid.azimuth_rad), float(grid.azimuth_rad[0])
    step_rad = float(grid.azimuth_rad[1]) - first_azimuth_rad if num_azimuths > 1 else 2 * math.pi
    a, b, c = conic[:, None].unbind(-1)
    along = elevation_rad[None, :] - centre[:, 1:]
    discriminant = (b * along) ** 2 - a * (c * along * along - support)
    reach = discriminant.clamp_min(0).sqrt()
    offset = torch.remainder(centre[:, :1] - first_azimuth_rad, 2 * math.pi)
    turns = 2 * math.pi * torch.tensor([-1.0, 0.0, 1.0]).to(centre)
    low = (offset + ((-b * along - reach) / a).clamp_min(LOWEST_RAD))[..., None] + turns
    high = (offset + ((-b * along + reach) / a).clamp_max(HIGHEST_RAD))[..., None] + turns
    first = torch.ceil(low / step_rad).long().clamp_min(0)
    last = torch.floor(high / step_rad).long().clamp_max(num_azimuths - 1)
    gaussian, row, turn = torch.nonzero((discriminant >= 0)[..., None] & (last >= first), as_tuple=True)
    count = (last - first + 1)[gaussian, row, turn]
    return gaussian, row, first[gaussian, row, turn], count
