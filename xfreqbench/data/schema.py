"""What a data set of channels and maps holds: its header and its variables (schema `xfreqbench/pas/1`)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
import pydantic_core
from jaxtyping import Float
from numpy.typing import NDArray
from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PositiveInt,
    SkipValidation,
    StrictBool,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic.dataclasses import dataclass

from xfreqbench.data.hdf5 import Variable
from xfreqbench.maps.bartlett import PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.types import FloatArray

SCHEMA = "xfreqbench/pas/1"

TX, CARRIER, ELEMENT = "tx", "carrier_hz", "element"  # axes, and the variables that are their coordinates
AXIS, RECEIVER_AXIS = "axis", "receiver_axis"
ELEVATION, AZIMUTH = "elevation_deg", "azimuth_deg"
ELEMENT_POSITION = "element_position_wavelengths"
UNKNOWN_NUM_PATHS = -1


def _parsed(value: Any) -> Any:
    """The value in the JSON text of a header attribute; what is no text is a value already, and is returned."""
    return pydantic_core.from_json(value) if isinstance(value, str) else value


_READ = BeforeValidator(_parsed)
_WRITTEN = PlainSerializer(lambda value: json.dumps(value, sort_keys=True))
_RECEIVER_WRITTEN = PlainSerializer(lambda value: TypeAdapter(ReceiverArray).dump_json(value).decode())


@dataclass(frozen=True, eq=False, config=ConfigDict(arbitrary_types_allowed=True, populate_by_name=True))
class DatasetHeader:
    """What a data set says about itself: the one definition of its HDF5 text attributes.

    Fields are stored in this order under their names, or under their alias where they have one, as JSON where
    they are not text. `carrier_hz` is not among them: it is a variable of the file. `settings` are the
    solver's, and `rejected` counts the grid positions left out, by reason. `paths` says whether paths are stored, and
    `physics` is the `PHYSICS_VERSION` of the solver. `references` says which edition of ITU-R P.2040 the materials
    follow; it is in no hash.

    A data set with `channels=False` was published by others as maps alone, which are then stored
    (`maps=True`). What was not published is marked in it: `peak_power` is 1 where there is a map (less where
    its PNG was nowhere white), `num_paths` is −1, and `line_of_sight` is 1 unless it is known.
    """

    scene_name: str
    scene_json: str
    scene_sha256: str
    receiver: Annotated[ReceiverArray, _READ, _RECEIVER_WRITTEN, Field(alias="receiver_json")]
    carrier_hz: Annotated[Float[FloatArray, "F"], SkipValidation]
    num_tx: Annotated[PositiveInt, _READ, _WRITTEN]
    pas_kind: PasKind
    maps: Annotated[StrictBool, _READ, _WRITTEN]
    settings: Annotated[dict[str, Any], _READ, _WRITTEN, Field(alias="settings_json")]
    software: Annotated[dict[str, str], _READ, _WRITTEN, Field(alias="software_json")]
    rejected: Annotated[dict[str, int], _READ, _WRITTEN, Field(alias="rejected_json")]
    channels: Annotated[StrictBool, _READ, _WRITTEN] = True
    paths: Annotated[StrictBool, _READ, _WRITTEN] = False
    physics: Annotated[str, Field(pattern=r"^[0-9]{1,9}$")] = "1"
    references: str = ""

    @model_validator(mode="after")
    def _stores_channels_or_maps(self) -> DatasetHeader:
        if not (self.maps or self.channels):
            raise ValueError("a data set without channels stores its maps")
        return self

    @property
    def num_bytes(self) -> int:
        """Size of the data set's variables in bytes, without paths, on the default grid of directions."""
        return sum(variable.num_bytes for variable in variables(self, AngularGrid.hemisphere()))

    def attributes(self) -> dict[str, str]:
        """The header as texts of HDF5 attributes; what has its default stays out."""
        stored = TypeAdapter(DatasetHeader).dump_python(
            self, by_alias=True, exclude={"carrier_hz"}, exclude_defaults=True
        )
        return {"schema": SCHEMA, **stored}

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, str], carrier_hz: Float[FloatArray, "F"]) -> DatasetHeader:
        """Inverse of `attributes`; raises `ValueError` naming an attribute that is missing or of another type."""
        try:
            return TypeAdapter(cls).validate_python({**attributes, "carrier_hz": carrier_hz})
        except ValidationError as error:
            fault = error.errors()[0]
            where = f"header attribute {fault['loc'][0]!r}: " if fault["loc"] else ""
            raise ValueError(f"{where}{fault['msg']}") from error


