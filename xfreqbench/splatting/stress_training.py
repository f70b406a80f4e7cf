"""How far encodings, targets, losses and networks are from their definitions: errors that `stress` judges.

Each function returns one error; what it is relative to, and the largest allowed, stand in `stress`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xfreqbench.angles import AngularGrid
from xfreqbench.array import planar_array
from xfreqbench.dataset import PasDataset
from xfreqbench.errors import DivergenceError
from xfreqbench.method import Budget, Method, build_method
from xfreqbench.metrics import Maps, ssim
from xfreqbench.pas import BartlettBeam, PasKind
from xfreqbench.splatting.aperture import ApertureField
from xfreqbench.splatting.encoding import Scaling, positional_encoding
from xfreqbench.splatting.loss import map_loss, mean_ssim
from xfreqbench.splatting.network import NetworkConfig, PairwiseMLP
from xfreqbench.splatting.splat import SplatConfig, SplatField
from xfreqbench.splatting.view import Beams, Targets, View, as_kind

_CPU = torch.device("cpu")
_GRID = AngularGrid.hemisphere()
_ELEMENTS = planar_array(4, 4, 0.5)
_TINY = NetworkConfig(width=8, layers=2, precision="float32")


@contextmanager
def one_thread() -> Iterator[None]:
    """Sums in the same order at every run."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _power(cfr: NDArray[np.complex128]) -> NDArray[np.float64]:
    """|Σ_n h_n exp(−j2π r_n·d)|²/M² by its definition, (B, E, A)."""
    phase = 2 * np.pi * np.einsum("eac,mc->eam", _GRID.directions, _ELEMENTS)
    return np.asarray(np.abs(np.einsum("eam,bm->bea", np.exp(-1j * phase), cfr)) ** 2 / len(_ELEMENTS) ** 2)


def targets(train: PasDataset) -> float:
    """Training targets derived from complex64 channels, of a peak of 1, against double precision."""
    beams = Beams(BartlettBeam(_ELEMENTS, _GRID), _CPU)
    rows = torch.arange(4)
    found = Targets(train, beams).maps(rows, View()).double().numpy()
    power = _power(train.cfr[:4].astype(np.complex128))
    return float(np.abs(found - power / power.max(axis=(1, 2), keepdims=True)).max())


def beams(amplitude: float) -> float:
    """Power by lags of the array in float32, relative to the peak; maps of that power are of any scale."""
    rng = np.random.default_rng(0)
    cfr = (rng.normal(size=(4, 16)) + 1j * rng.normal(size=(4, 16))).astype(np.complex64)
    scaled = torch.as_tensor(cfr * np.float32(amplitude))
    found = as_kind(Beams(BartlettBeam(_ELEMENTS, _GRID), _CPU).power(scaled, View()), "power")
    power = _power(cfr.astype(np.complex128))
    return float(np.abs(found.double().numpy() - power / power.max(axis=(1, 2), keepdims=True)).max())


def views() -> float:
    """A view of a map against the beams of that view's directions."""
    every = Beams(BartlettBeam(_ELEMENTS, _GRID), _CPU)
    view = View(7, 3, 5)
    cfr = torch.randn(2, 16, generator=torch.Generator().manual_seed(0), dtype=torch.complex64)
    return float((view.of_maps(every.power(cfr, View())) - every.power(cfr, view)).abs().max())


def zero_map(kind: PasKind, ssim_weight: float) -> float:
    """Loss and gradient by a map's power of a map without any: how many are not finite."""
    truth = torch.rand(2, 20, 30, generator=torch.Generator().manual_seed(0))
    power = torch.zeros(2, 20, 30, requires_grad=True)
    loss = map_loss(as_kind(power, kind), truth, ssim_weight, 7)
    (gradient,) = torch.autograd.grad(loss, power)
    return float((~torch.isfinite(gradient)).sum() + (~torch.isfinite(loss)).sum())


def faint_map(kind: PasKind) -> float:
    """Map and gradients of a power of 1e-25 against those of the same power at 1, which is as many times smaller."""
    unit = 0.1 + torch.rand(1, 20, 30, generator=torch.Generator().manual_seed(0))
    truth = torch.rand(1, 20, 30, generator=torch.Generator().manual_seed(1))
    gradients = []
    for scale in (1.0, 1e-25):
        power = (unit * scale).requires_grad_()
        loss = map_loss(as_kind(power, kind), truth, 0.5, 7)
        gradients.append(torch.autograd.grad(loss, power)[0].double() * scale)
    return float((gradients[0] - gradients[1]).abs().max() / gradients[0].abs().max())


