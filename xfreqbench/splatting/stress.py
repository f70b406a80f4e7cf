"""How far splatting is from its equations where numbers are at their edges: errors that `stress` judges.

Each function returns one error; what it is relative to, and the largest allowed, stand in `stress`.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import product
from typing import Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xfreqbench.angles import AngularGrid
from xfreqbench.splatting.composite import Backend, PixelLists, composite
from xfreqbench.splatting.composite_kernels import use_threads
from xfreqbench.splatting.footprints import bin_footprints, squared_distance
from xfreqbench.splatting.gaussians import covariance, rotation_matrix
from xfreqbench.splatting.projection import Projection, project, projection_jacobian

Attenuations = Literal["clear", "opaque", "denormal", "turning", "reversing", "any"]
# full footprints have G = 1, so that products lose nothing but by their attenuations
LISTS: tuple[tuple[Attenuations, bool], ...] = (
    *((kind, True) for kind in get_args(Attenuations)),
    ("turning", False),
    ("any", False),
)
NUM_FACTORS = 10_000
_BATCH = 2
_DENORMAL = [1e-42, 1e-310]  # of float32, of float64
_SUPPORT = 9.0
_TURNS_DEG = (0.0, 30.0, 100.0)
_BACKENDS: tuple[Backend, ...] = ("torch", "numba")
_GRID = AngularGrid.hemisphere()
Leaves = tuple[Tensor, Tensor, Tensor, Tensor]  # distance, inverse spread, signal, attenuation


def _attenuation(kind: Attenuations, generator: torch.Generator) -> Tensor:
    shape = NUM_FACTORS, _BATCH
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
    """A long list of Gaussians for each of `LISTS`, one behind the other; in full ones all of G is 1."""
    generator = torch.Generator().manual_seed(0)
    number = len(LISTS) * NUM_FACTORS
    is_full = torch.tensor([is_full for _, is_full in LISTS]).repeat_interleave(NUM_FACTORS)
    distance = 9 * torch.rand(number, generator=generator, dtype=torch.float64) * ~is_full
    spread = 0.5 + torch.rand(number, _BATCH, generator=generator, dtype=torch.float64)
    signal = torch.randn(number, _BATCH, generator=generator, dtype=torch.complex128)
    return distance, spread, signal, torch.cat([_attenuation(kind, generator) for kind, _ in LISTS])


def _lists(number: int = 1) -> PixelLists:
    return PixelLists(
        torch.arange(number + 1) * NUM_FACTORS, torch.arange(number * NUM_FACTORS), number * NUM_FACTORS
    )


def _with_gradients(field: Tensor, leaves: Leaves) -> tuple[Tensor, ...]:
    """The field, and the gradients of Re(1 − 2j) ΣR."""
    loss = (field * complex(1, -2)).real.sum()
    return field.detach(), *torch.autograd.grad(loss, leaves)


@cache
def _literal() -> tuple[Tensor, ...]:
    """R = Σ_i G_i S_i Π_{m<i} (1 − G_m (1 − δ_m)), factor by factor, differentiated by autograd: (lists, B)."""
    leaves = _tracked(_leaves(), torch.float64)
    distance, spread, signal, attenuation = leaves
    footprint = torch.exp(-0.5 * distance[:, None] * spread)
    of_lists = len(LISTS), NUM_FACTORS, _BATCH
    emitted = (footprint * signal).view(of_lists).unbind(1)
    factor = (1 - footprint * (1 - attenuation)).view(of_lists).unbind(1)
    field, product = torch.zeros_like(emitted[0]), torch.ones_like(emitted[0])
    for own, attenuated in zip(emitted, factor, strict=True):
        field = field + own * product
        product = product * attenuated
    return _with_gradients(field, leaves)


@cache
def _composited(backend: Backend) -> tuple[Tensor, ...]:
    """The same; torch computes in float64, numba in float32."""
    leaves = _tracked(_leaves(), torch.float32 if backend == "numba" else torch.float64)
    return _with_gradients(composite(_lists(len(LISTS)), *leaves, backend).T, leaves)


def _tracked(leaves: Leaves, kind: torch.dtype) -> Leaves:
    distance, spread, signal, attenuation = (
        leaf.to(kind.to_complex() if leaf.is_complex() else kind).clone().requires_grad_() for leaf in leaves
    )
    return distance, spread, signal, attenuation


def long_product(which: int, backend: Backend) -> float:
    """Of value and gradients of one of `LISTS`, relative to the largest of each."""
    errors = []
    for found, expected in zip(_composited(backend), _literal(), strict=True):
        one, other = (values.reshape(len(LISTS), -1)[which] for values in (found, expected))
        errors.append(float((one - other).abs().max() / other.abs().max().clamp_min(1e-300)))
    return max(errors)


def underflow(backend: Backend) -> float:
    """R = S (2 − 2^(1−L)) where each Gaussian passes a half: the last ones see 2^−10000."""
    kind = torch.float32 if backend == "numba" else torch.float64
    ones = torch.ones(NUM_FACTORS, _BATCH, dtype=kind)
    signal, half = ones.to(kind.to_complex()), (ones / 2).to(kind.to_complex())
    leaves = _tracked((torch.zeros(NUM_FACTORS, dtype=kind), ones, signal, half), kind)
    field, *gradients = _with_gradients(composite(_lists(), *leaves, backend)[:, 0], leaves)
    expected = (
        2 * 0.5 ** torch.arange(NUM_FACTORS, dtype=torch.float64)[:, None]
    )  # of δ_m: T_m · V = 2^−m · 2
    slope = gradients[3].real.double()
    seen_behind = torch.ones(NUM_FACTORS, 1, dtype=torch.float64)
    seen_behind[-1] = 0
    near = slice(0, 100)  # 2^−100 is a float32 that is not denormal
    return max(
        float((field - 2).abs().max()),
        float((slope / expected - 1)[near].abs().max()),
        float((slope - expected * seen_behind).abs().max()),
        float(
            sum((~torch.isfinite(torch.view_as_real(g) if g.is_complex() else g)).sum() for g in gradients)
        ),
    )


def far_outside(backend: Backend) -> float:
    """Value and gradients a long way out of a footprint, where G underflows; of signals of 1."""
    kind = torch.float32 if backend == "numba" else torch.float64
    ones = torch.ones(3, 1, dtype=kind)
    signal, clear = ones.to(kind.to_complex()), (0 * ones).to(kind.to_complex())
    leaves = _tracked((torch.tensor([1e3, 1e6, 1e12], dtype=kind), ones, signal, clear), kind)
    values = _with_gradients(
        composite(PixelLists(torch.tensor([0, 3]), torch.arange(3), 3), *leaves, backend)[:, 0], leaves
    )
    return max(float(value.abs().max()) for value in values)


def no_gaussians(backend: Backend) -> float:
    """Value and gradients of directions without any Gaussian."""
    lists = PixelLists(torch.zeros(6, dtype=torch.int64), torch.zeros(0, dtype=torch.int64), 2)
    signal = torch.ones(2, 3, dtype=torch.complex64)
    leaves = _tracked((torch.zeros(0), torch.ones(2, 3), signal, signal), torch.float32)
    field, *gradients = _with_gradients(composite(lists, *leaves, backend), leaves)
    assert field.shape == (3, 5), f"field of shape {tuple(field.shape)}"
    return float(field.abs().max()) + sum(float(gradient.abs().sum()) for gradient in gradients)


def threads() -> float:
    """Difference of fields of one thread and of two, relative to the largest value."""
    leaves, number = _tracked(_leaves(), torch.float32), len(LISTS) * NUM_FACTORS
    lists = PixelLists(torch.arange(0, number + 1, 100), torch.arange(number), number)
    one, two = (_composited_on(threads, lists, leaves) for threads in (1, 2))
    return float((one - two).abs().max() / one.abs().max())


def _composited_on(threads: int, lists: PixelLists, leaves: Leaves) -> Tensor:
    before, numba_before = torch.get_num_threads(), use_threads(threads)
    torch.set_num_threads(threads)
    try:
        return composite(lists, *leaves, "numba").detach()
    finally:
        torch.set_num_threads(before)
        use_threads(numba_before)


def _squared_distances(projection: Projection) -> NDArray[np.float64]:
    """(directions, N) of the ellipses, azimuths the short way round: every pair, one by one."""
    precision = np.linalg.inv(projection.covariance.double().numpy())
    azimuth, elevation = np.meshgrid(_GRID.azimuth_rad, _GRID.elevation_rad)
    across = azimuth.reshape(-1, 1) - projection.azimuth_rad.double().numpy()
    across = np.arctan2(np.sin(across), np.cos(across))
    along = elevation.reshape(-1, 1) - projection.elevation_rad.double().numpy()
    offset = np.stack([across, along], axis=-1)
    return np.asarray(np.einsum("kni,nij,knj->kn", offset, precision, offset))


def footprints(centre_deg: list[tuple[float, float]], deviation_deg: list[tuple[float, float]]) -> float:
    """Pairs of a direction and a Gaussian that are missing, too many or twice, in both backends.

    Centres and deviations are azimuth and elevation, the latter along axes as they are and turned; all
    combinations of a centre, a deviation and a turn are tried.
    """
    chosen = list(product(centre_deg, deviation_deg, _TURNS_DEG))
    angles, size, turn = (
        torch.tensor(values, dtype=torch.float64).deg2rad() for values in zip(*chosen, strict=True)
    )
    axes = torch.stack([turn.cos(), -turn.sin(), turn.sin(), turn.cos()], -1).reshape(-1, 2, 2)
    projection = _projection(angles, axes @ torch.diag_embed(size**2) @ axes.mT)
    return float(sum(_misplaced(projection, backend) for backend in _BACKENDS))


def _projection(centre_rad: Tensor, covariances: Tensor) -> Projection:
    """Azimuth and elevation (N, 2), one Gaussian behind the other."""
    azimuth_rad, elevation_rad = centre_rad.unbind(-1)
    return Projection(azimuth_rad, elevation_rad, covariances, torch.arange(len(centre_rad)).double())


def _misplaced(projection: Projection, backend: Backend) -> int:
    lists = bin_footprints(projection, _GRID, _SUPPORT, backend)
    found = np.zeros((_GRID.directions[..., 0].size, lists.num_gaussians), int)
    pixel = torch.repeat_interleave(lists.start.diff()).numpy()
    np.add.at(found, (pixel, lists.gaussian.numpy()), 1)
    distance = _squared_distances(projection)
    is_decided = np.abs(distance - _SUPPORT) > 1e-9  # on the ellipse itself rounding decides
    return int(np.abs(found - (distance <= _SUPPORT))[is_decided].sum())


def directions_of_everything() -> float:
    """Directions that a Gaussian as large as the sphere and beyond holds other than once."""
    angles = torch.tensor([[0.0, 0.5], [3.0, 1.5], [-math.pi, -1.0]]).double()
    projection = _projection(angles, 1e4 * torch.eye(2).double().expand(3, 2, 2))
    lists = [bin_footprints(projection, _GRID, _SUPPORT, backend) for backend in _BACKENDS]
    return float(sum((each.start.diff() != 3).sum() for each in lists))


def _strange_gaussians(kind: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """Positions at the receiver, on the pole's axis and beside it; all sizes and shapes, to 1e-8 and 1e4 m."""
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


