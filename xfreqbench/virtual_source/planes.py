"""Reflecting planes about an array, and the mirror images that they make.

A path by one reflection is as long as the straight line from the transmitter to the receiver's mirror image,
and arrives from where the transmitter's mirror image is. A plane that does not pass through the receiver is
told by the former alone, one point in space: half as far and in the same direction lies the plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from xfreqbench.angles import FloatArray


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane in the world's axes, seen from the array centre.

    `normal` is the unit vector from the array centre to the nearest point of the plane, `distance_m` > 0 how
    far that is. `distance_std_m` and `tilt_std_rad` are standard deviations of both, the latter in the worst
    direction. `evidence` says how much each carrier, ascending, speaks for the plane, an exponential variable of
    mean 1 where there is none; `score` is the sum in which no carrier counts for more than twice their median.
    """

    normal: Float[FloatArray, "3"]
    distance_m: float
    distance_std_m: float
    tilt_std_rad: float
    evidence: Float[FloatArray, "F"]
    score: float

    @property
    def mirrored_receiver_m(self) -> Float[FloatArray, "3"]:
        """The mirror image of the array centre, from the array centre."""
        return 2 * self.distance_m * self.normal

    def mirrored(self, offset_m: Float[FloatArray, "... 3"]) -> Float[FloatArray, "... 3"]:
        """The mirror images of points; both are told from the array centre, in the world's axes."""
        return mirrored(offset_m, self.mirrored_receiver_m)


def mirrored(
    offset_m: Float[FloatArray, "... 3"], mirrored_receiver_m: Float[FloatArray, "3"]
) -> Float[FloatArray, "... 3"]:
    """Images of points in the plane that puts the array centre's own image at `mirrored_receiver_m`, not 0."""
    share = offset_m @ mirrored_receiver_m / (mirrored_receiver_m @ mirrored_receiver_m)
    return offset_m + (1 - 2 * share[..., None]) * mirrored_receiver_m


def plane_of(
    mirrored_receiver_m: Float[FloatArray, "3"],
    covariance_m2: Float[FloatArray, "3 3"],
    evidence: Float[FloatArray, "F"],
    score: float,
) -> Plane:
    """The plane that puts the array centre's image at a point, which is known up to a covariance."""
    twice_m = float(np.linalg.norm(mirrored_receiver_m))
    normal = mirrored_receiver_m / twice_m
    across = np.eye(3) - np.outer(normal, normal)
    distance_variance = float(normal @ covariance_m2 @ normal) / 4
    tilt_variance = float(np.linalg.eigvalsh(across @ covariance_m2 @ across)[-1]) / twice_m**2
    return Plane(
        normal,
        twice_m / 2,
        max(distance_variance, 0.0) ** 0.5,
        max(tilt_variance, 0.0) ** 0.5,
        evidence,
        score,
    )
