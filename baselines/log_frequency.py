"""Trivial predictor: linear interpolation in log f between the two neighbouring training carriers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.dataset import PasDataset
from xfreqbench.method import Budget, Progress
from xfreqbench.transmitters import TrainingTransmitters


@dataclass(frozen=True)
class LogFrequencyConfig:
    """It has no options."""


class LogFrequency:
    """Interpolates the nearest transmitter's maps; outside the training band its edge is kept."""

    num_parameters = 0

    def __init__(self, config: LogFrequencyConfig = LogFrequencyConfig()) -> None:
        self.config = config

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        """Remember where the training maps are."""
        self._transmitters = TrainingTransmitters(train)
        yield Progress(step=1, loss=math.nan)

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """One or two stored maps a query, blended and scaled to peak 1."""
        return np.stack([self._map(*query) for query in zip(tx_position_m, carrier_hz, strict=True)])

    def _map(
        self, tx_position_m: Float[FloatArray, "3"], carrier_hz: float
    ) -> Float[NDArray[np.float32], "E A"]:
        rows = self._transmitters.rows(self._transmitters.nearest(tx_position_m))
        log_carrier = np.log(self._transmitters.train.carrier_hz[rows])  # rising: a table's rows are sorted
        place = np.interp(np.log(carrier_hz), log_carrier, np.arange(len(rows)))
        low, high = math.floor(place), math.ceil(place)
        if low == high:
            return self._transmitters.blend(rows[[low]], np.ones(1))
        return self._transmitters.blend(rows[[low, high]], np.array([high - place, place - low]))

    def save(self, directory: Path) -> None:
        """Store which rows were trained on."""
        self._transmitters.save(directory)

    @classmethod
    def load(cls, directory: Path) -> LogFrequency:
        """Inverse of `save`."""
        method = cls()
        method._transmitters = TrainingTransmitters.load(directory)
        return method
