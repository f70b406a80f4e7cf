"""What a method reports that it has learned of a room: planes, what they are made of, faces and images."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, model_validator

from xfreqbench.types import FloatArray
from xfreqbench.units import VACUUM_PERMITTIVITY_F_M

Number = Annotated[float, Field(allow_inf_nan=False)]
_Triple = tuple[Number, Number, Number]


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
        loss = conductivity_s_m / (2 * np.pi * carrier_hz * VACUUM_PERMITTIVITY_F_M)
        return complex(self.permittivity, -loss)


class FoundPlane(_Stored):
    """A plane that was found; `normal` points from the array centre to it, in world axes.

    The method divides a plane into cells: `held` is the share of the cells touched by paths that hold something,
    and `corners_m` are the corners, in turn, of the rectangle around those, None where no cell holds anything.
    """

    normal: _Triple
    distance_m: Number
    distance_std_m: Number
    tilt_std_rad: Number
    held: Number
    corners_m: tuple[_Triple, _Triple, _Triple, _Triple] | None
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
    corners_m: Annotated[tuple[_Triple, ...], Field(min_length=3)]
    seen: Number
    is_wall: bool


class FoundImage(_Stored):
    """Images of transmitters in a sequence of planes; `power` is relative to the line of sight."""

    planes: tuple[int, ...]
    power: Number


class FoundSurface(_Stored):
    """A surface of the room that a run refined and traced for its predictions, as `surfaces.surface_json` tells it."""

    number: int
    plane: int
    found_slab: int
    normal: _Triple
    corners_m: Annotated[tuple[_Triple, ...], Field(min_length=3)]
    slab: tuple[str, Number, Number]
    seen: Number
    is_wall: bool
    depth_m: Annotated[Number, Field(ge=0)]
    open_sides: tuple[int, ...]


class StoredFindings(_Stored):
    """What a method with planes and images stores in its record; the strongest images come first."""

    planes: tuple[FoundPlane, ...]
    receiver_m: _Triple
    images: tuple[FoundImage, ...]
    faces: tuple[FoundFace, ...] = ()  # absent in records written before they were found
    room: tuple[FoundSurface, ...] = ()  # absent where none was traced, and in older records

    @model_validator(mode="after")
    def _planes_and_images_exist(self) -> StoredFindings:
        if not all(any(plane.normal) for plane in self.planes):
            raise ValueError("a plane's normal is the zero vector")
        if any(not 0 <= index < len(self.planes) for image in self.images for index in image.planes):
            raise ValueError(f"an image names a plane that is not among the {len(self.planes)}")
        for face in self.faces:
            is_plane = 0 <= face.plane < len(self.planes)
            if not is_plane or not 0 <= face.slab < len(self.planes[face.plane].slabs):
                raise ValueError(f"a face names slab {face.slab} of plane {face.plane}, which is not there")
        return self

    @property
    def array_m(self) -> Float[FloatArray, "3"]:
        """Position of the array centre."""
        return np.array(self.receiver_m)
