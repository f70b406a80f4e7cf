"""A learned room as surfaces of P.2040 materials, which a tracer can trace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.scene.placement import MIN_SEPARATION_M
from xfreqbench.scene.visibility import distance_to_surfaces
from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

from ..stored import StoredFindings
from .materials import NamedSlab, SlabNames

_MIN_SEEN = 0.05  # of a face; where paths tell of less, its material is what learning began with
_ON_WALL_M = 0.02  # a side of a box that is nearer to a wall is none
_SAME_M = 0.01  # corners that are nearer to each other are one
LEAST_AREA_M2 = 0.01
NO_PLANE = -1  # of a surface that was found by the paths that it hides


@dataclass(frozen=True, eq=False)
class RoomSurface:
    """A convex polygon of a learned room, its corners in turn, of a P.2040 material; or the box behind it.

    `normal` points away from the array. `depth_m` is that of the box, 0 for the polygon alone; `open_sides` are its
    sides, by their first corner, that lie in walls. `seen` is that of `FoundFace`.
    """

    number: int
    plane: int
    found_slab: int
    normal: Float[FloatArray, "3"]
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
        return SurfaceMesh(
            self.name, self.slab.material, self.slab.thickness_m, vertices_m, np.concatenate(triangles)
        )

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

    @property
    def is_unseen(self) -> bool:
        """Whether too few paths tell of it for its material to mean anything."""
        return self.seen < _MIN_SEEN

    def with_depth(self, depth_m: float, walls: Sequence[RoomSurface]) -> RoomSurface:
        """The same polygon as the front of a box, which has no sides in walls."""
        ends_m = np.stack([self.corners_m, np.roll(self.corners_m, -1, axis=0)], axis=1)
        in_wall = np.zeros(len(ends_m), bool)
        for wall in walls:
            away_m = np.abs((ends_m - wall.corners_m[0]) @ wall.normal)
            in_wall |= (away_m < _ON_WALL_M).all(1)
        sides = tuple(np.flatnonzero(in_wall).tolist()) if depth_m else ()
        return replace(self, depth_m=depth_m, open_sides=sides)


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
    told = {each.name: getattr(surface, each.name) for each in fields(surface)}
    return {**told, "normal": surface.normal.tolist(), "corners_m": surface.corners_m.tolist()}


def surface_from_json(stored: Mapping[str, Any]) -> RoomSurface:
    """Inverse of `surface_json`."""
    arrays = {name: np.array(stored[name], np.float64) for name in ("normal", "corners_m")}
    return RoomSurface(
        **{**stored, **arrays, "slab": NamedSlab(*stored["slab"]), "open_sides": tuple(stored["open_sides"])}
    )


def learned_surfaces(
    findings: StoredFindings, carrier_hz: Sequence[float], standing_m: Float[FloatArray, "N 3"]
) -> list[RoomSurface]:
    """The faces of findings, each of the P.2040 material that is nearest over some carriers.

    A sliver is left out, and a face on which something stands, at one of the places `standing_m`; all are where P.2040
    defines no material at the carriers.
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
        surfaces.append(
            RoomSurface(number, face.plane, face.slab, normal, corners_m, slab, face.seen, face.is_wall)
        )
    return [each for each in surfaces if each.area_m2 > LEAST_AREA_M2 and is_clear(each, standing_m)]


def standing(
    receiver: ReceiverArray, carrier_hz: Float[FloatArray, "F"], tx_position_m: Float[FloatArray, "T 3"]
) -> Float[FloatArray, "N 3"]:
    """The places of the array's elements, at the lowest carrier, and of transmitters, where no surface can be."""
    aperture_m = receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz.min())
    return np.concatenate([aperture_m, tx_position_m])


def is_clear(surface: RoomSurface, standing_m: Float[FloatArray, "N 3"]) -> bool:
    """Whether a surface is as far from all these places as a tracer demands."""
    return bool(distance_to_surfaces([surface.mesh], standing_m).min() >= MIN_SEPARATION_M)
