"""Accumulation of Gaussians that every map of a minibatch has elsewhere: footprints are those of one map each."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.splatting import composite_kernels
from xfreqbench.methods.splatting.composite import arrays_of, numba_on_torch_threads
from xfreqbench.methods.splatting.footprint_kernels import footprint_spans
from xfreqbench.methods.splatting.footprints import inverse
from xfreqbench.methods.splatting.projection import Projection


def composite_maps(
    projection: Projection,
    grid: AngularGrid,
    support: float,
    signal: Float[Tensor, "B N"],
    opacity: Float[Tensor, "B N"],
) -> Float[Tensor, "B K"]:
    """R_k = Σ_i G_i S_i Π_{m<i} (1 − o_m G_m) of B maps, float32: Eq. (11) where all is real.

    `projection` has the N Gaussians of the first map, then those of the second, and so on. A footprint ends where
    the squared Mahalanobis distance is `support`. A CPU does it in a compiled kernel, a device one map after another.
    """
    if signal.device.type != "cpu":
        from xfreqbench.methods.splatting.composite_triton import composite_on_cuda

        azimuth_rad, elevation_rad = (
            torch.as_tensor(axis).float().to(signal.device) for axis in (grid.azimuth_rad, grid.elevation_rad)
        )
        of_maps = zip(*(part.chunk(len(signal)) for part in vars(projection).values()), signal, opacity, strict=True)
        fields = [
            composite_on_cuda(
                Projection(*geometry),
                azimuth_rad,
                elevation_rad,
                support,
                torch.ones_like(s)[:, None],
                s[:, None].to(torch.complex64),
                (1 - o)[:, None].to(torch.complex64),
            )
            for *geometry, s, o in of_maps
        ]
        return torch.cat(fields).real
    order = projection.range_m.reshape(signal.shape).argsort(stable=True)
    centre = torch.stack([projection.azimuth_rad, projection.elevation_rad], dim=-1)
    footprint = torch.cat([centre, inverse(projection.covariance)], dim=-1)
    ends = footprint.detach().double().numpy()
    spans = footprint_spans(ends[:, :2], ends[:, 2:], grid.elevation_rad, grid.azimuth_rad, support)
    rows = torch.stack([signal, opacity], dim=-1)
    return _Kernels.apply(footprint.float(), rows.float(), order, spans, grid)  # type: ignore[no-untyped-call]


class _Kernels(torch.autograd.Function):
    """Field (B, K) of maps with footprints (B·N, 5) of their own, and rows (B, N, 2) of S and 1 − δ, all real."""

    @staticmethod
    def forward(
        ctx: Any, footprint: Tensor, rows: Tensor, order: Tensor, spans: tuple[Any, Any], grid: AngularGrid
    ) -> Tensor:
        first, count = spans
        num_maps, (num_rows, num_columns) = len(rows), grid.shape
        start = np.append(0, count.reshape(num_maps, -1).sum(axis=1).cumsum())
        step_rad = float(grid.azimuth_rad[1] - grid.azimuth_rad[0]) if num_columns > 1 else 2 * math.pi
        offset_rad = (footprint[:, 0].double().numpy() - grid.azimuth_rad[0]) % (2 * math.pi)
        shapes, elevation_rad = footprint[:, 1:].contiguous().numpy(), grid.elevation_rad.astype(np.float32)
        shared = order.numpy(), first, count, start, offset_rad, shapes, elevation_rad, step_rad, rows.numpy()
        field, stash = torch.empty(num_maps, num_rows * num_columns), np.empty((start[-1], 2), np.float32)
        with numba_on_torch_threads():
            composite_kernels.forward_of_maps(*shared, field.numpy(), stash)
        ctx.arguments = *shared, stash
        return field

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_field: Tensor) -> tuple[Tensor | None, ...]:
        grad_footprint, grad_rows = torch.empty(len(ctx.arguments[4]), 5), torch.empty(ctx.arguments[8].shape)
        with numba_on_torch_threads():
            composite_kernels.backward_of_maps(
                *ctx.arguments, *arrays_of(grad_field.contiguous(), grad_footprint, grad_rows)
            )
        return grad_footprint, grad_rows, None, None, None
