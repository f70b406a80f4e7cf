"""Trivial predictor: the array's beam pattern of one plane wave from the transmitter's known position."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from xfreqbench.methods.lookup import TransmitterLookup
from xfreqbench.scene.array import steering_vector
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S


class LineOfSight(TransmitterLookup):
    """Knows the receiver's array and position, and nothing of the room; all carriers have the same map."""

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """Bartlett maps (Eqs. 2–3) of a plane wave from each transmitter."""
        asked = self.transmitters.asked
        receiver = asked.header.receiver
        offset_m = (tx_position_m - np.asarray(receiver.position_m)) @ receiver.rotation  # in its frame
        arrival = offset_m / np.linalg.norm(offset_m, axis=1, keepdims=True)
        # positions in wavelengths are positions in metres at a wavelength of one metre
        wave = steering_vector(asked.beam.element_position_wavelengths, arrival, SPEED_OF_LIGHT_M_S)
        return asked.beam.maps(wave, asked.header.pas_kind)[0]
