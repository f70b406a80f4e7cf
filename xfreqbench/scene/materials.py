"""Frequency-dispersive building materials of Recommendation ITU-R P.2040-4 (September 2025, Table 3).

Relative permittivity is ε' = a·f^b and conductivity σ = c·f^d in S/m, with f in GHz. The table is here and not
only in Sionna RT, so that a scene can be checked, and traced by the image method, without loading Sionna; a
test compares it with Sionna's. A scene's own materials are added to them; they are the same at every carrier.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Complex
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass as pydantic_dataclass

from xfreqbench.errors import MaterialBandError, UnknownNameError
from xfreqbench.system.arguments import CarriersGhz, checked, only_given
from xfreqbench.types import NDArray
from xfreqbench.units import VACUUM_PERMITTIVITY_F_M, format_ghz_list, ghz_to_hz

MaterialPolicy = Literal["error", "extrapolate"]
P2040_EDITION = "P.2040-4"  # of `ITU_MATERIALS`; who changes values raises `PHYSICS_VERSION` too
MAX_THICKNESS_M, MAX_PERMITTIVITY, MAX_CONDUCTIVITY_S_M = (1e3, 1e6, 1e9)  # Sionna RT's float32 holds their fields
Thickness = Annotated[float, Field(gt=0, le=MAX_THICKNESS_M, allow_inf_nan=False)]
DEFAULT_THICKNESS_M = 0.1  # of a material that states none, as in Sionna RT


@dataclass(frozen=True)
class Band:
    """One row of the table: the band in GHz and the four constants of P.2040."""

    low_ghz: float
    high_ghz: float
    a: float
    b: float
    c: float
    d: float

    def contains(self, carrier_hz: float) -> bool:
        """Whether P.2040 defines the material at this carrier."""
        return self.low_ghz <= carrier_hz / 1e9 <= self.high_ghz


@dataclass(frozen=True)
class ConstantMaterial:
    """A material that a scene defines itself: one permittivity ε' and one conductivity σ at every carrier."""

    name: str
    relative_permittivity: float
    conductivity_s_m: float

    def __str__(self) -> str:
        return self.name

    @property
    def band(self) -> Band:
        """The material as a row of P.2040's table, without an edge and without dispersion."""
        return Band(0.0, math.inf, self.relative_permittivity, 0, self.conductivity_s_m, 0)


Material = str | ConstantMaterial  # P.2040's by name, or a scene's own


class Layer(NamedTuple):
    """A layer of a slab."""

    material: Material
    thickness_m: float


@dataclass(frozen=True)
class LayeredMaterial:
    """A slab of several layers in contact, the first at its front; its thickness is theirs."""

    name: str
    layers: tuple[Layer, ...]

    def __str__(self) -> str:
        return self.name

    @property
    def thickness_m(self) -> float:
        """Thickness of all layers together."""
        return math.fsum(layer.thickness_m for layer in self.layers)

    @property
    def turned(self) -> LayeredMaterial:
        """The same with its back to the front."""
        return replace(self, layers=self.layers[::-1])


SlabMaterial = Material | LayeredMaterial
ScatteringPattern = Literal["lambertian", "directive", "backscattering"]
_PATTERN_NUMBERS = ("alpha_r", "alpha_i", "lambda_")  # the directive pattern has only the first


