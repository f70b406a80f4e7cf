"""Accumulation of Gaussians (Eq. 11) over very long lists, at extreme attenuations and distances."""

from __future__ import annotations

import math
from functools import cache
from typing import Literal, get_args

import torch
from torch import Tensor

from xfreqbench.bench.stress.case import Area, needing_two_threads
from xfreqbench.methods.splatting.composite import Backend, PixelLists, composite
from xfreqbench.methods.splatting.composite_kernels import use_threads

COMPOSITE = Area("composite")
Attenuations = Literal["clear", "opaque", "denormal", "turning", "reversing", "any"]
Leaves = tuple[Tensor, Tensor, Tensor, Tensor]  # distance, inverse spread, signal, attenuation
_NUM_FACTORS = 10_000
# kind of the attenuations of a list, and whether G = 1, so that products round by their attenuations alone
_LISTS: tuple[tuple[Attenuations, bool], ...] = (
    *((kind, True) for kind in get_args(Attenuations)),
    ("turning", False),
    ("any", False),
)
_IN_WORDS: dict[Attenuations, str] = {
    "clear": "of exactly 1",
    "opaque": "of 0",
    "denormal": "of 1e-42 and 1e-310",
    "turning": "of modulus 1, any phase",
    "reversing": "of −1",
    "any": "of any modulus and phase",
}
_BATCH = 2
_DENORMAL = [1e-42, 1e-310]  # of float32, of float64
_SINGLE = 1e-6  # some roundings of float32, 6e-8
# each factor may add a rounding: 6e-8 in float32, the precision of numba, and 1.1e-16 in float64
_LONG_LIMITS: dict[Backend, float] = {"torch": _NUM_FACTORS * 1.1e-16, "numba": _NUM_FACTORS * 6e-8}


def _of_both_backends(name: str) -> dict[str, tuple[Backend]]:
    """Arguments of two cases with that name, one for each backend."""
    return {f"{name}, {backend}": (backend,) for backend in _LONG_LIMITS}


def _attenuation(kind: Attenuations, generator: torch.Generator) -> Tensor:
    """Attenuations of one list in double precision, (L, B)."""
    shape = _NUM_FACTORS, _BATCH
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
    """Attributes of the Gaussians of all `_LISTS`, one list after the other, in double precision."""
    generator = torch.Generator().manual_seed(0)
    number = len(_LISTS) * _NUM_FACTORS
    is_full = torch.tensor([is_full for _, is_full in _LISTS]).repeat_interleave(_NUM_FACTORS)
    distance = 9 * torch.rand(number, generator=generator, dtype=torch.float64) * ~is_full
    spread = 0.5 + torch.rand(number, _BATCH, generator=generator, dtype=torch.float64)
    signal = torch.randn(number, _BATCH, generator=generator, dtype=torch.complex128)
    return distance, spread, signal, torch.cat([_attenuation(kind, generator) for kind, _ in _LISTS])


def _lists(number: int = 1) -> PixelLists:
    """Pixel lists of `number` pixels, which see as many Gaussians each as there are factors."""
    return PixelLists(
        torch.arange(number + 1) * _NUM_FACTORS, torch.arange(number * _NUM_FACTORS), number * _NUM_FACTORS
    )


def _with_gradients(field: Tensor, leaves: Leaves) -> tuple[Tensor, ...]:
    """The field, and the gradients of Re(1 − 2j) ΣR by the leaves."""
    loss = (field * complex(1, -2)).real.sum()
    return field.detach(), *torch.autograd.grad(loss, leaves)


@cache
def _literal() -> tuple[Tensor, ...]:
    """R = Σ_i G_i S_i Π_{m<i} (1 − G_m (1 − δ_m)) factor by factor, (lists, B), and its gradients by autograd."""
    leaves = _tracked(_leaves(), torch.float64)
    distance, spread, signal, attenuation = leaves
    footprint = torch.exp(-0.5 * distance[:, None] * spread)
    of_lists = len(_LISTS), _NUM_FACTORS, _BATCH
    emitted = (footprint * signal).view(of_lists).unbind(1)
    factor = (1 - footprint * (1 - attenuation)).view(of_lists).unbind(1)
    field, product = torch.zeros_like(emitted[0]), torch.ones_like(emitted[0])
    for own, attenuated in zip(emitted, factor, strict=True):
        field = field + own * product
        product = product * attenuated
    return _with_gradients(field, leaves)


@cache
def _composited(backend: Backend) -> tuple[Tensor, ...]:
    """The same from `composite`; torch computes in float64, numba in float32."""
    leaves = _tracked(_leaves(), torch.float32 if backend == "numba" else torch.float64)
    return _with_gradients(composite(_lists(len(_LISTS)), *leaves, backend).T, leaves)


