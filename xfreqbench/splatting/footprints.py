"""Which directions of a grid lie inside which Gaussian's footprint: once for a whole minibatch.

A footprint is the ellipse of squared Mahalanobis distance at most `support` around the angular centre.
It runs across the azimuth's seam, holds no direction twice, and ends at the grid's first and last rows.
"""

from __future__ import annotations

import math
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from xfreqbench.angles import AngularGrid
from xfreqbench.splatting.composite import PixelLists
from xfreqbench.splatting.footprint_kernels import fill_lists, footprint_rows
from xfreqbench.splatting.projection import Projection

Backend = Literal["auto", "torch", "numba"]


@torch.no_grad()
def bin_footprints(
    projection: Projection, grid: AngularGrid, support: float, backend: Backend = "auto"
) -> PixelLists:
    """Gaussians of every direction of a uniform grid, nearest first; directions are numbered row by row."""
    order = projection.range_m.argsort(stable=True)
    centre = torch.stack([projection.azimuth_rad, projection.elevation_rad], dim=-1)[order].double()
    conic = inverse(projection.covariance.double())[order]
    on_cpu = centre.device.type == "cpu"
    bin_ordered = _bin_torch if backend == "torch" or not on_cpu else _bin_numba
    start, nth = bin_ordered(centre, conic, grid, support)
    return PixelLists(start, order[nth], len(order))


def squared_distance(projection: Projection, lists: PixelLists, grid: AngularGrid) -> Float[Tensor, "P"]:
    """Squared Mahalanobis distance of every pair of a direction and a Gaussian, azimuths the short way round."""
    azimuth_rad, elevation_rad = _directions(grid, projection.azimuth_rad)
    pixel = torch.repeat_interleave(lists.start.diff())
    conic = inverse(projection.covariance)
    of_gaussian = torch.column_stack([projection.azimuth_rad, projection.elevation_rad, conic])
    # index_select adds its gradients up in order; indexing adds them in any, and runs would differ
    u, v, a, b, c = of_gaussian.T.index_select(1, lists.gaussian)
    across = azimuth_rad[pixel % len(azimuth_rad)] - u
    across = torch.remainder(across + math.pi, 2 * math.pi) - math.pi
    along = elevation_rad[pixel // len(azimuth_rad)] - v
    return a * across * across + 2 * b * across * along + c * along * along


def inverse(covariance: Float[Tensor, "N 2 2"]) -> Float[Tensor, "N 3"]:
    """Entries (0,0), (0,1), (1,1) of the inverse of symmetric positive matrices."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    return torch.stack([c, -b, a], dim=-1) / (a * c - b * b)[:, None]


def _directions(grid: AngularGrid, like: Tensor) -> tuple[Float[Tensor, "A"], Float[Tensor, "E"]]:
    return (
        torch.as_tensor(grid.azimuth_rad).to(like),
        torch.as_tensor(grid.elevation_rad).to(like),
    )


def _bin_numba(
    centre: Float[Tensor, "N 2"], conic: Float[Tensor, "N 3"], grid: AngularGrid, support: float
) -> tuple[Int[Tensor, "K1"], Int[Tensor, "P"]]:
    spans = footprint_rows(
        centre.numpy(), conic.numpy(), grid.elevation_rad, grid.azimuth_rad[0], len(grid.azimuth_rad), support
    )
    start, gaussian = fill_lists(*spans, len(grid.elevation_rad), len(grid.azimuth_rad))
    return torch.from_numpy(start), torch.from_numpy(gaussian)


def _bin_torch(
    centre: Float[Tensor, "N 2"], conic: Float[Tensor, "N 3"], grid: AngularGrid, support: float
) -> tuple[Int[Tensor, "K1"], Int[Tensor, "P"]]:
    """The same on any device: all rows of all footprints, then all directions of all rows."""
    gaussian, row, first, count = _row_spans(centre, conic, grid, support)
    span = torch.repeat_interleave(count)
    nth = torch.arange(len(span), device=span.device) - (count.cumsum(0) - count)[span]
    num_azimuths = len(grid.azimuth_rad)
    pixel = row[span] * num_azimuths + (first[span] + nth) % num_azimuths
    by_pixel = pixel.argsort(stable=True)
    counts = torch.bincount(pixel, minlength=num_azimuths * len(grid.elevation_rad))
    start = torch.cat([counts.new_zeros(1), counts.cumsum(0)])
    return start, gaussian[span][by_pixel]


def _row_spans(
    centre: Float[Tensor, "N 2"], conic: Float[Tensor, "N 3"], grid: AngularGrid, support: float
) -> tuple[Int[Tensor, "S"], Int[Tensor, "S"], Int[Tensor, "S"], Int[Tensor, "S"]]:
    """Gaussian, row, first column and number of columns wherever a footprint meets a row."""
    elevation_rad = torch.as_tensor(grid.elevation_rad, device=centre.device)
    step_rad = 2 * math.pi / len(grid.azimuth_rad)
    a, b, c = conic[:, None].unbind(-1)
    along = elevation_rad[None, :] - centre[:, 1:]
    discriminant = (b * along) ** 2 - a * (c * along * along - support)
    reach = discriminant.clamp_min(0).sqrt()
    low = ((-b * along - reach) / a).clamp_min(-math.pi)
    high = ((-b * along + reach) / a).clamp_max(math.pi)
    offset = centre[:, :1] - float(grid.azimuth_rad[0])
    first = torch.ceil((offset + low) / step_rad).long()
    last = torch.floor((offset + high) / step_rad).long()
    count = (last - first + 1).clamp(0, len(grid.azimuth_rad))
    gaussian, row = torch.nonzero((discriminant >= 0) & (count > 0), as_tuple=True)
    return gaussian, row, first[gaussian, row] % len(grid.azimuth_rad), count[gaussian, row]
