"""Trivial predictor: the map of the nearest training transmitter at the nearest training carrier."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.methods.lookup import TransmitterLookup
from xfreqbench.types import FloatArray


class Nearest(TransmitterLookup):
    """Copies the map of the nearest transmitter at the nearest carrier on a logarithmic axis."""

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """For each query, one stored map."""
        maps = []
        for position_m, each_hz in zip(tx_position_m, carrier_hz, strict=True):
            rows = self.transmitters.rows(self.transmitters.nearest(position_m))
            octaves = np.abs(np.log2(self.transmitters.train.carrier_hz[rows] / each_hz))
            maps.append(self.transmitters.blend(rows[[octaves.argmin()]], np.ones(1)))
        return np.stack(maps)
