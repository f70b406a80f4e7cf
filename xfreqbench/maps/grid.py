"""The angular grid of maps: directions of a hemisphere in the receiver's own frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from xfreqbench.errors import ArgumentError
from xfreqbench.types import FloatArray


@dataclass(frozen=True)
class AngularGrid:
    """Directions of a PAS: E elevations above the equator by A azimuths, in the receiver's frame.

    Elevation β is the angle above the equator of the hemisphere, whose pole is the frame's +z (polar
    angle θ = 90° − β); azimuth α is periodic and half-open. Row 0 of a map is `elevation_rad[0]`.
    """

    elevation_rad: Float[FloatArray, "E"]
    azimuth_rad: Float[FloatArray, "A"]

    def __post_init__(self) -> None:
        """Angles may be given as lists; raises `ArgumentError` for what is not a list of numbers."""
        for name in ("elevation_rad", "azimuth_rad"):
            try:
                angles = np.asarray(getattr(self, name), np.float64)
            except (TypeError, ValueError):
                angles = np.zeros(())
            if angles.ndim != 1:
                raise ArgumentError(f"A grid's {name} is a list of angles, but got {getattr(self, name)!r}.")
            object.__setattr__(self, name, angles)

    @classmethod
    def hemisphere(cls, num_elevations: int = 90, num_azimuths: int = 360) -> AngularGrid:
        """The grid of generated data: by default β = 0°…89° and α = 0°…359°, one degree apart, both half-open."""
        return cls(
            np.arange(num_elevations, dtype=np.float64) * (np.pi / 2 / num_elevations),
            np.arange(num_azimuths, dtype=np.float64) * (2 * np.pi / num_azimuths),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(E, A)."""
        return len(self.elevation_rad), len(self.azimuth_rad)

    @cached_property
    def directions(self) -> Float[FloatArray, "E A 3"]:
        """Unit vectors (cos β cos α, cos β sin α, sin β) in the receiver's frame, at elevation β and azimuth α."""
        elevation, azimuth = np.broadcast_arrays(self.elevation_rad[:, None], self.azimuth_rad[None, :])
        horizontal = np.cos(elevation)
        return np.stack([horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), np.sin(elevation)], axis=-1)
