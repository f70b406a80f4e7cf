"""What `bench render` prints: the time of splatting and of training steps, with the errors of splatting.

Splatting is compared with dense accumulation. Each time is the smallest of a few, because other programs on the machine
can only add to it.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from timeit import timeit
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Complex, Float
from torch import Tensor, autograd

from xfreqbench.bench.tables import Bench, timed_s
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.plane_waves import plane_wave_data
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning.targets import GridView
from xfreqbench.methods.registry import build_method
from xfreqbench.methods.splatting.composite import Backend, PixelLists, composite
from xfreqbench.methods.splatting.field import SUPPORT
from xfreqbench.methods.splatting.footprints import bin_footprints, squared_distance
from xfreqbench.methods.splatting.projection import Projection

METHODS = (
    *("xfreq-gs", "fixed-frequency-gs", "frequency-embedded-gs", "aperture-gs"),
    *("gsrf", "swift-wrf", "wideband-3dgs", "wrf-gs-plus"),
)
DIRECTIONS_PER_GAUSSIAN = 200
_MOST_DENSE_PAIRS = 100_000_000


def bench_render(bench: Bench, num_gaussians: Sequence[int], batch_sizes: Sequence[int], with_step: bool) -> None:
    """Print the table of splatting alone and, with `with_step`, that of training steps of methods."""
    bench.introduce()
    _tabulate_splatting(bench, num_gaussians, batch_sizes)
    if with_step:
        with tempfile.TemporaryDirectory() as folder:
            tabulate_fits(bench, plane_wave_data(Path(folder) / "waves.h5", np.array([1e9, 10e9]), num_tx=32))


def _tabulate_splatting(bench: Bench, num_gaussians: Sequence[int], batch_sizes: Sequence[int]) -> None:
    note = (
        f"Forward and backward, footprints given, all 90 × 360 directions, about {DIRECTIONS_PER_GAUSSIAN} "
        f"of them a Gaussian; ms a sample, numba and torch on {torch.get_num_threads()} threads. Dense: one sample in "
        "float32, every Gaussian on every direction; where `1/n` stands, timed on that part of the directions "
        "and scaled up, the squared distances of footprints included. Errors are those of numba in float32 against "
        "dense float64, relative to the largest value, on 1/81 of the directions."
    )
    sizes, times = ("N", "B", "pairs"), ("numba ms", "samples/s", "torch ms", "samples/s", "dense ms")
    columns = (*sizes, *times, "dense / numba", "dense / torch", "error of values", "of gradients")
    with bench.table("Splatting alone", note, columns) as table:
        for cells in splat_rows(num_gaussians, batch_sizes):
            table.add(*cells)


def tabulate_fits(bench: Bench, train: PasDataset) -> None:
    """Print the maps that training steps of methods see a second."""
    note = f"The method's own loop on a data set of 64 maps, {torch.get_num_threads()} threads, after its first step."
    with bench.table("Training steps of methods", note, ("method", "maps a step", "ms a step", "maps/s")) as table:
        for method in METHODS:
            size, seconds = build_method(method).config.batch_size, _step_s(train, method)
            table.add(method, str(size), f"{1e3 * seconds:.1f}", f"{size / seconds:,.0f}")


def _step_s(train: PasDataset, method: str) -> float:
    """Time of a step of `fit` in seconds, at half of the budget, where the loss has its final weights."""
    fit = build_method(method).fit(train, Budget(), 0)
    assert isinstance(fit, Generator)
    next(fit)
    return timed_s(lambda: fit.send(0.5))[0]


class Leaves(NamedTuple):
    """Inputs of accumulation that have gradients, for N Gaussians and B samples."""

    distance: Float[Tensor, "..."]
    inverse_spread: Float[Tensor, "N B"]
    signal: Complex[Tensor, "N B"]
    attenuation: Complex[Tensor, "N B"]


def splat_rows(num_gaussians: Sequence[int], batch_sizes: Sequence[int]) -> Iterator[tuple[str, ...]]:
    """Cells of the table of splatting: times of both backends and of dense accumulation, and the compiled one's errors.

    Footprints are random and of equal size. Times are in ms a sample. Errors are relative to the largest value of a
    tensor. Dense accumulation is timed for one sample on every `stride`-th row and column, then scaled.
    """
    grid = AngularGrid.hemisphere()
    for number in num_gaussians:
        projection = _random_projection(number)
        # fewer directions, where dense accumulation of all of them takes too long
        stride = 1 if number * math.prod(grid.shape) <= _MOST_DENSE_PAIRS else 5
        dense_ms = _dense_s(projection, GridView(stride).of_grid(grid)) * stride**2 * 1e3
        part = "" if stride == 1 else f" (1/{stride**2})"
        lists = bin_footprints(projection, grid, SUPPORT)
        distance = squared_distance(projection, lists, grid)
        for size in batch_sizes:
            leaves = _random_leaves(distance, number, size)
            own_ms = [_accumulation_s(lists, leaves, backend) / size * 1e3 for backend in ("numba", "torch")]
            times = [cell for ms in own_ms for cell in (f"{ms:.2f}", f"{1e3 / ms:.0f}")]
            ratios = [f"{dense_ms / ms:.0f}" for ms in own_ms]
            errors = [f"{error:.0e}" for error in _accumulation_errors(projection, size)]
            yield str(number), str(size), f"{len(distance):,}", *times, f"{dense_ms:.0f}{part}", *ratios, *errors


def _random_projection(num_gaussians: int) -> Projection:
    """Random circular footprints of `DIRECTIONS_PER_GAUSSIAN` directions each, spread over the hemisphere."""
    generator = torch.Generator().manual_seed(0)
    azimuth, elevation, distance = torch.rand(3, num_gaussians, generator=generator)
    variance = DIRECTIONS_PER_GAUSSIAN / (math.pi * SUPPORT) * math.radians(1.0) ** 2
    covariance = (variance * torch.eye(2)).repeat(num_gaussians, 1, 1)
    return Projection(2 * math.pi * azimuth, math.pi / 2 * elevation, covariance, 1 + distance)


def _random_leaves(distance: Float[Tensor, "P"], num_gaussians: int, batch_size: int) -> Leaves:
    """Distances with random attributes, like those of an untrained network."""
    generator = torch.Generator().manual_seed(1)
    shape = num_gaussians, batch_size
    phase_rad = 2 * math.pi * torch.rand(shape, generator=generator)
    return Leaves(
        distance,
        0.5 + torch.rand(shape, generator=generator),
        torch.randn(shape, generator=generator, dtype=torch.complex64),
        torch.polar(torch.full(shape, 0.9), phase_rad),
    )


def _differentiated(
    accumulate: Callable[[Leaves], Tensor], leaves: Leaves, weights: Tensor
) -> tuple[Tensor, tuple[Tensor, ...]]:
    """The field R, and the gradients of Re Σ conj(w) R by the leaves, with weights w."""
    free = Leaves(*(value.detach().requires_grad_() for value in leaves))
    field = accumulate(free)
    return field.detach(), autograd.grad(field, free, weights)


def _accumulation_s(lists: PixelLists, leaves: Leaves, backend: Backend) -> float:
    """Time of forward and backward for a minibatch, in seconds."""
    generator = torch.Generator().manual_seed(2)
    shape = leaves.signal.shape[1], len(lists.start) - 1
    weights = torch.randn(shape, generator=generator, dtype=torch.complex64)
    return timed_s(lambda: _differentiated(lambda free: composite(lists, *free, backend), leaves, weights))[0]


def dense_field(leaves: Leaves) -> Complex[Tensor, "B K"]:
    """Eq. 11 with every Gaussian on every direction; `distance` is (K, N), Gaussians are sorted, nearest first."""
    of_samples = []
    for sample in range(leaves.signal.shape[1]):
        footprint = torch.exp(-0.5 * leaves.distance * leaves.inverse_spread[:, sample])
        through = torch.cumprod(1 - footprint * (1 - leaves.attenuation[:, sample]), dim=1)
        in_front = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], dim=1)
        of_samples.append((footprint * in_front) @ leaves.signal[:, sample])
    return torch.stack(of_samples)


def _dense_s(projection: Projection, grid: AngularGrid) -> float:
    """Time of forward and backward for one sample on a grid in seconds, one row of directions after the other.

    It is that on one thread or on all, whichever is smaller, because tensors of a row are small.
    """
    order = projection.range_m.argsort()
    near_first = Projection(*(getattr(projection, field.name)[order] for field in fields(projection)))
    leaves = _random_leaves(torch.zeros(0), len(order), 1)
    weights = torch.ones(1, len(grid.azimuth_rad), dtype=torch.complex64)

    def render() -> None:
        for elevation_rad in grid.elevation_rad.tolist():
            # squared Mahalanobis distances between one row of directions and circular footprints
            azimuth_rad = torch.as_tensor(grid.azimuth_rad, dtype=torch.float32)[:, None]
            across = torch.remainder(azimuth_rad - near_first.azimuth_rad + math.pi, 2 * math.pi) - math.pi
            along = elevation_rad - near_first.elevation_rad
            distance = (across**2 + along**2) / near_first.covariance[:, 0, 0]
            _differentiated(dense_field, leaves._replace(distance=distance), weights)

    all_threads, times_s = torch.get_num_threads(), []
    try:
        for number in {1, all_threads}:
            torch.set_num_threads(number)
            times_s.append(timeit(render, number=1))
    finally:
        torch.set_num_threads(all_threads)
    return min(times_s)


def _accumulation_errors(projection: Projection, batch_size: int) -> tuple[float, float]:
    """Largest errors of values and of gradients of "numba" against dense float64, on a part of the directions.

    Only the first and the last sample have weights, so dense accumulation can leave out the others.
    """
    grid = GridView(stride=9).of_grid(AngularGrid.hemisphere())
    lists = bin_footprints(projection, grid, SUPPORT)
    leaves = _random_leaves(squared_distance(projection, lists, grid), lists.num_gaussians, batch_size)
    ends = sorted({0, batch_size - 1})
    weights = torch.zeros(batch_size, len(lists.start) - 1, dtype=torch.complex64)
    drawn = torch.Generator().manual_seed(0)
    weights[ends] = torch.randn(len(ends), weights.shape[1], dtype=torch.complex64, generator=drawn)
    field, gradients = _differentiated(lambda free: composite(lists, *free, "numba"), leaves, weights)
    order = projection.range_m.argsort(stable=True)
    pixel = torch.repeat_interleave(lists.start.diff())
    rank = order.argsort()[lists.gaussian]
    true, true_gradients = _dense_truth(leaves, order, (pixel, rank), ends, weights[ends])
    of_ends = (gradients[0], *(gradient[order][:, ends] for gradient in gradients[1:]))
    worst = max(_error(one, other) for one, other in zip(of_ends, true_gradients, strict=True))
    return _error(field[ends], true), worst


def _dense_truth(
    leaves: Leaves, order: Tensor, pair: tuple[Tensor, Tensor], ends: list[int], weights: Tensor
) -> tuple[Tensor, tuple[Tensor, ...]]:
    """Field and gradients of the samples `ends` by dense accumulation in double precision."""
    # the squared distance of Gaussians that a direction does not see; G is zero in double precision
    distance = torch.full((weights.shape[1], len(order)), 1e4, dtype=torch.float64)
    distance[pair] = leaves.distance.double()
    attributes = leaves.inverse_spread, leaves.signal, leaves.attenuation
    spread, signal, attenuation = (value[order][:, ends] for value in attributes)
    exact = Leaves(distance, spread.double(), signal.to(torch.complex128), attenuation.to(torch.complex128))
    true, (of_distance, *others) = _differentiated(dense_field, exact, weights.to(torch.complex128))
    return true, (of_distance[pair], *others)


def _error(value: Tensor, truth: Tensor) -> float:
    return float((value - truth).abs().max() / truth.abs().max())
