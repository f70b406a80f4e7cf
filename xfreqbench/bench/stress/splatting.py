"""Splatting at extremes: accumulation of Gaussians (Eq. 11) over long lists, footprints, and projection."""

from __future__ import annotations

import math
from functools import cache
from itertools import product
from typing import Literal, get_args

import numpy as np
import torch
from torch import Tensor

from xfreqbench.bench.stress.case import Area
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.splatting.composite import Backend, PixelLists, composite
from xfreqbench.methods.splatting.footprints import bin_footprints, squared_distance
from xfreqbench.methods.splatting.gaussians import covariance
from xfreqbench.methods.splatting.projection import Projection, project
from xfreqbench.types import NDArray

COMPOSITE = Area("composite")
Attenuations = Literal["clear", "opaque", "denormal", "turning", "reversing", "any"]
Leaves = tuple[Tensor, Tensor, Tensor, Tensor]  # distance, inverse spread, signal, attenuation
_NUM_FACTORS = 10_000
# kind of the attenuations of a list, and whether G = 1, so that products round by their attenuations alone
_LISTS: tuple[tuple[Attenuations, bool], ...] = (
    *((kind, True) for kind in get_args(Attenuations)),
    ("turning", False),
    ("any", False),
)
_IN_WORDS: dict[Attenuations, str] = {
    "clear": "of exactly 1",
    "opaque": "of 0",
    "denormal": "of 1e-42 and 1e-310",
    "turning": "of modulus 1, any phase",
    "reversing": "of −1",
    "any": "of any modulus and phase",
}
_BATCH = 2
_DENORMAL = [1e-42, 1e-310]  # of float32, of float64
_SINGLE = 1e-6  # some roundings of float32, 6e-8
# each factor may add a rounding: 6e-8 in float32, the precision of numba, and 1.1e-16 in float64
_LONG_LIMITS: dict[Backend, float] = {"torch": _NUM_FACTORS * 1.1e-16, "numba": _NUM_FACTORS * 6e-8}
FOOTPRINTS = Area("footprints")
_SUPPORT = 9.0
_TURNS_DEG = (0.0, 30.0, 100.0)
_GRID = AngularGrid.hemisphere()
_SEAM_DEG = [(0.0, 10.0), (359.9999, 20.0), (-1e-7, 30.0), (180.0, 5.0), (360.0, 0.0)]
_PLACES_AND_SIZES_DEG = {  # centres (azimuth, elevation) and deviations along the axes
    "at the zenith": ([(10.0, 90.0), (200.0, 89.5), (0.0, 88.0)], [(30.0, 1.0), (5.0, 5.0), (100.0, 0.5)]),
    "at the azimuth's seam": (_SEAM_DEG, [(3.0, 2.0), (0.5, 0.5)]),
    "a turn wide, a little less and more": (_SEAM_DEG, [(59.9, 3.0), (60.1, 3.0)]),
    "smaller than the grid": ([(0.0, 10.0), (17.2, 33.3), (17.5, 33.5)], [(0.1, 0.1), (1e-3, 1e-3), (0.1, 2.0)]),
    "behind the horizon": (
        [(0.0, -90.0), (40.0, -3.0), (80.0, -3.1), (300.0, -30.0)],
        [(1.0, 1.0), (9.0, 1.0), (1.0, 9.99)],
    ),
}
PROJECTION = Area("projection")


def _of_both_backends(name: str) -> dict[str, tuple[Backend]]:
    """Arguments of two cases with that name, one for each backend."""
    return {f"{name}, {backend}": (backend,) for backend in _LONG_LIMITS}


def _attenuation(kind: Attenuations, generator: torch.Generator) -> Tensor:
    """Attenuations of one list in double precision, (L, B)."""
    shape = _NUM_FACTORS, _BATCH
    phase = 2 * math.pi * torch.rand(shape, generator=generator, dtype=torch.float64)
    size = torch.rand(shape, generator=generator, dtype=torch.float64)
    values = {
        "clear": torch.ones(shape, dtype=torch.float64),
        "opaque": torch.zeros(shape, dtype=torch.float64),
        "denormal": torch.tensor(_DENORMAL, dtype=torch.float64).expand(shape),
        "turning": torch.polar(torch.ones_like(size), phase),
        "reversing": -torch.ones(shape, dtype=torch.float64),
        "any": torch.polar(size, phase),
    }
    return values[kind].to(torch.complex128)