def variables(header: DatasetHeader, grid: AngularGrid) -> list[Variable]:
    """Every variable of a data set with this header and maps on this grid, in the order of the file."""
    return [*_geometry_variables(header, grid), *_sample_variables(header, grid)]


def _geometry_variables(header: DatasetHeader, grid: AngularGrid) -> list[Variable]:
    """Axes with their coordinates, transmitters and receiver."""
    T, F, M = header.num_tx, len(header.carrier_hz), header.receiver.num_elements
    E, A = grid.shape
    receiver_axis = "axis of the receiver's frame; 2 is the pole"
    element_position = "element position about the array centre, in wavelengths, in the receiver's frame"
    return [
        Variable(TX, "<i4", (T,), (TX,), "1", "transmitter index"),
        Variable(CARRIER, "<f8", (F,), (CARRIER,), "Hz", "carrier frequency"),
        Variable(ELEMENT, "<i4", (M,), (ELEMENT,), "1", "array element index, row by row"),
        Variable(AXIS, "<i4", (3,), (AXIS,), "1", "world axis: 0 x, 1 y, 2 z", flags=_words("x", "y", "z")),
        Variable(RECEIVER_AXIS, "<i4", (3,), (RECEIVER_AXIS,), "1", receiver_axis),
        Variable(ELEVATION, "<f8", (E,), (ELEVATION,), "degree", "elevation above the frame's equator"),
        Variable(AZIMUTH, "<f8", (A,), (AZIMUTH,), "degree", "azimuth in the frame, periodic"),
        Variable("tx_position_m", "<f8", (T, 3), (TX, AXIS), "m", "transmitter position"),
        Variable("rx_position_m", "<f8", (3,), (AXIS,), "m", "position of the array centre"),
        Variable(ELEMENT_POSITION, "<f8", (M, 3), (ELEMENT, RECEIVER_AXIS), "1", element_position),
        Variable("frame_rotation", "<f8", (3, 3), (AXIS, RECEIVER_AXIS), "1", "receiver's frame to world"),
    ]


def _sample_variables(header: DatasetHeader, grid: AngularGrid) -> list[Variable]:
    """Channels, maps, and what is known of each transmitter or sample (transmitter, carrier)."""
    T, F, M = header.num_tx, len(header.carrier_hz), header.receiver.num_elements
    sample, channel, angles = (TX, CARRIER), (TX, CARRIER, ELEMENT), (ELEVATION, AZIMUTH)
    response, peak = "channel frequency response, exp(+j2πft)", "peak of the map before it was divided out"
    in_sight, traced = _words("blocked", "visible"), _words("missing", "traced")
    where = ("tx_position_m", "line_of_sight")
    cfr = Variable("cfr", "<c8", (T, F, M), channel, "1", response, coordinates=where)
    num_paths = "paths that reach at least one element"
    pas = Variable(
        "pas",
        "<f2",
        (T, F, *grid.shape),
        (*sample, *angles),
        "1",
        f"power angular spectrum ({header.pas_kind}), peak 1",
        chunk=(1, 1, *grid.shape),
        coordinates=where,
    )
    return [
        *([cfr] if header.channels else []),
        Variable("peak_power", "<f8", (T, F), sample, "1", peak, coordinates=where),
        Variable("line_of_sight", "u1", (T,), (TX,), "1", "1 where nothing blocks the direct path", flags=in_sight),
        Variable("num_paths", "<i4", (T, F), sample, "1", num_paths, coordinates=where),
        Variable("complete", "u1", (T,), (TX,), "1", "1 where the transmitter has been traced", flags=traced),
        *([pas] if header.maps else []),
    ]


def _words(*meanings: str) -> tuple[tuple[int, str], ...]:
    """The flags of a variable whose values 0, 1, … have these meanings."""
    return tuple(enumerate(meanings))


def constants(header: DatasetHeader, grid: AngularGrid) -> dict[str, NDArray[Any]]:
    """Values, by variable, of all that is known before the first ray: axes, grid and receiver."""
    receiver = header.receiver
    return {
        TX: np.arange(header.num_tx),
        CARRIER: header.carrier_hz,
        ELEMENT: np.arange(receiver.num_elements),
        AXIS: np.arange(3),
        RECEIVER_AXIS: np.arange(3),
        ELEVATION: np.degrees(grid.elevation_rad).round(9),
        AZIMUTH: np.degrees(grid.azimuth_rad).round(9),
        "rx_position_m": np.asarray(receiver.position_m),
        ELEMENT_POSITION: receiver.element_position_wavelengths,
        "frame_rotation": receiver.rotation,
    }
