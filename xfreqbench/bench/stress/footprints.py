"""Footprints at the edges of the grid of directions: the zenith, the azimuth's seam, the horizon, all sizes."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xfreqbench.bench.stress.case import Area
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.splatting.composite import Backend, PixelLists
from xfreqbench.methods.splatting.footprints import bin_footprints, squared_distance
from xfreqbench.methods.splatting.projection import Projection

FOOTPRINTS = Area("footprints")
_SUPPORT = 9.0
_TURNS_DEG = (0.0, 30.0, 100.0)
_BACKENDS: tuple[Backend, ...] = ("torch", "numba")
_GRID = AngularGrid.hemisphere()
_SEAM_DEG = [(0.0, 10.0), (359.9999, 20.0), (-1e-7, 30.0), (180.0, 5.0), (360.0, 0.0)]
_PLACES_AND_SIZES_DEG = {  # centres (azimuth, elevation) and deviations along the axes
    "at the zenith": (
        [(10.0, 90.0), (200.0, 89.5), (0.0, 88.0)],
        [(30.0, 1.0), (5.0, 5.0), (100.0, 0.5)],
    ),
    "at the azimuth's seam": (_SEAM_DEG, [(3.0, 2.0), (0.5, 0.5)]),
    "a turn wide, a little less and more": (_SEAM_DEG, [(59.9, 3.0), (60.1, 3.0)]),
    "smaller than the grid": (
        [(0.0, 10.0), (17.2, 33.3), (17.5, 33.5)],
        [(0.1, 0.1), (1e-3, 1e-3), (0.1, 2.0)],
    ),
    "behind the horizon": (
        [(0.0, -90.0), (40.0, -3.0), (80.0, -3.1), (300.0, -30.0)],
        [(1.0, 1.0), (9.0, 1.0), (1.0, 9.99)],
    ),
}


@FOOTPRINTS.each(_PLACES_AND_SIZES_DEG, limit=0, unit="pairs")
def _misplaced_pairs(
    centre_deg: list[tuple[float, float]], deviation_deg: list[tuple[float, float]]
) -> float:
    """Number of pairs of a direction and a Gaussian that are missing, wrong or double, in both backends.

    All combinations of a centre, a deviation and a turn of the axes are tried.
    """
    chosen = list(product(centre_deg, deviation_deg, _TURNS_DEG))
    angles, size, turn = (
        torch.tensor(values, dtype=torch.float64).deg2rad() for values in zip(*chosen, strict=True)
    )
    axes = torch.stack([turn.cos(), -turn.sin(), turn.sin(), turn.cos()], -1).reshape(-1, 2, 2)
    projection = _projection(angles, axes @ torch.diag_embed(size**2) @ axes.mT)
    return float(sum(_misplaced(projection, backend) for backend in _BACKENDS))


def _projection(centre_rad: Tensor, covariances: Tensor) -> Projection:
    """Gaussians with these azimuths and elevations, (N, 2), each farther away than the one before."""
    azimuth_rad, elevation_rad = centre_rad.unbind(-1)
    return Projection(azimuth_rad, elevation_rad, covariances, torch.arange(len(centre_rad)).double())


def _misplaced(projection: Projection, backend: Backend) -> int:
    """Wrong entries in the lists of one backend."""
    lists = bin_footprints(projection, _GRID, _SUPPORT, backend)
    found = np.zeros((_GRID.directions[..., 0].size, lists.num_gaussians), int)
    pixel = torch.repeat_interleave(lists.start.diff()).numpy()
    np.add.at(found, (pixel, lists.gaussian.numpy()), 1)
    distance = _squared_distances(projection)
    is_decided = np.abs(distance - _SUPPORT) > 1e-9  # on the ellipse itself rounding decides
    return int(np.abs(found - (distance <= _SUPPORT))[is_decided].sum())


def _squared_distances(projection: Projection) -> NDArray[np.float64]:
    """Squared Mahalanobis distances of all pairs, (directions, N), azimuths taken the short way round."""
    precision = np.linalg.inv(projection.covariance.double().numpy())
    azimuth, elevation = np.meshgrid(_GRID.azimuth_rad, _GRID.elevation_rad)
    across = azimuth.reshape(-1, 1) - projection.azimuth_rad.double().numpy()
    across = np.arctan2(np.sin(across), np.cos(across))
    along = elevation.reshape(-1, 1) - projection.elevation_rad.double().numpy()
    offset = np.stack([across, along], axis=-1)
    return np.asarray(np.einsum("kni,nij,knj->kn", offset, precision, offset))


@FOOTPRINTS.case("larger than the sphere", limit=0, unit="directions")
def _larger_than_the_sphere() -> float:
    """Number of directions that do not see each of three Gaussians, larger than the sphere, exactly once."""
    angles = torch.tensor([[0.0, 0.5], [3.0, 1.5], [-math.pi, -1.0]]).double()
    projection = _projection(angles, 1e4 * torch.eye(2).double().expand(3, 2, 2))
    lists = [bin_footprints(projection, _GRID, _SUPPORT, backend) for backend in _BACKENDS]
    return float(sum((each.start.diff() != 3).sum() for each in lists))


# up to 360 per rad² times 2 · 3e-7 rad, the rounding of π, of roots of distances of 1e-3 and more
@FOOTPRINTS.case("distances across the seam", limit=1e-4, unit="relative")
def _seam() -> float:
    """Relative error of distances across the azimuth's seam in float32, against the same in double precision."""
    azimuth_rad = torch.tensor([0.0, -1e-7, math.pi, -math.pi, 2 * math.pi - 1e-3])
    elevation_rad = torch.tensor([0.0, 0.01, 0.0, -0.02, 0.03])
    covariances = torch.tensor([[0.01, 0.012], [0.012, 0.02]]).expand(5, 2, 2)
    projection = Projection(azimuth_rad, elevation_rad, covariances, torch.ones(5))
    start = torch.tensor([0] + [5] * 180 + [10] * 180 + [10] * (89 * 360))  # directions 0° and 180° alone
    found = squared_distance(projection, PixelLists(start, torch.arange(5).repeat(2), 5), _GRID).double()
    gap = torch.tensor([0.0, math.pi]).repeat_interleave(5).double() - azimuth_rad.double().repeat(2)
    across, along = torch.atan2(gap.sin(), gap.cos()), -elevation_rad.double().repeat(2)
    # the inverse of [[a, b], [b, c]] is [[c, −b], [−b, a]] over ac − b²
    expected = (0.02 * across**2 - 0.024 * across * along + 0.01 * along**2) / (0.01 * 0.02 - 0.012**2)
    return float(((found - expected).abs() / (1e-3 + expected)).max())
