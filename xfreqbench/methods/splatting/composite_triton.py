"""Projected Gaussians accumulated along each direction, Eq. (11), on a CUDA device: no lists of pairs, fixed shapes.

A program has a tile of `TILE_ROWS` × `TILE_COLUMNS` directions and up to `MAX_LANES` samples of the minibatch. The
Gaussians whose boxes meet a tile are listed first, nearest first; a direction outside of a Gaussian's footprint
passes it by. Nothing waits for the host, so that a step of training can be captured and replayed as a CUDA graph.

Going back, T is computed forward again in stretches of `STRETCH` Gaussians from the values that the forward sweep left,
as it cannot be divided by what may be zero. Gradients are added in the order in which programs end: two runs differ
in their last digits.

With `TRITON_INTERPRET=1`, Triton runs all of this on a CPU.
"""

from __future__ import annotations

import math
from typing import Any

import torch
import triton
import triton.language as tl
from jaxtyping import Complex, Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from xfreqbench.methods.splatting.footprints import inverse
from xfreqbench.methods.splatting.projection import Projection

TILE_ROWS, TILE_COLUMNS = 4, 8
MAX_LANES = 16
WARPS = 1  # a program's sums then need no barrier
STRETCH = 32
LISTED_AT_ONCE = 128
_TURN = tl.constexpr(2 * math.pi)


def composite_on_cuda(
    projection: Projection,
    azimuth_rad: Float[Tensor, "A"],
    elevation_rad: Float[Tensor, "E"],
    support: float,
    inverse_spread: Float[Tensor, "MN B"],
    signal: Complex[Tensor, "MN B"],
    attenuation: Complex[Tensor, "MN B"],
    num_sets: int = 1,
) -> Complex[Tensor, "MB K"]:
    """R_k of all K = E A directions, row by row: as `composite` of the footprints of N Gaussians, float32.

    A footprint ends where the squared Mahalanobis distance, before the frequency's spread λ, is `support`. Of
    M = `num_sets` of Gaussians each has N of them and B samples of its own, one set after another.
    """
    ranges_m = projection.range_m.detach().unflatten(0, (num_sets, -1))
    first = ranges_m.shape[1] * torch.arange(num_sets, device=ranges_m.device)  # Gaussian of each set
    order = (ranges_m.argsort(dim=1, stable=True) + first[:, None]).flatten()
    centre = torch.stack([projection.azimuth_rad, projection.elevation_rad], dim=-1)
    # boxes are a little larger than footprints, for rounding
    reach = (support * projection.covariance.detach().diagonal(dim1=-2, dim2=-1)).sqrt() + 1e-4
    boxes = torch.cat([centre.detach(), reach], dim=-1)[order].contiguous()
    geometry = torch.cat([centre, inverse(projection.covariance)], dim=-1)
    absorption = 1 - attenuation
    rows = torch.stack([inverse_spread, signal.real, signal.imag, absorption.real, absorption.imag], dim=1)
    field = _Composite.apply(
        geometry.contiguous(), rows.contiguous(), boxes, order, azimuth_rad, elevation_rad, support, num_sets
    )
    return torch.view_as_complex(field)


class _Composite(torch.autograd.Function):
    """The field (M·B, K, 2) of Gaussians with geometry (M·N, 5) and rows (M·N, FIELDS, B).

    Geometry is azimuth, elevation and three entries of the inverse covariance.
    """

    @staticmethod
    def forward(
        ctx: Any,
        geometry: Tensor,
        rows: Tensor,
        boxes: Tensor,
        order: Tensor,
        azimuth_rad: Tensor,
        elevation_rad: Tensor,
        support: float,
        num_sets: int,
    ) -> Tensor:
        number, batch = len(rows) // num_sets, rows.shape[2]
        num_rows, num_columns = len(elevation_rad), len(azimuth_rad)
        tiles = num_sets * triton.cdiv(num_rows, TILE_ROWS) * triton.cdiv(num_columns, TILE_COLUMNS)
        lanes = min(MAX_LANES, triton.next_power_of_2(batch))
        programs = tiles, triton.cdiv(batch, lanes)
        lists, counts = order.new_empty(tiles, number, dtype=torch.int32), order.new_empty(tiles, dtype=torch.int32)
        shape = TILE_ROWS, TILE_COLUMNS
        _list_kernel[(tiles,)](
            boxes, order, azimuth_rad, elevation_rad, lists, counts, number, num_rows, num_columns, *shape,
            LISTED_AT_ONCE,
        )  # fmt: skip
        stretches = triton.cdiv(number, STRETCH)
        kept = rows.new_empty(programs[0] * programs[1], stretches, 2, TILE_ROWS * TILE_COLUMNS, lanes)
        field = rows.new_empty(num_sets * batch, num_rows * num_columns, 2)
        sizes = number, batch, num_rows, num_columns, support, *shape, lanes, STRETCH
        _forward_kernel[programs](
            geometry, rows, azimuth_rad, elevation_rad, lists, counts, kept, field, *sizes, num_warps=WARPS
        )
        ctx.save_for_backward(geometry, rows, azimuth_rad, elevation_rad, lists, counts, kept)
        ctx.programs, ctx.sizes = programs, sizes
        return field

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_field: Tensor) -> tuple[Tensor | None, ...]:
        geometry, rows, azimuth_rad, elevation_rad, lists, counts, kept = ctx.saved_tensors
        scratch = kept.new_empty(len(kept), STRETCH, *kept.shape[2:])
        grad_geometry, grad_rows = torch.zeros_like(geometry), torch.zeros_like(rows)
        _backward_kernel[ctx.programs](
            geometry, rows, azimuth_rad, elevation_rad, lists, counts, kept, scratch, grad_field.contiguous(),
            grad_geometry, grad_rows, *ctx.sizes, num_warps=WARPS,
        )  # fmt: skip
        return grad_geometry, grad_rows, None, None, None, None, None, None


