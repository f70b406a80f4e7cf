"""A field of virtual sources: transmitters mirrored in planes, with exact phases at every carrier."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor, nn

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning.aperture import ApertureField
from xfreqbench.methods.learning.encoding import Scaling, positional_encoding
from xfreqbench.methods.learning.network import NetworkConfig
from xfreqbench.methods.learning.targets import Beams, GridView
from xfreqbench.methods.learning.training import ChannelField
from xfreqbench.types import FloatArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

from ..config import LOOK_SHARES, SourceConfig
from ..search.cross_terms import Explained
from ..search.planes import Plane
from ..search.range_profile import find_more_planes, find_planes, random_planes
from .images import Traces
from .learned_room import MIN_LENGTH_M, LearnedRoom
from .slabs import phasor

_FEWEST_PLANES = 2  # of a room
_MIN_STEPS_BETWEEN_LOOKS = 500
# Most of a budget in seconds that the first search takes, and a later one.
_SEARCH_SHARE, _LOOK_SHARE = 0.75, 0.2
_CELL_RATE, _SLAB_RATE = 60.0, 5.0  # of the learning rate
_START_FREE = 0.1  # amplitude of the free sources at the start, relative to the line of sight


class PathGain(nn.Module):
    """A factor 1 + correction for the gain of a path.

    It depends on the transmitter, the arrival and the planes that the path bounces off, and not on the carrier.
    """

    def __init__(self, num_planes: int, width: int, num_octaves: int, max_change: float, scaling: Scaling) -> None:
        super().__init__()
        self.num_octaves, self.max_change, self.scaling = num_octaves, max_change, scaling
        self.of_plane = nn.Embedding(num_planes + 1, width)
        self.of_tx = nn.Linear(3 * (1 + 2 * num_octaves), width)
        self.of_arrival = nn.Linear(3, width)
        self.layers = nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.head = nn.Linear(width, 2)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, tx_m: Float[Tensor, "B 3"], traces: Traces) -> Complex[Tensor, "B K"]:
        """Complex factors close to 1 for K paths of B transmitters; `tx_m` is in the receiver's frame."""
        tx = positional_encoding(self.scaling.unit_position(tx_m) / 2, self.num_octaves)
        order = torch.arange(1, traces.bounce.plane.shape[-1] + 1, device=tx.device)
        planes = (self.of_plane(traces.bounce.plane + 1) / order[:, None]).sum(2)
        hidden = self.of_tx(tx)[:, None] + self.of_arrival(traces.arrival) + planes
        return 1 + torch.view_as_complex(self.max_change * self.head(self.layers(hidden)).tanh())


@dataclass(frozen=True, eq=False)
class TracedPairs:
    """B pairs of one of T transmitters, whose paths are traced, and one of F carriers.

    `offset_m` are the transmitters relative to the array centre. `of_tx` and `of_carrier` are the indices of each
    pair. Free sources are told the carriers `free_carrier_hz` of the pairs instead, if they are given.
    """

    offset_m: Float[Tensor, "T 3"]
    traces: Traces
    carrier_hz: Float[Tensor, "F"]
    of_tx: Int[Tensor, "B"]
    of_carrier: Int[Tensor, "B"]
    free_carrier_hz: Float[Tensor, "B"] | None = None


