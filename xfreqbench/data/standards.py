"""What standards and measurement campaigns say of indoor channels, beside which a data set's statistics are put.

All of them are medians: of 3GPP TR 38.901 V19 (Tables 7.4.1-1, 7.5-6 and 7.5-10, indoor office), of Recommendation
ITU-R P.1238 (site-general model, office), of the mmMAGIC project (deliverable D2.2, 6 to 100 GHz, indoor), and of
small rooms: the delay spread by the rule of 38.901 for a hall of given volume and surface, and the decay of room
electromagnetics. Distances are in metres, carriers in hertz.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from xfreqbench.types import FloatArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

# (in sight, not in sight): a and b of log10(value) = a + b·log10(1 + f), f in GHz; spreads in seconds and degrees
TR38901_SPREADS: Mapping[str, tuple[tuple[float, float], tuple[float, float]]] = MappingProxyType(
    {
        "lgDS": ((-7.692, -0.01), (-7.173, -0.28)),
        "lgASD": ((1.60, 0.0), (1.62, 0.0)),
        "lgASA": ((1.781, -0.19), (1.863, -0.11)),
        "lgZSD": ((2.228, -1.43), (1.08, 0.0)),
        "lgZSA": ((1.44, -0.26), (1.387, -0.15)),
    }
)
MMMAGIC_SPREADS: Mapping[str, tuple[tuple[float, float], tuple[float, float]]] = MappingProxyType(
    {"lgDS": ((-7.75, -0.13), (-7.58, -0.01)), "lgASA": ((2.09, -0.24), TR38901_SPREADS["lgASA"][1])}
)
TR38901_K_DB = 7.0  # in sight


def tr38901_path_loss_db(
    distance_m: Float[FloatArray, "n"], carrier_hz: float, in_sight: bool
) -> Float[FloatArray, "n"]:
    """Path loss in an office by 3GPP TR 38.901, Table 7.4.1-1 (InH), for 1 to 150 m and .5 to 100 GHz."""
    decades, carrier = np.log10(distance_m), np.log10(carrier_hz / 1e9)
    seen = 32.4 + 17.3 * decades + 20 * carrier
    return seen if in_sight else np.maximum(seen, 17.3 + 38.3 * decades + 24.9 * carrier)


def p1238_path_loss_db(distance_m: Float[FloatArray, "n"], carrier_hz: float, in_sight: bool) -> Float[FloatArray, "n"]:
    """Path loss in an office by ITU-R P.1238, 10·α·log10(d) + β + 10·γ·log10(f), for 2 to 27 m and .3 to 83.5 GHz."""
    alpha, beta, gamma = (1.46, 34.62, 2.03) if in_sight else (2.46, 29.53, 2.38)
    return np.asarray(10 * alpha * np.log10(distance_m) + beta + 10 * gamma * np.log10(carrier_hz / 1e9))


def spread_by(
    table: Mapping[str, tuple[tuple[float, float], tuple[float, float]]], name: str, carrier_hz: float, in_sight: bool
) -> float:
    """The median spread of a table above, in seconds or degrees; nan where it has none of that name.

    Below 6 GHz, 38.901 takes that of 6 GHz indoors.
    """
    if name not in table:
        return float("nan")
    constant, slope = table[name][0 if in_sight else 1]
    carrier_ghz = carrier_hz / 1e9 if table is not TR38901_SPREADS else max(6.0, carrier_hz / 1e9)
    return float(10 ** (constant + slope * np.log10(1 + carrier_ghz)))


def mmmagic_k_db(carrier_hz: float) -> float:
    """Power of the direct path over that of all others, in dB, by mmMAGIC D2.2: 4.9 + 5·log10(1 + f)."""
    return float(4.9 + 5 * np.log10(1 + carrier_hz / 1e9))


def small_room_delay_spread_s(volume_m3: float, surface_m2: float) -> float:
    """The delay spread of a room by its size: 10^(log10(26·V/S + 14) − 9.35), by 38.901 for factory halls (InF)."""
    return float((26 * volume_m3 / surface_m2 + 14) * 10**-9.35)


def room_decay_s(volume_m3: float, surface_m2: float, absorption: float) -> float:
    """Time in which the diffuse power of a room falls by 1/e, 4V / (c·η·S): η is the mean absorption of its surface.

    It is the rms delay spread of a channel that decays so from its beginning (Andersen et al., 2007); infinite where
    nothing is absorbed.
    """
    return float(4 * volume_m3 / (SPEED_OF_LIGHT_M_S * surface_m2 * absorption)) if absorption else float("inf")
