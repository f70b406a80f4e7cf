"""Accumulation of Gaussians that every map of a minibatch has elsewhere: footprints are those of one map each."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.splatting import composite_kernels, projection_kernels
from xfreqbench.methods.splatting.composite import arrays_of, numba_on_torch_threads
from xfreqbench.methods.splatting.footprint_kernels import footprint_runs
from xfreqbench.methods.splatting.projection import project_gaussians
from xfreqbench.types import IntArray, NDArray


def composite_maps(
    gaussians: Float[Tensor, "B N 10"],
    grid: AngularGrid,
    support: float,
    signal: Float[Tensor, "B N"],
    opacity: Float[Tensor, "B N"],
) -> Float[Tensor, "B K"]:
    """R_k = Σ_i G_i S_i Π_{m<i} (1 − o_m G_m) of B maps, float32: Eq. (11) where all is real.

    `gaussians` are positions, quaternions and log-scales, as `project_gaussians` takes them, of each map. A footprint
    ends where the squared Mahalanobis distance is `support`. Compiled kernels do it all, on a CPU and on a device.
    """
    if signal.device.type == "cpu":
        field: Tensor = _Kernels.apply(gaussians, signal, opacity, grid, support)  # type: ignore[no-untyped-call]
        return field
    from xfreqbench.methods.splatting.composite_triton import composite_on_cuda

    axes = grid.azimuth_rad, grid.elevation_rad
    azimuth_rad, elevation_rad = (torch.as_tensor(axis).float().to(signal.device) for axis in axes)
    each = opacity.flatten()[:, None]
    return composite_on_cuda(
        project_gaussians(gaussians.flatten(0, 1)),
        azimuth_rad,
        elevation_rad,
        support,
        torch.ones_like(each),
        signal.flatten()[:, None].to(torch.complex64),
        (1 - each).to(torch.complex64),
        num_sets=len(signal),
    ).real


class _Kernels(torch.autograd.Function):
    """`composite_maps` on a CPU: projection, footprints and accumulation by compiled kernels."""

    @staticmethod
    def forward(
        ctx: Any, gaussians: Tensor, signal: Tensor, opacity: Tensor, grid: AngularGrid, support: float
    ) -> Tensor:
        shapes, s, o = arrays_of(*(each.float().contiguous() for each in (gaussians.flatten(0, 1), signal, opacity)))
        footprint, range_m = np.empty((len(shapes), 5)), np.empty(signal.shape, np.float32)
        projection_kernels.project(shapes, footprint, range_m.ravel())
        a, b, c = footprint[:, 2:].T
        footprint[:, 2:] = (np.array([c, -b, a]) / (a * c - b * b)).T
        before, runs, angles_rad = footprint_runs(
            footprint[:, :2], footprint[:, 2:], grid.elevation_rad, grid.azimuth_rad, support
        )
        step_rad = float(grid.azimuth_rad[1] - grid.azimuth_rad[0]) if len(grid.azimuth_rad) > 1 else 2 * math.pi
        shared = _nearest_first(range_m), before, runs, angles_rad, footprint, step_rad, s, o
        field, stash = torch.empty(len(signal), math.prod(grid.shape)), np.empty((before[-1, 1], 2), np.float32)
        with numba_on_torch_threads():
            composite_kernels.forward_of_maps(*shared, field.numpy(), stash)
        ctx.shapes, ctx.arguments = shapes, (*shared, stash)
        return field

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_field: Tensor) -> tuple[Tensor | None, ...]:
        num_maps, num_gaussians = ctx.arguments[-3].shape
        slope = torch.empty(num_maps * num_gaussians, 5, dtype=torch.float64)
        grad_shapes, (grad_signal, grad_opacity) = torch.empty(len(slope), 10), torch.empty(2, num_maps, num_gaussians)
        with numba_on_torch_threads():
            composite_kernels.backward_of_maps(
                *ctx.arguments, *arrays_of(grad_field.contiguous(), slope, grad_signal, grad_opacity)
            )
        projection_kernels.project_backward(ctx.shapes, *arrays_of(slope, grad_shapes))
        return grad_shapes.view(num_maps, num_gaussians, 10), grad_signal, grad_opacity, None, None


def _nearest_first(range_m: Float[NDArray[np.float32], "B N"]) -> Int[IntArray, "B N"]:
    """The order of ranges in each row, of equal ones as they stand: their bits as whole numbers, places behind them."""
    places = range_m.view(np.int32).astype(np.int64) << 32 | np.arange(range_m.shape[1])
    places.sort(axis=1)
    return places & 0xFFFFFFFF
