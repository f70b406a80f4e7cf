"""Trivial predictor: linear interpolation in log f between the maps at the two neighbouring training carriers."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.methods.lookup import TransmitterLookup
from xfreqbench.types import FloatArray


class LogFrequency(TransmitterLookup):
    """Interpolates the nearest transmitter's maps; outside the training band it keeps the map at its edge."""

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """For each query, one stored map, or two blended linearly in log f and scaled to peak 1."""
        return np.stack([self._map(*query) for query in zip(tx_position_m, carrier_hz, strict=True)])

    def _map(self, tx_position_m: Float[FloatArray, "3"], carrier_hz: float) -> Float[NDArray[np.float32], "E A"]:
        """The map of one query."""
        rows = self.transmitters.rows(self.transmitters.nearest(tx_position_m))
        log_carrier = np.log(self.transmitters.train.carrier_hz[rows])  # ascending, because rows are sorted by carrier
        place = np.interp(np.log(carrier_hz), log_carrier, np.arange(len(rows)))
        low, high = math.floor(place), math.ceil(place)
        if low == high:
            return self.transmitters.blend(rows[[low]], np.ones(1))
        return self.transmitters.blend(rows[[low, high]], np.array([high - place, place - low]))
