"""Trivial predictor: the mean of the same transmitter's maps over the training carriers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from pydantic import Field

from xfreqbench.angles import FloatArray
from xfreqbench.transmitters import TransmitterLookup


@dataclass(frozen=True)
class MeanOverFrequencyConfig:
    """How many of the nearest transmitters stand in for one that was not trained on."""

    num_nearest: Annotated[int, Field(ge=1)] = 6


class MeanOverFrequency(TransmitterLookup):
    """Averages maps of all training carriers and ignores the carrier that is asked for."""

    Config = MeanOverFrequencyConfig

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """One mean a query, scaled to peak 1."""
        return np.stack([self._map(position_m) for position_m in tx_position_m])

    def _map(self, tx_position_m: Float[FloatArray, "3"]) -> Float[NDArray[np.float32], "E A"]:
        nearest = self.transmitters.nearest(tx_position_m, self.config.num_nearest)
        rows = self.transmitters.rows(nearest)
        return self.transmitters.blend(rows, np.ones(len(rows)))