@triton.jit
def _short_way(angle_rad):
    """An angle of any size, taken into [−π, π)."""
    return angle_rad - _TURN * tl.floor(angle_rad / _TURN + 0.5)


@triton.jit
def _place(num_rows, num_columns, ROWS: tl.constexpr, COLUMNS: tl.constexpr):
    """The set of Gaussians of a program, and the first row and column of its tile."""
    across = tl.cdiv(num_columns, COLUMNS)
    tiles = tl.cdiv(num_rows, ROWS) * across
    tile = tl.program_id(0) % tiles
    return tl.program_id(0) // tiles, (tile // across) * ROWS, (tile % across) * COLUMNS


@triton.jit
def _list_kernel(
    boxes, order, azimuth_rad, elevation_rad, lists, counts, number, num_rows, num_columns,
    ROWS: tl.constexpr, COLUMNS: tl.constexpr, AT_ONCE: tl.constexpr,
):  # fmt: skip
    """The Gaussians whose boxes meet a tile, in the order of `boxes`."""
    nth_set, row, column = _place(num_rows, num_columns, ROWS, COLUMNS)
    own = lists + tl.program_id(0).to(tl.int64) * number
    low_u = tl.load(azimuth_rad + column)
    high_u = tl.load(azimuth_rad + tl.minimum(column + COLUMNS, num_columns) - 1)
    low_v = tl.load(elevation_rad + row)
    high_v = tl.load(elevation_rad + tl.minimum(row + ROWS, num_rows) - 1)
    count = 0
    for first in range(0, number, AT_ONCE):
        nth = nth_set * number + first + tl.arange(0, AT_ONCE)
        box, there = boxes + 4 * nth, nth < (nth_set + 1) * number
        off_u = tl.abs(_short_way(tl.load(box, mask=there, other=0.0) - (low_u + high_u) / 2))
        off_v = tl.abs(tl.load(box + 1, mask=there, other=0.0) - (low_v + high_v) / 2)
        meets_u = off_u <= tl.load(box + 2, mask=there, other=0.0) + tl.abs(high_u - low_u) / 2
        meets_v = off_v <= tl.load(box + 3, mask=there, other=0.0) + tl.abs(high_v - low_v) / 2
        hit = (there & meets_u & meets_v).to(tl.int32)
        tl.store(
            own + count + tl.cumsum(hit, 0) - 1, tl.load(order + nth, mask=there, other=0).to(tl.int32), mask=hit == 1
        )
        count += tl.sum(hit, 0)
    tl.store(counts + tl.program_id(0), count)


@triton.jit
def _directions(azimuth_rad, elevation_rad, num_rows, num_columns, ROWS: tl.constexpr, COLUMNS: tl.constexpr):
    """The directions of a program's tile: azimuth, elevation, number, and whether the grid has them; and the set."""
    nth = tl.arange(0, ROWS * COLUMNS)
    nth_set, row, column = _place(num_rows, num_columns, ROWS, COLUMNS)
    row, column = row + nth // COLUMNS, column + nth % COLUMNS
    there = (row < num_rows) & (column < num_columns)
    u = tl.load(azimuth_rad + column, mask=there, other=0.0)
    v = tl.load(elevation_rad + row, mask=there, other=0.0)
    return u, v, row * num_columns + column, there, nth_set


