"""Complex accumulation of the Gaussians that each pixel sees, Eq. (11), with gradients.

The receiver never moves, so one set of pixel lists serves the whole minibatch. Two backends give the same result:
"torch" processes all pixels layer by layer on any device, "numba" runs compiled kernels on the CPU in float32.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import torch
from jaxtyping import Complex, Float, Int64
from torch import Tensor, view_as_real
from torch.autograd.function import once_differentiable

from xfreqbench.methods.splatting import composite_kernels
from xfreqbench.methods.splatting.composite_kernels import FIELDS, LANES

Backend = Literal["auto", "torch", "numba"]


@dataclass(frozen=True, eq=False)
class PixelLists:
    """Which Gaussians each pixel sees, nearest first, in compressed rows; the whole minibatch shares them."""

    start: Int64[Tensor, " edges"]  # (K+1,): pairs of pixel k are start[k]:start[k + 1]
    gaussian: Int64[Tensor, " P"]  # (P,): index of the Gaussian of each (pixel, Gaussian) pair
    num_gaussians: int


def composite(
    lists: PixelLists,
    distance: Float[Tensor, " P"],
    inverse_spread: Float[Tensor, "N B"],
    signal: Complex[Tensor, "N B"],
    attenuation: Complex[Tensor, "N B"],
    backend: Backend = "auto",
) -> Complex[Tensor, "B K"]:
    """R_k = Σ_i G_i S_i Π_{m<i} (1 − G_m (1 − δ_m)) with G = exp(−distance · inverse_spread / 2): Eq. (11).

    `distance` is the squared Mahalanobis distance of each pair before the frequency spread λ, `inverse_spread` is
    1/λ, both ≥ 0; `signal` is S, `attenuation` δ. The product equals the paper's Π δ_m where G = 1. A pixel
    without Gaussians has the value zero. All four tensors receive gradients. "auto" is "numba" for float32 on a
    CPU and "torch" elsewhere; results of "numba" depend on torch.get_num_threads() in the last digits.
    Raises ValueError if "numba" is asked for on another device or in another precision.
    """
    if _chosen(backend, distance) == "numba":
        rows = _rows(inverse_spread, signal, 1 - attenuation)
        return _Kernels.apply(  # type: ignore[no-untyped-call]
            lists.start, lists.gaussian, distance.contiguous(), rows, inverse_spread.shape[1]
        )
    return _composite_torch(lists, distance, inverse_spread, signal, attenuation)


def _chosen(backend: Backend, distance: Tensor) -> Backend:
    """The backend to use, "torch" or "numba", for the device and precision of `distance`."""
    can_compile = distance.device.type == "cpu" and distance.dtype == torch.float32  # as all of them are
    if backend == "numba" and not can_compile:
        raise ValueError(
            f"The numba backend takes float32 tensors on a CPU, but distance is {distance.dtype} on "
            f"{distance.device}. Convert the tensors, or use backend='torch'."
        )
    if backend == "auto":
        return "numba" if can_compile else "torch"
    return backend


def _composite_torch(
    lists: PixelLists, distance: Tensor, inverse_spread: Tensor, signal: Tensor, attenuation: Tensor
) -> Tensor:
    length = lists.start.diff()
    order = length.argsort(descending=True, stable=True)
    counts = length.cpu()
    num_pixels = (len(counts) - counts.bincount().cumsum(0))[:-1].tolist()
    layers = _Layers(num_pixels, lists.start[:-1][order], lists.gaussian)
    field: Tensor = _Peel.apply(  # type: ignore[no-untyped-call]
        layers, distance, inverse_spread, signal, 1 - attenuation
    )
    return field[order.argsort()].T.contiguous()


@dataclass(frozen=True, eq=False)
class _Layers:
    """The pixel lists seen as layers, pixels sorted by the length of their lists, longest first.

    Layer l holds the l-th nearest pair of the `num_pixels[l]` pixels that have more than l Gaussians.
    """

    num_pixels: list[int]
    first: Tensor  # (K,): the first pair of each pixel
    gaussian: Tensor  # (P,): the Gaussian of each pair


def _peel(
    layers: _Layers, distance: Tensor, inverse_spread: Tensor, absorption: Tensor
) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
    """For each layer from the nearest: its pairs, their Gaussians, G, and G T, with T the transmittance in front."""
    transmittance = absorption.new_ones(len(layers.first), absorption.shape[1])
    for depth, num_pixels in enumerate(layers.num_pixels):
        pair = layers.first[:num_pixels] + depth
        index, transmittance = layers.gaussian[pair], transmittance[:num_pixels]
        footprint = torch.exp(-0.5 * distance[pair, None] * inverse_spread[index])
        visible = footprint * transmittance
        yield pair, index, footprint, visible
        transmittance = transmittance - visible * absorption[index]


class _Peel(torch.autograd.Function):
    """Field of all pixels, those with the longest list first, (K, B); absorption is 1 − δ.

    With V the field from behind per unit of T: dR/dG = T (S − (1 − δ) V), dR/dS = T G, dR/dδ = T G V.
    Nothing is divided by δ, which may be zero.
    """

    @staticmethod
    def forward(
        ctx: Any, layers: _Layers, distance: Tensor, inverse_spread: Tensor, signal: Tensor, absorption: Tensor
    ) -> Tensor:
        ctx.layers = layers
        ctx.save_for_backward(distance, inverse_spread, signal, absorption)
        field = signal.new_zeros(len(layers.first), signal.shape[1])
        for pair, index, _, visible in _peel(layers, distance, inverse_spread, absorption):
            field[: len(pair)] += visible * signal[index]
        return field

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_field: Tensor) -> tuple[Tensor | None, ...]:
        distance, inverse_spread, signal, absorption = ctx.saved_tensors
        grads = [torch.zeros_like(tensor) for tensor in (distance, inverse_spread, signal, absorption)]
        grad_distance, grad_spread, grad_signal, grad_absorption = grads
        behind = torch.zeros_like(grad_field)
        peeled = list(_peel(ctx.layers, distance, inverse_spread, absorption))
        for pair, index, footprint, visible in reversed(peeled):
            arriving = behind[: len(pair)]
            weight = visible.conj() * grad_field[: len(pair)]
            per_transmittance = signal[index] - absorption[index] * arriving
            slope = -0.5 * (view_as_real(weight) * view_as_real(per_transmittance)).sum(-1)
            grad_distance[pair] = (slope * inverse_spread[index]).sum(1)
            grad_spread.index_add_(0, index, slope * distance[pair, None])
            grad_signal.index_add_(0, index, weight)
            grad_absorption.index_add_(0, index, -weight * arriving.conj())
            arriving += footprint * per_transmittance
        return None, *grads


def _rows(inverse_spread: Tensor, signal: Tensor, absorption: Tensor) -> Tensor:
    """What the kernels read for each Gaussian: (blocks, N, fields, lanes). Lanes without a sample hold zeros."""
    num_gaussians, batch = inverse_spread.shape
    fields = [inverse_spread, signal.real, signal.imag, absorption.real, absorption.imag]
    num_blocks = -(-batch // LANES)
    padded = torch.nn.functional.pad(torch.stack(fields, 1), (0, num_blocks * LANES - batch))
    return padded.view(num_gaussians, FIELDS, num_blocks, LANES).permute(2, 0, 1, 3).contiguous()


class _Kernels(torch.autograd.Function):
    """Field (B, K) from rows as `_rows` gives them."""

    @staticmethod
    def forward(ctx: Any, start: Tensor, gaussian: Tensor, distance: Tensor, rows: Tensor, batch: int) -> Tensor:
        ctx.save_for_backward(start, gaussian, distance, rows)
        field = torch.empty(batch, len(start) - 1, dtype=torch.complex64)
        of_field = view_as_real(field)
        with numba_on_torch_threads() as num_threads:
            composite_kernels.forward(num_threads, *arrays_of(start, gaussian, distance, rows.flatten(2), of_field))
        return field

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_field: Tensor) -> tuple[Tensor | None, ...]:
        start, gaussian, distance, rows = ctx.saved_tensors
        grad_distance = torch.zeros_like(distance)
        incoming = view_as_real(grad_field.resolve_conj().contiguous())
        with numba_on_torch_threads() as num_threads:
            grad_rows = rows.new_zeros(num_threads, *rows.shape)  # each thread's own
            shared, longest = (start, gaussian, distance), int(start.diff().max())
            tensors = *shared, rows.flatten(2), incoming, grad_distance, grad_rows.flatten(3)
            composite_kernels.backward(longest, *arrays_of(*tensors))
        return None, None, grad_distance, grad_rows.sum(0), None


def arrays_of(*tensors: Tensor) -> list[Any]:
    """What kernels take of tensors."""
    return [tensor.detach().numpy() for tensor in tensors]


@contextmanager
def numba_on_torch_threads() -> Iterator[int]:
    """Let the kernels use as many threads as torch does, and leave torch's number as it was.

    Both may share one OpenMP, whose number of threads Numba sets when it runs for the first time.
    """
    number = torch.get_num_threads()
    before = composite_kernels.use_threads(number)
    torch.set_num_threads(number)
    try:
        yield number
    finally:
        composite_kernels.use_threads(before)