def strange_gaussians() -> float:
    """Angles, covariances, distances and gradients that are not finite, and footprints that are no ellipse."""
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


def pole(height_m: float) -> float:
    """Radians by which Gaussians exactly above or below the receiver are seen off the pole."""
    position_m = torch.tensor([[0.0, 0.0, height_m]])
    projection = project(position_m, torch.zeros(1, 3, 3))
    return float((projection.elevation_rad - math.copysign(math.pi / 2, height_m)).abs())


def seam() -> float:
    """Distances across the azimuth's seam, against twice those halfway, in float32, relative."""
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


def jacobian() -> float:
    """Relative to its largest entry, in float32, from the equator to 1.1° off the pole, against differences."""
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


def jacobian_at_the_pole() -> float:
    """Within 1° of the pole the azimuth changes by 1/(sin 1° · range) a metre, the elevation by 1/range; relative."""
    position_m = torch.tensor([[1e-12, 0, 5], [1e-6, 1e-6, 5], [0.01, -0.01, -5], [0.08, 0, 5]])
    found = projection_jacobian(position_m).double().norm(dim=-1)
    range_m = position_m.double().norm(dim=-1, keepdim=True)
    expected = torch.tensor([1 / math.sin(math.pi / 180), 1.0]).double() / range_m
    return float((found / expected - 1).abs().max())


def extreme_scales() -> float:
    """Σ of needles turned so that the axes change places is their diagonal in that order.

    Turned by 90° about z, relative to the largest; by 120° about all three, where the quaternion and so every
    product is exact, relative to each entry of the diagonal.
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


def quaternions() -> float:
    """Rotations of quaternions of length 1e-6, 1 and 1e6 are one; that of length 0 turns nothing."""
    unit = torch.nn.functional.normalize(
        torch.randn(10, 4, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    still = rotation_matrix(torch.zeros(1, 4)) - torch.eye(3)
    others = [rotation_matrix(length * unit) - rotation_matrix(unit) for length in (1e-6, 1e6)]
    product = rotation_matrix(unit).double()
    return max(
        float(off.abs().max()) for off in (still, *others, product @ product.mT - torch.eye(3).double())
    )


def smallest_footprint() -> float:
    """A Gaussian without extent is seen as a circle of half a degree, relative."""
    found = project(torch.tensor([[1.0, 2.0, 1.0]]), torch.zeros(1, 3, 3)).covariance
    return float((found / math.radians(0.5) ** 2 - torch.eye(2)).abs().max())
