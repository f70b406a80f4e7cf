"""Training at extremes: targets, losses, networks and fits, encodings of carriers, and seeds."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import Concatenate, ParamSpec

import numpy as np
import torch
from torch import Tensor

from xfreqbench.bench.stress.case import Area
from xfreqbench.bench.stress.channels import CARRIERS_GHZ, data_of
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import plan_generation
from xfreqbench.errors import DivergenceError
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning.aperture import ApertureField
from xfreqbench.methods.learning.encoding import Scaling, positional_encoding
from xfreqbench.methods.learning.loss import map_loss, mean_ssim
from xfreqbench.methods.learning.low_rank import LowRankConfig
from xfreqbench.methods.learning.network import PairwiseMLP, WideFreqNetwork
from xfreqbench.methods.learning.targets import Beams, GridView, Targets, as_kind
from xfreqbench.methods.registry import build_method
from xfreqbench.methods.splatting.field import SplatConfig, SplatField
from xfreqbench.scene.array import planar_array
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION, TraceSettings
from xfreqbench.types import Maps, NDArray
from xfreqbench.units import ghz_to_hz

Arguments = ParamSpec("Arguments")
TRAINING = Area("training")
TINY_FIT = ("width=8", "layers=2", "batch_size=4", "num_gaussians=20", "precision=float32")
_TINY = LowRankConfig(width=8, layers=2, precision="float32")
_PAIRWISE = SplatConfig(network="pairwise", start="random", direct_wave=False, band=False, angular_size_deg=6.0)
_LOSS_KINDS: tuple[PasKind, ...] = ("power", "amplitude")
_SINGLE = 5e-6  # as of maps: sums of 136 pairs of elements in float32, of a peak of 1
_CPU = torch.device("cpu")
_GRID = AngularGrid.hemisphere()
_ELEMENTS = planar_array(4, 4, 0.5)
ENCODING = Area("encoding")
_BANDS_HZ = {  # lowest and highest carrier of the training band, carriers to be scaled
    "carriers within the training band": (1e9, 94e9, [1e9, 94e9, 24.25e9]),
    "carriers outside the training band": (1e9, 94e9, [0.5e9, 300e9]),
    "band of one carrier": (1e9, 1e9, [1e9, 2e9]),
    "band of 100 kHz at 24.25 GHz": (24.25e9, 24.25e9 + 1e5, [24.25e9, 24.25e9 + 1e5]),
}


# float64 keeps 4e-15 of a logarithm of 24, and 1 Hz is 4e-11 of it
SEEDS = Area("seeds")


def on_random_channels(
    error_function: Callable[Concatenate[PasDataset, Arguments], float],
) -> Callable[Arguments, float]:
    """Decorator: hand a data set over as the first argument, which holds twelve random channels at two carriers."""

    @wraps(error_function)
    def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> float:
        rng = np.random.default_rng(0)
        tx_m = rng.uniform((0.5, 0.5, 0.5), (4.0, 4.0, 1.5), size=(6, 3))
        cfr = rng.normal(size=(6, 2, 16)) + 1j * rng.normal(size=(6, 2, 16))
        with tempfile.TemporaryDirectory() as folder:
            train = data_of(Path(folder) / "train.h5", tx_m, [1e9, 10e9], (1e-4 * cfr).astype(np.complex128))
            return error_function(train, *args, **kwargs)

    return run


@TRAINING.case("targets from stored channels at all directions", limit=_SINGLE, unit="absolute")
@on_random_channels
def _targets(train: PasDataset) -> float:
    """Error of training targets derived from complex64 channels, against double precision; the peak is 1."""
    beams = Beams(BartlettBeam(_ELEMENTS, _GRID), _CPU)
    rows = torch.arange(4)
    found = Targets(train, beams).maps(rows, GridView()).double().numpy()
    power = _power(train.cfr[:4].astype(np.complex128))
    return float(np.abs(found - power / power.max(axis=(1, 2), keepdims=True)).max())


def _power(cfr: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Power |Σ_n h_n exp(−j2π r_n·d)|²/M² of channels (B, M) by its definition, (B, E, A)."""
    phase = 2 * np.pi * np.einsum("eac,mc->eam", _GRID.directions, _ELEMENTS)
    return np.asarray(np.abs(np.einsum("eam,bm->bea", np.exp(-1j * phase), cfr)) ** 2 / len(_ELEMENTS) ** 2)


