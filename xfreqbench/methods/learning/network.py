"""The network that gives each Gaussian its attributes for a transmitter and a carrier (Eq. 7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, Literal

import torch
from jaxtyping import Complex, Float
from pydantic import Field as Limits
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn.functional import normalize, relu
from typing_extensions import Doc

from xfreqbench.methods.learning.encoding import (
    FeatureGrid,
    Scaling,
    encoded_size,
    positional_encoding,
    rated_with_grid,
)

Precision = Literal["auto", "float32", "bfloat16"]

_CLEAR = 2.0  # logit of |δ| at the start, 0.88, so that Gaussians behind are seen
_BEARING_WIDTHS = (0.005, 0.02, 0.1)  # of 1 − cos: about 6, 11 and 26 degrees
BEARING_SIZE = 1 + len(_BEARING_WIDTHS)


def bearing(query_m: Float[Tensor, "B 3"], position_m: Float[Tensor, "V 3"]) -> Float[Tensor, "B V 4"]:
    """Angle under which the receiver sees a transmitter and a Gaussian apart: its cosine, and three bumps of it.

    A bump is exp((cosine − 1) / width). Positions are relative to the receiver.
    """
    cosine = normalize(query_m, dim=-1) @ normalize(position_m, dim=-1).T
    bumps = [torch.exp((cosine - 1) / width) for width in _BEARING_WIDTHS]
    return torch.stack([cosine, *bumps], dim=-1)


class PairwiseMLP(nn.Module):
    """A ReLU network that is applied to all pairs of B queries and V Gaussians.

    Its first layer is factorised, W_q q_b + W_g g_i + W_p p_bi, so that the parts of a query and of a Gaussian are
    computed once. Layers on pairs compute in bfloat16 with float32 weights where `precision` says so; `auto` chooses
    bfloat16 on processors and devices that multiply it natively.
    """

    def __init__(
        self,
        query_size: int,
        gaussian_size: int,
        pair_size: int,
        hidden: Sequence[int],
        num_outputs: int,
        precision: Precision,
    ) -> None:
        super().__init__()
        self.of_query = nn.Linear(query_size, hidden[0])
        self.of_pair = nn.Linear(gaussian_size + pair_size, hidden[0], bias=False)
        self.hidden = nn.ModuleList([nn.Linear(*widths) for widths in pairwise(hidden)])
        self.head = nn.Linear(hidden[-1], num_outputs)
        self.precision = precision

    def forward(
        self, query: Float[Tensor, "B Q"], gaussian: Float[Tensor, "V G"], pair: Float[Tensor, "B V P"]
    ) -> Float[Tensor, "B V O"]:
        """Outputs for every pair, float32."""
        kind = self.kind_for(query)
        of_gaussian, of_pair = self.of_pair.weight.split([gaussian.shape[1], pair.shape[2]], dim=1)
        first = self.of_query(query).to(kind)[:, None] + (gaussian @ of_gaussian.T).to(kind)
        if pair.shape[2]:
            first = torch.addmm(first.flatten(0, 1), pair.to(kind).flatten(0, 1), of_pair.T.to(kind)).view_as(first)
        return self.after_first(first).to(query.dtype)

    def kind_for(self, query: Tensor) -> torch.dtype:
        """The kind in which layers on pairs compute."""
        return torch.bfloat16 if _is_narrow(self.precision, query.device) else query.dtype

    def after_first(self, first: Float[Tensor, "B V W"]) -> Float[Tensor, "B V O"]:
        """Outputs for pairs whose first layer is given, before its ReLU, which overwrites it."""
        parameters = [each for layer in (*self.hidden, self.head) for each in (layer.weight, layer.bias)]
        outputs: Tensor = _Layers.apply(first.flatten(0, 1), *parameters)  # type: ignore[no-untyped-call]
        return outputs.unflatten(0, first.shape[:2])


class _Layers(torch.autograd.Function):
    """Outputs (P, O) of pairs whose first layer is given (P, W), before its ReLU, by layers of weights and biases.

    All is in the kind of `first`, in one pass without the casts and copies of autocast; gradients are the weights'.
    `first` is overwritten: no one else needs it, and fresh memory costs more than the sum itself.
    """

    @staticmethod
    def forward(ctx: Any, first: Tensor, *parameters: Tensor) -> Tensor:
        ctx.parameters = [parameter.to(first.dtype) for parameter in parameters]
        ctx.kinds = [parameter.dtype for parameter in parameters]
        weights, biases = ctx.parameters[::2], ctx.parameters[1::2]
        ctx.features = [relu(first, inplace=True)]
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            ctx.features.append(_hidden(ctx.features[-1], weight, bias))
        return torch.addmm(biases[-1], ctx.features[-1], weights[-1].T)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor, ...]:
        gradients: list[Tensor] = []
        for weight, features in zip(reversed(ctx.parameters[::2]), reversed(ctx.features), strict=True):
            gradients[:0] = slope.T @ features, slope.sum(0)
            slope = slope @ weight
            torch.ops.aten.threshold_backward.grad_input(slope, features, 0, grad_input=slope)
        return slope, *(each.to(kind) for each, kind in zip(gradients, ctx.kinds, strict=True))


def _hidden(features: Float[Tensor, "P W"], weight: Float[Tensor, "V W"], bias: Float[Tensor, "V"]) -> Tensor:
    """ReLU of a layer (P, V). In bfloat16 on a CPU it is one pass; `addmm` copies the bias to all rows first."""
    if features.dtype == torch.bfloat16 and features.device.type == "cpu" and torch.backends.mkldnn.is_available():
        fused: Tensor = torch.ops.mkldnn._linear_pointwise(features, weight, bias, "relu", [], "")
        return fused
    return relu(torch.addmm(bias, features, weight.T), inplace=True)


def _is_narrow(precision: Precision, device: torch.device) -> bool:
    """Whether hidden layers compute in bfloat16 on a device."""
    if precision != "auto":
        return precision == "bfloat16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return bool(_cpu_capabilities().get("avx512_bf16"))


@cache
def _cpu_capabilities() -> dict[str, object]:
    """What this processor can do, by torch's names; empty where torch does not say."""
    known = getattr(torch.cpu, "get_capabilities", dict)
    return dict(known())


