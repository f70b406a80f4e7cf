"""A network of low rank that gives each Gaussian its attributes: one vector a query, one learned code a Gaussian."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Literal

import torch
from jaxtyping import Float
from pydantic import Field as Limits
from torch import Tensor, nn
from torch.nn.functional import silu
from typing_extensions import Doc

from xfreqbench.methods.learning.encoding import (
    FeatureGrid,
    Scaling,
    encoded_size,
    positional_encoding,
    rated_with_grid,
)
from xfreqbench.methods.learning.network import Attributes, NetworkConfig

_CLEAR = 4.0  # logit of |δ| at the start, 0.98, so that the direct wave's Gaussians hardly shade each other
_HEAD = 0.1  # of the usual weights of the last layer at the start
Trend = Literal["root", "log", "none"]
NUM_SHAPES = 3  # |δ|, arg δ, λ


@dataclass(frozen=True)
class LowRankConfig(NetworkConfig):
    """Options of attributes as products ⟨a(p_tx, f), b_i⟩; `width` and `layers` are those of the network for a.

    The codes b_i are learned for each Gaussian, or given by its place alone where `latent` is 0. The carrier, by its
    root or its logarithm, scales a trend that starts at nothing; without a `trend` it is one more input of the network.
    """

    rank: Annotated[int, Limits(ge=1), Doc("numbers of a Gaussian's code")] = 64
    width: Annotated[int, Limits(ge=1)] = 192
    layers: Annotated[int, Limits(ge=1)] = 1
    max_spread: Annotated[float, Limits(ge=1)] = 1.3
    trend: Annotated[Trend, Doc("what of the carrier scales a trend; none: it is an input")] = "root"


@dataclass(frozen=True, eq=False)
class Codes:
    """Codes of V Gaussians: what the products with a query's vector are taken with, and what is added to them."""

    signal: Float[Tensor, "V 2 R"]
    shape: Float[Tensor, "V 3 R"]
    shape_start: Float[Tensor, "V 3"]
    shape_trend: Float[Tensor, "V 3"]


class _PlaceCodes(nn.Module):
    """Codes that follow from a Gaussian's place: a network of its encoded position."""

    def __init__(self, config: LowRankConfig) -> None:
        super().__init__()
        self.octaves, self.rank = config.position_octaves, config.rank
        self.hidden = nn.Linear(encoded_size(3, self.octaves), config.width)
        self.head = nn.Linear(config.width, (2 + NUM_SHAPES) * (config.rank + 2))
        with torch.no_grad():
            self.head.weight.mul_(_HEAD)

    def forward(self, unit_position: Float[Tensor, "V 3"]) -> Codes:
        """Codes of V Gaussians at places in [−1, 1]."""
        features = silu(self.hidden(positional_encoding(unit_position, self.octaves)))
        codes = self.head(features).unflatten(-1, (2 + NUM_SHAPES, self.rank + 2))
        products, added = codes.split([self.rank, 2], dim=-1)
        return Codes(products[:, :2], products[:, 2:], added[:, 2:, 0], added[:, 2:, 1])


class LowRankNetwork(nn.Module):
    """S, δ and λ of Gaussian i as products ⟨a(p_tx, f), b_i⟩ (Eqs. 4 and 7): a once a query, b_i once a Gaussian.

    a(p_tx, f) = a₀(p_tx) + u(f) a₁(p_tx), where u is the carrier on an axis of roots or logarithms, and a₁ starts at
    zero: at first every carrier is alike. Spread and attenuation have a trend of their own in u, so that footprints
    widen or narrow with the carrier. One more output is the strength of the direct wave, 1 at the start.
    """

    def __init__(self, config: LowRankConfig, scaling: Scaling) -> None:
        super().__init__()
        self.config, self.scaling = config, scaling
        self.places = FeatureGrid(config.tx_levels)
        has_trend = config.sees_carrier and config.trend != "none"
        self._is_input = config.sees_carrier and not has_trend
        carrier_size = encoded_size(1, config.carrier_octaves) * self._is_input
        size = encoded_size(3, config.tx_octaves) + self.places.num_outputs + carrier_size
        widths = [size, *[config.width] * config.layers]
        self.layers = nn.ModuleList(nn.Linear(*sizes) for sizes in pairwise(widths))
        self.head = nn.Linear(config.width, config.rank + 1)
        self.trend = nn.Linear(config.width, config.rank + 1) if has_trend else None
        self.of_place = _PlaceCodes(config) if not config.latent else None
        with torch.no_grad():
            self.head.weight.mul_(_HEAD)
            self.head.bias.zero_()
            for parameter in self.trend.parameters() if self.trend is not None else ():
                parameter.zero_()

    def forward(
        self,
        tx_m: Float[Tensor, "B 3"],
        carrier_hz: Float[Tensor, "B"],
        position_m: Float[Tensor, "V 3"],
        codes: Codes | None = None,
    ) -> Attributes:
        """Attributes of V Gaussians for B transmitters, positions in the receiver's frame in metres.

        `codes` are those of the Gaussians where they are learned, None where they follow from places.
        """
        if codes is None:
            assert self.of_place is not None
            codes = self.of_place(self.scaling.unit_position(position_m))
        features = self._features(tx_m, carrier_hz)
        vector = self.head(features)
        added = codes.shape_start[..., None]
        if self.trend is not None:
            of_carrier = self.scaling.root_carrier if self.config.trend == "root" else self.scaling.unit_carrier
            axis = of_carrier(carrier_hz)
            vector = vector + axis * self.trend(features)
            added = added + codes.shape_trend[..., None] * axis.T
        of_gaussians, direct = vector.split([self.config.rank, 1], dim=-1)
        signal, shape = (
            (code.flatten(0, 1) @ of_gaussians.T).unflatten(0, code.shape[:2]) for code in (codes.signal, codes.shape)
        )
        opaque, turn, spread = (shape + added).unbind(1)
        return Attributes(
            signal=torch.complex(signal[:, 0], signal[:, 1])[None],
            attenuation=torch.polar(torch.sigmoid(opaque + _CLEAR), turn),
            inverse_spread=self.config.max_spread ** torch.tanh(spread),
            direct=1 + direct[:, 0],
        )

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Parameters with their learning rates; features of places learn faster, because few transmitters use each."""
        return rated_with_grid(self, self.places, learning_rate)

    def _features(self, tx_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"]) -> Float[Tensor, "B W"]:
        place = self.scaling.unit_position(tx_m)
        inputs = [positional_encoding(place, self.config.tx_octaves), 4.0 * self.places(place)]
        if self._is_input:
            carrier = self.scaling.unit_carrier(carrier_hz)
            inputs.append(positional_encoding(carrier, self.config.carrier_octaves))
        features = torch.cat(inputs, dim=-1)
        for layer in self.layers:
            features = silu(layer(features))
        return features