@TRAINING.each(
    {
        "beams by lags against their definition": (1.0,),
        "beams of channels of 1e-12": (1e-12,),
        "beams of channels of 1e12": (1e12,),
    },
    limit=_SINGLE,
    unit="absolute",
)
def _beams(amplitude: float) -> float:
    """Error of power by lags of the array in float32, relative to the peak, for channels of any amplitude."""
    rng = np.random.default_rng(0)
    cfr = (rng.normal(size=(4, 16)) + 1j * rng.normal(size=(4, 16))).astype(np.complex64)
    scaled = torch.as_tensor(cfr * np.float32(amplitude))
    found = as_kind(Beams(BartlettBeam(_ELEMENTS, _GRID), _CPU).power(scaled, GridView()), "power")
    power = _power(cfr.astype(np.complex128))
    return float(np.abs(found.double().numpy() - power / power.max(axis=(1, 2), keepdims=True)).max())


@TRAINING.case("a view of a map against beams in view", limit=_SINGLE, unit="absolute")
def _views() -> float:
    """Difference between a view of a map and the beams towards the directions in that view."""
    every = Beams(BartlettBeam(_ELEMENTS, _GRID), _CPU)
    view = GridView(7, 3, 5)
    cfr = torch.randn(2, 16, generator=torch.Generator().manual_seed(0), dtype=torch.complex64)
    return float((view.of_maps(every.power(cfr, GridView())) - every.power(cfr, view)).abs().max())


@TRAINING.each(
    {f"loss of a zero {kind} map, SSIM {weight:.0%}": (kind, weight) for kind in _LOSS_KINDS for weight in (0.0, 0.8)},
    limit=0,
    unit="values",
)
def _zero_map(kind: PasKind, ssim_weight: float) -> float:
    """Number of values of loss and gradient that are not finite where the predicted map is zero everywhere."""
    truth = torch.rand(2, 20, 30, generator=torch.Generator().manual_seed(0))
    power = torch.zeros(2, 20, 30, requires_grad=True)
    loss = map_loss(as_kind(power, kind), truth, ssim_weight, 7)
    (gradient,) = torch.autograd.grad(loss, power)
    return float((~torch.isfinite(gradient)).sum() + (~torch.isfinite(loss)).sum())


# the gradient of SSIM adds 49 windows, each some roundings of 6e-8 off
@TRAINING.each(
    {f"loss of {kind} maps of 1e-25, gradient rescaled": (kind,) for kind in _LOSS_KINDS}, limit=1e-4, unit="relative"
)
def _faint_map(kind: PasKind) -> float:
    """Difference between the gradients at a power of 1e-25 and at the same power scaled to 1, rescaled alike."""
    unit = 0.1 + torch.rand(1, 20, 30, generator=torch.Generator().manual_seed(0))
    truth = torch.rand(1, 20, 30, generator=torch.Generator().manual_seed(1))
    gradients = []
    for scale in (1.0, 1e-25):
        power = (unit * scale).requires_grad_()
        loss = map_loss(as_kind(power, kind), truth, 0.5, 7)
        gradients.append(torch.autograd.grad(loss, power)[0].double() * scale)
    return float((gradients[0] - gradients[1]).abs().max() / gradients[0].abs().max())


@TRAINING.each(
    {f"gradients of fields without and with a faint response, {kind}": (kind,) for kind in _LOSS_KINDS},
    limit=0,
    unit="values",
)
@on_random_channels
def _faint_field(train: PasDataset, kind: PasKind) -> float:
    """Number of gradients by the parameters of fields with a faint response whose squares, for Adam, are not finite."""
    truth = torch.rand(2, 18, 72, generator=torch.Generator().manual_seed(0))
    faults = 0
    for response in (1e-12, 1e-17, 1e-22, 0.0):
        field = SplatField(replace(_PAIRWISE, num_gaussians=50), replace(_TINY, latent=0))
        field.adapt(train, torch.Generator().manual_seed(0))
        assert isinstance(field.network, WideFreqNetwork)
        head = field.network.mlp.head
        with torch.no_grad():  # outputs 2 and 3 are the signal's real and imaginary part
            head.weight[2:4] *= response
            head.bias[2:4] *= response
        map_loss(as_kind(_field_power(field), kind), truth, 0.5, 7).backward()
        gradients = [parameter.grad for parameter in field.parameters() if parameter.grad is not None]
        faults += sum(int((~torch.isfinite(gradient.square())).sum()) for gradient in gradients)
    return float(faults)


