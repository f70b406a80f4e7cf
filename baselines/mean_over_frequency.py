"""Trivial predictor: the mean of the same transmitter's maps over the training carriers."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.dataset import PasDataset
from xfreqbench.method import Budget, Progress
from xfreqbench.transmitters import TrainingTransmitters

_FILE = "config.json"


@dataclass(frozen=True)
class MeanOverFrequencyConfig:
    """How many of the nearest transmitters stand in for one that was not trained on."""

    num_nearest: int = 6


class MeanOverFrequency:
    """Averages maps of all training carriers and ignores the carrier that is asked for."""

    num_parameters = 0

    def __init__(self, config: MeanOverFrequencyConfig = MeanOverFrequencyConfig()) -> None:
        self.config = config

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        """Remember where the training maps are."""
        self._transmitters = TrainingTransmitters(train)
        yield Progress(step=1, loss=math.nan)

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """One mean a query, scaled to peak 1."""
        return np.stack([self._map(position_m) for position_m in tx_position_m])

    def _map(self, tx_position_m: Float[FloatArray, "3"]) -> Float[NDArray[np.float32], "E A"]:
        nearest = self._transmitters.nearest(tx_position_m, self.config.num_nearest)
        rows = self._transmitters.rows(nearest)
        return self._transmitters.blend(rows, np.ones(len(rows)))

    def save(self, directory: Path) -> None:
        """Store the configuration and which rows were trained on."""
        (directory / _FILE).write_text(json.dumps(asdict(self.config)))
        self._transmitters.save(directory)

    @classmethod
    def load(cls, directory: Path) -> MeanOverFrequency:
        """Inverse of `save`."""
        method = cls(MeanOverFrequencyConfig(**json.loads((directory / _FILE).read_text())))
        method._transmitters = TrainingTransmitters.load(directory)
        return method
