"""Where a Gaussian is seen and how wide, also where Eqs. (8) and (9) have no value; `test_footprints` has the rest."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from xfreqbench.methods.splatting.gaussians import covariance
from xfreqbench.methods.splatting.projection import (
    MIN_RANGE_M,
    MIN_VARIANCE,
    POLE_DISTANCE,
    Projection,
    angular_centre,
    project,
    project_gaussians,
    projection_jacobian,
)

# float64 loses a few digits of its 2e-16 to the cancellation of J Σ Jᵀ; float32 likewise of its 6e-8
AT_THE_EDGES = {
    "in the zenith": (0.0, 0.0, 2.0),
    "in the nadir": (0.0, 0.0, -2.0),
    "a millimetre from the axis": (1e-3, 0.0, 2.0),
    "at the receiver": (0.0, 0.0, 0.0),
    "a tenth of a millimetre from the receiver": (5e-5, -5e-5, 5e-5),
    "below the horizon": (1.0, -2.0, -1.0),
    "on the seam": (-2.0, 0.0, 1.0),
    "a kilometre off": (600.0, -700.0, 400.0),
}


def projected(position_m: Tensor, quaternion: Tensor, log_scale: Tensor) -> Projection:
    return project_gaussians(torch.cat([position_m, quaternion, log_scale], dim=-1))


def flat(seen: Projection) -> Tensor:
    """Azimuth, elevation and covariance of every Gaussian, (N, 6)."""
    return torch.column_stack([seen.azimuth_rad, seen.elevation_rad, seen.covariance.flatten(1)])


def relative_error(actual: Tensor, expected: Tensor) -> float:
    """Of the worst row, against its own length."""
    difference = (actual.double() - expected).flatten(1).norm(dim=1)
    return float((difference / expected.flatten(1).norm(dim=1)).max())


def test_inside_the_pole_cap_the_jacobian_of_elevation_stays_the_derivative() -> None:
    position_m = torch.tensor([[0.01, 0.02, 3.0], [-1e-4, 0.0, 2.0]], dtype=torch.float64)
    expected = torch.autograd.functional.jacobian(lambda x: angular_centre(x)[1].sum(), position_m)
    assert relative_error(projection_jacobian(position_m)[:, 1], expected) < 1e-12


def test_an_axis_aligned_gaussian_is_as_wide_as_its_sides_over_its_range() -> None:
    upright, on_its_side = (1.0, 0.0, 0.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)  # 90° about x
    position_m = torch.tensor([[2.0, 0.0, 0.0]] * 2, dtype=torch.float64)
    log_scale = torch.tensor([[0.9, 0.2, 0.1]] * 2, dtype=torch.float64).log()
    seen = projected(position_m, torch.tensor([upright, on_its_side], dtype=torch.float64), log_scale)
    wide, narrow = (0.2 / 2) ** 2 + MIN_VARIANCE, (0.1 / 2) ** 2 + MIN_VARIANCE
    expected = torch.diag_embed(torch.tensor([[wide, narrow], [narrow, wide]], dtype=torch.float64))
    torch.testing.assert_close(seen.covariance, expected)


@pytest.mark.parametrize("axis_distance_m", [0.0, 1e-9, 0.02, 0.2])
def test_towards_the_pole_a_ball_grows_wider_in_azimuth_up_to_the_cap(axis_distance_m: float) -> None:
    position_m = torch.tensor([[0.0, axis_distance_m, math.sqrt(4 - axis_distance_m**2)]], dtype=torch.float64)
    ball = torch.full((1, 3), math.log(0.1), dtype=torch.float64)
    seen = projected(position_m, torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64), ball)
    width_rad = 0.1 / max(axis_distance_m, 2 * POLE_DISTANCE)
    expected = torch.tensor([width_rad**2, (0.1 / 2) ** 2], dtype=torch.float64).diag()
    # 1e-5: a point on the axis is looked at a micrometre beside it
    torch.testing.assert_close(
        seen.covariance[0], expected + MIN_VARIANCE * torch.eye(2).double(), rtol=1e-5, atol=1e-9
    )


def test_a_ball_around_the_receiver_is_as_wide_as_at_the_least_range() -> None:
    position_m = torch.tensor([[1e-4, 0.0, 0.0], [MIN_RANGE_M, 0.0, 0.0]], dtype=torch.float64)
    ball_m2 = torch.eye(3, dtype=torch.float64).expand(2, 3, 3) * 1e-4
    inside, outside = project(position_m, ball_m2).covariance
    # its elevation is foreshortened by the pole's axis, which lies through the receiver
    assert float(inside[1, 1]) <= float(outside[1, 1])
    assert float(inside[0, 0]) == pytest.approx(1e-4 / (POLE_DISTANCE * MIN_RANGE_M) ** 2 + MIN_VARIANCE)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("place", AT_THE_EDGES)
def test_values_and_gradients_are_finite_wherever_a_gaussian_is(place: str, dtype: torch.dtype) -> None:
    position_m = torch.tensor([AT_THE_EDGES[place]], dtype=dtype, requires_grad=True)
    quaternion = torch.tensor([[0.3, -0.5, 0.2, 0.9]], dtype=dtype, requires_grad=True)
    log_scale = torch.tensor([[-3.0, -1.0, 0.0]], dtype=dtype, requires_grad=True)
    seen = flat(projected(position_m, quaternion, log_scale))
    assert bool(seen.isfinite().all())
    assert float(seen.detach()[0, 2]) >= MIN_VARIANCE * (1 - 1e-6)  # which float32 rounds
    for gradient in torch.autograd.grad(seen.sum(), (position_m, quaternion, log_scale)):
        assert bool(gradient.isfinite().all())


@pytest.mark.parametrize("place", AT_THE_EDGES)
def test_compiled_projection_is_that_of_torch_in_value_and_gradient(place: str) -> None:
    """Needles, whose correlation is clipped, and shapes between, at the edges and beside them."""
    generator = torch.Generator().manual_seed(0)
    gaussians = torch.randn(30, 10, generator=generator, dtype=torch.float64)
    gaussians[:, :3] = torch.tensor(AT_THE_EDGES[place]).double() + torch.linspace(0, 1e-5, 30).double()[:, None]
    gaussians[::3, 7:] = torch.tensor([4.0, -9.0, -9.0]).double()
    weight = torch.randn(30, 6, generator=generator, dtype=torch.float64)
    answers = []
    for compiled in (True, False):
        given = gaussians.clone().requires_grad_()
        position_m, quaternion, log_scale = given.split([3, 4, 3], dim=-1)
        seen = project_gaussians(given) if compiled else project(position_m, covariance(quaternion, log_scale))
        flattened = flat(seen)
        answers.append((flattened.detach(), *torch.autograd.grad((flattened * weight).sum(), given)))
    for found, expected in zip(*answers, strict=True):
        assert relative_error(found, expected) < 1e-11


def test_a_needle_has_an_ellipse_for_a_footprint() -> None:
    generator = torch.Generator().manual_seed(0)
    position_m, quaternion = (torch.randn(500, 3, generator=generator), torch.randn(500, 4, generator=generator))
    for size_m in ((10.0, 1e-3, 1e-3), (1e4, 1e-8, 1e-8)):
        log_scale = torch.tensor(size_m).log().expand(500, 3)
        found = projected(position_m, quaternion, log_scale).covariance
        a, b, c = found[:, 0, 0], found[:, 0, 1], found[:, 1, 1]
        assert bool((a * c - b * b > 0).all())  # in float32, as it is inverted


def test_covariances_of_needles_are_exact_to_some_roundings() -> None:
    """Σ of a needle turned so that its axes change places is the diagonal matrix with exchanged entries.

    After a turn by 90° about z the error is relative to the largest entry. After a turn by 120° about all three
    axes, whose quaternion and products are exact, it is relative to each entry of the diagonal.
    """
    scale = torch.tensor([[1e-8, 1e4, 1.0], [1e4, 1e-8, 1e-8], [1e4, 1e4, 1e-8]])
    half = math.sqrt(0.5)
    found = covariance(torch.tensor([[half, 0.0, 0.0, half]]).expand(3, 4), scale.log()).double()
    expected = torch.diag_embed(scale.double()[:, [1, 0, 2]] ** 2)
    assert ((found - expected).abs() / expected.amax((1, 2), keepdim=True)).max() < 5e-6
    exact = covariance(torch.full((3, 4), 0.5), scale.log()).double()
    entries = scale.double()[:, [2, 0, 1]] ** 2
    torch.testing.assert_close(exact.diagonal(dim1=1, dim2=2), entries, rtol=5e-6, atol=0)
    assert (exact - torch.diag_embed(exact.diagonal(dim1=1, dim2=2))).abs().max() < 5e-6