@cache
def _leaves() -> Leaves:
    """Attributes of the Gaussians of all `_LISTS`, one list after the other, in double precision."""
    generator = torch.Generator().manual_seed(0)
    number = len(_LISTS) * _NUM_FACTORS
    is_full = torch.tensor([is_full for _, is_full in _LISTS]).repeat_interleave(_NUM_FACTORS)
    distance = 9 * torch.rand(number, generator=generator, dtype=torch.float64) * ~is_full
    spread = 0.5 + torch.rand(number, _BATCH, generator=generator, dtype=torch.float64)
    signal = torch.randn(number, _BATCH, generator=generator, dtype=torch.complex128)
    return distance, spread, signal, torch.cat([_attenuation(kind, generator) for kind, _ in _LISTS])


def _lists(number: int = 1) -> PixelLists:
    """Pixel lists of `number` pixels, which see as many Gaussians each as there are factors."""
    return PixelLists(
        torch.arange(number + 1) * _NUM_FACTORS, torch.arange(number * _NUM_FACTORS), number * _NUM_FACTORS
    )


def _with_gradients(field: Tensor, leaves: Leaves) -> tuple[Tensor, ...]:
    """The field, and the gradients of Re(1 − 2j) ΣR by the leaves."""
    loss = (field * complex(1, -2)).real.sum()
    return field.detach(), *torch.autograd.grad(loss, leaves)


@cache
def _literal() -> tuple[Tensor, ...]:
    """R = Σ_i G_i S_i Π_{m<i} (1 − G_m (1 − δ_m)) factor by factor, (lists, B), and its gradients by autograd."""
    leaves = _tracked(_leaves(), torch.float64)
    distance, spread, signal, attenuation = leaves
    footprint = torch.exp(-0.5 * distance[:, None] * spread)
    of_lists = len(_LISTS), _NUM_FACTORS, _BATCH
    emitted = (footprint * signal).view(of_lists).unbind(1)
    factor = (1 - footprint * (1 - attenuation)).view(of_lists).unbind(1)
    field, product = torch.zeros_like(emitted[0]), torch.ones_like(emitted[0])
    for own, attenuated in zip(emitted, factor, strict=True):
        field = field + own * product
        product = product * attenuated
    return _with_gradients(field, leaves)


@cache
def _composited(backend: Backend) -> tuple[Tensor, ...]:
    """The same from `composite`; torch computes in float64, numba in float32."""
    leaves = _tracked(_leaves(), torch.float32 if backend == "numba" else torch.float64)
    return _with_gradients(composite(_lists(len(_LISTS)), *leaves, backend).T, leaves)


def _tracked(leaves: Leaves, kind: torch.dtype) -> Leaves:
    """Copies of the leaves in a precision, which require gradients."""
    distance, spread, signal, attenuation = (
        leaf.to(kind.to_complex() if leaf.is_complex() else kind).clone().requires_grad_() for leaf in leaves
    )
    return distance, spread, signal, attenuation


def _long_product(which: int, backend: Backend) -> float:
    """Largest error of the field and of each gradient of one of `_LISTS`, relative to the largest value of each."""
    errors = []
    for found, expected in zip(_composited(backend), _literal(), strict=True):
        one, other = (values.reshape(len(_LISTS), -1)[which] for values in (found, expected))
        errors.append(float((one - other).abs().max() / other.abs().max().clamp_min(1e-300)))
    return max(errors)


for _which, (_kind, _is_full) in enumerate(_LISTS):
    for _backend, _limit in _LONG_LIMITS.items():
        _name = f"{_NUM_FACTORS:,} attenuations {_IN_WORDS[_kind]}, {'G = 1' if _is_full else 'G < 1'}, {_backend}"
        COMPOSITE.case(_name, _which, _backend, limit=_limit, unit="relative")(_long_product)


