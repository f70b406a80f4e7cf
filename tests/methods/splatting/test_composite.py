from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from tests.support.reference import accumulate, continuous_factor
from xfreqbench.methods.splatting.composite import Backend, PixelLists, composite

pytestmark = pytest.mark.usefixtures("one_thread")

TOLERANCE = 1e-5  # float32 rounds to 6e-8, 3,000 factors in a row were seen to err by 2e-6
BACKENDS: list[tuple[Backend, torch.dtype]] = [
    ("torch", torch.float64),
    ("torch", torch.float32),
    ("numba", torch.float32),
]
either_backend = pytest.mark.parametrize("backend", ["torch", "numba"])
any_backend = pytest.mark.parametrize(("backend", "dtype"), BACKENDS)
Renderer = Callable[[PixelLists, "Inputs"], Tensor]


class Inputs(NamedTuple):
    distance: Tensor
    inverse_spread: Tensor
    signal: Tensor
    attenuation: Tensor


class Answer(NamedTuple):
    """The field, and the gradients of Re Σ conj(w) R for fixed random weights w."""

    field: Tensor
    distance: Tensor
    inverse_spread: Tensor
    signal: Tensor
    attenuation: Tensor


def pixel_lists(lengths: list[int], num_gaussians: int, seed: int = 0) -> PixelLists:
    """Every pixel sees Gaussians drawn at random, none twice."""
    generator = torch.Generator().manual_seed(seed)
    drawn = [torch.randperm(num_gaussians, generator=generator)[:length] for length in lengths]
    start = torch.tensor([0, *lengths]).cumsum(0)
    return PixelLists(start, torch.cat(drawn), num_gaussians)


def random_inputs(lists: PixelLists, batch: int, magnitude: float = 0.9, seed: int = 0) -> Inputs:
    """Float32, as a training step has them: distances within three deviations, |δ| = magnitude, any phase."""
    generator = torch.Generator().manual_seed(seed)
    shape = (lists.num_gaussians, batch)
    phase_rad = 2 * math.pi * torch.rand(shape, generator=generator)
    return Inputs(
        distance=9 * torch.rand(len(lists.gaussian), generator=generator),
        inverse_spread=0.5 + torch.rand(shape, generator=generator),
        signal=torch.randn(shape, generator=generator, dtype=torch.complex64),
        attenuation=torch.polar(torch.full(shape, magnitude), phase_rad),
    )


def to_precision(inputs: Inputs, dtype: torch.dtype) -> Inputs:
    return Inputs(*(x.to(dtype.to_complex() if x.is_complex() else dtype) for x in inputs))


def weights(field: Tensor) -> Tensor:
    """The same for every renderer, each pixel's its own."""
    generator = torch.Generator().manual_seed(1)
    return torch.randn(field.shape, generator=generator, dtype=torch.complex64).to(field)


def differentiated(render: Renderer, lists: PixelLists, inputs: Inputs) -> Answer:
    leaves = Inputs(*(x.detach().clone().requires_grad_() for x in inputs))
    field = render(lists, leaves)
    return Answer(field.detach(), *torch.autograd.grad(field, leaves, weights(field), materialize_grads=True))


def literal(lists: PixelLists, inputs: Inputs) -> Tensor:
    """Eq. (11) pixel by pixel, in double precision, differentiated by autograd."""
    pixels = []
    for first, end in zip(lists.start[:-1].tolist(), lists.start[1:].tolist(), strict=True):
        index = lists.gaussian[first:end]
        footprint = torch.exp(-inputs.distance[first:end, None] * inputs.inverse_spread[index] / 2)
        factor = continuous_factor(footprint, inputs.attenuation[index])
        pixels.append(accumulate(footprint, inputs.signal[index], factor))
    return torch.stack(pixels, 1)


def expected(lists: PixelLists, inputs: Inputs) -> Answer:
    return differentiated(literal, lists, to_precision(inputs, torch.float64))


def answer(lists: PixelLists, inputs: Inputs, backend: Backend, dtype: torch.dtype = torch.float32) -> Answer:
    return differentiated(
        lambda lists, leaves: composite(lists, *leaves, backend=backend), lists, to_precision(inputs, dtype)
    )


def assert_same(got: Answer, wanted: Answer, tolerance: float = TOLERANCE) -> None:
    """Every entry within `tolerance` of the largest entry of its own tensor; NaN fails."""
    for name, one, other in zip(Answer._fields, got, wanted, strict=True):
        error, most = (one.cpu().to(other.dtype) - other).abs().max(), other.abs().max()
        assert error <= tolerance * most, f"{name} is off by {error:.1e}, its largest entry is {most:.1e}"


@functools.cache
def long_rows(attenuation: complex | str) -> tuple[PixelLists, Inputs, Answer]:
    """Lists of 3,000 Gaussians with one δ, or with |δ| = 0.9 and any phase; and what Eq. (11) says."""
    lists = pixel_lists([3000, 0, 17], num_gaussians=3000)
    inputs = random_inputs(lists, batch=2)
    if not isinstance(attenuation, str):
        inputs = inputs._replace(attenuation=torch.full_like(inputs.attenuation, attenuation))
    return lists, inputs, expected(lists, inputs)