@pydantic_dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Scattering:
    """How a rough surface reflects diffusely (Degli-Esposti et al., 2007), which P.2040 does not say.

    `coefficient` S is the share of the reflected field that is scattered: S² of the reflected power, and the specular
    reflection keeps 1 − S². `xpd_coefficient` is the share of the scattered power that changes its polarisation.
    `pattern` is where it goes: by Lambert's law, in a lobe about the specular direction, the narrower the larger
    `alpha_r`, or in that and one back to the source, of width `alpha_i`, which share the power as `lambda_` to
    1 − `lambda_`.
    """

    coefficient: Annotated[float, Field(ge=0, le=1)]
    xpd_coefficient: Annotated[float, Field(ge=0, le=1)] = 0.0
    pattern: ScatteringPattern = "lambertian"
    alpha_r: Annotated[int, Field(ge=1, le=100)] | None = None
    alpha_i: Annotated[int, Field(ge=1, le=100)] | None = None
    lambda_: Annotated[float, Field(ge=0, le=1)] | None = None

    @model_validator(mode="after")
    def _has_the_numbers_of_its_pattern(self) -> Scattering:
        number = {"lambertian": 0, "directive": 1, "backscattering": 3}[self.pattern]
        wanted, stated = list(_PATTERN_NUMBERS[:number]), list(self.pattern_numbers)
        if stated != wanted:
            raise ValueError(
                f"the pattern {self.pattern!r} has {' and '.join(wanted) or 'no numbers'}, but "
                f"{' and '.join(stated) or 'none'} is stated"
            )
        return self

    @property
    def stated(self) -> dict[str, Any]:
        """Fields by name, without the numbers that the pattern does not have."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    @property
    def pattern_numbers(self) -> dict[str, float]:
        """The numbers of the pattern, by name."""
        return {name: value for name, value in self.stated.items() if name in _PATTERN_NUMBERS}


# Rows are in Sionna's order: where bands overlap, the first one that contains the carrier is used.
ITU_MATERIALS: dict[str, tuple[Band, ...]] = {
    "vacuum": (Band(0.001, 100, 1.0, 0, 0, 0),),
    "concrete": (Band(1, 100, 5.24, 0, 0.0462, 0.7822), Band(110, 330, 5.17, 0, 0.0145, 1.09)),
    "brick": (Band(1, 40, 3.91, 0, 0.0238, 0.16), Band(110, 330, 4.15, 0, 0.0006, 1.5712)),
    "plasterboard": (
        Band(1, 100, 2.73, 0, 0.0085, 0.9395),
        Band(110, 330, 2.56, 0, 0.0001, 1.7799),
        Band(100, 400, 2.65, 0, 0.0002, 1.598),
    ),
    "wood": (
        Band(0.001, 100, 1.99, 0, 0.0047, 1.0718),
        Band(110, 330, 1.82, 0, 0.0040, 1.0761),
        Band(100, 400, 2.1183, 0, 0.0055, 1.1113),
    ),
    "glass": (
        Band(0.1, 100, 6.31, 0, 0.0036, 1.3394),
        Band(220, 450, 5.79, 0, 0.0004, 1.658),
        Band(100, 400, 6.5767, 0, 0.0012, 1.4697),
    ),
    "clear_acrylic": (Band(110, 330, 2.58, 0, 0.0001, 1.6524),),
    "ceiling_board": (
        Band(1, 100, 1.48, 0, 0.0011, 1.0750),
        Band(220, 450, 1.52, 0, 0.0029, 1.029),
        Band(100, 400, 1.2567, 0, 0.00013, 1.454),
    ),
    "chipboard": (Band(1, 100, 2.58, 0, 0.0217, 0.78), Band(100, 200, 2.16, 0, 0.0023, 1.359)),
    "plywood": (
        Band(1, 40, 2.71, 0, 0.33, 0),
        Band(110, 330, 1.94, 0, 0.0067, 0.9982),
        Band(100, 400, 2.17, 0, 0.0063, 1.045),
    ),
    "marble": (
        Band(1, 60, 7.074, 0, 0.0055, 0.9262),
        Band(110, 330, 7.94, 0, 0.0001, 1.7330),
        Band(100, 400, 8.62, 0, 0.0027, 1.15),
    ),
    "floorboard": (
        Band(50, 100, 3.66, 0, 0.0044, 1.3515),
        Band(220, 300, 5.27, 0, 2.22e-17, 7.3413),
        Band(300, 400, 5.27, 0, 0.0003, 2.0298),
        Band(400, 450, 5.27, 0, 49.8726, 0),
        Band(100, 400, 3.1575, 0, 0.001675, 1.32775),
    ),
    "vinyl_tile": (Band(1, 40, 3.62, 0, 0.0051, 0.8422),),
    "carpet_tile": (Band(1, 40, 2.08, 0, 0.0009, 0.82),),
    "asphalt_concrete": (Band(1, 40, 4.83, 0, 0.0108, 1.3969),),
    "metal": (Band(1, 100, 1, 0, 1e7, 0),),
    "very_dry_ground": (Band(1, 10, 3, 0, 0.00015, 2.52),),
    "medium_dry_ground": (Band(1, 10, 15, -0.1, 0.035, 1.63),),
    "wet_ground": (Band(1, 10, 30, -0.4, 0.15, 1.3),),
}


def material_bands(material: Material) -> tuple[Band, ...]:
    """Rows of P.2040's table for a material, or the one of a constant material; raises `UnknownNameError`."""
    if isinstance(material, ConstantMaterial):
        return (material.band,)
    if material not in ITU_MATERIALS:
        raise UnknownNameError("ITU-R P.2040 material", material, [*ITU_MATERIALS, *PRESETS])
    return ITU_MATERIALS[material]


