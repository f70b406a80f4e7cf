"""Reflecting planes around an array, and the mirror images that they make.

A path with one reflection is as long as the straight line from the transmitter to the mirror image of the
receiver, and it arrives from the direction of the transmitter's mirror image. The mirror image of the receiver
alone, one point in space, therefore says which plane it is: the plane lies in the same direction, half as far
away. Only a plane through the receiver itself cannot be described in this way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from xfreqbench.types import FloatArray

Vector = Float[FloatArray, "3"]  # a position in metres, or a direction, along the axes of the world

Points = Float[FloatArray, "N 3"]  # positions in metres


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane relative to the array centre, in world axes.

    `normal` is the unit vector from the array centre to the nearest point of the plane, `distance_m` > 0 the
    distance to that point. `distance_std_m` and `tilt_std_rad` are the standard deviations of both; the tilt's is
    that in the worst direction. `score` says how much the training maps speak for the plane; see the functions
    that make planes.
    """

    normal: Vector
    distance_m: float
    distance_std_m: float
    tilt_std_rad: float
    score: float


def mirrored(offset_m: Float[FloatArray, "... 3"], mirrored_receiver_m: Vector) -> Float[FloatArray, "... 3"]:
    """Mirror images of points in the plane that puts the array centre's own image at `mirrored_receiver_m`, not 0."""
    share = offset_m @ mirrored_receiver_m / (mirrored_receiver_m @ mirrored_receiver_m)
    return offset_m + (1 - 2 * share[..., None]) * mirrored_receiver_m


def plane_of(mirrored_receiver_m: Vector, covariance_m2: Float[FloatArray, "3 3"], score: float) -> Plane:
    """The plane that puts the array centre's image at a point with this covariance."""
    twice_m = float(np.linalg.norm(mirrored_receiver_m))
    normal = mirrored_receiver_m / twice_m
    across = np.eye(3) - np.outer(normal, normal)
    distance_variance = float(normal @ covariance_m2 @ normal) / 4
    tilt_variance = float(np.linalg.eigvalsh(across @ covariance_m2 @ across)[-1]) / twice_m**2
    return Plane(normal, twice_m / 2, max(distance_variance, 0.0) ** 0.5, max(tilt_variance, 0.0) ** 0.5, score)
