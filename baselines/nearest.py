"""Trivial predictor: the map of the nearest training transmitter at the nearest training carrier."""

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
class NearestConfig:
    """It has no options."""


class Nearest:
    """Copies the map of the nearest transmitter, at the carrier nearest on a logarithmic axis."""

    num_parameters = 0

    def __init__(self, config: NearestConfig = NearestConfig()) -> None:
        self.config = config

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        """Remember where the training maps are."""
        self._transmitters = TrainingTransmitters(train)
        yield Progress(step=1, loss=math.nan)

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """One stored map a query."""
        return np.stack([self._map(*query) for query in zip(tx_position_m, carrier_hz, strict=True)])

    def _map(
        self, tx_position_m: Float[FloatArray, "3"], carrier_hz: float
    ) -> Float[NDArray[np.float32], "E A"]:
        rows = self._transmitters.rows(self._transmitters.nearest(tx_position_m))
        octaves = np.abs(np.log2(self._transmitters.train.carrier_hz[rows] / carrier_hz))
        return self._transmitters.blend(rows[[octaves.argmin()]], np.ones(1))

    def save(self, directory: Path) -> None:
        """Store which rows were trained on."""
        self._transmitters.save(directory)

    @classmethod
    def load(cls, directory: Path) -> Nearest:
        """Inverse of `save`."""
        method = cls()
        method._transmitters = TrainingTransmitters.load(directory)
        return method
