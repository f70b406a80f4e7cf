"""Trivial predictor: the array's beam pattern of one plane wave from the transmitter's known position."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.array import steering_vector
from xfreqbench.dataset import PasDataset
from xfreqbench.method import Budget, Progress
from xfreqbench.transmitters import TrainingTransmitters
from xfreqbench.units import SPEED_OF_LIGHT_M_S


@dataclass(frozen=True)
class LineOfSightConfig:
    """It has no options."""


class LineOfSight:
    """Knows the receiver's array and place, and nothing of the room; every carrier looks the same."""

    num_parameters = 0

    def __init__(self, config: LineOfSightConfig = LineOfSightConfig()) -> None:
        self.config = config

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        """Take the receiver's geometry from the data set's header."""
        self._transmitters = TrainingTransmitters(train)
        yield Progress(step=1, loss=math.nan)

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """Bartlett maps (Eqs. 2–3) of lone plane waves."""
        train = self._transmitters.train
        receiver = train.header.receiver
        offset_m = (tx_position_m - np.asarray(receiver.position_m)) @ receiver.rotation  # in its frame
        arrival = offset_m / np.linalg.norm(offset_m, axis=1, keepdims=True)
        # Positions in wavelengths are positions in metres at a wavelength of one metre.
        wave = steering_vector(train.beam.element_position_wavelengths, arrival, SPEED_OF_LIGHT_M_S)
        return train.beam.maps(wave, train.header.pas_kind)[0]

    def save(self, directory: Path) -> None:
        """Store which data set it knows the receiver of."""
        self._transmitters.save(directory)

    @classmethod
    def load(cls, directory: Path) -> LineOfSight:
        """Inverse of `save`."""
        method = cls()
        method._transmitters = TrainingTransmitters.load(directory)
        return method
