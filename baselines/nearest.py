"""Trivial predictor: the map of the nearest training transmitter at the nearest training carrier."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from xfreqbench.methods.lookup import TransmitterLookup, WeightedRows
from xfreqbench.types import FloatArray


class Nearest(TransmitterLookup):
    """Copies the map of the nearest transmitter at the nearest carrier on a logarithmic axis."""

    def weighted(self, tx_position_m: Float[FloatArray, "3"], carrier_hz: float) -> WeightedRows:
        """One row."""
        rows = self.transmitters.rows(self.transmitters.nearest(tx_position_m))
        octaves = np.abs(np.log2(self.transmitters.train.carrier_hz[rows] / carrier_hz))
        return rows[[octaves.argmin()]], np.ones(1)
