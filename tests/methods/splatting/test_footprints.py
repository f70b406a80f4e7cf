"""Which directions see which Gaussians: both backends against a comparison of every pair."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.support import reference
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.learning.targets import GridView
from xfreqbench.methods.splatting.bells import bells
from xfreqbench.methods.splatting.composite import PixelLists, composite
from xfreqbench.methods.splatting.composite_maps import composite_maps
from xfreqbench.methods.splatting.footprints import Backend, bin_footprints, squared_distance
from xfreqbench.methods.splatting.gaussians import covariance
from xfreqbench.methods.splatting.projection import MIN_VARIANCE, Projection, project, project_gaussians

SUPPORT = 9.0
DEGREE = math.pi / 180
GRID = AngularGrid.hemisphere(18, 72)
either_backend = pytest.mark.parametrize("backend", ["torch", "numba"])


def random_projection(num_gaussians: int = 80, seed: int = 0) -> Projection:
    """Ellipses of 1° to 200°, wider than the circle, turned at random, from 20° below the horizon to the zenith."""
    generator = torch.Generator().manual_seed(seed)
    azimuth, height, turn, distance = torch.rand(4, num_gaussians, generator=generator, dtype=torch.float64)
    deviation_rad = torch.logspace(0, math.log10(200), num_gaussians, dtype=torch.float64) * DEGREE
    other = deviation_rad[torch.randperm(num_gaussians, generator=generator)]
    cosine, sine = torch.cos(math.pi * turn), torch.sin(math.pi * turn)
    axes = torch.stack([torch.stack([cosine, -sine], -1), torch.stack([sine, cosine], -1)], -2)
    axes = axes * torch.stack([deviation_rad, other], dim=-1)[:, None]
    return Projection(2 * math.pi * azimuth, (110 * height - 20) * DEGREE, axes @ axes.mT, 1 + distance)


def lone(azimuth_deg: float, elevation_deg: float, deviation_deg: tuple[float, float]) -> Projection:
    """One Gaussian, its axes along azimuth and elevation."""
    centre = torch.tensor([[azimuth_deg, elevation_deg]], dtype=torch.float64) * DEGREE
    variance = (torch.tensor([deviation_deg], dtype=torch.float64) * DEGREE) ** 2
    return Projection(centre[:, 0], centre[:, 1], torch.diag_embed(variance), torch.ones(1).double())


def times_seen(lists: PixelLists, grid: AngularGrid) -> Tensor:
    """How often each direction's list holds each Gaussian, (N, E, A)."""
    pixel = torch.repeat_interleave(lists.start.diff())
    counts = torch.zeros(lists.num_gaussians, len(lists.start) - 1, dtype=torch.int64)
    counts.index_put_((lists.gaussian, pixel), torch.ones_like(pixel), accumulate=True)
    return counts.reshape(lists.num_gaussians, *grid.shape)


def distance_to_all(projection: Projection, grid: AngularGrid) -> Tensor:
    """Squared Mahalanobis distance of every Gaussian from every direction, (N, E, A)."""
    azimuth_rad, elevation_rad = torch.from_numpy(grid.azimuth_rad), torch.from_numpy(grid.elevation_rad)
    turn = azimuth_rad - projection.azimuth_rad[:, None]
    across = torch.atan2(turn.sin(), turn.cos())[:, None, :]
    along = (elevation_rad - projection.elevation_rad[:, None])[:, :, None]
    offset = torch.stack(torch.broadcast_tensors(across, along), dim=-1)
    return torch.einsum("neai,nij,neaj->nea", offset, torch.linalg.inv(projection.covariance), offset)


@either_backend
@pytest.mark.parametrize("seed", range(2))
def test_a_direction_sees_exactly_the_gaussians_that_lie_within_the_support(seed: int, backend: Backend) -> None:
    projection = random_projection(seed=seed)
    counts = times_seen(bin_footprints(projection, GRID, SUPPORT, backend), GRID)
    expected = distance_to_all(projection, GRID) <= SUPPORT
    assert 0 < int(expected.sum()) < expected.numel()
    assert torch.equal(counts, expected.long())