def _tracked(leaves: Leaves, kind: torch.dtype) -> Leaves:
    """Copies of the leaves in a precision, which require gradients."""
    distance, spread, signal, attenuation = (
        leaf.to(kind.to_complex() if leaf.is_complex() else kind).clone().requires_grad_() for leaf in leaves
    )
    return distance, spread, signal, attenuation


def _long_product(which: int, backend: Backend) -> float:
    """Largest error of the field and of each gradient of one of `_LISTS`, relative to the largest value of each."""
    errors = []
    for found, expected in zip(_composited(backend), _literal(), strict=True):
        one, other = (values.reshape(len(_LISTS), -1)[which] for values in (found, expected))
        errors.append(float((one - other).abs().max() / other.abs().max().clamp_min(1e-300)))
    return max(errors)


for _which, (_kind, _is_full) in enumerate(_LISTS):
    for _backend, _limit in _LONG_LIMITS.items():
        _name = f"{_NUM_FACTORS:,} attenuations {_IN_WORDS[_kind]}, {'G = 1' if _is_full else 'G < 1'}, {_backend}"
        COMPOSITE.case(_name, _which, _backend, limit=_limit, unit="relative")(_long_product)


@COMPOSITE.each(
    _of_both_backends(f"{_NUM_FACTORS:,} attenuations of a half: underflow"), limit=_SINGLE, unit="relative"
)
def _underflow(backend: Backend) -> float:
    """R = S (2 − 2^(1−L)) where each of L Gaussians transmits a half: in front of the last one T is 2^−10000."""
    kind = torch.float32 if backend == "numba" else torch.float64
    ones = torch.ones(_NUM_FACTORS, _BATCH, dtype=kind)
    signal, half = ones.to(kind.to_complex()), (ones / 2).to(kind.to_complex())
    leaves = _tracked((torch.zeros(_NUM_FACTORS, dtype=kind), ones, signal, half), kind)
    field, *gradients = _with_gradients(composite(_lists(), *leaves, backend)[:, 0], leaves)
    # the gradient of δ_m is T_m · V = 2^−m · 2
    expected = 2 * 0.5 ** torch.arange(_NUM_FACTORS, dtype=torch.float64)[:, None]
    slope = gradients[3].real.double()
    seen_behind = torch.ones(_NUM_FACTORS, 1, dtype=torch.float64)
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


# the kernels keep G at 2^−124 or more, and the gradient of 1/λ is a distance of 1e12 times that
@COMPOSITE.each(_of_both_backends("footprints 1e12 deviations² away"), limit=1e-25, unit="absolute")
def _far_outside(backend: Backend) -> float:
    """Field and gradients far outside a footprint, where G underflows; the signals are 1."""
    kind = torch.float32 if backend == "numba" else torch.float64
    ones = torch.ones(3, 1, dtype=kind)
    signal, clear = ones.to(kind.to_complex()), (0 * ones).to(kind.to_complex())
    leaves = _tracked((torch.tensor([1e3, 1e6, 1e12], dtype=kind), ones, signal, clear), kind)
    values = _with_gradients(
        composite(PixelLists(torch.tensor([0, 3]), torch.arange(3), 3), *leaves, backend)[:, 0], leaves
    )
    return max(float(value.abs().max()) for value in values)


@COMPOSITE.each(_of_both_backends("directions without a Gaussian"), limit=0, unit="absolute")
def _no_gaussians(backend: Backend) -> float:
    """Field and gradients of directions that see no Gaussian."""
    lists = PixelLists(torch.zeros(6, dtype=torch.int64), torch.zeros(0, dtype=torch.int64), 2)
    signal = torch.ones(2, 3, dtype=torch.complex64)
    leaves = _tracked((torch.zeros(0), torch.ones(2, 3), signal, signal), torch.float32)
    field, *gradients = _with_gradients(composite(lists, *leaves, backend), leaves)
    assert field.shape == (3, 5), f"field of shape {tuple(field.shape)}"
    return float(field.abs().max()) + sum(float(gradient.abs().sum()) for gradient in gradients)


@COMPOSITE.case("one thread and two", limit=_SINGLE, unit="relative")
@needing_two_threads
def _threads() -> float:
    """Difference between the fields of one thread and of two, relative to the largest value."""
    leaves, number = _tracked(_leaves(), torch.float32), len(_LISTS) * _NUM_FACTORS
    lists = PixelLists(torch.arange(0, number + 1, 100), torch.arange(number), number)
    one, two = (_composited_on(threads, lists, leaves) for threads in (1, 2))
    return float((one - two).abs().max() / one.abs().max())


def _composited_on(threads: int, lists: PixelLists, leaves: Leaves) -> Tensor:
    """The field that the kernels compute on so many threads."""
    before, numba_before = torch.get_num_threads(), use_threads(threads)
    torch.set_num_threads(threads)
    try:
        return composite(lists, *leaves, "numba").detach()
    finally:
        torch.set_num_threads(before)
        use_threads(numba_before)