# variances are differences of means of squares: 6e-8 over C₂ = 9e-4; population covariances would be 1e-3 off
@TRAINING.case("SSIM loss equals SSIM score", limit=1e-4, unit="absolute")
def _ssim_loss() -> float:
    """Difference between the SSIM of the loss and that of the score, map by map, for maps of many kinds.

    Faint structure has variances about as large as SSIM's constant; there a sample covariance and a population
    covariance differ most.
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
    return max(float(np.abs(_ssim_of_loss(x, y) - ssim(x, y, _GRID)).max()) for x, y in pairs)


def _ssim_of_loss(x: Maps, y: Maps) -> NDArray[np.float64]:
    maps = zip(torch.as_tensor(x.copy()), torch.as_tensor(y.copy()), strict=True)
    return np.array([float(mean_ssim(one[None], other[None])) for one, other in maps])


@TRAINING.case("gradient of the SSIM of flat maps", limit=0, unit="values")
def _flat_ssim_gradient() -> float:
    """Number of gradients of the SSIM of constant maps that are not finite."""
    faults = 0
    for value in (0.0, 0.5, 1.0):
        flat = torch.full((1, 20, 30), value, requires_grad=True)
        mean_ssim(flat, torch.full((1, 20, 30), 0.5)).backward()
        assert flat.grad is not None
        faults += int((~torch.isfinite(flat.grad)).sum())
    return float(faults)


@TRAINING.case("a fit stops before a nan is stepped on", limit=0, unit="values")
@on_random_channels
def _divergence(train: PasDataset) -> float:
    """Number of parameters that a fit changes after one was set to nan; it has to raise `DivergenceError` before."""
    method = build_method("xfreq-gs", TINY_FIT)
    fit = method.fit(train, Budget(), 0)
    next(fit)
    field = method._training.field
    before = [parameter.detach().clone() for parameter in field.parameters()]
    with torch.no_grad():
        field.network.head.bias[0] = torch.nan
    try:
        next(fit)
    except DivergenceError:
        pairs = zip(field.parameters(), before, strict=True)
        return float(sum(int((one != other).sum()) for one, other in pairs) - 1)  # the one that was spoilt
    return 1.0


# 8 bits, rounded in each of five layers: 5 · 2^−9 and as much for what is cancelled in the sums
@TRAINING.case("network in bfloat16", limit=2e-2, unit="relative")
def _bfloat16() -> float:
    """Difference between the outputs of the network in bfloat16 and in float32, relative to the largest."""
    outputs = []
    for precision in ("bfloat16", "float32"):
        generator = torch.Generator().manual_seed(0)
        with torch.random.fork_rng(devices=[]), torch.no_grad():
            torch.manual_seed(0)
            network = PairwiseMLP(5, 7, 4, [64] * 4, 9, precision)
            inputs = [torch.randn(shape, generator=generator) for shape in ((8, 5), (30, 7), (8, 30, 4))]
            outputs.append(network(*inputs))
    return float((outputs[0] - outputs[1]).abs().max() / outputs[1].abs().max())


@TRAINING.case("field whose Gaussians are all behind the horizon", limit=0, unit="absolute")
@on_random_channels
def _behind_the_horizon(train: PasDataset) -> float:
    """Sum of power and gradients of a field of which no direction sees any Gaussian."""
    field = SplatField(replace(_PAIRWISE, num_gaussians=5), _TINY)
    field.adapt(train, torch.Generator().manual_seed(0))
    with torch.no_grad():
        field.gaussians.position_m.copy_(torch.tensor([0.1, 0.1, -3.0]).expand(5, 3))
    power = _field_power(field)
    as_kind(power, "power").sum().backward()
    gradients = [parameter.grad for parameter in field.parameters() if parameter.grad is not None]
    return float(power.detach().abs().max()) + sum(float(gradient.abs().sum()) for gradient in gradients)


@TRAINING.case("fields with a Gaussian at the receiver", limit=0, unit="values")
@on_random_channels
def _gaussian_at_the_receiver(train: PasDataset) -> float:
    """Number of powers and gradients that are not finite where a Gaussian stands at the array's centre."""
    faults = 0
    for field in (SplatField(replace(_PAIRWISE, num_gaussians=4), _TINY), ApertureField(4, 2, _TINY)):
        field.adapt(train, torch.Generator().manual_seed(0))
        position_m = field.gaussians.position_m if isinstance(field, SplatField) else field.position_m
        with torch.no_grad():
            position_m[0] = 0
        power = _field_power(field)
        power.sum().backward()
        gradients = [parameter.grad for parameter in field.parameters() if parameter.grad is not None]
        faults += sum(int((~torch.isfinite(values)).sum()) for values in (power, *gradients))
    return float(faults)


@TRAINING.case("power at 1 MHz and 1 THz, trained on 1 to 10 GHz", limit=0, unit="values")
@on_random_channels
def _unseen_carriers(train: PasDataset) -> float:
    """Number of powers that are not finite at carriers far outside the training band."""
    field = SplatField(replace(_PAIRWISE, num_gaussians=50), _TINY)
    field.adapt(train, torch.Generator().manual_seed(0))
    with torch.no_grad():
        return float((~torch.isfinite(_field_power(field, (1e6, 1e12)))).sum())