class VirtualSourceField(ChannelField):
    """h_n = Σ_p g_p(p_tx, f) d_0/d_p exp(−j2πf d_{p,n}/c), p over the transmitter's images in sequences of planes.

    d_{p,n} is the distance of the image to element n, exact to second order in the aperture. The gain g_p is the
    product of the slabs' reflections at the bounces, with polarisation, of the transmissions on the way, both
    weighted by the contents of the planes' cells, and of the correction of a small network. Free sources, as in
    `ApertureField`, take what no plane explains; their powers add to the map. Channels are in units of the line of
    sight.
    """

    array_m: Tensor
    num_looks: Tensor
    last_look: Tensor
    gain: PathGain | None
    budget = Budget()  # of the fit, of which searches take a share

    def __init__(self, config: SourceConfig, network: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.scaling = Scaling()
        self.register_buffer("array_m", torch.zeros(3, dtype=torch.float64))
        self.register_buffer("num_looks", torch.tensor(0))
        self.register_buffer("last_look", torch.tensor(0))
        self.room = LearnedRoom(config)
        self.free = ApertureField(config.free_sources, config.free_modes, network) if config.free_sources else None
        self.log_free = nn.Parameter(torch.tensor(_START_FREE).log())
        self.gain = self._new_gain()

    def _new_gain(self) -> PathGain | None:
        """The network for gains before training, for the planes at hand; None where the options say so."""
        config, num_planes = self.config, len(self.room.normal)
        if not config.max_gain:
            return None
        return PathGain(num_planes, config.gain_width, config.gain_octaves, config.max_gain, self.scaling)

    def match(self, tensors: Mapping[str, Tensor]) -> None:
        """Take the numbers of planes, cells and images of stored tensors, so that they can be loaded."""
        self.room.match({name[5:]: tensor for name, tensor in tensors.items() if name.startswith("room.")})
        self.gain = self._new_gain()

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Find planes in the training rows and choose the images with most power; draw random values for the rest."""
        receiver = train.header.receiver
        self.array_m.copy_(torch.as_tensor(receiver.position_m, dtype=torch.float64))
        antenna = (receiver.pattern, receiver.polarization)
        heard = train[np.flatnonzero(train.has_path)]
        self.room.enter(antenna, self.offsets(heard.tx_position_m), torch.as_tensor(heard.carrier_hz))
        self.scaling.adapt(train)
        seed, planes = int(torch.randint(2**31, (), generator=generator)), list[Plane]()
        if self.searches:
            planes = find_planes(train, seed, self.budget.timer(_SEARCH_SHARE))
        elif self.config.max_order:
            planes = random_planes(train, seed, self.config.max_planes)
        self.room.take([], planes)
        self.gain = self._new_gain()
        if self.free is not None:
            self.free.adapt(train, generator)

    @property
    def has_too_few_planes(self) -> bool:
        """Whether planes were searched, but no room was found, so that free sources would have to explain the rest."""
        return self.searches and len(self.room.normal) < min(_FEWEST_PLANES, self.config.max_planes)

    @property
    def searches(self) -> bool:
        """Whether planes are searched at all."""
        config = self.config
        return config.planes == "search" and config.max_order > 0 and config.max_planes > 0

    def is_time_to_look(self, step: int, share: float) -> bool:
        """Whether it is time for another search for planes, given the step and the share of the budget spent."""
        if not (self.searches and self.config.phase and len(self.room.normal)):
            return False
        looks = int(self.num_looks)
        has_learned = step - int(self.last_look) >= _MIN_STEPS_BETWEEN_LOOKS
        has_time = self.budget.max_seconds is None or share < 1 - _LOOK_SHARE
        return looks < self.config.looks and share >= LOOK_SHARES[looks] and has_learned and has_time

    def look_again(self, train: PasDataset, explained: Explained, step: int, generator: torch.Generator) -> None:
        """Search for planes in what the field does not explain, and choose images again by what was learned."""
        is_over = self.budget.timer(_LOOK_SHARE)
        self.num_looks += 1
        self.last_look.fill_(step)
        kept = self.room.worth_keeping()
        planes = self.room.planes
        known = [planes[index] for index in kept]
        self.room.take(kept, find_more_planes(train, known, explained, is_over) if known else [])
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(torch.randint(2**31, (), generator=generator)))
            self.gain = self._new_gain()

    def offsets(self, tx_position_m: Float[FloatArray, "B 3"] | Float[Tensor, "B 3"]) -> Float[Tensor, "B 3"]:
        """Positions relative to the array centre, float64."""
        return torch.as_tensor(tx_position_m, dtype=torch.float64) - self.array_m

    def channels(
        self,
        offset_m: Float[Tensor, "B 3"],
        traces: Traces,
        carrier_hz: Float[Tensor, "F"],
        element: Float[Tensor, "M 3"],
    ) -> Complex[Tensor, "B F M"]:
        """Channels of each transmitter's virtual sources relative to the line of sight; `element` is in wavelengths."""
        gain = self.room.attenuated(traces, carrier_hz)
        if self.gain is not None:
            gain = gain * self.gain(offset_m.float() @ self.scaling.rotation, traces)[..., None]
        if self.config.phase:
            gain = gain * self._travel(traces.length_m, carrier_hz)
        return torch.einsum("bkf,bkfm->bfm", gain, self._response(traces, carrier_hz, element))

    def _travel(self, length_m: Float[Tensor, "B K"], carrier_hz: Float[Tensor, "F"]) -> Complex[Tensor, "B K F"]:
        """exp(−j2πf d/c), whole turns subtracted before the angle is rounded to float32."""
        kind = getattr(torch, self.config.lengths)
        turns = length_m.to(kind)[..., None] * (carrier_hz.to(kind) / SPEED_OF_LIGHT_M_S)
        return phasor((-2 * math.pi * (turns % 1)).float())

    def _response(
        self, traces: Traces, carrier_hz: Float[Tensor, "F"], element: Float[Tensor, "M 3"]
    ) -> Complex[Tensor, "B K F M"]:
        """Phase factors at the elements of the paths' spherical waves, to second order in the aperture."""
        along = traces.arrival @ self.scaling.rotation @ element.T
        bend = ((element * element).sum(-1) - along * along) / traces.length_m.clamp_min(MIN_LENGTH_M).float()[
            ..., None
        ]
        wavelength_m = (SPEED_OF_LIGHT_M_S / carrier_hz).float()
        return phasor(2 * math.pi * along[:, :, None] - math.pi * bend[:, :, None] * wavelength_m[:, None])

    def power(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Bartlett maps of virtual and free sources; positions are float64, for the phases of high carriers."""
        offset_m = self.offsets(tx_position_m)
        unique_m, of_tx = torch.unique(offset_m, dim=0, return_inverse=True)
        carriers, of_carrier = torch.unique(carrier_hz.double(), return_inverse=True)
        pairs = TracedPairs(unique_m, self.room.traced(unique_m), carriers, of_tx, of_carrier)
        return self.power_of(pairs, view, beams)

    def power_of(self, pairs: TracedPairs, view: GridView, beams: Beams) -> Float[Tensor, "B E A"]:
        """Bartlett maps in view of pairs of a transmitter and a carrier, whose paths are traced already."""
        element = torch.as_tensor(beams.element_position_wavelengths, dtype=torch.float32)
        of_tx, of_carrier, free_hz = pairs.of_tx, pairs.of_carrier, pairs.free_carrier_hz
        cfr = self.channels(pairs.offset_m, pairs.traces, pairs.carrier_hz, element)[of_tx, of_carrier][None]
        if self.free is not None:
            told_hz = pairs.carrier_hz[of_carrier] if free_hz is None else free_hz
            cfr = torch.cat([cfr, self.free_channels(pairs.offset_m[of_tx], told_hz, element)])
        return beams.power(cfr, view)

    def free_channels(
        self, offset_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], element: Float[Tensor, "M 3"]
    ) -> Complex[Tensor, "Q B M"]:
        """Channels of the free sources in units of the line of sight: Q channels that do not interfere."""
        if self.free is None:
            return torch.zeros(0, len(offset_m), len(element), dtype=torch.complex64)
        signal = self.free.network(offset_m.float() @ self.scaling.rotation, carrier_hz, self.free.position_m).signal
        return self.log_free.exp() * (signal.mT @ self.free.response(element))

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Parameters with their learning rates.

        Cells and slabs learn faster, because a step touches few of them. Thicknesses learn slowly, so that their
        phase does not jump by a whole turn.
        """
        gain = self.gain.parameters() if self.gain is not None else ()
        thickness = self.room.slabs.log_thickness
        others = [parameter for parameter in self.room.slabs.parameters() if parameter is not thickness]
        rated = [
            ([self.room.presence.logits], _CELL_RATE),
            (others, _SLAB_RATE),
            ([thickness, self.log_free, *gain], 1.0),
        ]
        groups = [{"params": parameters, "lr": rate * learning_rate} for parameters, rate in rated]
        return [*groups, *(self.free.parameter_groups(learning_rate) if self.free is not None else ())]

    def counts(self) -> dict[str, float]:
        """Numbers of planes, images and free sources."""
        return {
            "planes": len(self.room.normal),
            "images": len(self.room.sequence),
            "free_sources": len(self.free.position_m) if self.free is not None else 0,
        }
