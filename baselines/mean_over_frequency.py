"""Trivial predictor: the mean of the same transmitter's maps over the training carriers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from pydantic import Field
from typing_extensions import Doc

from xfreqbench.methods.lookup import TransmitterLookup
from xfreqbench.types import FloatArray


@dataclass(frozen=True)
class MeanOverFrequencyConfig:
    """Options: the number of nearest transmitters that replace one that is not in the training rows."""

    num_nearest: Annotated[int, Field(ge=1), Doc("transmitters that replace an untrained one")] = 6


class MeanOverFrequency(TransmitterLookup):
    """Averages the maps of all training carriers and ignores the carrier of the query."""

    Config = MeanOverFrequencyConfig

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """For each query, the mean map, scaled to peak 1."""
        maps = []
        for position_m in tx_position_m:
            nearest = self.transmitters.nearest(position_m, self.config.num_nearest)
            rows = self.transmitters.rows(nearest)
            maps.append(self.transmitters.blend(rows, np.ones(len(rows))))
        return np.stack(maps)