@COMPOSITE.cases_of(
    _of_both_backends(f"{_NUM_FACTORS:,} attenuations of a half: underflow"), limit=_SINGLE, unit="relative"
)
def _underflow(backend: Backend) -> float:
    """R = S (2 − 2^(1−L)) where each of L Gaussians transmits a half: in front of the last one T is 2^−10000."""
    kind = torch.float32 if backend == "numba" else torch.float64
    ones = torch.ones(_NUM_FACTORS, _BATCH, dtype=kind)
    signal, half = ones.to(kind.to_complex()), (ones / 2).to(kind.to_complex())
    leaves = _tracked((torch.zeros(_NUM_FACTORS, dtype=kind), ones, signal, half), kind)
    field, *gradients = _with_gradients(composite(_lists(), *leaves, backend)[:, 0], leaves)
    # the gradient of δ_m is T_m · V = 2^−m · 2
    expected = 2 * 0.5 ** torch.arange(_NUM_FACTORS, dtype=torch.float64)[:, None]
    slope = gradients[3].real.double()
    seen_behind = torch.ones(_NUM_FACTORS, 1, dtype=torch.float64)
    seen_behind[-1] = 0
    near = slice(0, 100)  # 2^−100 is a float32 that is not denormal
    return max(
        float((field - 2).abs().max()),
        float((slope / expected - 1)[near].abs().max()),
        float((slope - expected * seen_behind).abs().max()),
        float(sum((~torch.isfinite(torch.view_as_real(g) if g.is_complex() else g)).sum() for g in gradients)),
    )


@FOOTPRINTS.cases_of(_PLACES_AND_SIZES_DEG, limit=0, unit="pairs")
def _misplaced_pairs(centre_deg: list[tuple[float, float]], deviation_deg: list[tuple[float, float]]) -> float:
    """Number of pairs of a direction and a Gaussian that are missing, wrong or double, in both backends.

    All combinations of a centre, a deviation and a turn of the axes are tried.
    """
    chosen = list(product(centre_deg, deviation_deg, _TURNS_DEG))
    angles, size, turn = (torch.tensor(values, dtype=torch.float64).deg2rad() for values in zip(*chosen, strict=True))
    axes = torch.stack([turn.cos(), -turn.sin(), turn.sin(), turn.cos()], -1).reshape(-1, 2, 2)
    projection = _projection(angles, axes @ torch.diag_embed(size**2) @ axes.mT)
    return float(sum(_misplaced(projection, backend) for backend in _LONG_LIMITS))


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


@PROJECTION.case("Gaussians of all places, sizes, and zero quaternions", limit=0, unit="values")
def _faults_of_strange_gaussians() -> float:
    """Number of results and gradients that are not finite, and of footprints that are no ellipse."""
    leaves = [leaf.requires_grad_() for leaf in _strange_gaussians(torch.float32)]
    projection = project(leaves[0], covariance(leaves[2], leaves[1]))
    lists = PixelLists(torch.tensor([0, *[len(leaves[0])] * 32400]), torch.arange(len(leaves[0])), len(leaves[0]))
    distance = squared_distance(projection, lists, _GRID)
    torch.exp(-distance / 2).sum().backward()
    gradients = [leaf.grad for leaf in leaves if leaf.grad is not None]
    values = [projection.azimuth_rad, projection.elevation_rad, projection.covariance, distance, *gradients]
    faults = sum((~torch.isfinite(value)).sum() for value in values)
    return float(faults + (distance < 0).sum() + (torch.linalg.eigvalsh(projection.covariance.double()) <= 0).sum())


def _strange_gaussians(kind: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """Positions, log-scales and quaternions: at the receiver, on the pole's axis and beside it, from 1e-8 to 1e4 m."""
    places = [(0, 0, 0), (0, 0, 3), (0, 0, -3), (1e-7, 0, 3), (1e-3, 1e-3, 1), (0, -2, 0), (-2, 0, 1e-20), (-3, 2, 1)]
    scales = [(1e-8, 1e-8, 1e-8), (1e4, 1e-8, 1e-8), (1e4, 1e4, 1e-8), (1e4, 1e4, 1e4), (10, 1e-3, 1e-3), (1, 1, 1)]
    turns = torch.randn(20, 4, generator=torch.Generator().manual_seed(0)).tolist()
    pairs = [(place, scale, turn) for place in places for scale in scales for turn in [(0, 0, 0, 0), *turns]]
    position_m, scale_m, quaternion = (torch.tensor(column, dtype=kind) for column in zip(*pairs, strict=True))
    return position_m, scale_m.log(), quaternion
