"""Wideband3DGS, reduced: Gaussians with an electromagnetic feature network, which sees carriers on a linear axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import torch
from jaxtyping import Float
from pydantic import Field as Limits
from torch import Tensor, nn
from torch.nn.functional import linear, pad, relu, softplus
from typing_extensions import Doc

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.learning.encoding import Scaling, encoded_size, positional_encoding
from xfreqbench.methods.learning.network import Attributes, PairwiseMLP, Precision
from xfreqbench.methods.learning.training import ChannelField, Count, LearnedMethod
from xfreqbench.methods.splatting.field import GaussianConfig, GaussianField, SplatTrainingConfig
from xfreqbench.methods.splatting.gaussians import RFGaussians, Seen

_HIGHEST_HZ = 94e9  # carrier that is scaled to 1 on a linear axis
_NEAREST_M = 0.1  # smallest distance to the receiver by which signals are divided
_OPACITY = 0.1  # of each Gaussian at the start


@dataclass(frozen=True)
class Wideband3DGSConfig(GaussianConfig, SplatTrainingConfig):
    """Options. The paper has 8 layers of 128 for the attenuation, 128 and 64 for the signal, and 10 octaves."""

    angular_size_deg: Annotated[float, Limits(gt=0, le=90), Doc("one deviation at the start")] = 6.0
    width: Annotated[int, Limits(ge=2), Doc("features of each hidden layer")] = 64
    layers: Annotated[Count, Doc("hidden layers")] = 4
    octaves: Annotated[int, Limits(ge=0), Doc("octaves of sines of places")] = 4
    carrier_octaves: Annotated[int, Limits(ge=0), Doc("octaves of sines of the carrier")] = 10
    precision: Annotated[Precision, Doc("auto: bfloat16 where the processor has it")] = "auto"
    batch_size: Count = 48


class FeatureNetwork(nn.Module):
    """Attenuation δ from place and carrier alone; signal S from their features, the transmitter and the view."""

    def __init__(self, config: Wideband3DGSConfig, scaling: Scaling) -> None:
        super().__init__()
        self.config, self.scaling = config, scaling
        place, carrier = encoded_size(3, config.octaves), encoded_size(1, config.carrier_octaves)
        self.gate = nn.Linear(carrier, place)
        sizes = [place, *[config.width] * config.layers]
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(sizes))
        self.skip = nn.Linear(place, config.width, bias=False)  # to the layer in the middle
        self.attenuation = nn.Linear(config.width, 2)
        hidden = [config.width, config.width // 2]
        self.radiance = PairwiseMLP(place + carrier, 0, place + config.width, hidden, 2, config.precision)

    def forward(
        self, tx_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], position_m: Float[Tensor, "V 3"]
    ) -> tuple[Float[Tensor, "V B 2"], Float[Tensor, "V B 2"]]:
        """Attenuation and signal, each as amplitude and phase without bounds; positions in the receiver's frame.

        What a carrier alone changes is computed once for rows with equal carriers.
        """
        distinct_hz, of_row = carrier_hz.unique(return_inverse=True)
        carrier = positional_encoding((distinct_hz / _HIGHEST_HZ)[:, None].float(), self.config.carrier_octaves)
        unit_tx, place = self.scaling.unit_position(tx_m), self.scaling.unit_position(position_m)
        feature, size = self.features(carrier, place), self.config.width
        query = positional_encoding(unit_tx, self.config.octaves), carrier.index_select(0, of_row)
        of_feature, of_view = self.radiance.of_pair.weight.split([size, query[0].shape[1]], dim=1)
        of_place = (feature @ of_feature.T.to(feature)).index_select(1, of_row)
        first = self._with_view(of_place, self.radiance.of_query(torch.cat(query, -1)), unit_tx / 2, place / 2, of_view)
        attenuation = self.attenuation(feature.to(tx_m.dtype)).index_select(1, of_row)
        return attenuation, self.radiance.after_first(first).to(tx_m.dtype)

    def features(self, carrier: Float[Tensor, "U C"], place: Float[Tensor, "V 3"]) -> Float[Tensor, "V U W"]:
        """The features of places at each encoded carrier, in the kind in which layers on pairs compute."""
        kind = self.radiance.kind_for(carrier)
        encoded = positional_encoding(place, self.config.octaves)
        gated = feature = (encoded[:, None] * torch.sigmoid(self.gate(carrier))).to(kind).flatten(0, 1)
        for depth, layer in enumerate(self.layers):
            weight, bias = (parameter.to(kind) for parameter in layer.parameters())
            outputs = linear(feature, weight, bias)
            if depth == len(self.layers) // 2:
                outputs.addmm_(gated, self.skip.weight.T.to(kind))
            feature = relu(outputs, inplace=True)
        return feature.unflatten(0, (len(place), len(carrier)))

    def _with_view(
        self,
        of_place: Float[Tensor, "V B W"],
        of_query: Float[Tensor, "B W"],
        query: Float[Tensor, "B 3"],
        place: Float[Tensor, "V 3"],
        weight: Float[Tensor, "W P"],
    ) -> Float[Tensor, "V B W"]:
        """The first layer: the parts of places and queries, and the view, encoded `place` − `query`, times weights.

        Sines and cosines of differences are sums of products, so that the view's part is one product of matrices,
        with one more column for the queries' part.
        """
        octaves, kind = self.config.octaves, of_place.dtype
        parts = [3, 3 * octaves, 3 * octaves]
        straight, of_sine, of_cosine = weight.split(parts, dim=1)
        _, sine, cosine = (part[:, None] for part in positional_encoding(query, octaves).split(parts, dim=1))
        turned = [sine * of_cosine + cosine * of_sine, cosine * of_cosine - sine * of_sine]
        shift = (of_query - query @ straight.T)[..., None]
        of_view = torch.cat([straight.expand(len(query), -1, -1), *turned, shift], dim=-1).flatten(0, 1)
        encoded = pad(positional_encoding(place, octaves), (0, 1), value=1.0).to(kind)
        return torch.addmm(of_place.flatten(1), encoded, of_view.T.to(kind)).view_as(of_place)


class OpaqueGaussians(RFGaussians):
    """Gaussians with an opacity each."""

    def __init__(self, num_gaussians: int) -> None:
        super().__init__(num_gaussians)
        self.opacity_logit = nn.Parameter(torch.full((num_gaussians,), math.log(_OPACITY / (1 - _OPACITY))))


class Wideband3DGSField(GaussianField):
    """R_k = Σ_i o_i G_i S_i / d_i Π_{m<i} (1 − o_m G_m (1 − δ_m)), with d_i the distance to the receiver."""

    config: Wideband3DGSConfig
    network: FeatureNetwork
    gaussians: OpaqueGaussians

    def __init__(self, config: Wideband3DGSConfig) -> None:
        scaling = Scaling()
        super().__init__(config, scaling, FeatureNetwork(config, scaling))

    def new_gaussians(self, number: int) -> OpaqueGaussians:
        """New Gaussians, all with the same opacity."""
        return OpaqueGaussians(number)

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Place the Gaussians at random points in the box of the training data."""
        self.scaling.adapt(train)
        self.gaussians.scatter(self.scaling, math.radians(self.config.angular_size_deg), generator)

    def attributes(self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], seen: Seen) -> Attributes:
        """The network's outputs for the Gaussians `seen`, with their opacity and path loss."""
        position_m = self.gaussians.position_m.detach()[seen]
        opacity = torch.sigmoid(self.gaussians.opacity_logit[seen])[:, None]
        tx_m = self.scaling.in_frame(tx_position_m)
        attenuation, signal = (output.unbind(-1) for output in self.network(tx_m, carrier_hz, position_m))
        share = opacity / position_m.norm(dim=-1, keepdim=True).clamp_min(_NEAREST_M)
        transmitted = torch.polar(torch.sigmoid(attenuation[0]), attenuation[1])
        return Attributes(
            torch.polar(share * softplus(signal[0]), signal[1])[None],
            1 - opacity * (1 - transmitted),
            torch.ones_like(attenuation[0]),
        )


class Wideband3DGS(LearnedMethod):
    """Wideband3DGS (NeurIPS 2025), from its paper's idea, on this renderer.

    Kept: opacities, an attenuation branch of encoded places gated by the carrier, which no transmitter changes,
    a radiance branch of its feature, view, transmitter and carrier, a path loss, carriers on a linear axis.
    Left out: half the width and half the layers of the attenuation branch, octaves of places, all but a few
    hundred Gaussians, hours of training.
    Changed: one skip; Gaussians are divided by their pull, dropped by their contribution, and move by their
    footprints' gradient alone; maps are normalised, and the loss is Eq. 12.
    """

    Config = Wideband3DGSConfig

    def field(self) -> ChannelField:
        """The field for the options, before training."""
        return Wideband3DGSField(self.config)