def _field_power(field: SplatField | ApertureField, carrier_hz: tuple[float, float] = (1e9, 94e9)) -> Tensor:
    """Power of a field for two transmitters, each at one of the carriers, on every fifth row and column."""
    tx_m, carrier = (torch.tensor([[1.0, 2.0, 1.5], [6.0, 4.0, 1.0]]), torch.tensor(carrier_hz, dtype=torch.float64))
    return field.power(tx_m, carrier, GridView(5), Beams(BartlettBeam(_ELEMENTS, _GRID), _CPU))


@ENCODING.case(
    "band of 1 Hz at 24.25 GHz", *(24.25e9, 24.25e9 + 1, [24.25e9, 24.25e9 + 1]), limit=3e-4, unit="absolute"
)
@ENCODING.each(_BANDS_HZ, limit=1e-6, unit="absolute")  # some roundings of 6e-8
def _unit_carriers(low_hz: float, high_hz: float, carrier_hz: list[float]) -> float:
    """Error of carriers on the logarithmic axis of a training band, against ratios of logarithms.

    Carriers beyond the band are taken for its edge; that of a band of one carrier is 0.
    """
    scaling = Scaling()
    scaling.log_band.copy_(torch.tensor([low_hz, high_hz], dtype=torch.float64).log())
    found = scaling.unit_carrier(torch.tensor(carrier_hz, dtype=torch.float64))[:, 0]
    width, inside = math.log1p((high_hz - low_hz) / low_hz), np.clip(carrier_hz, low_hz, high_hz)
    expected = [2 * math.log1p((carrier - low_hz) / low_hz) / width - 1 if width else 0.0 for carrier in inside]
    return float((found - torch.tensor(expected)).abs().max())


# the finest octave reaches 2⁹π rad, where float32 is 6e-8 of 1608 off
@ENCODING.case("positions in ten octaves", limit=2e-4, unit="absolute")
def _finest_octave() -> float:
    """Error of ten octaves of positions in [−1, 1] in float32, against double precision."""
    x = torch.linspace(-1, 1, 501)[:, None]
    found = positional_encoding(x, 10).double().numpy()
    angle = x.double().numpy() * math.pi * 2.0 ** np.arange(10)
    return float(np.abs(found - np.concatenate([x, np.sin(angle), np.cos(angle)], axis=-1)).max())


def _refit(train: PasDataset, seeds: tuple[int, int]) -> float:
    """Largest difference between the maps of two fits of three steps, which have these seeds."""
    maps, num_threads = [], torch.get_num_threads()
    torch.set_num_threads(1)  # so that sums have the same order in both fits
    try:
        for seed in seeds:
            method = build_method("xfreq-gs", TINY_FIT)
            for _, _ in zip(range(3), method.fit(train, Budget(), seed), strict=False):
                continue
            maps.append(method.predict(train.tx_position_m[:4], train.carrier_hz[:4]))
    finally:
        torch.set_num_threads(num_threads)
    return float(np.abs(maps[0] - maps[1]).max())


@SEEDS.case("two fits with one seed", limit=0, unit="absolute")
@on_random_channels
def _equal_fits(train: PasDataset) -> float:
    return _refit(train, (1, 1))


@SEEDS.case("two fits with two seeds differ", limit=0, unit="fits")
@on_random_channels
def _unequal_fits(train: PasDataset) -> float:
    """1 where another seed gives the same maps, else 0."""
    return float(_refit(train, (1, 2)) == 0)


@SEEDS.case("two data sets with one seed", limit=0, unit="bytes")
def _same_seed() -> float:
    """Number of bytes that differ between two files."""
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        first, second = _generated(1, one), _generated(1, other)
    assert len(first) == len(second), f"files of {len(first)} and {len(second)} bytes"
    return float((np.frombuffer(first, np.uint8) != np.frombuffer(second, np.uint8)).sum())


def _generated(seed: int, folder: str) -> bytes:
    """The file of a data set of three transmitters in free space."""
    settings = TraceSettings(interactions=WITHOUT_DIFFRACTION, solver="image", rays=1000, seed=seed)
    carriers = [ghz_to_hz(ghz) for ghz in (CARRIERS_GHZ[0], CARRIERS_GHZ[-1])]
    plan = plan_generation(load_scene("empty"), carriers, settings, num_transmitters=3, maps=False)
    return generate_planned(plan, Path(folder) / "data.h5").read_bytes()


@SEEDS.case("two data sets with two seeds differ", limit=0, unit="data sets")
def _other_seed() -> float:
    """1 where another seed chooses the same transmitters, else 0."""
    scene = load_scene("empty")
    chosen = [
        plan_generation(
            scene, [1e9], TraceSettings(interactions=WITHOUT_DIFFRACTION, solver="image", seed=seed), num_transmitters=3
        ).tx_position_m
        for seed in (1, 2)
    ]
    return float(np.array_equal(chosen[0], chosen[1]))
