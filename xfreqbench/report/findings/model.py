"""What a method reports that it has learned: planes, what they are made of, and images of transmitters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from xfreqbench.scene.materials import Material, complex_permittivity
from xfreqbench.tracing.image.kernels import slab_coefficients
from xfreqbench.types import FloatArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, VACUUM_PERMITTIVITY_F_M

MAX_IMAGE_ORDER = 2

TrueSlab = tuple[Material, float]  # a material, and the thickness in metres
Number = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Number, Number, Number]


class _Stored(BaseModel):
    model_config = ConfigDict(frozen=True)


class FoundSlab(_Stored):
    """A slab that fills a `share` of a plane: ε′ is constant, σ = c f^d with f in GHz."""

    share: Number
    permittivity: Number
    conductivity_s_m: Number
    conductivity_power: Number
    thickness_m: Number

    def permittivity_at(self, carrier_hz: float) -> complex:
        """Complex relative permittivity ε′ − jσ/(2πf·ε₀) (ITU-R P.2040, Eq. 9)."""
        conductivity_s_m = self.conductivity_s_m * (carrier_hz / 1e9) ** self.conductivity_power
        return complex(
            self.permittivity, -conductivity_s_m / (2 * np.pi * carrier_hz * VACUUM_PERMITTIVITY_F_M)
        )


class FoundPlane(_Stored):
    """A plane that was found; `normal` points from the array centre to it, in world axes.

    The method divides a plane into cells: `held` is the share of the cells touched by paths that hold something,
    and `corners_m` are the corners, in turn, of the rectangle around those, None where no cell holds anything.
    """

    normal: Vector
    distance_m: Number
    distance_std_m: Number
    tilt_std_rad: Number
    held: Number
    corners_m: tuple[Vector, Vector, Vector, Vector] | None
    slabs: tuple[FoundSlab, ...]

    @property
    def unit_normal(self) -> Float[FloatArray, "3"]:
        """`normal`, of length 1."""
        return np.array(self.normal) / np.linalg.norm(self.normal)


class FoundFace(_Stored):
    """A part of a plane that one of its slabs fills: a convex polygon, its corners in turn, in world axes.

    `seen` is the share of it that paths of the training rows tell of, and `is_wall` says that it bounds the room.
    """

    plane: int
    slab: int
    corners_m: Annotated[tuple[Vector, ...], Field(min_length=3)]
    seen: Number
    is_wall: bool


class FoundImage(_Stored):
    """Images of transmitters in a sequence of planes; `power` is relative to the line of sight."""

    planes: tuple[int, ...]
    power: Number


class StoredFindings(_Stored):
    """What a method with planes and images stores in its record; the strongest images come first."""

    planes: tuple[FoundPlane, ...]
    receiver_m: Vector
    images: tuple[FoundImage, ...]
    faces: tuple[FoundFace, ...] = ()  # absent in records written before they were found

    @model_validator(mode="after")
    def _planes_and_images_exist(self) -> StoredFindings:
        if not all(any(plane.normal) for plane in self.planes):
            raise ValueError("a plane's normal is the zero vector")
        if any(not 0 <= index < len(self.planes) for image in self.images for index in image.planes):
            raise ValueError(f"an image names a plane that is not among the {len(self.planes)}")
        for face in self.faces:
            if not 0 <= face.plane < len(self.planes) or not 0 <= face.slab < len(
                self.planes[face.plane].slabs
            ):
                raise ValueError(f"a face names slab {face.slab} of plane {face.plane}, which is not there")
        return self

    @property
    def array_m(self) -> Float[FloatArray, "3"]:
        """Position of the array centre."""
        return np.array(self.receiver_m)


@dataclass(frozen=True, eq=False)
class Reflection:
    """Magnitude of the reflection coefficient at normal incidence, as learned and by ITU-R P.2040."""

    carrier_hz: Float[FloatArray, "F"]
    learned: Float[FloatArray, "F"]
    truth: Float[FloatArray, "F"]

    @property
    def difference(self) -> Float[FloatArray, "F"]:
        """Distance between the two magnitudes, at each carrier."""
        return np.abs(self.learned - self.truth)


@dataclass(frozen=True, eq=False)
class ImageSource:
    """Where a transmitter seems to be after it is mirrored in found planes, given in the order of the bounces."""

    planes: tuple[int, ...]
    power: float
    position_m: Float[FloatArray, "3"]


def reflection(
    slabs: Sequence[FoundSlab], truth: Mapping[TrueSlab, float], carrier_hz: Float[FloatArray, "F"]
) -> Reflection:
    """|R| of learned slabs and of true ones, each mixed by shares; what the shares leave open reflects nothing."""
    learned = [
        slab.share
        * _coefficient([slab.permittivity_at(f) for f in carrier_hz.tolist()], slab.thickness_m, carrier_hz)
        for slab in slabs
    ]
    true = [share * true_coefficient(slab, carrier_hz) for slab, share in truth.items()]
    nothing = np.zeros(len(carrier_hz), dtype=np.complex128)
    return Reflection(carrier_hz, np.abs(sum(learned, nothing)), np.abs(sum(true, nothing)))


def true_coefficient(
    slab: TrueSlab, carrier_hz: Float[FloatArray, "F"]
) -> Complex[NDArray[np.complex128], "F"]:
    """R of a P.2040 slab at normal incidence; the material's power laws are extrapolated beyond their band."""
    material, thickness_m = slab
    permittivity = [complex_permittivity(material, f, "extrapolate") for f in carrier_hz.tolist()]
    return _coefficient(permittivity, thickness_m, carrier_hz)


def virtual_sources(findings: StoredFindings, tx_position_m: Float[FloatArray, "3"]) -> list[ImageSource]:
    """Images of a transmitter after 1 to `MAX_IMAGE_ORDER` bounces, the strongest first."""
    return [
        ImageSource(image.planes, image.power, _image_m(findings, image.planes, tx_position_m))
        for image in findings.images
        if 0 < len(image.planes) <= MAX_IMAGE_ORDER
    ]


def _coefficient(
    permittivity: Sequence[complex], thickness_m: float, carrier_hz: Float[FloatArray, "F"]
) -> Complex[NDArray[np.complex128], "F"]:
    phase_thickness = 2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S * thickness_m
    pairs = zip(permittivity, phase_thickness.tolist(), strict=True)
    return np.array([slab_coefficients(1.0, eta, thickness)[0] for eta, thickness in pairs])


def _image_m(
    findings: StoredFindings, planes: Sequence[int], position_m: Float[FloatArray, "3"]
) -> Float[FloatArray, "3"]:
    for plane in (findings.planes[index] for index in planes):
        beyond_m = plane.unit_normal @ (position_m - findings.array_m) - plane.distance_m
        position_m = position_m - 2 * beyond_m * plane.unit_normal
    return position_m
