"""Trivial predictor: the mean of the same transmitter's maps over the training carriers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field
from typing_extensions import Doc

from xfreqbench.methods.lookup import TransmitterLookup, WeightedRows
from xfreqbench.types import FloatArray


@dataclass(frozen=True)
class MeanOverFrequencyConfig:
    """Options: the number of nearest transmitters that replace one that is not in the training rows."""

    num_nearest: Annotated[int, Field(ge=1), Doc("transmitters that replace an untrained one")] = 6


class MeanOverFrequency(TransmitterLookup):
    """Averages the maps of all training carriers and ignores the carrier of the query."""

    Config = MeanOverFrequencyConfig

    def weighted(self, tx_position_m: Float[FloatArray, "3"], carrier_hz: float) -> WeightedRows:
        """All rows of the transmitter, or of the nearest ones, with equal weights."""
        rows = self.transmitters.rows(self.transmitters.nearest(tx_position_m, self.config.num_nearest))
        return rows, np.ones(len(rows))