def faint_field(train: PasDataset, kind: PasKind) -> float:
    """Gradients by the parameters of fields of faint response whose squares, which Adam takes, are not finite."""
    truth = torch.rand(2, 18, 72, generator=torch.Generator().manual_seed(0))
    faults = 0
    for response in (1e-12, 1e-17, 1e-22, 0.0):
        field = SplatField(SplatConfig(num_gaussians=50), replace(_TINY, latent=0))
        field.adapt(train, torch.Generator().manual_seed(0))
        head = field.network.mlp.head
        with torch.no_grad():  # outputs 2 and 3 are the signal's real and imaginary part
            head.weight[2:4] *= response
            head.bias[2:4] *= response
        map_loss(as_kind(_field_power(field), kind), truth, 0.5, 7).backward()
        gradients = [parameter.grad for parameter in field.parameters() if parameter.grad is not None]
        faults += sum(int((~torch.isfinite(gradient.square())).sum()) for gradient in gradients)
    return float(faults)


def ssim_loss() -> float:
    """The loss's SSIM against the score's, map by map: of random, correlated, flat, zero and nearly equal maps.

    Faint structure has variances about as large as SSIM's constant, beside which a covariance of the sample and
    one of the population lie furthest apart.
    """
    random = np.random.default_rng(0).random((4, *_GRID.shape), dtype=np.float32)
    flat = np.stack([np.full(_GRID.shape, value, np.float32) for value in (0, 1, 0.5, 1e-3)])
    mixed = np.float32(0.7) * random + np.float32(0.3) * random[::-1]
    pairs: list[tuple[Maps, Maps]] = [
        (random, flat),
        (flat, flat[::-1]),
        (random, random + np.float32(1e-4)),
        (random, mixed),
        (np.float32(0.1) * random, np.float32(0.1) * mixed),
    ]
    return max(float(np.abs(_losses_ssim(x, y) - ssim(x, y, _GRID)).max()) for x, y in pairs)


def _losses_ssim(x: Maps, y: Maps) -> NDArray[np.float64]:
    each = zip(torch.as_tensor(x.copy()), torch.as_tensor(y.copy()), strict=True)
    return np.array([float(mean_ssim(one[None], other[None])) for one, other in each])


def flat_ssim_gradient() -> float:
    """Gradients of the SSIM of flat maps that are not finite."""
    faults = 0
    for value in (0.0, 0.5, 1.0):
        flat = torch.full((1, 20, 30), value, requires_grad=True)
        mean_ssim(flat, torch.full((1, 20, 30), 0.5)).backward()
        assert flat.grad is not None
        faults += int((~torch.isfinite(flat.grad)).sum())
    return float(faults)


def divergence(train: PasDataset) -> float:
    """Steps a fit takes with a parameter that is nan: none, it raises `DivergenceError` first."""
    method = build_method("xfreq-gs", _TINY_FIT)
    fit = method.fit(train, Budget(), 0)
    next(fit)
    field = method._training.field  # type: ignore[attr-defined]
    before = [parameter.detach().clone() for parameter in field.parameters()]
    with torch.no_grad():
        field.network.mlp.head.bias[0] = torch.nan
    try:
        next(fit)
    except DivergenceError:
        pairs = zip(field.parameters(), before, strict=True)
        return float(sum(int((one != other).sum()) for one, other in pairs) - 1)  # the one that was spoilt
    return 1.0


def bfloat16() -> float:
    """The network's outputs in bfloat16 against float32, relative to their largest."""
    outputs = []
    for precision in ("bfloat16", "float32"):
        generator = torch.Generator().manual_seed(0)
        with torch.random.fork_rng(devices=[]), torch.no_grad():
            torch.manual_seed(0)
            network = PairwiseMLP(5, 7, 4, [64] * 4, 9, precision)
            inputs = [torch.randn(shape, generator=generator) for shape in ((8, 5), (30, 7), (8, 30, 4))]
            outputs.append(network(*inputs))
    return float((outputs[0] - outputs[1]).abs().max() / outputs[1].abs().max())


