"""How groups draw the maps that they publish in the PNG layout: what no file of theirs says, as a table.

Each field was read in the publisher's code, or measured; `read_in` tells where. Anyone else's folder is the
nearest of these with fields changed: `--set first_column_deg=0`. All maps are drawn in the receiver's own
frame, whose +z is the hemisphere's pole; the folder's quaternion turns that frame into the world.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float, Shaped
from numpy.typing import NDArray
from pydantic import Field

from xfreqbench.angles import AngularGrid, FloatArray
from xfreqbench.array import ArrayPlane
from xfreqbench.config import override
from xfreqbench.errors import DataError, UnknownNameError
from xfreqbench.pas import PasKind
from xfreqbench.units import SPEED_OF_LIGHT_M_S

Degrees = Annotated[float, Field(allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, le=64)]
Pixels = Annotated[int, Field(ge=2, le=4096)]
_NOT_OF_MAPS = ("read_in", "caveat", "index", "num_rows", "num_columns")
Values = Literal["amplitude", "power", "phase-only-amplitude"]


@dataclass(frozen=True)
class Convention:
    """What the pixels of a publisher's maps mean; rows and columns are evenly spaced, both ends included.

    `values` is what a level is proportional to: the beam's `amplitude` or `power`, or, in
    `phase-only-amplitude`, the amplitude of the beam of the channel's phases alone, h/|h| (the square root
    of what `phase-only` maps are here: such maps are kept as published, of kind `amplitude`).
    `darkest` says what level 0 is: no power, or the map's own minimum (min-max scaling, which cannot be
    undone). `peak` says where a lone wave from direction d is brightest: at d, or, where the maps were
    correlated with the conjugate of the steering vector, at −d; that is the same as to turn the array half
    round about its normal, and an import does so. `num_rows` and `num_columns` are those of an export; an
    import takes the files'.
    """

    rows: Literal["elevation", "polar"]
    first_row_deg: Degrees
    last_row_deg: Degrees
    first_column_deg: Degrees
    last_column_deg: Degrees
    values: Values
    read_in: str
    caveat: str = ""  # what is wrong with the maps themselves, which no field can mend
    darkest: Literal["zero", "minimum"] = "zero"
    peak: Literal["source", "opposite"] = "source"
    quaternion: Literal["xyzw", "wxyz"] = "xyzw"
    plane: ArrayPlane = "xy"
    array_rows: Count = 4
    array_cols: Count = 4
    spacing_wavelengths: Annotated[float, Field(gt=0, le=10)] = 0.5
    index: Literal["file-stem", "zero-based"] = "file-stem"
    num_rows: Pixels = 90
    num_columns: Pixels = 360

    @property
    def last_column_repeats_the_first(self) -> bool:
        """Whether both ends of the azimuths are one direction."""
        return bool(np.isclose(abs(self.last_column_deg - self.first_column_deg), 360))

    def of_maps(self) -> dict[str, Any]:
        """What has to be alike for maps to be read as they were drawn, by field."""
        return {name: value for name, value in asdict(self).items() if name not in _NOT_OF_MAPS}

    @property
    def pas_kind(self) -> PasKind:
        """Kind of the maps as a data set keeps them."""
        return "power" if self.values == "power" else "amplitude"

    def grid(self, num_rows: int, num_columns: int) -> AngularGrid:
        """Directions of a map whose rows and columns ascend (see `ascending`)."""
        elevation_deg = np.linspace(*self._elevation_ends_deg, num_rows)
        azimuth_deg = np.linspace(self.first_column_deg, self.last_column_deg, num_columns)
        return AngularGrid(np.radians(np.sort(elevation_deg)), np.radians(np.sort(azimuth_deg)))

    def ascending(self, maps: Shaped[NDArray[Any], "... R C"]) -> Shaped[NDArray[Any], "... R C"]:
        """Published maps with elevation and azimuth ascending, or such maps as they are published."""
        first_deg, last_deg = self._elevation_ends_deg
        maps = maps[..., ::-1, :] if first_deg > last_deg else maps
        return maps[..., ::-1] if self.first_column_deg > self.last_column_deg else maps

    @property
    def _elevation_ends_deg(self) -> tuple[float, float]:
        ends = self.first_row_deg, self.last_row_deg
        return (90 - ends[0], 90 - ends[1]) if self.rows == "polar" else ends

    def quaternion_xyzw(self, published: tuple[float, ...]) -> tuple[float, float, float, float]:
        """A folder's quaternion as the receiver's, x, y, z, w: in our order, and half turned where maps are."""
        x, y, z, w = published if self.quaternion == "xyzw" else (*published[1:], published[0])
        if self.peak == "source":
            return x, y, z, w
        return (w, z, -y, -x) if self.plane == "yz" else (y, -x, w, -z)

    def published_quaternion(self, receiver: tuple[float, ...]) -> tuple[float, ...]:
        """Inverse of `quaternion_xyzw`, to the last bit."""
        x, y, z, w = receiver
        if self.peak == "opposite":
            x, y, z, w = (-w, -z, y, x) if self.plane == "yz" else (-y, x, -w, z)
        return (x, y, z, w) if self.quaternion == "xyzw" else (w, x, y, z)

    def peak_power(self, brightest: Float[FloatArray, "..."]) -> Float[FloatArray, "..."]:
        """Power at the brightest pixels, given as parts of the highest level."""
        return brightest if self.values == "power" else brightest**2

    def brightest(self, peak_power: Float[FloatArray, "..."]) -> Float[FloatArray, "..."]:
        """Inverse of `peak_power`."""
        return peak_power if self.values == "power" else np.sqrt(peak_power)


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
    "wideband3dgs": Convention(
        rows="polar",
        first_row_deg=0,
        last_row_deg=90,
        first_column_deg=-180,
        last_column_deg=180,
        values="amplitude",
        plane="yz",
        read_in="measured on the published example of Wideband3DGS (tests/test_interchange.py); its receiver is not "
        "turned, so that the quaternion's order is that of its relatives",
    ),
    "xfreq-gs": Convention(
        rows="polar",
        first_row_deg=0,
        last_row_deg=90,
        first_column_deg=-180,
        last_column_deg=180,
        values="phase-only-amplitude",
        peak="opposite",
        plane="yz",
        index="zero-based",
        read_in="KINGAZ1019/XFreq-GS, dataset/scene_builder: utils.py subtracts the channel's phase, exp(+jkr·d), from "
        "-kr·d, so that a lone wave peaks opposite to its source",
        caveat="Its build_dataset.py leaves the scene at Sionna RT's 3.5 GHz and gives the carrier f to cfr() as an "
        "offset: directions are stretched by 1 + f/3.5 GHz, aliased from a few GHz on. Whatever steers an array at "
        "them (line-of-sight, aperture-gs, virtual-source) goes astray on such maps. Shown with its recipe, not with "
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
}


def convention_named(name: str, assignments: Iterable[str] = ()) -> Convention:
    """A convention of the table, with fields changed by `field=value`.

    Raises `UnknownNameError`, `MethodError` for a value that is not of its field's type, and `DataError` for
    angles that no hemisphere has.
    """
    if name not in CONVENTIONS:
        raise UnknownNameError("convention", name, CONVENTIONS)
    convention = override(CONVENTIONS[name], assignments)
    _check_angles(convention)
    return convention


def _check_angles(convention: Convention) -> None:
    rows = convention.first_row_deg, convention.last_row_deg
    if min(rows) < 0 or max(rows) > 90 or rows[0] == rows[1]:
        raise DataError(
            f"Rows from {rows[0]:g} to {rows[1]:g} degrees are no part of a hemisphere; give --set first_row_deg "
            "and last_row_deg from 0 to 90, and not the same."
        )
    span_deg = abs(convention.last_column_deg - convention.first_column_deg)
    if not 0 < span_deg <= 360:
        raise DataError(
            f"Columns from {convention.first_column_deg:g} to {convention.last_column_deg:g} degrees span "
            f"{span_deg:g}; give --set first_column_deg and last_column_deg that span more than 0, and 360 at most."
        )


def convention_rows() -> list[tuple[str, ...]]:
    """The table to print: a row a field, its name first, then its value in every convention; sources left out."""
    shown = [field.name for field in fields(Convention) if field.name not in ("read_in", "caveat")]
    rows = [(name, *(_text(getattr(each, name)) for each in CONVENTIONS.values())) for name in shown]
    repeats = ("yes" if each.last_column_repeats_the_first else "no" for each in CONVENTIONS.values())
    return [*rows, ("last column repeats first", *repeats)]


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
