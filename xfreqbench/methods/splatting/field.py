"""Fields of Gaussians splatted on the sphere of directions (Adaptive Orthographic Splatting, Eqs. 8–11)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import torch
from jaxtyping import Complex, Float
from pydantic import Field as Limits
from torch import Tensor, nn
from torch.nn.functional import normalize
from typing_extensions import Doc

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import MethodError
from xfreqbench.methods.learning.encoding import Scaling
from xfreqbench.methods.learning.low_rank import LowRankConfig, LowRankNetwork
from xfreqbench.methods.learning.network import Attributes, WideFreqNetwork
from xfreqbench.methods.learning.targets import Beams, GridView
from xfreqbench.methods.learning.training import ChannelField, Count, Fraction, Positive, TrainingConfig
from xfreqbench.methods.splatting.composite import PixelLists, composite
from xfreqbench.methods.splatting.density import DensityConfig, DensityControl
from xfreqbench.methods.splatting.footprints import bin_footprints, squared_distance
from xfreqbench.methods.splatting.gaussians import CODES, CodedGaussians, RFGaussians, Seen
from xfreqbench.methods.splatting.projection import Projection, project_gaussians

SUPPORT = 9.0  # squared Mahalanobis distance at which a footprint ends: three deviations


@dataclass(frozen=True)
class BandConfig:
    """Options of where power is accumulated.

    With `band`, that is every `splat_stride`-th row and column alone, and the power there is projected on the maps
    that the array can give: a map is a combination of the array's few lag functions.
    """

    band: Annotated[bool, Doc("whether power is projected on the maps that the array can give")] = True
    splat_stride: Annotated[Count, Doc("with band, power is computed on every so many rows and columns")] = 8


@dataclass(frozen=True)
class GaussianConfig(BandConfig, DensityConfig):
    """Options of Gaussians: their number at the start, how it changes, and where they are accumulated."""

    num_gaussians: Annotated[Count, Doc("Gaussians at the start")] = 256
    position_rate: Annotated[Positive, Doc("rate of the Gaussians' places, of the learning rate")] = 10.0
    move_from: Annotated[Fraction, Doc("share of the budget from which Gaussians move; 1: never")] = 0.0


@dataclass(frozen=True)
class SplatTrainingConfig(TrainingConfig):
    """Options of training with which splatting sees many maps a second."""

    batch_size: Count = 128
    learning_rate: Positive = 5e-3
    ssim_ramp: Fraction = 0.1
    carrier_blur: Annotated[float, Limits(ge=0)] = 0.0
    stride: Count = 6
    ssim_window: Annotated[int, Limits(ge=2)] = 2
    averaging: Annotated[float, Limits(ge=0, lt=1)] = 0.995


class BandField(ChannelField):
    """A field whose subclasses give the power that is `splatted`, projected on the array's band by the options."""

    config: BandConfig

    def power(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Power |R_k|² from each direction in view, within the array's band where the options say so."""
        if not self.config.band:
            return self.splatted(tx_position_m, carrier_hz, view, beams)
        return beams.power_of_lags(self._lags(tx_position_m, carrier_hz, beams), view)

    def unit_power(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """The power divided by its peak, which is looked for in more directions where that costs little."""
        if not self.config.band:
            return super().unit_power(tx_position_m, carrier_hz, view, beams)
        lags = self._lags(tx_position_m, carrier_hz, beams)
        # with the loss's own directions it is fine enough to find a beam's peak
        return beams.power_of_lags(lags / beams.peak_of_lags(lags, view, GridView(6, 3, 3)), view)

    def _lags(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], beams: Beams
    ) -> Float[Tensor, "B L"]:
        """Power on few directions, projected on the array's lag functions."""
        coarse = beams.coarse_view(self.config.splat_stride)
        return beams.lags_of(self.splatted(tx_position_m, carrier_hz, coarse, beams), coarse)

    def splatted(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Power of what is accumulated from each direction in view."""
        raise NotImplementedError


class GaussianField(BandField):
    """Complex Gaussians accumulated along each direction, nearest first; subclasses give their `attributes`.

    `network` is what `attributes` uses; it belongs to the parameters. `max_spread` is the upper bound of λ.
    """

    config: GaussianConfig
    moves: Tensor

    def __init__(self, config: GaussianConfig, scaling: Scaling, network: nn.Module, max_spread: float = 1.0) -> None:
        super().__init__()
        if config.num_gaussians > config.max_gaussians:
            raise MethodError(
                f"num_gaussians={config.num_gaussians} is more than max_gaussians={config.max_gaussians}; raise "
                "the latter too."
            )
        self.config = config
        self.scaling = scaling
        self.network = network
        self.gaussians = self.new_gaussians(config.num_gaussians)
        self.density = DensityControl(config)
        self.register_buffer("moves", torch.tensor(config.move_from == 0))
        self._support = SUPPORT * max_spread
        self._standing: dict[GridView, tuple[PixelLists, Tensor]] = {}  # footprints of Gaussians that do not move

    def attributes(self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], seen: Seen) -> Attributes:
        """Signal, attenuation and spread of the Gaussians `seen`, for each transmitter and carrier."""
        raise NotImplementedError

    def new_gaussians(self, number: int) -> RFGaussians:
        """New Gaussians, all zero.

        They may be of a subclass of `RFGaussians`, whose parameters are divided and dropped with the Gaussians.
        """
        return RFGaussians(number)

    @property
    def position_m(self) -> Float[Tensor, "N 3"]:
        """Where the Gaussians are, which training can change only once they move."""
        return self.gaussians.position_m if self._move else self.gaussians.position_m.detach()

    @property
    def shapes(self) -> Float[Tensor, "N 10"]:
        """Positions, quaternions and log-scales side by side."""
        return torch.cat([self.position_m, self.gaussians.quaternion, self.gaussians.log_scale], dim=-1)

    @property
    def _move(self) -> bool:
        """Whether Gaussians move by now; the device is asked where it depends on the share of the budget alone."""
        return self.config.move_from == 0 or (self.config.move_from < 1 and bool(self.moves))

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Parameters with their learning rates: the network, and the Gaussians."""
        network = {"params": list(self.network.parameters()), "lr": learning_rate}
        rate = self.config.position_rate * learning_rate
        return [network, {"params": list(self.gaussians.parameters()), "lr": rate}]

    def splatted(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Power |R_k|² of what is accumulated from each direction in view (Eq. 11)."""
        footprints = self._footprints(view, beams) if tx_position_m.device.type == "cpu" else None
        seen: Seen = slice(None)
        if footprints is not None:
            seen = torch.bincount(footprints[0].gaussian, minlength=len(self.gaussians)) > 0
        attributes = self.attributes(tx_position_m, carrier_hz, seen)
        self.density.watch(seen, attributes.signal)
        signal = self.signal_of(attributes, tx_position_m, beams, seen)
        spread, attenuation = attributes.inverse_spread, attributes.attenuation
        if footprints is None or isinstance(seen, slice):
            from xfreqbench.methods.splatting.composite_triton import composite_on_cuda

            geometry = self.projection(), *beams.angles_in(view), self._support
            response = composite_on_cuda(*geometry, spread, signal, attenuation)
        else:
            lists, distance = footprints
            # only the Gaussians that are seen from any direction have attributes
            seen_lists = PixelLists(lists.start, (seen.cumsum(0) - 1)[lists.gaussian], int(seen.sum()))
            response = composite(seen_lists, distance, spread, signal, attenuation)
        return torch.view_as_real(response).square().sum(-1).reshape(-1, *view.of_grid(beams.grid).shape)

    def signal_of(
        self, attributes: Attributes, tx_position_m: Float[Tensor, "B 3"], beams: Beams, seen: Seen
    ) -> Complex[Tensor, "V B"]:
        """The signals that are accumulated."""
        return attributes.signal[0]

    def _footprints(self, view: GridView, beams: Beams) -> tuple[PixelLists, Float[Tensor, "P"]]:
        """Which directions see which Gaussians, and their distances; computed once while no Gaussian moves."""
        if not self._move and view in self._standing:
            return self._standing[view]
        grid, projection = view.of_grid(beams.grid), self.projection()
        lists = bin_footprints(projection, grid, self._support)
        distance = squared_distance(projection, lists, grid)
        if not self._move:
            distance = distance.detach()
            self._standing[view] = lists, distance
        return lists, distance

    def projection(self) -> Projection:
        """The footprints before the frequency spread λ."""
        return project_gaussians(self.shapes if self._move else self.shapes.detach())

    def after_step(self, optimizer: torch.optim.Adam, step: int, share: float) -> None:
        """Divide and drop Gaussians, and let them move, when it is time; while they stand still none is divided."""
        self.density.after_step(self.gaussians, optimizer, step, share if self._move else math.inf)
        if self.config.move_from <= share and 0 < self.config.move_from < 1:
            self.moves.fill_(True)

    def counts(self) -> dict[str, float]:
        """Number of Gaussians."""
        return {"gaussians": len(self.gaussians)}

    def match(self, tensors: Mapping[str, Tensor]) -> None:
        """Take the number of stored Gaussians, so that they can be loaded."""
        self.gaussians = self.new_gaussians(len(tensors["gaussians.position_m"]))
        self.density.resize(len(tensors["density.contribution"]))  # zero where nothing was summed yet


@dataclass(frozen=True)
class SplatConfig(GaussianConfig):
    """Options of the Gaussians' start and footprints, and of what is accumulated.

    Gaussians start at random points of the box, or on a lattice of directions. `direct_wave` adds to their signals
    what the array hears of a plane wave from the transmitter. `network` is `WideFreqNetwork`, a network of all pairs
    of a transmitter and a Gaussian, or one of low rank.
    """

    network: Annotated[Literal["low-rank", "pairwise"], Doc("products with codes, or all pairs")] = "low-rank"
    start: Annotated[Literal["lattice", "random"], Doc("where Gaussians stand at first")] = "lattice"
    angular_size_deg: Annotated[float, Limits(gt=0, le=90), Doc("one deviation at the start")] = 8.0
    footprint: Annotated[Literal["projected", "circular"], Doc("circular: all of one size")] = "projected"
    direct_wave: Annotated[bool, Doc("whether a plane wave from the transmitter is added")] = True
    transmittance: Annotated[bool, Doc("whether Gaussians hide others behind them")] = True


class SplatField(GaussianField):
    """Gaussians whose attributes come from a network, after Eqs. 4–11."""

    config: SplatConfig
    network: WideFreqNetwork | LowRankNetwork

    def __init__(self, config: SplatConfig, network: LowRankConfig) -> None:
        self._rank = network.rank if config.network == "low-rank" and network.latent else 0
        scaling = Scaling()
        kind = LowRankNetwork if config.network == "low-rank" else WideFreqNetwork
        super().__init__(config, scaling, kind(network, scaling), network.max_spread)
        self.is_capturable = not config.densify_every and config.move_from in (0, 1)  # else Python looks on

    def new_gaussians(self, number: int) -> RFGaussians:
        """New Gaussians, with codes where these are learned."""
        return CodedGaussians(number, self._rank) if self._rank else RFGaussians(number)

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Place the Gaussians at their start."""
        self.scaling.adapt(train)
        size_rad = math.radians(self.config.angular_size_deg)
        if self.config.start == "lattice":
            self.gaussians.spread_out(self.scaling, size_rad, train.grid, generator)
        else:
            self.gaussians.scatter(self.scaling, size_rad, generator)

    def projection(self) -> Projection:
        """The footprints before the frequency spread λ, or circles of fixed size, as the options say."""
        projection = super().projection()
        if self.config.footprint == "projected":
            return projection
        size = math.radians(self.config.angular_size_deg) ** 2
        circle = size * torch.eye(2, dtype=projection.covariance.dtype, device=projection.covariance.device)
        return replace(projection, covariance=circle.expand_as(projection.covariance))

    def attributes(self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], seen: Seen) -> Attributes:
        """The network's outputs for the Gaussians `seen`."""
        query = self.scaling.in_frame(tx_position_m), carrier_hz, self.gaussians.position_m.detach()[seen]
        if isinstance(self.network, WideFreqNetwork):
            attributes = self.network(*query)
        else:
            codes = self.gaussians.codes(seen) if isinstance(self.gaussians, CodedGaussians) else None
            attributes = self.network(*query, codes)
        if self.config.transmittance:
            return attributes
        return replace(attributes, attenuation=torch.ones_like(attributes.attenuation))

    def signal_of(
        self, attributes: Attributes, tx_position_m: Float[Tensor, "B 3"], beams: Beams, seen: Seen
    ) -> Complex[Tensor, "V B"]:
        """The signals, with the direct wave where the options say so."""
        signal = attributes.signal[0]
        if not self.config.direct_wave:
            return signal
        heard = self._direct_wave(self.scaling.in_frame(tx_position_m), beams, seen)
        return signal + (heard if attributes.direct is None else attributes.direct * heard)

    def _direct_wave(self, tx_m: Float[Tensor, "B 3"], beams: Beams, seen: Seen) -> Complex[Tensor, "V B"]:
        """What the array, steered at each Gaussian, hears of a plane wave from the transmitter: aᴴ(d_i) a(d_tx) / M."""
        element = 2 * math.pi * beams.element.to(tx_m)
        wave, beam = (
            normalize(point_m, dim=-1) @ element.T for point_m in (tx_m, self.gaussians.position_m.detach()[seen])
        )
        steered, arriving = (torch.polar(torch.ones_like(phase), phase) for phase in (-beam, wave))
        return steered @ arriving.T / len(element)

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Parameters with their learning rates: those of the network as it says, the Gaussians, and their codes."""
        codes = [value for name, value in self.gaussians.named_parameters() if name in CODES]
        geometry = [value for name, value in self.gaussians.named_parameters() if name not in CODES]
        return [
            *self.network.parameter_groups(learning_rate),
            {"params": geometry, "lr": self.config.position_rate * learning_rate},
            *([{"params": codes, "lr": 2.0 * learning_rate}] if codes else []),
        ]
