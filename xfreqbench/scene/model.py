"""A scene as data: surfaces, receiver array and transmitter grid, read from TOML."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from math import atan2, degrees, hypot, isclose, prod
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, cast, get_args

import numpy as np
from jaxtyping import Float
from pydantic import ConfigDict, Field, FiniteFloat, TypeAdapter, model_serializer, model_validator
from pydantic.dataclasses import dataclass

from xfreqbench.errors import SceneError, UnknownNameError
from xfreqbench.scene.array import (
    ArrayPlane,
    frame_rotation,
    orientation_rotation,
    planar_array,
    quaternion_rotation,
    rotation_quaternion,
)
from xfreqbench.scene.imported import Slab, rough
from xfreqbench.scene.materials import LayeredMaterial, SceneMaterial, Thickness, faults_named, material_named
from xfreqbench.scene.polygons import MAX_CORNERS, flat_polygon
from xfreqbench.scene.toml_files import form_errors, load_toml, shipped_families, shipped_scenes, toml_content
from xfreqbench.system.arguments import FilePath, checked, only_given
from xfreqbench.types import FloatArray

FAR_M = 1e7  # no coordinate may be farther from the origin
NEAR_M = 32.0  # from the origin, where single precision holds coordinates to 4 µm
MAX_CANDIDATES = 1_000_000  # positions of a transmitter grid, which take minutes to place, and 650 GB at ten carriers

Metres = Annotated[float, Field(ge=-FAR_M, le=FAR_M, allow_inf_nan=False)]
Point = tuple[Metres, Metres, Metres]
Quaternion = tuple[Metres, Metres, Metres, Metres]
PositiveMetres = Annotated[float, Field(gt=0, le=FAR_M, allow_inf_nan=False)]

Pattern = Literal["iso", "dipole", "tr38901"]
Polarization = Literal["V", "H"]
PolarizationPair = Literal["VV", "VH", "HV", "HH"]  # polarization of the transmitter, then of the receiver
POLARIZATION_PAIRS: tuple[PolarizationPair, ...] = get_args(PolarizationPair)
Degrees = Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)]
Orientation = tuple[Degrees, Degrees, Degrees]  # bearing, downtilt and slant: see `orientation_rotation`

_STRICT = ConfigDict(extra="forbid")
Unit = Literal["m", "cm", "mm", "km", "in", "ft"]
UNIT_M: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "in": 0.0254, "ft": 0.3048}


@dataclass(frozen=True, config=_STRICT)
class Surface:
    """A box, a rectangle or a polygon of one material, each face a slab of `thickness_m`.

    A material with layers has its own thickness. Its first layer is at the outside of a box, at the side of a
    rectangle to which its axis points, and at the side of a polygon from which its corners turn counter-clockwise.

    From `min_m` to `max_m` it is a rectangle if they agree along one axis (a wall, a pane), otherwise the six faces of
    a closed box (a cabinet). `vertices_m` instead of them are the corners, in order, of a polygon in any plane. It may
    be concave and touch itself, as with a slit to a hole, but not cross itself. Corners up to 1 mm off its plane are
    moved into it. With `mirrors = false` it blocks and transmits, but does not reflect, as small objects do. The JSON
    omits fields that are not given.
    """

    name: str
    material: str
    thickness_m: Thickness | None = None
    min_m: Point | None = None
    max_m: Point | None = None
    vertices_m: Annotated[tuple[Point, ...], Field(min_length=3, max_length=MAX_CORNERS)] | None = None
    mirrors: Literal[False] | None = None

    _json = only_given

    @model_validator(mode="after")
    def _has_an_area(self) -> Surface:
        if self.vertices_m is not None and self.min_m is None and self.max_m is None:
            try:
                flat_polygon(self.corners_m)
            except ValueError as error:
                raise ValueError(f"the polygon of surface {self.name!r} {error}") from error
            return self
        if self.vertices_m is not None or self.min_m is None or self.max_m is None:
            raise ValueError(f"surface {self.name!r} needs either min_m and max_m, or vertices_m, and not both")
        extent = np.subtract(self.max_m, self.min_m)
        if (extent < 0).any() or (extent == 0).sum() > 1:
            raise ValueError(
                f"surface {self.name!r} spans {self.min_m} to {self.max_m}; max_m must exceed min_m along "
                "at least two axes and never be below it"
            )
        return self

    @property
    def corners_m(self) -> Float[FloatArray, "n 3"]:
        """The corners of the polygon as they are given, or the lowest and the highest corner of the box."""
        return np.array([self.min_m, self.max_m] if self.vertices_m is None else self.vertices_m)


class Antenna(NamedTuple):
    """The antenna of a device: see `ReceiverArray`."""

    pattern: Pattern
    polarization: Polarization
    orientation_deg: Orientation = (0.0, 0.0, 0.0)

    def __str__(self) -> str:
        angles = zip(("bearing", "downtilt", "slant"), self.orientation_deg, strict=True)
        turned = "".join(f", {name} {angle_deg:g}°" for name, angle_deg in angles) if any(self.orientation_deg) else ""
        return f"{self.pattern} pattern, polarization {self.polarization}{turned}"

    @property
    def as_vertical(self) -> Antenna:
        """The antenna as one of polarization V, if it is a dipole: a dipole along y is one along z, slanted by 90°."""
        if (self.pattern, self.polarization) != ("dipole", "H"):
            return self
        bearing, downtilt, slant = self.orientation_deg
        return Antenna("dipole", "V", (bearing, downtilt, slant + 90))

    @property
    def rotation(self) -> Float[FloatArray, "3 3"]:
        """Matrix that takes the antenna's axes to the world; its columns are these axes."""
        return orientation_rotation(self.orientation_deg)


