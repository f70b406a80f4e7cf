"""Trivial predictor: the map of the nearest training transmitter at the nearest training carrier."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.transmitters import TransmitterLookup


class Nearest(TransmitterLookup):
    """Copies the map of the nearest transmitter, at the carrier nearest on a logarithmic axis."""

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """One stored map a query."""
        return np.stack([self._map(*query) for query in zip(tx_position_m, carrier_hz, strict=True)])

    def _map(
        self, tx_position_m: Float[FloatArray, "3"], carrier_hz: float
    ) -> Float[NDArray[np.float32], "E A"]:
        rows = self.transmitters.rows(self.transmitters.nearest(tx_position_m))
        octaves = np.abs(np.log2(self.transmitters.train.carrier_hz[rows] / carrier_hz))
        return self.transmitters.blend(rows[[octaves.argmin()]], np.ones(1))