@triton.jit
def _footprint(geometry, rows, gaussian, u, v, there, lane, has_lane, batch, support):
    """G and 1/λ of a Gaussian, how far each direction is from its centre, and the squared distance."""
    of_gaussian, row = geometry + 5 * gaussian, rows + 5 * gaussian * batch + lane
    across, along = _short_way(u - tl.load(of_gaussian)), v - tl.load(of_gaussian + 1)
    a, b, c = tl.load(of_gaussian + 2), tl.load(of_gaussian + 3), tl.load(of_gaussian + 4)
    distance = a * across * across + 2 * b * across * along + c * along * along
    spread = tl.load(row, mask=has_lane, other=0.0)
    inside = there & (distance <= support)
    g = tl.where(inside[:, None], tl.exp(-0.5 * distance[:, None] * spread[None, :]), 0.0)
    return g, spread, across, along, distance


@triton.jit
def _attributes(rows, gaussian, lane, has_lane, batch):
    """S and 1 − δ of a Gaussian for each lane, real and imaginary parts."""
    row = rows + 5 * gaussian * batch + lane
    s_re = tl.load(row + batch, mask=has_lane, other=0.0)[None, :]
    s_im = tl.load(row + 2 * batch, mask=has_lane, other=0.0)[None, :]
    e_re = tl.load(row + 3 * batch, mask=has_lane, other=0.0)[None, :]
    e_im = tl.load(row + 4 * batch, mask=has_lane, other=0.0)[None, :]
    return s_re, s_im, e_re, e_im


