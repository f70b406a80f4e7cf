"""Trivial predictor: linear interpolation in log f between the maps at the two neighbouring training carriers."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from xfreqbench.methods.lookup import TransmitterLookup, WeightedRows
from xfreqbench.types import FloatArray


class LogFrequency(TransmitterLookup):
    """Interpolates the nearest transmitter's maps; outside the training band it keeps the map at its edge."""

    def weighted(self, tx_position_m: Float[FloatArray, "3"], carrier_hz: float) -> WeightedRows:
        """One row, or two whose weights are linear in log f."""
        rows = self.transmitters.rows(self.transmitters.nearest(tx_position_m))
        log_carrier = np.log(self.transmitters.train.carrier_hz[rows])  # ascending, because rows are sorted by carrier
        place = np.interp(np.log(carrier_hz), log_carrier, np.arange(len(rows)))
        low, high = math.floor(place), math.ceil(place)
        if low == high:
            return rows[[low]], np.ones(1)
        return rows[[low, high]], np.array([high - place, place - low])
