"""Trivial predictor: the array's beam pattern of one plane wave from the transmitter's known position."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.array import steering_vector
from xfreqbench.transmitters import TransmitterLookup
from xfreqbench.units import SPEED_OF_LIGHT_M_S


class LineOfSight(TransmitterLookup):
    """Knows the receiver's array and place, and nothing of the room; every carrier looks the same."""

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """Bartlett maps (Eqs. 2–3) of lone plane waves."""
        train = self.transmitters.train
        receiver = train.header.receiver
        offset_m = (tx_position_m - np.asarray(receiver.position_m)) @ receiver.rotation  # in its frame
        arrival = offset_m / np.linalg.norm(offset_m, axis=1, keepdims=True)
        # Positions in wavelengths are positions in metres at a wavelength of one metre.
        wave = steering_vector(train.beam.element_position_wavelengths, arrival, SPEED_OF_LIGHT_M_S)
        return train.beam.maps(wave, train.header.pas_kind)[0]