@dataclass(frozen=True)
class NetworkConfig:
    """Inputs and size of the network. The paper has width 256, 10 octaves and no bearing."""

    width: Annotated[int, Limits(ge=1), Doc("features of each hidden layer")] = 64
    layers: Annotated[int, Limits(ge=1), Doc("hidden layers")] = 4
    tx_octaves: Annotated[int, Limits(ge=0), Doc("octaves of sines of the transmitter's place")] = 6
    tx_levels: Annotated[int, Limits(ge=0, le=8), Doc("levels of learned features of places")] = 4
    position_octaves: Annotated[int, Limits(ge=0), Doc("octaves of sines of a Gaussian's place")] = 4
    carrier_octaves: Annotated[int, Limits(ge=0), Doc("octaves of sines of the carrier")] = 0
    sees_carrier: Annotated[bool, Doc("whether the carrier is an input")] = True
    bearing: Annotated[bool, Doc("of all pairs: whether the angle between transmitter and Gaussian is an input")] = True
    latent: Annotated[int, Limits(ge=0), Doc("numbers of a Gaussian's latent; 0: of its place alone")] = 4
    max_spread: Annotated[float, Limits(ge=1), Doc("largest spread of footprints by the carrier")] = 2.0
    precision: Annotated[Precision, Doc("of all pairs; auto: bfloat16 where the processor has it")] = "auto"


@dataclass(frozen=True, eq=False)
class Attributes:
    """Attributes of V Gaussians for B queries: Q signals that do not interfere, attenuation δ, and 1/λ.

    `direct` is the strength of the direct wave, None where the network leaves it at 1.
    """

    signal: Complex[Tensor, "Q V B"]
    attenuation: Complex[Tensor, "V B"]
    inverse_spread: Float[Tensor, "V B"]
    direct: Float[Tensor, "B"] | None = None