@either_backend
@pytest.mark.parametrize("stride", [1, 7])
def test_azimuths_that_repeat_the_first_or_do_not_close_see_what_lies_within_the_support(
    stride: int, backend: Backend
) -> None:
    published = AngularGrid(np.linspace(0, np.pi / 2, 19), np.linspace(-np.pi, np.pi, 73))
    grid = GridView(stride, row=2, column=3).of_grid(published) if stride > 1 else published
    projection = random_projection()
    counts = times_seen(bin_footprints(projection, grid, SUPPORT, backend), grid)
    expected = distance_to_all(projection, grid) <= SUPPORT
    assert torch.equal(counts, expected.long())
    assert stride > 1 or torch.equal(counts[:, :, 0], counts[:, :, -1])


@either_backend
def test_lists_begin_with_the_nearest_gaussian(backend: Backend) -> None:
    projection = random_projection()
    lists = bin_footprints(projection, GRID, SUPPORT, backend)
    ranges_m = projection.range_m[lists.gaussian].split(lists.start.diff().tolist())
    assert max(len(of_pixel) for of_pixel in ranges_m) > 5
    assert all(bool((of_pixel.diff() >= 0).all()) for of_pixel in ranges_m)


def test_the_distance_of_a_pair_takes_azimuths_the_short_way_round() -> None:
    projection = random_projection()
    lists = bin_footprints(projection, GRID, SUPPORT)
    pixel = torch.repeat_interleave(lists.start.diff())
    expected = distance_to_all(projection, GRID).flatten(1)[lists.gaussian, pixel]
    # rounding of angles of 2π, divided by deviations down to 1°
    torch.testing.assert_close(squared_distance(projection, lists, GRID), expected, rtol=1e-9, atol=1e-9)


def ball_in_the_zenith() -> Projection:
    deviation_m = 2 * math.tan(3 * DEGREE)
    ball_m2 = deviation_m**2 * torch.eye(3, dtype=torch.float64)[None]
    return project(torch.tensor([[0.0, 0.0, 2.0]], dtype=torch.float64), ball_m2)


@either_backend
@pytest.mark.parametrize(
    ("projection", "least", "most"),
    [
        (lone(0.2, 30.1, (1, 0.2)), 6, 6),  # across the seam of azimuths
        (lone(-0.2, 30.1, (1, 0.2)), 6, 6),
        (lone(720.2, 30.1, (1, 0.2)), 6, 6),
        (ball_in_the_zenith(), 8 * 360 + 1, 9 * 360),  # three deviations of 3° and the blur, below 90°
        (lone(123.4, 45, (1e5, 1e5)), 90 * 360, 90 * 360),
        (lone(359.9, 30.1, (0.1, 0.1)), 1, 1),
        (lone(10.5, 30.0, (0.1, 0.1)), 0, 0),  # between two directions
        (lone(77, -10, (30, 3)), 0, 0),  # well below the horizon
        (lone(77, -8, (30, 3)), 51, 360),
        (Projection(*(x[:0] for x in vars(lone(0, 0, (1, 1))).values())), 0, 0),  # no Gaussian
    ],
)
def test_at_seam_pole_and_horizon_a_footprint_is_seen_once_by_whoever_lies_in_it(
    projection: Projection, least: int, most: int, backend: Backend
) -> None:
    grid = AngularGrid.hemisphere()
    lists = bin_footprints(projection, grid, SUPPORT, backend)
    assert torch.equal(times_seen(lists, grid), (distance_to_all(projection, grid) <= SUPPORT).long())
    assert least <= len(lists.gaussian) == len(squared_distance(projection, lists, grid)) <= most


class Scene(NamedTuple):
    """40 Gaussians seen by three queries."""

    position_m: Tensor
    log_scale: Tensor
    quaternion: Tensor
    spread: Tensor
    signal: Tensor
    attenuation: Tensor


