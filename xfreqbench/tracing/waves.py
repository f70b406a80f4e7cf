"""The channel of single paths at the elements of an array."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex

from xfreqbench.scene.model import ReceiverArray
from xfreqbench.tracing.paths import Paths, element_delays_s
from xfreqbench.types import NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S


def spherical_waves(paths: Paths, carrier: int, receiver: ReceiverArray) -> Complex[NDArray[np.complex128], "P M"]:
    """Channel of each path at the array's elements, as one spherical wave.

    The wave comes from the path's source as the array centre sees it; power and polarisation are those at the
    centre for all elements. `carrier` is an index into the paths' carriers.
    """
    carrier_hz = float(paths.carrier_hz[carrier])
    element_m = receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz) - np.asarray(receiver.position_m)
    turns = carrier_hz * element_delays_s(paths.delay_s, paths.arrival, element_m)
    return paths.gain[carrier][:, None] * np.exp(-2j * np.pi * turns)
