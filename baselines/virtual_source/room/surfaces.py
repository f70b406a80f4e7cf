"""A learned room as surfaces of P.2040 materials, which a tracer can trace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from xfreqbench.scene.materials import complex_permittivity, materials_defined_at
from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.scene.placement import MIN_SEPARATION_M
from xfreqbench.scene.visibility import distance_to_surfaces
from xfreqbench.tracing.image.kernels.slabs import slab_coefficients
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

from ..search.planes import Points, Vector
from ..stored import FoundSlab, StoredFindings

_WORSE = 0.05  # by which a slab may be farther from what was learned than the nearest one
METAL_THICKNESS_M = 0.002  # what is behind the surface of a metal does not matter
_COSINES = np.linspace(0.1, 1.0, 7)  # of the angles of incidence that are compared
_THICKNESSES = np.linspace(0.9, 1.1, 41)  # in units of the one that delays a wave as the learned slab does
MIN_SEEN = 0.05  # share of a face; where paths show less of it, its material is what learning began with
_ON_WALL_M = 0.02  # a side of a box that is nearer to a wall is left out
_SAME_M = 0.01  # corners that are nearer to each other are one
LEAST_AREA_M2 = 0.01
NO_PLANE = -1  # of a surface that was found by the paths that it hides


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


def slab_reflection(
    permittivity: Sequence[complex], thickness_m: float, carrier_hz: Sequence[float], cosine: Float[FloatArray, "C"]
) -> Complex[NDArray[np.complex128], "F C 2"]:
    """Coefficients TE and TM of a slab for F carriers and C cosines of the incidence (P.2040, Eqs. 37, 43 and 44)."""
    phase = 2 * np.pi * np.asarray(carrier_hz) / SPEED_OF_LIGHT_M_S * thickness_m
    return np.array(
        [
            [slab_coefficients(value, eta, turn)[:2] for value in cosine.tolist()]
            for eta, turn in zip(permittivity, phase.tolist(), strict=True)
        ]
    )


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
        learned = slab_reflection(permittivity.tolist(), slab.thickness_m, self.carrier_hz, _COSINES)
        named = []
        for material in self.materials:
            own = np.array([complex_permittivity(material, carrier) for carrier in self.carrier_hz])
            scale = np.sqrt(permittivity.real.mean() / own.real.mean())
            metres = [METAL_THICKNESS_M] if material == "metal" else slab.thickness_m * scale * _THICKNESSES
            reflected = [
                slab_reflection(own.tolist(), thickness_m, self.carrier_hz, _COSINES) for thickness_m in metres
            ]
            distances = [np.sqrt((np.abs(reflection - learned) ** 2).mean()) for reflection in reflected]
            best = int(np.argmin(distances))
            named.append(NamedSlab(material, float(metres[best]), float(distances[best])))
        return sorted(named, key=lambda slab: slab.distance)


def likely_slabs(nearest: Sequence[NamedSlab]) -> list[NamedSlab]:
    """Slabs that may be the learned one, of all the nearest first: those about as near as that one, and metal."""
    return [slab for slab in nearest if slab.distance < nearest[0].distance + _WORSE or slab.material == "metal"]


@dataclass(frozen=True, eq=False)
class RoomSurface:
    """A convex polygon of a learned room, its corners in turn, of a P.2040 material; or the box behind it.

    `normal` points away from the array. `depth_m` is that of the box, 0 for the polygon alone; `open_sides` are its
    sides, by their first corner, that lie in walls. `seen` is that of `FoundFace`.
    """

    number: int
    plane: int
    found_slab: int
    normal: Vector
    corners_m: Float[FloatArray, "n 3"]
    slab: NamedSlab
    seen: float
    is_wall: bool
    depth_m: float = 0.0
    open_sides: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        """What it is, and in which plane it was found, if it was found by one."""
        kind = "wall" if self.is_wall else "box" if self.depth_m else "face"
        return f"{kind} {self.number}" + (f" of plane {self.plane}" if self.plane != NO_PLANE else "")

    @cached_property
    def mesh(self) -> SurfaceMesh:
        """The polygon as a fan of triangles, with the same behind it and the sides between, where it is a box."""
        number, fan = len(self.corners_m), fan_of(len(self.corners_m))
        vertices_m, triangles = self.corners_m, [fan]
        if self.depth_m:
            vertices_m = np.concatenate([vertices_m, vertices_m + self.depth_m * self.normal])
            sides = [(a, (a + 1) % number) for a in range(number) if a not in self.open_sides]
            quads = [[[a, b, number + b], [a, number + b, number + a]] for a, b in sides]
            triangles += [fan + number, np.array(quads, dtype=np.int64).reshape(-1, 3)]
        return SurfaceMesh(self.name, self.slab.material, self.slab.thickness_m, vertices_m, np.concatenate(triangles))

    @property
    def area_m2(self) -> float:
        """Area of the polygon."""
        return polygon_area_m2(self.corners_m)

    @cached_property
    def outward(self) -> Float[FloatArray, "n 3"]:
        """Unit vectors within the polygon's plane, at right angles to its sides, that point out of it."""
        along = np.roll(self.corners_m, -1, axis=0) - self.corners_m
        across = np.cross(along, self.normal)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        inside_m = self.corners_m - self.corners_m.mean(axis=0)
        return across * np.where(np.einsum("nc,nc->n", across, inside_m) > 0, 1.0, -1.0)[:, None]

    @property
    def slab_name(self) -> str:
        """Material and thickness in words, as in `glass 7.90 mm`."""
        return f"{self.slab.material} {self.slab.thickness_m * 1e3:.2f} mm"

    def with_depth(self, depth_m: float, walls: Surfaces) -> RoomSurface:
        """The same polygon as the front of a box, which has no sides in walls."""
        ends_m = np.stack([self.corners_m, np.roll(self.corners_m, -1, axis=0)], axis=1)
        in_wall = np.zeros(len(ends_m), bool)
        for wall in walls:
            away_m = np.abs((ends_m - wall.corners_m[0]) @ wall.normal)
            in_wall |= (away_m < _ON_WALL_M).all(1)
        sides = tuple(np.flatnonzero(in_wall).tolist()) if depth_m else ()
        return replace(self, depth_m=depth_m, open_sides=sides)