class WideFreqNetwork(nn.Module):
    """Network for attenuation δ = ΔA e^{jΔψ}, signal S = A e^{jψ}, latent z and spread λ of each Gaussian (Eq. 7).

    S is given by its real and imaginary part; there may be several signals that do not interfere. The latent adds
    a bilinear term for each carrier to signal and attenuation: Δ = z · W E(f). Carriers are encoded on a
    logarithmic axis in few octaves or none, because a fine encoding memorises the training carriers.
    """

    def __init__(self, config: NetworkConfig, scaling: Scaling, num_signals: int = 1) -> None:
        super().__init__()
        self.config, self.scaling = config, scaling
        self._num_modulated = 2 + 2 * num_signals
        carrier_size = encoded_size(1, config.carrier_octaves) * config.sees_carrier
        self.tx_features = FeatureGrid(config.tx_levels) if config.tx_levels else None
        num_features = self.tx_features.num_outputs if self.tx_features is not None else 0
        self.mlp = PairwiseMLP(
            encoded_size(3, config.tx_octaves) + carrier_size + num_features,
            encoded_size(3, config.position_octaves),
            BEARING_SIZE * config.bearing,
            [config.width] * config.layers,
            self._num_modulated + 1 + config.latent,
            config.precision,
        )
        self._latent_sees_carrier = bool(config.latent and carrier_size)
        if self._latent_sees_carrier:
            self.of_carrier = nn.Linear(carrier_size, self._num_modulated * config.latent)

    def forward(
        self, tx_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], position_m: Float[Tensor, "V 3"]
    ) -> Attributes:
        """Attributes of V Gaussians for B transmitters, positions in the receiver's frame in metres."""
        carrier = self._encoded_carrier(carrier_hz)
        unit_tx = self.scaling.unit_position(tx_m)
        query = positional_encoding(unit_tx, self.config.tx_octaves)
        if self.tx_features is not None:
            query = torch.cat([query, self.tx_features(unit_tx)], dim=-1)
        gaussian = positional_encoding(self.scaling.unit_position(position_m), self.config.position_octaves)
        pair = bearing(tx_m, position_m)[..., : BEARING_SIZE * self.config.bearing]
        outputs = self.mlp(torch.cat([query, carrier], dim=-1), gaussian, pair)
        modulated, spread, latent = outputs.split([self._num_modulated, 1, self.config.latent], dim=-1)
        if self._latent_sees_carrier:
            weights = self.of_carrier(carrier).reshape(len(carrier), self.config.latent, -1)
            modulated = modulated + latent @ weights
        return self._attributes(modulated, spread[..., 0].T)

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Parameters with their learning rates; features of places learn faster, because few transmitters use each."""
        return rated_with_grid(self, self.tx_features, learning_rate)

    def _encoded_carrier(self, carrier_hz: Float[Tensor, "B"]) -> Float[Tensor, "B C"]:
        """The encoding E(f); it has no columns where the network does not see the carrier."""
        if not self.config.sees_carrier:
            return self.scaling.log_band.new_zeros(len(carrier_hz), 0, dtype=torch.float32)
        return positional_encoding(self.scaling.unit_carrier(carrier_hz), self.config.carrier_octaves)

    def _attributes(self, modulated: Float[Tensor, "B V A"], spread: Float[Tensor, "V B"]) -> Attributes:
        """Attributes from the network's outputs: attenuation and signals, and the spread."""
        attenuation, phase = modulated[..., :2].permute(2, 1, 0)
        signal = torch.view_as_complex(modulated[..., 2:].unflatten(-1, (-1, 2)).contiguous())
        return Attributes(
            signal=signal.permute(2, 1, 0),
            attenuation=torch.polar(torch.sigmoid(attenuation + _CLEAR), phase),
            inverse_spread=self.config.max_spread ** torch.tanh(spread),
        )
