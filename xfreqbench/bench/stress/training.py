"""Training at extremes: beams, losses, networks and fields."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from xfreqbench.bench.stress.case import Area
from xfreqbench.bench.stress.channels import RECEIVER
from xfreqbench.bench.stress.maps import beam, power_map
from xfreqbench.data.plane_waves import stored_channels
from xfreqbench.maps.bartlett import PasKind
from xfreqbench.methods.learning.aperture import ApertureField
from xfreqbench.methods.learning.loss import map_loss
from xfreqbench.methods.learning.low_rank import LowRankConfig
from xfreqbench.methods.learning.network import PairwiseMLP, WideFreqNetwork
from xfreqbench.methods.learning.targets import Beams, GridView, as_kind
from xfreqbench.methods.splatting.field import SplatConfig, SplatField

TRAINING = Area("training")
_TINY = LowRankConfig(width=8, layers=2, precision="float32")
_PAIRWISE = SplatConfig(network="pairwise", start="random", direct_wave=False, band=False, angular_size_deg=6.0)
_LOSS_KINDS: tuple[PasKind, ...] = ("power", "amplitude")
_SINGLE = 5e-6  # as of maps: sums of 136 pairs of elements in float32, of a peak of 1
_CPU = torch.device("cpu")
Field = TypeVar("Field", bound=SplatField | ApertureField)


@TRAINING.cases_of(
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
    found = as_kind(Beams(beam(), _CPU).power(scaled, GridView()), "power")
    return max(float(np.abs(m - power_map(row)).max()) for m, row in zip(found.double().numpy(), cfr, strict=True))


# the gradient of SSIM adds 49 windows, each some roundings of 6e-8 off
@TRAINING.cases_of(
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


@TRAINING.cases_of(
    {f"gradients of fields without and with a faint response, {kind}": (kind,) for kind in _LOSS_KINDS},
    limit=0,
    unit="values",
)
def _faint_field(kind: PasKind) -> float:
    """Number of gradients by the parameters of fields with a faint response whose squares, for Adam, are not finite."""
    truth = torch.rand(2, 18, 72, generator=torch.Generator().manual_seed(0))
    faults = 0
    for response in (1e-12, 1e-17, 1e-22, 0.0):
        field = _adapted(SplatField(replace(_PAIRWISE, num_gaussians=50), replace(_TINY, latent=0)))
        assert isinstance(field.network, WideFreqNetwork)
        head = field.network.mlp.head
        with torch.no_grad():  # outputs 2 and 3 are the signal's real and imaginary part
            head.weight[2:4] *= response
            head.bias[2:4] *= response
        map_loss(as_kind(_field_power(field), kind), truth, 0.5, 7).backward()
        faults += sum(int((~torch.isfinite(gradient.square())).sum()) for gradient in _gradients(field))
    return float(faults)


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
def _behind_the_horizon() -> float:
    """Sum of power and gradients of a field of which no direction sees any Gaussian."""
    field = _adapted(SplatField(replace(_PAIRWISE, num_gaussians=5), _TINY))
    with torch.no_grad():
        field.gaussians.position_m.copy_(torch.tensor([0.1, 0.1, -3.0]).expand(5, 3))
    power = _field_power(field)
    as_kind(power, "power").sum().backward()
    return float(power.detach().abs().max()) + sum(float(gradient.abs().sum()) for gradient in _gradients(field))


@TRAINING.case("fields with a Gaussian at the receiver", limit=0, unit="values")
def _gaussian_at_the_receiver() -> float:
    """Number of powers and gradients that are not finite where a Gaussian stands at the array's centre."""
    faults = 0
    for field in (SplatField(replace(_PAIRWISE, num_gaussians=4), _TINY), ApertureField(4, 2, _TINY)):
        _adapted(field)
        position_m = field.gaussians.position_m if isinstance(field, SplatField) else field.position_m
        with torch.no_grad():
            position_m[0] = 0
        power = _field_power(field)
        power.sum().backward()
        faults += sum(int((~torch.isfinite(values)).sum()) for values in (power, *_gradients(field)))
    return float(faults)


@TRAINING.case("power at 1 MHz and 1 THz, trained on 1 to 10 GHz", limit=0, unit="values")
def _unseen_carriers() -> float:
    """Number of powers that are not finite at carriers far outside the training band."""
    field = _adapted(SplatField(replace(_PAIRWISE, num_gaussians=50), _TINY))
    with torch.no_grad():
        return float((~torch.isfinite(_field_power(field, (1e6, 1e12)))).sum())


def _gradients(field: torch.nn.Module) -> list[Tensor]:
    return [parameter.grad for parameter in field.parameters() if parameter.grad is not None]


def _adapted(field: Field) -> Field:
    """The field itself, adapted to twelve random channels at two carriers."""
    rng = np.random.default_rng(0)
    tx_m = rng.uniform((0.5, 0.5, 0.5), (4.0, 4.0, 1.5), size=(6, 3))
    cfr = 1e-4 * (rng.normal(size=(6, 2, 16)) + 1j * rng.normal(size=(6, 2, 16)))
    with tempfile.TemporaryDirectory() as folder:
        path, carrier_hz = Path(folder) / "train.h5", np.array([1e9, 10e9])
        data = stored_channels(path, RECEIVER, carrier_hz, tx_m, cfr.astype(np.complex128), maps=False)
        field.adapt(data, torch.Generator().manual_seed(0))
    return field


def _field_power(field: SplatField | ApertureField, carrier_hz: tuple[float, float] = (1e9, 94e9)) -> Tensor:
    """Power of a field for two transmitters, each at one of the carriers, on every fifth row and column."""
    tx_m, carrier = (torch.tensor([[1.0, 2.0, 1.5], [6.0, 4.0, 1.0]]), torch.tensor(carrier_hz, dtype=torch.float64))
    return field.power(tx_m, carrier, GridView(5), Beams(beam(), _CPU))
