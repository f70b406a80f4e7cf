"""Reflection of what a method has learned, beside the truth, and its images of transmitters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from xfreqbench.scene.materials import Material, complex_permittivity
from xfreqbench.tracing.image.kernels import slab_coefficients
from xfreqbench.types import FloatArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

from ..stored import FoundSlab, StoredFindings

MAX_IMAGE_ORDER = 2

TrueSlab = tuple[Material, float]  # a material, and the thickness in metres


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
    permittivity = [true_permittivity(material, f) for f in carrier_hz.tolist()]
    return _coefficient(permittivity, thickness_m, carrier_hz)


def true_permittivity(material: Material, carrier_hz: float) -> complex:
    """Complex relative permittivity by P.2040, whose power laws are extrapolated beyond a material's band."""
    return complex_permittivity(material, carrier_hz, "extrapolate")


def reflection_over_angle(
    permittivity: complex, thickness_m: float, carrier_hz: float, angle_rad: Float[FloatArray, "A"]
) -> Float[FloatArray, "2 A"]:
    """|R| of a slab, TE and TM, at angles of incidence from the normal (ITU-R P.2040, Eqs. 37, 43, 44)."""
    turn = 2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S * thickness_m
    pairs = [slab_coefficients(cosine, permittivity, turn)[:2] for cosine in np.cos(angle_rad).tolist()]
    return np.abs(np.array(pairs)).T


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
