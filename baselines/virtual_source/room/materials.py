"""The material of ITU-R P.2040 that reflects most as a learned slab does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex
from numpy.typing import NDArray

from xfreqbench.scene.materials import complex_permittivity, materials_defined_at
from xfreqbench.tracing.image.kernels import slab_coefficients
from xfreqbench.units import SPEED_OF_LIGHT_M_S

from ..stored import FoundSlab

_WORSE = 0.05  # by which a slab may be farther from what was learned than the nearest one
METAL_THICKNESS_M = 0.002  # what is behind the surface of a metal does not matter
_COSINES = np.linspace(0.1, 1.0, 7)  # of the angles of incidence that are compared
_THICKNESSES = np.linspace(0.9, 1.1, 41)  # in units of the one that delays a wave as the learned slab does


class NamedSlab(NamedTuple):
    """A slab of a P.2040 material, and how far its reflection is from a learned one's.

    `distance` is the root mean square of |ΔR| over carriers, angles of incidence and both polarisations.
    """

    material: str
    thickness_m: float
    distance: float

    def thinned(self, factor: float) -> NamedSlab:
        """The same of another thickness."""
        return self._replace(thickness_m=self.thickness_m * factor)


@dataclass(frozen=True, eq=False)
class SlabNames:
    """Names learned slabs after the materials that P.2040 defines at all of the carriers, vacuum aside."""

    carrier_hz: Sequence[float]

    @cached_property
    def materials(self) -> list[str]:
        """The names of these materials."""
        return [name for name in materials_defined_at(self.carrier_hz) if name != "vacuum"]

    def nearest(self, slab: FoundSlab) -> list[NamedSlab]:
        """Every material with the thickness at which it is nearest to the slab, the nearest material first."""
        permittivity = np.array([slab.permittivity_at(carrier) for carrier in self.carrier_hz])
        learned = self._reflection(permittivity, slab.thickness_m)
        named = []
        for material in self.materials:
            own = np.array([complex_permittivity(material, carrier) for carrier in self.carrier_hz])
            scale = np.sqrt(permittivity.real.mean() / own.real.mean())
            metres = [METAL_THICKNESS_M] if material == "metal" else slab.thickness_m * scale * _THICKNESSES
            distances = [
                np.sqrt((np.abs(self._reflection(own, each) - learned) ** 2).mean()) for each in metres
            ]
            best = int(np.argmin(distances))
            named.append(NamedSlab(material, float(metres[best]), float(distances[best])))
        return sorted(named, key=lambda each: each.distance)

    def _reflection(
        self, permittivity: Complex[NDArray[np.complex128], "F"], thickness_m: float
    ) -> Complex[NDArray[np.complex128], "F C 2"]:
        """Coefficients TE and TM at every carrier and angle of incidence."""
        phase = 2 * np.pi * np.asarray(self.carrier_hz) / SPEED_OF_LIGHT_M_S * thickness_m
        return np.array(
            [
                [slab_coefficients(cosine, eta, turn)[:2] for cosine in _COSINES.tolist()]
                for eta, turn in zip(permittivity.tolist(), phase.tolist(), strict=True)
            ]
        )


def likely_slabs(nearest: Sequence[NamedSlab]) -> list[NamedSlab]:
    """Slabs that may be the learned one, of all the nearest first: those about as near as that one, and metal."""
    return [
        each for each in nearest if each.distance < nearest[0].distance + _WORSE or each.material == "metal"
    ]