Surfaces = Sequence[RoomSurface]


def fan_of(number: int) -> Int[IntArray, "t 3"]:
    """The triangles of a convex polygon with so many corners, all from the first of them."""
    return np.array([[0, corner, corner + 1] for corner in range(1, number - 1)])


def polygon_area_m2(corners_m: Float[FloatArray, "n 3"]) -> float:
    """Area of a polygon by its corners in turn; 0 where it has fewer than three."""
    if len(corners_m) < 3:
        return 0.0
    edges_m = corners_m[1:] - corners_m[0]
    return float(np.linalg.norm(np.cross(edges_m[:-1], edges_m[1:]).sum(0)) / 2)


def surface_json(surface: RoomSurface) -> dict[str, Any]:
    """A surface as values of JSON, for `surface_from_json`."""
    values = {entry.name: getattr(surface, entry.name) for entry in fields(surface)}
    return {**values, "normal": surface.normal.tolist(), "corners_m": surface.corners_m.tolist()}


def surface_from_json(stored: Mapping[str, Any]) -> RoomSurface:
    """Inverse of `surface_json`."""
    arrays = {name: np.array(stored[name], np.float64) for name in ("normal", "corners_m")}
    return RoomSurface(
        **{**stored, **arrays, "slab": NamedSlab(*stored["slab"]), "open_sides": tuple(stored["open_sides"])}
    )


def learned_surfaces(findings: StoredFindings, carrier_hz: Sequence[float], standing_m: Points) -> list[RoomSurface]:
    """The faces of findings, each of the P.2040 material that is nearest over some carriers.

    Slivers are left out, and so are faces that are too near to one of the places `standing_m`. There are none where
    P.2040 defines no material at the carriers.
    """
    names = SlabNames(carrier_hz)
    if not names.materials:
        return []
    nearest = {
        (face.plane, face.slab): names.nearest(findings.planes[face.plane].slabs[face.slab])[0]
        for face in findings.faces
    }
    surfaces = []
    for number, face in enumerate(findings.faces):
        slab, normal = nearest[face.plane, face.slab], findings.planes[face.plane].unit_normal
        corners_m = np.array(face.corners_m)
        corners_m = corners_m[np.linalg.norm(corners_m - np.roll(corners_m, -1, axis=0), axis=1) > _SAME_M]
        surfaces.append(RoomSurface(number, face.plane, face.slab, normal, corners_m, slab, face.seen, face.is_wall))
    return [surface for surface in surfaces if surface.area_m2 > LEAST_AREA_M2 and is_clear(surface, standing_m)]


def standing(
    receiver: ReceiverArray, carrier_hz: Float[FloatArray, "F"], tx_position_m: Float[FloatArray, "T 3"]
) -> Points:
    """The places of the array's elements, at the lowest carrier, and of transmitters, where no surface can be."""
    aperture_m = receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz.min())
    return np.concatenate([aperture_m, tx_position_m])


def is_clear(surface: RoomSurface, standing_m: Points) -> bool:
    """Whether a surface is as far from all these places as a tracer demands."""
    return bool(distance_to_surfaces([surface.mesh], standing_m).min() >= MIN_SEPARATION_M)