@any_backend
@pytest.mark.parametrize("attenuation", [0, "any phase", 1])
def test_3000_gaussians_in_a_row_match_the_literal_equation(
    backend: Backend, dtype: torch.dtype, attenuation: complex | str
) -> None:
    lists, inputs, wanted = long_rows(attenuation)
    assert_same(answer(lists, inputs, backend, dtype), wanted)


@any_backend
def test_gradients_survive_gaussians_that_let_nothing_through(backend: Backend, dtype: torch.dtype) -> None:
    lists = pixel_lists([40, 7, 0, 25], num_gaussians=60)
    inputs = random_inputs(lists, batch=3)
    opaque = torch.rand(60, 3, generator=torch.Generator().manual_seed(2)) < 0.2
    inputs = inputs._replace(
        distance=torch.where(inputs.distance < 4.5, 0.0, inputs.distance),
        attenuation=torch.where(opaque, 0, inputs.attenuation),
    )
    assert_same(answer(lists, inputs, backend, dtype), expected(lists, inputs))


@any_backend
@pytest.mark.parametrize("batch", [1, 16, 33])
def test_any_batch_over_lists_of_unequal_length_matches_the_literal_equation(
    backend: Backend, dtype: torch.dtype, batch: int
) -> None:
    lists = pixel_lists([5, 0, 12, 1, 30, 0], num_gaussians=40)
    inputs = random_inputs(lists, batch)
    assert_same(answer(lists, inputs, backend, dtype), expected(lists, inputs))


@either_backend
def test_at_their_centres_gaussians_multiply_their_attenuations_as_in_the_paper(backend: Backend) -> None:
    lists = PixelLists(torch.tensor([0, 6]), torch.arange(6), num_gaussians=6)
    inputs = random_inputs(lists, batch=4)
    inputs = inputs._replace(distance=torch.zeros(6))
    paper = accumulate(torch.ones(6, 1), inputs.signal, inputs.attenuation)
    torch.testing.assert_close(composite(lists, *inputs, backend=backend)[:, 0], paper)


@either_backend
def test_the_nearest_gaussian_hides_the_others(backend: Backend) -> None:
    lists = PixelLists(torch.tensor([0, 2, 4]), torch.tensor([0, 1, 1, 0]), num_gaussians=2)
    ones = torch.ones(2, 1)
    signal, opaque = torch.tensor([[1 + 2j], [3 - 1j]]), torch.zeros(2, 1, dtype=torch.complex64)
    field = composite(lists, torch.zeros(4), ones, signal, opaque, backend=backend)
    assert field.tolist() == [[1 + 2j, 3 - 1j]]


@either_backend
def test_pixels_that_see_nothing_are_dark_and_teach_nothing(backend: Backend) -> None:
    lists = pixel_lists([0, 0, 0], num_gaussians=2)
    dark = answer(lists, random_inputs(lists, batch=4), backend)
    assert dark.field.shape == (4, 3)
    assert not any(tensor.any() for tensor in dark)


@either_backend
def test_gradients_of_a_gaussian_that_every_pixel_sees_stay_accurate(backend: Backend) -> None:
    lists = pixel_lists([3] * 32_400, num_gaussians=3)
    inputs = random_inputs(lists, batch=1)
    assert_same(answer(lists, inputs, backend), answer(lists, inputs, "torch", torch.float64))


def test_gradients_repeat_to_the_last_bit_on_two_threads_and_are_those_of_one() -> None:
    lists = pixel_lists([50, 0, 1, 7] * 50, num_gaussians=80)
    inputs = random_inputs(lists, batch=17)
    on_one = answer(lists, inputs, "numba")
    torch.set_num_threads(2)
    once, again = (answer(lists, inputs, "numba") for _ in range(2))
    assert all(torch.equal(one, other) for one, other in zip(once, again, strict=True))
    assert_same(once, on_one)


def test_the_compiled_backend_refuses_double_precision() -> None:
    lists = pixel_lists([2], num_gaussians=3)
    inputs = to_precision(random_inputs(lists, batch=1), torch.float64)
    with pytest.raises(ValueError, match=r"takes float32 tensors on a CPU, but distance is torch\.float64"):
        composite(lists, *inputs, backend="numba")


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no CUDA device")
def test_a_cuda_device_gives_what_the_cpu_gives() -> None:
    lists = pixel_lists([50, 0, 1, 700, 7] * 40, num_gaussians=800)
    inputs = random_inputs(lists, batch=5)
    on_device = PixelLists(lists.start.cuda(), lists.gaussian.cuda(), lists.num_gaussians)
    got = answer(on_device, Inputs(*(x.cuda() for x in inputs)), "auto")
    assert got.field.is_cuda
    assert_same(got, answer(lists, inputs, "torch", torch.float64))
