"""Gaussians of one angle, which products of two make Gaussians of the plane of azimuth and elevation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from xfreqbench.methods.splatting import composite_kernels
from xfreqbench.methods.splatting.composite import arrays_of, numba_on_torch_threads


def bells(
    angle_rad: Float[Tensor, "K"],
    centre_rad: Float[Tensor, "*shape"],
    deviation_rad: Float[Tensor, "*shape"],
    full_turn: bool = False,
) -> Float[Tensor, "*shape K"]:
    """exp(−½ (angle − centre)² / deviation²); with `full_turn`, angles are taken the short way round.

    In float32 on a CPU, this is a compiled kernel, which sets far tails to zero.
    """
    if centre_rad.device.type == "cpu" and centre_rad.dtype == torch.float32:
        return _Kernels.apply(angle_rad, centre_rad, deviation_rad, full_turn)  # type: ignore[no-untyped-call]
    across = angle_rad.to(centre_rad) - centre_rad[..., None]
    if full_turn:
        across = torch.remainder(across + math.pi, 2 * math.pi) - math.pi
    return torch.exp(-0.5 * (across / deviation_rad[..., None]).square())


class _Kernels(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, angle_rad: Tensor, centre_rad: Tensor, deviation_rad: Tensor, full_turn: bool) -> Tensor:
        bell = centre_rad.new_empty(*centre_rad.shape, len(angle_rad))
        given = arrays_of(angle_rad, centre_rad.flatten(), deviation_rad.flatten())
        ctx.given = *given, np.float32(full_turn / (2 * math.pi)), bell.flatten(0, -2).numpy()
        with numba_on_torch_threads():
            composite_kernels.bells(*ctx.given)
        return bell

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        of_centre, of_deviation = slope.new_empty(slope.shape[:-1]), slope.new_empty(slope.shape[:-1])
        with numba_on_torch_threads():
            composite_kernels.bells_backward(
                *ctx.given, *arrays_of(slope.contiguous().flatten(0, -2), of_centre.view(-1), of_deviation.view(-1))
            )
        return None, of_centre, of_deviation, None