@contextmanager
def faults_named(what: str) -> Iterator[None]:
    """A block of a pydantic validator in which an unknown name becomes a `ValueError` that begins with `what`."""
    try:
        yield
    except UnknownNameError as error:
        raise ValueError(f"{what}: {error}") from error


@pydantic_dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class SceneLayer:
    """A layer of a material: a material of P.2040 (`vacuum` for air), or of the scene, that has no layers itself."""

    material: str
    thickness_m: Thickness


@pydantic_dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class SceneMaterial:
    """A material under a name that the scene's surfaces, or its mesh file, use for it.

    It is `itu`, a material of ITU-R P.2040, by default the one of the same name; or it has a relative permittivity
    and a conductivity of its own, which are the same at every carrier; or it has `layers`, from the front of a surface
    to its back. `thickness_m` is that of imported meshes: a surface states its own, and layers have theirs.
    `scattering` says how rough it is; without it, nothing is reflected diffusely.
    """

    name: str
    itu: str | None = None
    relative_permittivity: Annotated[float, Field(ge=1, le=MAX_PERMITTIVITY, allow_inf_nan=False)] | None = None
    conductivity_s_m: Annotated[float, Field(ge=0, le=MAX_CONDUCTIVITY_S_M, allow_inf_nan=False)] | None = None
    thickness_m: Thickness | None = None
    scattering: Scattering | None = None
    layers: Annotated[tuple[SceneLayer, ...], Field(min_length=1, max_length=32)] | None = None

    _json = only_given

    @model_validator(mode="after")
    def _is_one_material(self) -> SceneMaterial:
        is_own = self.relative_permittivity is not None
        if self.layers is not None:
            others = ("itu", "relative_permittivity", "conductivity_s_m", "thickness_m")
            stated = [name for name in others if getattr(self, name) is not None]
            if stated:
                raise ValueError(f"material {self.name!r} has layers and {' and '.join(stated)}; give one of them")
            return self
        if is_own and self.itu is not None:
            raise ValueError(
                f"material {self.name!r} is {self.itu!r} and has a relative_permittivity; give one of them"
            )
        if self.conductivity_s_m is not None and not is_own:
            raise ValueError(f"material {self.name!r} has a conductivity_s_m; give its relative_permittivity too")
        is_preset = not is_own and self.itu is None and self.name in PRESETS
        if is_preset and self.thickness_m is not None:
            raise ValueError(f"material {self.name!r} has layers with their own thickness; leave thickness_m out")
        if not is_own and not is_preset:
            with faults_named(f"material {self.name!r}"):
                material_bands(self.itu or self.name)
        return self

    @property
    def material(self) -> Material:
        """Name of the P.2040 material, or the constant material that is defined here; of one without layers."""
        if self.relative_permittivity is None:
            return self.itu or self.name
        return ConstantMaterial(self.name, self.relative_permittivity, self.conductivity_s_m or 0.0)


# Parts of buildings that any scene may name. docs/new-scene.md says where their dimensions are from.
PRESETS = {
    name: LayeredMaterial(name, tuple(Layer(*layer) for layer in layers))
    for name, layers in {
        "double-glazing": [("glass", 0.004), ("vacuum", 0.016), ("glass", 0.004)],
        "brick-wall": [("plasterboard", 0.015), ("brick", 0.115), ("plasterboard", 0.015)],
        "stud-wall": [("plasterboard", 0.0125), ("vacuum", 0.075), ("plasterboard", 0.0125)],
        "solid-door": [("wood", 0.04)],
        "hollow-door": [("chipboard", 0.003), ("vacuum", 0.034), ("chipboard", 0.003)],
    }.items()
}