@triton.jit
def _forward_kernel(
    geometry, rows, azimuth_rad, elevation_rad, lists, counts, kept, field,
    number, batch, num_rows, num_columns, support,
    ROWS: tl.constexpr, COLUMNS: tl.constexpr, LANES: tl.constexpr, LENGTH: tl.constexpr,
):  # fmt: skip
    """R += G T S, then T −= G T (1 − δ), nearest first; T before each stretch is kept."""
    SIZE: tl.constexpr = ROWS * COLUMNS * LANES
    u, v, direction, there, nth_set = _directions(azimuth_rad, elevation_rad, num_rows, num_columns, ROWS, COLUMNS)
    program = tl.program_id(0) * tl.num_programs(1) + tl.program_id(1)
    listed = lists + tl.program_id(0).to(tl.int64) * number
    lane = tl.program_id(1) * LANES + tl.arange(0, LANES)
    has_lane, sample = lane < batch, (nth_set * batch + lane).to(tl.int64)[None, :]
    cell = tl.arange(0, ROWS * COLUMNS)[:, None] * LANES + tl.arange(0, LANES)[None, :]
    own = kept + program.to(tl.int64) * tl.cdiv(number, LENGTH) * 2 * SIZE + cell
    t_re = tl.full((ROWS * COLUMNS, LANES), 1.0, tl.float32)
    t_im, r_re, r_im = tl.zeros_like(t_re), tl.zeros_like(t_re), tl.zeros_like(t_re)
    count = tl.load(counts + tl.program_id(0))
    for nth in range(count):
        if nth % LENGTH == 0:
            tl.store(own + (nth // LENGTH) * 2 * SIZE, t_re)
            tl.store(own + (nth // LENGTH) * 2 * SIZE + SIZE, t_im)
        gaussian = tl.load(listed + nth)
        g, _, _, _, _ = _footprint(geometry, rows, gaussian, u, v, there, lane, has_lane, batch, support)
        s_re, s_im, e_re, e_im = _attributes(rows, gaussian, lane, has_lane, batch)
        w_re, w_im = g * t_re, g * t_im
        r_re += w_re * s_re - w_im * s_im
        r_im += w_re * s_im + w_im * s_re
        t_re -= w_re * e_re - w_im * e_im
        t_im -= w_re * e_im + w_im * e_re
    place = field + 2 * (sample * (num_rows * num_columns) + direction[:, None])
    mask = there[:, None] & has_lane[None, :]
    tl.store(place, r_re, mask=mask)
    tl.store(place + 1, r_im, mask=mask)


@triton.jit
def _backward_kernel(
    geometry, rows, azimuth_rad, elevation_rad, lists, counts, kept, scratch, grad_field, grad_geometry, grad_rows,
    number, batch, num_rows, num_columns, support,
    ROWS: tl.constexpr, COLUMNS: tl.constexpr, LANES: tl.constexpr, LENGTH: tl.constexpr,
):  # fmt: skip
    """Gradients, farthest first, with V the field from behind per unit of T: V ← V + G (S − (1 − δ) V)."""
    SIZE: tl.constexpr = ROWS * COLUMNS * LANES
    u, v, direction, there, nth_set = _directions(azimuth_rad, elevation_rad, num_rows, num_columns, ROWS, COLUMNS)
    program = tl.program_id(0) * tl.num_programs(1) + tl.program_id(1)
    listed = lists + tl.program_id(0).to(tl.int64) * number
    lane = tl.program_id(1) * LANES + tl.arange(0, LANES)
    has_lane, sample = lane < batch, (nth_set * batch + lane).to(tl.int64)[None, :]
    cell = tl.arange(0, ROWS * COLUMNS)[:, None] * LANES + tl.arange(0, LANES)[None, :]
    own = kept + program.to(tl.int64) * tl.cdiv(number, LENGTH) * 2 * SIZE + cell
    stash = scratch + program.to(tl.int64) * LENGTH * 2 * SIZE + cell
    place = grad_field + 2 * (sample * (num_rows * num_columns) + direction[:, None])
    mask = there[:, None] & has_lane[None, :]
    y_re, y_im = tl.load(place, mask=mask, other=0.0), tl.load(place + 1, mask=mask, other=0.0)
    v_re, v_im = tl.zeros_like(y_re), tl.zeros_like(y_re)
    count = tl.load(counts + tl.program_id(0))
    stretches = tl.cdiv(count, LENGTH)
    for back in range(stretches):
        stretch = stretches - 1 - back
        first = stretch * LENGTH
        length = tl.minimum(LENGTH, count - first)
        t_re, t_im = tl.load(own + stretch * 2 * SIZE), tl.load(own + stretch * 2 * SIZE + SIZE)
        for nth in range(length):
            tl.store(stash + nth * 2 * SIZE, t_re)
            tl.store(stash + nth * 2 * SIZE + SIZE, t_im)
            gaussian = tl.load(listed + first + nth)
            g, _, _, _, _ = _footprint(geometry, rows, gaussian, u, v, there, lane, has_lane, batch, support)
            s_re, s_im, e_re, e_im = _attributes(rows, gaussian, lane, has_lane, batch)
            w_re, w_im = g * t_re, g * t_im
            t_re -= w_re * e_re - w_im * e_im
            t_im -= w_re * e_im + w_im * e_re
        tl.debug_barrier()
        for turned in range(length):
            nth = length - 1 - turned
            t_re, t_im = tl.load(stash + nth * 2 * SIZE), tl.load(stash + nth * 2 * SIZE + SIZE)
            gaussian = tl.load(listed + first + nth)
            g, spread, across, along, distance = _footprint(
                geometry, rows, gaussian, u, v, there, lane, has_lane, batch, support
            )
            s_re, s_im, e_re, e_im = _attributes(rows, gaussian, lane, has_lane, batch)
            w_re = g * (t_re * y_re + t_im * y_im)  # conj(G T) times the field's gradient
            w_im = g * (t_re * y_im - t_im * y_re)
            p_re = s_re - (e_re * v_re - e_im * v_im)
            p_im = s_im - (e_re * v_im + e_im * v_re)
            slope = -0.5 * (w_re * p_re + w_im * p_im)
            row = grad_rows + 5 * gaussian * batch + lane
            tl.atomic_add(row, tl.sum(slope * distance[:, None], 0), mask=has_lane)
            tl.atomic_add(row + batch, tl.sum(w_re, 0), mask=has_lane)
            tl.atomic_add(row + 2 * batch, tl.sum(w_im, 0), mask=has_lane)
            tl.atomic_add(row + 3 * batch, -tl.sum(w_re * v_re + w_im * v_im, 0), mask=has_lane)
            tl.atomic_add(row + 4 * batch, -tl.sum(w_im * v_re - w_re * v_im, 0), mask=has_lane)
            v_re += g * p_re
            v_im += g * p_im
            of_distance = tl.sum(slope * spread[None, :], 1)
            of_gaussian, grad = geometry + 5 * gaussian, grad_geometry + 5 * gaussian
            a, b, c = tl.load(of_gaussian + 2), tl.load(of_gaussian + 3), tl.load(of_gaussian + 4)
            tl.atomic_add(grad, -2 * tl.sum(of_distance * (a * across + b * along), 0))
            tl.atomic_add(grad + 1, -2 * tl.sum(of_distance * (b * across + c * along), 0))
            tl.atomic_add(grad + 2, tl.sum(of_distance * across * across, 0))
            tl.atomic_add(grad + 3, 2 * tl.sum(of_distance * across * along, 0))
            tl.atomic_add(grad + 4, tl.sum(of_distance * along * along, 0))
        tl.debug_barrier()
