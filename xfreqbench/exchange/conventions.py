"""How other projects draw the maps that they publish in the PNG layout. Their files do not say, so this table does.

Each field was read in the project's code, or measured on its maps; `read_in` says where. For another folder, take the
nearest convention and change its fields, as in `--set first_column_deg=0`. All maps are drawn in the receiver's own
frame, whose +z is the pole of the hemisphere; the folder's quaternion turns that frame into the world.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float, Shaped
from pydantic import Field

from xfreqbench.errors import DataError, UnknownNameError
from xfreqbench.maps.bartlett import PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.config import override
from xfreqbench.scene.array import ArrayPlane
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

Degrees = Annotated[float, Field(allow_inf_nan=False)]


@dataclass(frozen=True)
class Convention:
    """What the pixels of a project's maps mean. Rows and columns are evenly spaced, both ends included.

    `values` is what the grey level of a pixel is proportional to: the beam's `amplitude` or `power`, or with
    `phase-only-amplitude` the amplitude of the beam of h/|h|, only the phases of the channel. The latter is the
    square root of a `phase-only` map of this toolkit; such maps are stored as they were published, with the kind
    `amplitude`. `darkest` is what level 0 means: no power, or the minimum of the map (min-max scaling, which cannot be
    undone). `peak` says where the map of a single wave from direction d is brightest: at d, or at −d if the channel
    was correlated with the conjugate of the steering vector. The latter is the same as an array that is turned by
    half a turn about its normal, which is what an import does. `num_rows` and `num_columns` are for an export; an
    import takes the size of the PNGs.
    """

    rows: Literal["elevation", "polar"]
    first_row_deg: Degrees
    last_row_deg: Degrees
    first_column_deg: Degrees
    last_column_deg: Degrees
    values: Literal["amplitude", "power", "phase-only-amplitude"]
    read_in: str
    caveat: str = ""  # what is wrong with the maps themselves, which no other field can correct
    darkest: Literal["zero", "minimum"] = "zero"
    peak: Literal["source", "opposite"] = "source"
    quaternion: Literal["xyzw", "wxyz"] = "xyzw"
    plane: ArrayPlane = "xy"
    array_rows: Annotated[int, Field(ge=1, le=64)] = 4
    array_cols: Annotated[int, Field(ge=1, le=64)] = 4
    spacing_wavelengths: Annotated[float, Field(gt=0, le=10)] = 0.5
    index: Literal["file-stem", "zero-based"] = "file-stem"
    num_rows: Annotated[int, Field(ge=2, le=4096)] = 90
    num_columns: Annotated[int, Field(ge=2, le=4096)] = 360

    def drawing_fields(self) -> dict[str, Any]:
        """The fields that must be the same when maps are drawn and when they are read, with their values."""
        not_about_maps = ("read_in", "caveat", "index", "num_rows", "num_columns")
        return {name: value for name, value in asdict(self).items() if name not in not_about_maps}

    @property
    def pas_kind(self) -> PasKind:
        """Kind of the maps in a data set."""
        return "power" if self.values == "power" else "amplitude"

    def grid(self, num_rows: int, num_columns: int) -> AngularGrid:
        """Directions of a map of that size, once its elevations and azimuths ascend (see `ascending`)."""
        elevation_deg = np.linspace(*self._elevation_ends_deg, num_rows)
        azimuth_deg = np.linspace(self.first_column_deg, self.last_column_deg, num_columns)
        return AngularGrid(np.radians(np.sort(elevation_deg)), np.radians(np.sort(azimuth_deg)))

    def ascending(self, maps: Shaped[NDArray[Any], "... R C"]) -> Shaped[NDArray[Any], "... R C"]:
        """Published maps turned so that elevation and azimuth ascend, or such maps turned to how they are published."""
        first_deg, last_deg = self._elevation_ends_deg
        maps = maps[..., ::-1, :] if first_deg > last_deg else maps
        return maps[..., ::-1] if self.first_column_deg > self.last_column_deg else maps

    @property
    def _elevation_ends_deg(self) -> tuple[float, float]:
        ends = self.first_row_deg, self.last_row_deg
        return (90 - ends[0], 90 - ends[1]) if self.rows == "polar" else ends

    def quaternion_xyzw(self, published: tuple[float, ...]) -> tuple[float, float, float, float]:
        """The receiver's quaternion x, y, z, w from a folder's; with `peak="opposite"` it has half a turn more."""
        x, y, z, w = published if self.quaternion == "xyzw" else (*published[1:], published[0])
        if self.peak == "source":
            return x, y, z, w
        return (w, z, -y, -x) if self.plane == "yz" else (y, -x, w, -z)

    def published_quaternion(self, receiver: tuple[float, ...]) -> tuple[float, ...]:
        """The inverse of `quaternion_xyzw`, exact to the last bit."""
        x, y, z, w = receiver
        if self.peak == "opposite":
            x, y, z, w = (-w, -z, y, x) if self.plane == "yz" else (-y, x, -w, z)
        return (x, y, z, w) if self.quaternion == "xyzw" else (w, x, y, z)

    def peak_power(self, brightest: Float[FloatArray, "..."]) -> Float[FloatArray, "..."]:
        """Power of the brightest pixel of each map; `brightest` is its level over the highest level, 255."""
        return brightest if self.values == "power" else brightest**2

    def brightest(self, peak_power: Float[FloatArray, "..."]) -> Float[FloatArray, "..."]:
        """The inverse of `peak_power`."""
        return peak_power if self.values == "power" else np.sqrt(peak_power)


_WIDEBAND3DGS = Convention(
    rows="polar",
    first_row_deg=0,
    last_row_deg=90,
    first_column_deg=-180,
    last_column_deg=180,
    values="amplitude",
    plane="yz",
    read_in="measured on the published example of Wideband3DGS (tests/exchange/test_against_wideband3dgs.py); "
    "its receiver is not turned, so that the quaternion's order is that of its relatives",
)
_NERF2 = Convention(
    rows="elevation",
    first_row_deg=1,
    last_row_deg=90,
    first_column_deg=0,
    last_column_deg=359,
    values="phase-only-amplitude",
    darkest="minimum",
    spacing_wavelengths=0.16 * 920e6 / SPEED_OF_LIGHT_M_S,
    read_in="XPengZhao/NeRF2, dataset_tools/gen_spectrum.py: elements 0.16 m apart, maps drawn for 920 MHz, phases "
    "that grow with distance, as RFID readers report them. Its dataloader.py takes the azimuths to be 1 to 360",
)
CONVENTIONS = {
    "wideband3dgs": _WIDEBAND3DGS,
    "xfreq-gs": replace(
        _WIDEBAND3DGS,
        values="phase-only-amplitude",
        peak="opposite",
        index="zero-based",
        read_in="KINGAZ1019/XFreq-GS, dataset/scene_builder: utils.py subtracts the channel's phase, exp(+jkr·d), from "
        "-kr·d, so that a lone wave peaks opposite to its source",
        caveat="Its build_dataset.py leaves the scene at Sionna RT's 3.5 GHz and gives the carrier f to cfr() as an "
        "offset: directions are stretched by 1 + f/3.5 GHz, aliased from a few GHz on. Methods that steer "
        "an array at directions, such as line-of-sight, go astray on such maps. Shown with its recipe, not with "
        "its PNGs.",
    ),
    "nerf2": _NERF2,
    "wrf-gs": replace(
        _NERF2,
        read_in="wenchaozheng/WRF-GSplus, scene/dataloader.py: the maps are those of NeRF2, and were drawn by its "
        "generator",
    ),
    "gsrf": replace(
        _NERF2,
        index="zero-based",
        read_in="nesl/GSRF, scene/dataset_readers.py: the maps are those of NeRF2, and were drawn by its generator. "
        "Its renderer takes the azimuths to be 1 to 360, its config the carrier to be 915 MHz",
    ),
    "swiftwrf": replace(
        _NERF2,
        read_in="Evan-sudo/Swift_WRF, dataloader.py: files of NeRF2's layout, its maps among them",
        caveat="It publishes sets of its own too, but not their generator: that their pixels mean what NeRF2's do is "
        "an assumption. A data set cannot hold a receiver that moves while the transmitter is fixed.",
    ),
}
# Projects whose data cannot come in as folders of maps, and why.
NO_CONVENTIONS = {
    "newrf": "LuHaofan/NeWRF publishes channels between single antennas, which have no map of angles, as pickles of "
    "Python, which are never loaded here, for they may run code. Its rooms are STL files: name one in a Mitsuba XML as "
    "a shape of type stl, with a material, and generate data in it.",
    "rf-3dgs": "SunLab-UGA/RF-3DGS publishes pictures by pinhole cameras at many places of the receiver, for one place "
    "of the transmitter, with poses in COLMAP's format. Maps here are hemispheres seen from one receiver, for many "
    "places of the transmitter: neither can be made from the other.",
}


def convention_named(name: str, assignments: Iterable[str] = ()) -> Convention:
    """The convention of that name, with fields changed by texts `field=value`.

    Raises `UnknownNameError`, `MethodError` for a value that is not of its field's type, and `DataError` for
    angles that are not on a hemisphere, and for a project of `NO_CONVENTIONS`.
    """
    if name in NO_CONVENTIONS:
        raise DataError(f"There is no convention {name!r}. {NO_CONVENTIONS[name]}")
    if name not in CONVENTIONS:
        raise UnknownNameError("convention", name, CONVENTIONS)
    convention = override(CONVENTIONS[name], assignments)
    rows = convention.first_row_deg, convention.last_row_deg
    if min(rows) < 0 or max(rows) > 90 or rows[0] == rows[1]:
        raise DataError(
            f"Rows from {rows[0]:g} to {rows[1]:g} degrees are not in a hemisphere; give --set first_row_deg "
            "and last_row_deg from 0 to 90, and not the same."
        )
    span_deg = abs(convention.last_column_deg - convention.first_column_deg)
    if not 0 < span_deg <= 360:
        raise DataError(
            f"Columns from {convention.first_column_deg:g} to {convention.last_column_deg:g} degrees span "
            f"{span_deg:g}; give --set first_column_deg and last_column_deg that span more than 0, and at most 360."
        )
    return convention


def convention_rows() -> list[tuple[str, ...]]:
    """A table to print: one row for each field, with its name and then its value in every convention.

    The fields that say where a convention was read, and what is wrong with its maps, are left out.
    """
    shown = [field.name for field in fields(Convention) if field.name not in ("read_in", "caveat")]
    rows = []
    for name in shown:
        values = (getattr(convention, name) for convention in CONVENTIONS.values())
        rows.append((name, *(f"{value:g}" if isinstance(value, float) else str(value) for value in values)))
    spans_deg = (abs(convention.last_column_deg - convention.first_column_deg) for convention in CONVENTIONS.values())
    return [*rows, ("last column repeats first", *("yes" if np.isclose(span, 360) else "no" for span in spans_deg))]