SMALL_GRID = AngularGrid.hemisphere(6, 12)
WIDE_SUPPORT = 18.0  # spread up to 2


def random_scene(dtype: torch.dtype) -> Scene:
    """Float32 numbers at most of a metre's size, 1 to 6 m off, all heights."""
    generator = torch.Generator().manual_seed(0)
    direction = torch.nn.functional.normalize(torch.randn(40, 3, generator=generator), dim=-1)
    scene = Scene(
        position_m=direction * (1 + 5 * torch.rand(40, 1, generator=generator)),
        log_scale=0.4 * torch.randn(40, 3, generator=generator) - 0.5,
        quaternion=torch.randn(40, 4, generator=generator),
        spread=0.5 + 1.5 * torch.rand(40, 3, generator=generator),
        signal=torch.randn(40, 3, generator=generator, dtype=torch.complex64),
        attenuation=torch.polar(torch.rand(40, 3, generator=generator), 6 * torch.rand(40, 3, generator=generator)),
    )
    return Scene(*(x.to(dtype.to_complex() if x.is_complex() else dtype).requires_grad_() for x in scene))


def rendered(scene: Scene) -> Tensor:
    projection = project(scene.position_m, covariance(scene.quaternion, scene.log_scale))
    lists = bin_footprints(projection, SMALL_GRID, WIDE_SUPPORT)
    distance = squared_distance(projection, lists, SMALL_GRID)
    return composite(lists, distance, 1 / scene.spread, scene.signal, scene.attenuation)


def literally_rendered(scene: Scene) -> Tensor:
    """Eqs. (5), (8)–(11), direction by direction: (B, K)."""
    centres = torch.stack([reference.angular_centre(offset_m) for offset_m in scene.position_m])
    inverses = torch.stack([_inverse_covariance(*each) for each in zip(*scene[:3], strict=True)])
    order = scene.position_m.detach().norm(dim=-1).argsort()
    responses = []
    for elevation_rad in SMALL_GRID.elevation_rad:
        for azimuth_rad in SMALL_GRID.azimuth_rad:
            offset = torch.tensor([azimuth_rad, elevation_rad], dtype=torch.float64) - centres
            across = torch.atan2(offset[:, 0].sin(), offset[:, 0].cos())
            offset = torch.stack([across, offset[:, 1]], dim=-1)
            distance = torch.einsum("ni,nij,nj->n", offset, inverses, offset)
            near = order[distance.detach()[order] <= WIDE_SUPPORT]
            footprint = torch.exp(-distance[near, None] / scene.spread[near] / 2)
            factor = reference.continuous_factor(footprint, scene.attenuation[near])
            responses.append(reference.accumulate(footprint, scene.signal[near], factor))
    return torch.stack(responses, dim=-1)


def _inverse_covariance(offset_m: Tensor, log_scale: Tensor, quaternion: Tensor) -> Tensor:
    projected = reference.projected_covariance(offset_m, reference.covariance(quaternion, log_scale))
    return torch.linalg.inv(projected + MIN_VARIANCE * torch.eye(2, dtype=projected.dtype))


@pytest.mark.parametrize(
    ("dtype", "tolerance"),
    # float32 rounds at 6e-8; a hundred-fold of it is what twenty factors and an inverted covariance cost
    [(torch.float64, 1e-9), (torch.float32, 1e-5)],
)
def test_a_rendered_scene_and_its_gradients_are_those_of_the_published_equations(
    dtype: torch.dtype, tolerance: float
) -> None:
    scene = random_scene(dtype)
    twin = Scene(*(_double(x.detach()).requires_grad_() for x in scene))
    actual, expected = rendered(scene), literally_rendered(twin)
    assert float(((expected.detach().abs() > 0).double()).mean()) > 0.9
    generator = torch.Generator().manual_seed(1)
    weight = torch.randn(expected.shape, generator=generator, dtype=torch.complex128)
    ours = torch.autograd.grad(actual, scene, weight.to(actual.dtype))
    theirs = torch.autograd.grad(expected, twin, weight)
    for name, one, other in zip(("field", *Scene._fields), (actual, *ours), (expected, *theirs), strict=True):
        error = (_double(one) - other).norm() / other.norm()
        assert float(error.detach()) < tolerance, name


