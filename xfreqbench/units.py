"""Physical constants, and the only place where texts become numbers and gigahertz become hertz."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf
from typing import TypeVar

SPEED_OF_LIGHT_M_S = 299_792_458.0
VACUUM_PERMITTIVITY_F_M = 8.8541878128e-12  # CODATA 2018

MAX_CARRIER_GHZ = 1000.0
PAPER_CARRIERS_GHZ = (1.0, 2.4, 5.0, 10.0, 24.25, 37.0, 47.0, 60.0, 77.0, 94.0)
Number = TypeVar("Number", int, float)


def parse_number(text: str, kind: type[Number] = float) -> Number:  # type: ignore[assignment]
    """The finite number that a text shows in decimal digits, with a decimal point and an exponent unless it is an int.

    Raises `ValueError` for every other text, and also for `1_0`, which Python would take for 10.
    """
    number = kind(text)
    if "_" in text or not text.isascii() or not abs(number) < inf:
        raise ValueError(f"{text!r} is not a finite number in decimal digits")
    return number


def ghz_to_hz(carrier_ghz: float) -> float:
    """Carrier in hertz, rounded to the hertz so that 24.25 GHz is the same number everywhere.

    Raises `ValueError` for a carrier below a hertz or not finite, and for one above `MAX_CARRIER_GHZ`, which was
    probably given in another unit.
    """
    if not 1e-9 <= carrier_ghz < inf:
        raise ValueError(f"a carrier in GHz is a number above 0, as in 24.25, and not {carrier_ghz:g}")
    if carrier_ghz > MAX_CARRIER_GHZ:
        units = (("MHz", 1e3), ("kHz", 1e6), ("hertz", 1e9))  # the first in which it is at most 100 GHz
        unit, of_ghz = next((unit for unit in units if carrier_ghz <= 100 * unit[1]), units[-1])
        raise ValueError(
            f"a carrier in GHz is at most {MAX_CARRIER_GHZ:,.0f}, and not {carrier_ghz:g}. Was that {unit}? Then it is "
            f"{carrier_ghz / of_ghz:g} GHz"
        )
    return float(round(carrier_ghz * 1e9))


def format_ghz(carrier_hz: float) -> str:
    """Carrier as a user writes it: `24.25 GHz`."""
    return format_ghz_list([carrier_hz])


def format_ghz_list(carrier_hz: Iterable[float]) -> str:
    """Carriers as a user writes them, to the hertz: `60, 94 GHz`."""
    return ", ".join(f"{carrier / 1e9:.12g}" for carrier in carrier_hz) + " GHz"


def band_text(low_hz: float, high_hz: float) -> str:
    """A band of carriers as text: `2.4 to 77 GHz`, or one carrier where both ends are the same."""
    return format_ghz(low_hz) if low_hz == high_hz else f"{low_hz / 1e9:.12g} to {format_ghz(high_hz)}"


def format_point(point_m: Iterable[float]) -> str:
    """A place as text, in metres to the millimetre, however far from the origin: `(691608.25, 5334762.5, 1.2)`."""
    return f"({', '.join(f'{round(coordinate, 3):.10g}' for coordinate in point_m)})"