def behind_the_horizon(train: PasDataset) -> float:
    """Power, gradients and maps of a field whose Gaussians are all unseen."""
    field = SplatField(SplatConfig(num_gaussians=5), _TINY)
    field.adapt(train, torch.Generator().manual_seed(0))
    with torch.no_grad():
        field.gaussians.position_m.copy_(torch.tensor([0.1, 0.1, -3.0]).expand(5, 3))
    power = _field_power(field)
    as_kind(power, "power").sum().backward()
    gradients = [parameter.grad for parameter in field.parameters() if parameter.grad is not None]
    return float(power.detach().abs().max()) + sum(float(gradient.abs().sum()) for gradient in gradients)


def gaussian_at_the_receiver(train: PasDataset) -> float:
    """Powers and gradients of fields with a Gaussian at the array's centre that are not finite."""
    faults = 0
    for field in (SplatField(SplatConfig(num_gaussians=4), _TINY), ApertureField(4, 2, _TINY)):
        field.adapt(train, torch.Generator().manual_seed(0))
        position_m = field.gaussians.position_m if isinstance(field, SplatField) else field.position_m
        with torch.no_grad():
            position_m[0] = 0
        power = _field_power(field)
        power.sum().backward()
        gradients = [parameter.grad for parameter in field.parameters() if parameter.grad is not None]
        faults += sum(int((~torch.isfinite(values)).sum()) for values in (power, *gradients))
    return float(faults)


def unseen_carriers(train: PasDataset) -> float:
    """Powers at carriers far outside the training band that are not finite."""
    field = SplatField(SplatConfig(num_gaussians=50), _TINY)
    field.adapt(train, torch.Generator().manual_seed(0))
    with torch.no_grad():
        return float((~torch.isfinite(_field_power(field, (1e6, 1e12)))).sum())


def _field_power(field: SplatField | ApertureField, carrier_hz: tuple[float, float] = (1e9, 94e9)) -> Tensor:
    tx_m, carrier = (
        torch.tensor([[1.0, 2.0, 1.5], [6.0, 4.0, 1.0]]),
        torch.tensor(carrier_hz, dtype=torch.float64),
    )
    return field.power(tx_m, carrier, View(5), Beams(BartlettBeam(_ELEMENTS, _GRID), _CPU))


_TINY_FIT = ("width=8", "layers=2", "batch_size=4", "num_gaussians=20", "precision=float32")


def refit(train: PasDataset, seeds: tuple[int, int]) -> float:
    """Largest difference of the maps of two fits of three steps."""
    maps = [_fitted(train, seed).predict(train.tx_position_m[:4], train.carrier_hz[:4]) for seed in seeds]
    return float(np.abs(maps[0] - maps[1]).max())


def _fitted(train: PasDataset, seed: int) -> Method:
    with one_thread():
        method = build_method("xfreq-gs", _TINY_FIT)
        for _, _ in zip(range(3), method.fit(train, Budget(), seed), strict=False):
            continue
    return method


def _scaling(low_hz: float, high_hz: float) -> Scaling:
    scaling = Scaling()
    scaling.log_band.copy_(torch.tensor([low_hz, high_hz], dtype=torch.float64).log())
    return scaling


def unit_carriers(low_hz: float, high_hz: float, carrier_hz: list[float]) -> float:
    """Carriers on the logarithmic axis of a training band, against log ratios; 0 throughout where it is one carrier."""
    found = _scaling(low_hz, high_hz).unit_carrier(torch.tensor(carrier_hz, dtype=torch.float64))[:, 0]
    if low_hz == high_hz:
        expected = [2 * math.log(carrier / low_hz) for carrier in carrier_hz]
    else:
        width = math.log1p((high_hz - low_hz) / low_hz)
        expected = [2 * math.log1p((carrier - low_hz) / low_hz) / width - 1 for carrier in carrier_hz]
    return float((found - torch.tensor(expected)).abs().max())


def finest_octave() -> float:
    """Ten octaves of positions in [−1, 1], in float32."""
    x = torch.linspace(-1, 1, 501)[:, None]
    found = positional_encoding(x, 10).double().numpy()
    angle = x.double().numpy() * math.pi * 2.0 ** np.arange(10)
    return float(np.abs(found - np.concatenate([x, np.sin(angle), np.cos(angle)], axis=-1)).max())