def _double(x: Tensor) -> Tensor:
    return x.to(torch.complex128 if x.is_complex() else torch.float64)


@pytest.mark.parametrize("log_scale", [-2.0, 1.5])  # between the directions, and wider than the circle
def test_maps_whose_gaussians_differ_are_those_of_one_map_after_another(log_scale: float) -> None:
    """With gradients by shapes, signals and opacities; compiled in float32 against lists in float64."""
    generator = torch.Generator().manual_seed(0)
    grid = AngularGrid.hemisphere(6, 45)
    gaussians = torch.randn(3, 40, 10, generator=generator)
    gaussians[..., 2].abs_()
    gaussians[..., 7:] = 0.5 * gaussians[..., 7:] + log_scale
    inputs = gaussians, torch.randn(3, 40, generator=generator), torch.rand(3, 40, generator=generator)
    weight = torch.randn(3, 6 * 45, generator=generator, dtype=torch.float64)
    answers = []
    for kind in (torch.float32, torch.float64):
        given = [each.to(kind).requires_grad_() for each in inputs]
        shapes, signal, opacity = given
        if kind == torch.float32:
            fields = composite_maps(shapes, grid, SUPPORT, signal, opacity)
        else:
            fields = torch.cat([_one_map(grid, *each) for each in zip(*given, strict=True)])
        answers.append([fields, *torch.autograd.grad((fields * weight.to(kind)).sum(), given)])
    for found, expected in zip(*answers, strict=True):
        assert float((found - expected).norm().detach()) < 1e-5 * float(expected.norm().detach())


def _one_map(grid: AngularGrid, gaussians: Tensor, signal: Tensor, opacity: Tensor) -> Tensor:
    projection = project_gaussians(gaussians)
    lists = bin_footprints(projection, grid, SUPPORT)
    real = signal[:, None].to(torch.complex128), (1 - opacity)[:, None].to(torch.complex128)
    return composite(lists, squared_distance(projection, lists, grid), torch.ones(40, 1).double(), *real).real


@pytest.mark.parametrize("full_turn", [True, False])
def test_a_bell_of_one_angle_is_its_formula_in_value_and_gradient(full_turn: bool) -> None:
    generator = torch.Generator().manual_seed(0)
    angle_rad = torch.linspace(-3, 6, 45)
    inputs = 4 * torch.randn(3, 20, generator=generator), 0.05 + torch.rand(3, 20, generator=generator)
    weight = torch.randn(3, 20, 45, generator=generator, dtype=torch.float64)
    answers = []
    for kind in (torch.float32, torch.float64):  # a kernel, and torch
        given = [each.to(kind).requires_grad_() for each in inputs]
        bell = bells(angle_rad.to(kind), *given, full_turn=full_turn)
        answers.append([bell, *torch.autograd.grad((bell * weight.to(kind)).sum(), given)])
    for found, expected in zip(*answers, strict=True):
        assert float((found - expected).norm().detach()) < 1e-5 * float(expected.norm().detach())


def test_far_tails_of_bells_are_zero_so_that_no_product_of_two_is_denormal() -> None:
    angle_rad, deviation_rad = torch.linspace(-math.pi, math.pi, 60), torch.tensor([0.05])
    across, along = (bells(angle_rad, torch.tensor([centre_rad]), deviation_rad) for centre_rad in (0.0, 0.5))
    product = across.mT @ along
    assert 9 < product.count_nonzero() < product.numel() / 2
    assert bool(((product == 0) | (product >= torch.finfo(torch.float32).tiny)).all())