@dataclass(frozen=True, config=_STRICT)
class ReceiverArray:
    """A planar array whose boresight is the pole of the hemisphere of directions.

    Elements are `spacing_wavelengths` apart at each carrier, by default half a wavelength. All of them have the same
    antenna. It has its own axes: it looks along x, and z points up. They are turned by `antenna_orientation_deg`,
    bearing, downtilt and slant as in 3GPP TR 38.901. By default they are the world's, but elements of pattern `tr38901`
    look along the boresight, with z as near to the world's vertical as possible (the world's x, if they look down).

    `pattern` is `iso`, `dipole` (short) or `tr38901` (the element of Table 7.3-1, 8 dBi), and `polarization` is `V` or
    `H`. A dipole is along z (`V`) or y (`H`). The field of the others is along the unit vector of the polar angle
    (`V`) or of the azimuth (`H`) about z.

    `plane` and `orientation` are for data sets that others published. In plane `yz` of its frame, the array contains
    the pole, and `boresight` is only the pole. `orientation`, a quaternion x, y, z, w, is the whole rotation from the
    frame to the world, and its pole has to be the boresight. `name` identifies a receiver of a scene with several. The
    JSON omits these fields if they are not given.
    """

    position_m: Point
    rows: Annotated[int, Field(ge=1, le=64)] = 4
    cols: Annotated[int, Field(ge=1, le=64)] = 4
    spacing_wavelengths: Annotated[float, Field(gt=0, le=10)] = 0.5
    boresight: Point = (0.0, 0.0, -1.0)
    pattern: Pattern = "iso"
    polarization: Polarization = "V"
    antenna_orientation_deg: Orientation | None = None
    plane: ArrayPlane = "xy"
    orientation: Quaternion | None = None
    name: str | None = None

    @model_serializer(mode="wrap")
    def _without_what_is_not_given(self, serialize: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        default = {"antenna_orientation_deg": None, "plane": "xy", "orientation": None, "name": None}
        return {key: value for key, value in serialize(self).items() if key not in default or value != default[key]}

    @model_validator(mode="after")
    def _boresight_is_the_pole(self) -> ReceiverArray:
        if max(map(abs, self.boresight)) < 1e-6:
            raise ValueError("the receiver's boresight is the zero vector; give a direction like [0, 0, -1]")
        if self.orientation is None:
            return self
        if not np.linalg.norm(self.orientation) > 1e-6:
            raise ValueError("the receiver's orientation is the zero quaternion; [0, 0, 0, 1] means no rotation")
        pole = np.asarray(self.boresight) / np.linalg.norm(self.boresight)
        if not np.allclose(self.rotation[:, 2], pole, atol=1e-6):
            raise ValueError(
                f"the receiver's orientation turns its pole to {self.rotation[:, 2].round(6).tolist()}, but its "
                f"boresight is {self.boresight}; give the same direction, or no orientation"
            )
        return self

    @property
    def antenna(self) -> Antenna:
        """The antenna of each element."""
        given = self.antenna_orientation_deg
        if given is None and self.pattern == "tr38901":
            x, y, z = self.boresight
            given = degrees(atan2(y, x)), degrees(atan2(-z, hypot(x, y))), 0.0
        return Antenna(self.pattern, self.polarization, given or (0.0, 0.0, 0.0))

    @property
    def num_elements(self) -> int:
        """Number of elements, M."""
        return self.rows * self.cols

    @property
    def resolves_directions(self) -> bool:
        """Whether maps resolve directions; those of one element, or of elements nearly at one point, hardly vary."""
        # any two maps of a smaller array have an SSIM above .998
        return (max(self.rows, self.cols) - 1) * self.spacing_wavelengths >= 0.05

    @property
    def rotation(self) -> Float[FloatArray, "3 3"]:
        """Matrix that takes the receiver's frame to the world; its columns are the frame's axes."""
        if self.orientation is None:
            return frame_rotation(self.boresight)
        return quaternion_rotation(self.orientation)

    @property
    def quaternion_xyzw(self) -> tuple[float, float, float, float]:
        """`rotation` as a quaternion x, y, z, w: the given `orientation`, where there is one."""
        return self.orientation or rotation_quaternion(self.rotation)

    @property
    def element_position_wavelengths(self) -> Float[FloatArray, "M 3"]:
        """Element positions about the array centre, in wavelengths, in the receiver's frame."""
        return planar_array(self.rows, self.cols, self.spacing_wavelengths, self.plane)

    @property
    def in_plane_xy(self) -> ReceiverArray:
        """An array in plane `xy` of its frame whose elements are at the same positions in the world."""
        if self.plane == "xy":
            return self
        rotation = self.rotation[:, [1, 2, 0]]
        x, y, z = rotation[:, 2].tolist()
        return replace(self, plane="xy", boresight=(x, y, z), orientation=rotation_quaternion(rotation))

    @property
    def local_origin_m(self) -> Float[FloatArray, "3"]:
        """The origin of coordinates in single precision: whole metres, 0 if the array is near the origin.

        Single precision holds a place to .5 m at UTM coordinates. Along each axis this is the array's coordinate,
        rounded, where that is beyond `NEAR_M`.
        """
        position_m = np.asarray(self.position_m)
        return np.where(np.abs(position_m) > NEAR_M, np.round(position_m), 0.0)

    def element_position_m(self, wavelength_m: float) -> Float[FloatArray, "M 3"]:
        """Element positions in the world, in metres, at one wavelength."""
        offset_m = self.element_position_wavelengths @ self.rotation.T * wavelength_m
        return np.asarray(self.position_m) + offset_m


@dataclass(frozen=True, config=_STRICT)
class TransmitterGrid:
    """A lattice of positions for transmitters; those nearer than `clearance_m` to anything are left out.

    `pattern` and `polarization` are those of all transmitters, also of those at other positions; by default the
    receiver's, but `iso` for a receiver of pattern `tr38901`. `orientation_deg` turns their antennas (see
    `ReceiverArray`). `power_dbm` is the power that each sends, for `received_power_dbm`; no channel depends on it.
    """

    min_m: Point
    max_m: Point
    step_m: tuple[PositiveMetres, PositiveMetres, PositiveMetres]
    clearance_m: PositiveMetres = 0.15
    pattern: Pattern | None = None
    polarization: Polarization | None = None
    orientation_deg: Orientation | None = None
    power_dbm: FiniteFloat | None = None

    _json = only_given

    @model_validator(mode="after")
    def _is_not_empty(self) -> TransmitterGrid:
        if any(low > high for low, high in zip(self.min_m, self.max_m, strict=True)):
            raise ValueError(f"the transmitter grid's min_m {self.min_m} exceeds its max_m {self.max_m}")
        if (num_candidates := prod(self._num_steps)) > MAX_CANDIDATES:
            raise ValueError(
                f"the transmitter grid has {num_candidates:,.0f} positions, and at most {MAX_CANDIDATES:,} are "
                "allowed; give it a larger step_m, or less space"
            )
        return self

    @property
    def _num_steps(self) -> list[float]:
        """Positions along each axis, before they are cut to whole numbers."""
        spans = zip(self.min_m, self.max_m, self.step_m, strict=True)
        return [(high - low) / step + 1 + 1e-9 for low, high, step in spans]

    @property
    def lattice_m(self) -> Float[FloatArray, "N 3"]:
        """Every position of the lattice, x varying slowest."""
        axes = [
            low + step * np.arange(int(number))
            for low, step, number in zip(self.min_m, self.step_m, self._num_steps, strict=True)
        ]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


class PatchSize(NamedTuple):
    """The least size of a coplanar patch of a mesh that reflects; `width_m` is 4·area / perimeter."""

    area_m2: float = 0.05
    width_m: float = 0.1


@dataclass(frozen=True, config=_STRICT)
class Scene:
    """A room for tracing rays: surfaces, a receiver array and, if positions are not given, a grid of transmitters.

    `scene` may name a file whose meshes are added to the surfaces: a Mitsuba XML, GLB or OBJ, relative to `folder`,
    or `sionna:NAME` for a scene that ships with Sionna RT. In the file the axis `up` points upwards, by default y in a
    GLB, as glTF demands, and z in the others, and lengths are in `unit`, by default metres. `outside` allows the array,
    or all transmitters, to be outside of all surfaces. `material` names materials. `rooms` names closed meshes whose
    inside is free space; without it, they are found. `closed` states that the room of the receiver has no opening. A
    file may have several `[[receiver]]`, each with a name: those after the first are `other_receivers`.
    `transmitter_polarization` overrides that of the grid of transmitters.

    `mirrors` says which parts of these meshes reflect: with `patches`, the default, connected coplanar patches of at
    least `least_patch_area_m2` and `least_patch_width_m`, while smaller ones only block and transmit; with `facets`,
    every triangle, however small compared with the wavelength. Surfaces reflect unless they have `mirrors = false`.
    """

    name: str
    receiver: ReceiverArray
    transmitters: TransmitterGrid | None = None
    description: str = ""
    surface: tuple[Surface, ...] = ()
    scene: str | None = None
    up: Literal["y", "z"] | None = None
    unit: Unit | None = None
    outside: bool = False
    material: tuple[SceneMaterial, ...] = ()
    rooms: tuple[str, ...] = ()
    closed: bool = False
    mirrors: Literal["patches", "facets"] | None = None
    least_patch_area_m2: Annotated[float, Field(gt=0, le=FAR_M, allow_inf_nan=False)] | None = None
    least_patch_width_m: PositiveMetres | None = None
    other_receivers: tuple[ReceiverArray, ...] = ()
    transmitter_polarization: Polarization | None = None
    folder: Annotated[Path, Field(exclude=True)] = Path()

    @model_serializer(mode="wrap")
    def _without_what_is_not_given(self, serialize: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        always = {"name", "receiver", "description", "surface", "scene"}
        return {key: value for key, value in serialize(self).items() if key in always or value}

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Scene:
        if self.receiver.plane != "xy":
            raise ValueError(
                f"the receiver is in plane {self.receiver.plane!r} of its frame; rays are traced only to arrays in "
                "'xy', which is the default: leave the plane out"
            )
        of_file = "up", "unit", "mirrors", "least_patch_area_m2", "least_patch_width_m"
        given = [name for name in of_file if getattr(self, name)]
        if given and self.scene is None:
            raise ValueError(
                f"{given[0]!r} is for the meshes of a file, but the scene names no file: name it, as in scene = "
                f'"room.glb", or leave {given[0]!r} out; lengths of surfaces are in metres'
            )
        receivers = self.receivers if self.other_receivers else ()
        if not all(receiver.name for receiver in receivers):
            raise ValueError('each of several receivers needs its own name, as in name = "north"')
        for kind, named in (("surface", self.surface), ("material", self.material), ("receiver", receivers)):
            names = Counter(item.name or "" for item in named)
            twice = sorted(name for name, count in names.items() if count > 1)
            if twice:
                raise ValueError(f"two {kind}s are named {twice[0]!r}; every {kind} needs its own name")
        for material in self.material:
            with faults_named(f"material {material.name!r}"):
                material_named(material.name, self.materials)
        for surface in self.surface:
            with faults_named(f"surface {surface.name!r}"):
                self.slab_of(surface)
        return self

    @property
    def receivers(self) -> tuple[ReceiverArray, ...]:
        """All receivers of the scene, in the order of its file."""
        return self.receiver, *self.other_receivers

    def with_receiver(self, *names: str) -> Scene:
        """The scene with only some of its receivers, the first if no name is given; raises `UnknownNameError`."""
        by_name = {receiver.name: receiver for receiver in self.receivers if receiver.name is not None}
        for name in names:
            if name not in by_name:
                raise UnknownNameError("receiver", name, by_name)
        first, *others = [by_name[name] for name in dict.fromkeys(names)] or [self.receiver]
        return replace(self, receiver=first, other_receivers=tuple(others))

    def with_polarization(self, pair: PolarizationPair) -> Scene:
        """The scene with the first of two polarizations for its transmitters, and the second for its receivers.

        `pair` is one of `POLARIZATION_PAIRS`; raises `UnknownNameError`.
        """
        if pair not in POLARIZATION_PAIRS:
            raise UnknownNameError("pair of polarizations", pair, POLARIZATION_PAIRS)
        sent, heard = cast("tuple[Polarization, Polarization]", tuple(pair))
        first, *others = [replace(receiver, polarization=heard) for receiver in self.receivers]
        turned = replace(self, receiver=first, other_receivers=tuple(others), transmitter_polarization=None)
        is_so = turned.transmitter_antenna.polarization == sent
        return turned if is_so else replace(turned, transmitter_polarization=sent)

    @cached_property
    def materials(self) -> dict[str, SceneMaterial]:
        """The scene's own table of materials, by name."""
        return {material.name: material for material in self.material}

    def slab_of(self, surface: Surface) -> Slab:
        """The slab of a surface, of a material of the scene's table or of P.2040.

        Raises `UnknownNameError` for another, and `ValueError` if the thickness does not fit.
        """
        material, thickness_m = material_named(surface.material, self.materials), surface.thickness_m
        if isinstance(material, LayeredMaterial):
            total_m = material.thickness_m
            if not isclose(thickness_m or total_m, total_m, rel_tol=1e-6):
                raise ValueError(
                    f"surface {surface.name!r} has thickness_m = {thickness_m:g}, but the layers of "
                    f"{material.name!r} are {total_m:g} m thick; leave thickness_m out"
                )
            thickness_m = total_m
        if thickness_m is None:
            raise ValueError(f"surface {surface.name!r} of {surface.material!r} needs a thickness_m")
        own = self.materials.get(surface.material)
        slab = Slab(material, thickness_m, rough(own.scattering) if own else None)
        # the triangles of a rectangle across y show the side to which y does not point
        is_across_y = surface.min_m is not None and surface.max_m is not None and surface.min_m[1] == surface.max_m[1]
        return slab.turned if is_across_y else slab

    @property
    def transmitter_antenna(self) -> Antenna:
        """The antenna of every transmitter, by `TransmitterGrid` and `transmitter_polarization`."""
        pattern, polarization, _ = self.receiver.antenna
        usual = Antenna("iso" if pattern == "tr38901" else pattern, polarization)
        stated = {name: getattr(self.transmitters, name, None) for name in Antenna._fields}
        stated["polarization"] = self.transmitter_polarization or stated["polarization"]
        return usual._replace(**{name: value for name, value in stated.items() if value is not None})

    @property
    def antenna_settings(self) -> dict[str, Any]:
        """The transmitters' antenna, for the header of data; empty if it is that of the receiver."""
        pattern, polarization, orientation_deg = antenna = self.transmitter_antenna
        if antenna == self.receiver.antenna:
            return {}
        turned = {"transmitter_orientation_deg": list(orientation_deg)} if any(orientation_deg) else {}
        return {"transmitter_pattern": pattern, "transmitter_polarization": polarization, **turned}

    @property
    def least_patch(self) -> PatchSize | None:
        """The least patch of imported meshes that mirrors; None if every triangle does."""
        area_m2 = self.least_patch_area_m2 or PatchSize().area_m2
        width_m = self.least_patch_width_m or PatchSize().width_m
        return None if self.mirrors == "facets" else PatchSize(area_m2, width_m)

    @property
    def mirror_settings(self) -> dict[str, Any]:
        """The fields that say what of imported meshes mirrors, for the header of data; empty without such meshes."""
        if self.scene is None:
            return {}
        size = self.least_patch
        least = {} if size is None else {f"least_patch_{name}": value for name, value in size._asdict().items()}
        return {"mirrors": self.mirrors or "patches", **least}

    @property
    def canonical_json(self) -> str:
        """The scene as the JSON text that data sets hold; equal scenes give equal text."""
        return TypeAdapter(Scene).dump_json(self, exclude={"folder"}).decode()


@checked
def load_scene(name_or_path: FilePath) -> Scene:
    """Read a shipped scene by name, or any scene by the path of its TOML file, which ends in `.toml`.

    Raises `UnknownNameError` for a name that does not ship and `SceneError` for a file that cannot be
    read or that describes no valid scene, every fault listed with its place in the file.
    """
    return load_toml(name_or_path, "scene", [*shipped_scenes(), *shipped_families()], parse_scene)


@checked
def parse_scene(text: str, folder: Path = Path()) -> Scene:
    """Scene from TOML text. Relative paths of meshes start at `folder`. Raises `SceneError`."""
    content = toml_content(text)
    if "type" in content:
        raise SceneError(
            "this describes a family of rooms, not a scene. Generate rooms of it with `xfreqbench generate FAMILY "
            "--rooms 1000 --tx 120 -o rooms`, or draw one by its seed with `xfreqbench.draw_room(FAMILY, 1).scene`."
        )
    if "folder" in content:
        raise SceneError("the scene has no valid form:\n  folder: no such key")
    if isinstance(content.get("receiver"), list):  # [[receiver]], once or several times
        first, *others = content["receiver"] or [{}]
        content = {**content, "receiver": first, "other_receivers": others}
    with form_errors("scene", Scene):
        return TypeAdapter(Scene).validate_python({**content, "folder": folder})


def scene_schema() -> dict[str, Any]:
    """JSON Schema of a scene file, with which editors complete and check TOML."""
    schema: dict[str, Any] = TypeAdapter(Scene).json_schema()
    properties = schema["properties"]
    one, several = properties["receiver"], properties.pop("other_receivers")
    properties["receiver"] = {"anyOf": [one, {"type": "array", "items": several["items"], "minItems": 1}]}
    return schema
