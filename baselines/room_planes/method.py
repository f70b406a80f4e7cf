"""Adds reflections by planes that are found in an unseen room to what `room-lags` predicts there.

Where 32 or more of the given transmitters are in line of sight, planes are found in their maps (`search`). For a
transmitter that is asked for, the direct wave and one and two reflections by the planes are traced with their phases.
What the reflections change in the direct wave's sums over lags is added to the sums of `room-lags`, of each plane as
much as is heard of it around that place (`shares`). Where fewer are in line of sight, or no plane is found, it is
`room-lags`.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field, TypeAdapter
from torch import Tensor
from typing_extensions import Doc

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.maps.lags import LagFunctions
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.scene.imported import Slab
from xfreqbench.types import FloatArray

from ..room_lags import RoomLags, RoomLagsConfig, RoomLagsPredictor, heard_sums
from .search import ArrayView, FoundPlane, PlaneSearch, slabs_in
from .shares import HeardShares

_LEAST_IN_SIGHT = 32  # transmitters; with fewer, what is found makes predictions worse
_START = 0.7  # share of all planes at which the effect of each is taken
_SLABS_FILE = "slabs.json"
_SLABS = TypeAdapter(list[Slab])


@dataclass(frozen=True)
class RoomPlanesConfig(RoomLagsConfig):
    """Options of `room-planes`: those of `room-lags`, and of the search for planes."""

    max_planes: Annotated[int, Field(ge=0), Doc("most planes of a room")] = 10
    least_score: Annotated[float, Field(gt=0), Doc("of a plane: how much better it explains maps")] = 0.06


class RoomPlanes(RoomLags):
    """`room-lags`, and in rooms where enough is heard, the reflections by planes that are found there."""

    config: RoomPlanesConfig
    Config = RoomPlanesConfig

    def __init__(self, config: RoomPlanesConfig = RoomPlanesConfig()) -> None:
        super().__init__(config)
        self.slabs: list[Slab] = []

    def fit(self, rooms: Collection, budget: Budget, seed: int) -> Generator[Progress, float, None]:
        """Note what large surfaces of the training rooms are made of; then as `RoomLags.fit`."""
        self.slabs = self.slabs or slabs_in(rooms.select(num_rooms=self.config.trained_on or None))
        yield from super().fit(rooms, budget, seed)

    def adapt(self, heard: PasDataset, budget: Budget) -> RoomLagsPredictor:
        """As `RoomLags.adapt`, with the planes that are found."""
        predictor, search = self.heard(heard)
        if search and (planes := search.planes()):
            return WithPlanes(predictor, search, planes)
        return predictor

    def heard(self, heard: PasDataset) -> tuple[RoomLagsPredictor, PlaneSearch | None]:
        """The predictor of `room-lags`, and the search for planes where enough is in sight and antennas are upright."""
        position_m, sums = heard_sums(heard)
        predictor, receiver = self.adapted(heard, position_m, sums), heard.header.receiver
        pattern, polarization, turned_deg = receiver.antenna
        is_known = pattern != "tr38901" and not any(turned_deg)
        if not (is_known and self.slabs) or len(position_m) < _LEAST_IN_SIGHT:
            return predictor, None
        element = heard.beam.element_position_wavelengths @ receiver.rotation.T
        search = PlaneSearch(
            ArrayView(element, (pattern, polarization)),
            LagFunctions(heard.beam),
            position_m @ receiver.rotation.T,
            sums,
            self.slabs,
            self.config.least_score,
            self.config.max_planes,
        )
        return predictor, search if search.num_in_sight >= _LEAST_IN_SIGHT else None

    def save(self, directory: Path) -> None:
        """As `RoomLags.save`, and the slabs as JSON."""
        super().save(directory)
        (directory / _SLABS_FILE).write_bytes(_SLABS.dump_json(self.slabs))

    @classmethod
    def load(cls, directory: Path) -> RoomPlanes:
        """The method as it was saved; its `fit` goes on from there."""
        method = super().load(directory)
        assert isinstance(method, RoomPlanes)
        method.slabs = _SLABS.validate_json((directory / _SLABS_FILE).read_bytes())
        return method


class WithPlanes(RoomLagsPredictor):
    """Predicts as another, with the reflections by planes."""

    def __init__(self, other: RoomLagsPredictor, search: PlaneSearch, planes: Sequence[FoundPlane]) -> None:
        vars(self).update(vars(other))
        self.view, self.planes = search.view, list(planes)
        tx_m, carrier_hz = search.tx_m, search.carrier_hz
        sample_m = np.repeat(tx_m + np.asarray(self.receiver.position_m), len(carrier_hz), axis=0)
        known = other.sums(sample_m, np.tile(carrier_hz, len(tx_m))).detach().double().numpy()
        share = np.full((len(tx_m), len(planes)), _START)
        without = [self._lags(tx_m, carrier_hz, np.where(one, 0, share)) for one in np.eye(len(planes), dtype=bool)]
        effect = (self._lags(tx_m, carrier_hz, share) - torch.stack(without)) / _START
        self.shares = HeardShares.of(
            tx_m,
            search.sums.astype(float),
            known.reshape(search.sums.shape),
            effect.double().numpy(),
            np.tile(search.lags.weight, 2),
        )

    def sums(self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]) -> Float[Tensor, "B L"]:
        """Those of the other, more by what reflections change in those of the direct wave."""
        sums, offset_m = super().sums(tx_position_m, carrier_hz), tx_position_m - np.asarray(self.receiver.position_m)
        for carrier in np.unique(carrier_hz).tolist():
            here = np.flatnonzero(carrier_hz == carrier)
            share = self.shares.at(offset_m[here])
            reflected, direct = (self._lags(offset_m[here], np.array([carrier]), each) for each in (share, 0.0))
            sums[here] += (reflected - direct)[:, 0]
        return sums

    def _lags(
        self,
        tx_m: Float[FloatArray, "T 3"],
        carrier_hz: Float[FloatArray, "F"],
        share: Float[FloatArray, "T P"] | float,
    ) -> Float[Tensor, "T F L"]:
        """Sums over lags of direct waves with shares of the planes, of transmitters as seen from the array."""
        channels = self.view.channels(self.planes, tx_m, carrier_hz, share).astype(np.complex64)
        return torch.stack([self.field.beams.lags_of_channels(each) for each in torch.as_tensor(channels)], dim=1)