def material_named(name: str, table: Mapping[str, SceneMaterial]) -> SlabMaterial:
    """The material of a name: a material of a scene's own table, a preset, or one of P.2040.

    Raises `UnknownNameError` for another name, and `ValueError` for a layer of what has layers itself.
    """
    own = table.get(name)
    if own is None or own.layers is None:
        material = own.material if own else name
        if isinstance(material, str) and material in PRESETS:
            return PRESETS[material]
        material_bands(material)
        return material
    layers = []
    for layer in own.layers:
        other = table.get(layer.material) if layer.material != name else None
        if (other is not None and other.layers is not None) or layer.material in PRESETS:
            raise ValueError(f"a layer of material {name!r} is {layer.material!r}, which has layers itself; give those")
        material = other.material if other else layer.material
        material_bands(material)
        layers.append(Layer(material, layer.thickness_m))
    return LayeredMaterial(name, tuple(layers))


def _defining_band(material: Material, carrier_hz: float) -> Band | None:
    return next((band for band in material_bands(material) if band.contains(carrier_hz)), None)


def complex_permittivity(material: Material, carrier_hz: float, policy: MaterialPolicy = "error") -> complex:
    """Relative complex permittivity ε' − jσ/(2πf·ε₀) at one carrier (ITU-R P.2040, Eq. 9).

    Outside every band of the material, `policy="error"` raises `MaterialBandError` and
    `policy="extrapolate"` continues the power law of the nearest band.
    """
    band, carrier_ghz = _defining_band(material, carrier_hz), carrier_hz / 1e9
    if band is None:
        if policy == "error":
            check_dispersion([material], [carrier_hz])
        # the band whose edge is nearest on a logarithmic axis
        band = min(
            material_bands(material), key=lambda each: max(each.low_ghz / carrier_ghz, carrier_ghz / each.high_ghz)
        )
    conductivity_s_m = band.c * carrier_ghz**band.d
    return complex(band.a * carrier_ghz**band.b, -conductivity_s_m / (2 * np.pi * carrier_hz * VACUUM_PERMITTIVITY_F_M))


@checked
def permittivity(
    material: str, freqs_ghz: CarriersGhz, policy: MaterialPolicy = "error"
) -> Complex[NDArray[np.complex128], "F"]:
    """Relative complex permittivity (F,) of a material of ITU-R P.2040, by its name, at F carriers in GHz.

    Raises `UnknownNameError` for another name. Outside every band of the material, `policy="error"` raises
    `MaterialBandError`, and `policy="extrapolate"` continues the power law of the nearest band.
    """
    if material not in ITU_MATERIALS:
        raise UnknownNameError("material", material, ITU_MATERIALS)
    return np.array([complex_permittivity(material, ghz_to_hz(ghz), policy) for ghz in freqs_ghz])


def conductivity_s_m(permittivity: complex, carrier_hz: float) -> float:
    """The conductivity σ in S/m of a complex relative permittivity at one carrier (ITU-R P.2040, Eq. 9)."""
    return -permittivity.imag * 2 * np.pi * carrier_hz * VACUUM_PERMITTIVITY_F_M


def materials_defined_at(carrier_hz: Iterable[float]) -> list[str]:
    """Names of the materials that P.2040 defines at all of the carriers."""
    carriers = list(carrier_hz)
    return [name for name in ITU_MATERIALS if all(_defining_band(name, carrier) for carrier in carriers)]


def check_dispersion(
    materials: Iterable[Material], carrier_hz: Sequence[float], policy: MaterialPolicy = "error"
) -> list[str]:
    """Check every used material against every carrier before any ray is shot.

    Returns the materials that have to be extrapolated, sorted. With `policy="error"` the first such
    material raises `MaterialBandError`, which names the band, the carriers outside and the materials
    that would do.
    """
    extrapolated = []
    for material in sorted({material for material in materials if isinstance(material, str)}):
        outside = [carrier for carrier in carrier_hz if _defining_band(material, carrier) is None]
        if outside and policy == "error":
            bands = " and ".join(f"{b.low_ghz:g} to {b.high_ghz:g} GHz" for b in material_bands(material))
            others = ", ".join(materials_defined_at(carrier_hz))
            choice = f"use one of {others}" if others else "use others (none is defined at all of yours)"
            raise MaterialBandError(
                f"ITU-R P.2040 defines {material!r} from {bands}, but the scene is asked for "
                f"{format_ghz_list(outside)}. Drop those carriers, which are given in GHz, {choice}, or pass "
                "--materials extrapolate."
            )
        if outside:
            extrapolated.append(material)
    return extrapolated
