"""The header and the variables of a data set of channels and maps (schema `xfreqbench/pas/1`)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import pydantic_core
from jaxtyping import Float
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

from xfreqbench.data.hdf5 import PACKED, Variable
from xfreqbench.errors import UnknownNameError
from xfreqbench.maps.bartlett import PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.model import PolarizationPair, ReceiverArray, Scene
from xfreqbench.types import FloatArray, NDArray

SCHEMA = "xfreqbench/pas/1"

TX, CARRIER, ELEMENT = "tx", "carrier_hz", "element"  # axes, and the variables that are their coordinates
RECEIVER, POLARIZATION = "receiver", "polarization"  # axes of a file with several
AXIS, RECEIVER_AXIS = "axis", "receiver_axis"
ELEVATION, AZIMUTH = "elevation_deg", "azimuth_deg"
UNKNOWN_NUM_PATHS = -1


_READ = BeforeValidator(lambda value: pydantic_core.from_json(value) if isinstance(value, str) else value)
_WRITTEN = PlainSerializer(lambda value: json.dumps(value, sort_keys=True))
_RECEIVER_WRITTEN = PlainSerializer(lambda value: TypeAdapter(ReceiverArray).dump_json(value).decode())


@dataclass(frozen=True, eq=False, config=ConfigDict(arbitrary_types_allowed=True, populate_by_name=True))
class DatasetHeader:
    """The header of a data set: the one definition of its HDF5 text attributes.

    Fields are stored in this order under their names, or under their alias if they have one, as JSON if they are not
    text. `carrier_hz` is not among them: it is a variable of the file. `settings` are the solver's, and `rejected`
    counts the grid positions left out, by reason. `paths` says whether paths are stored, and `physics` is the
    `PHYSICS_VERSION` of the solver. `references` names the edition of ITU-R P.2040 that the materials follow; it is in
    no hash.

    A file may hold several links: `receivers` names its receivers if there are several, all in the scene, and
    `polarizations` its pairs of polarizations, the transmitters' first. `receiver` and `settings` are then those of the
    first link; `at` gives the header of each.

    A data set with `channels=False` was published by others as maps, which are then stored (`maps=True`). Values that
    were not published are marked: `peak_power` is 1 where there is a map (less if its PNG is nowhere white),
    `num_paths` is −1, and `line_of_sight` is 1 unless it is known.
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
    receivers: Annotated[tuple[str, ...], _READ, _WRITTEN, Field(alias="receivers_json")] = ()
    polarizations: Annotated[tuple[PolarizationPair, ...], _READ, _WRITTEN, Field(alias="polarizations_json")] = ()

    @model_validator(mode="after")
    def _stores_channels_or_maps(self) -> DatasetHeader:
        if not (self.maps or self.channels):
            raise ValueError("a data set without channels stores its maps")
        return self

    @property
    def num_carriers(self) -> int:
        """Number of carriers F."""
        return len(self.carrier_hz)

    @property
    def link_names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Receivers and pairs of polarizations (`VH`: sent in V, received in H); empty if there is only one."""
        return self.receivers, self.polarizations

    @property
    def link_axes(self) -> dict[str, int]:
        """The axes between transmitter and carrier, with their lengths: empty for a file of one link."""
        return {
            axis: len(names) for axis, names in zip((RECEIVER, POLARIZATION), self.link_names, strict=True) if names
        }

    def link(self, receiver: str | None = None, polarization: str | None = None) -> tuple[int, int]:
        """The numbers of a receiver and of a pair of polarizations, of the first if None.

        Raises `UnknownNameError` for one that the file does not have.
        """
        own = self.settings.get("transmitter_polarization", self.receiver.polarization) + self.receiver.polarization
        known = {
            "receiver": (receiver, self.receivers or (self.receiver.name or "",)),
            "polarization": (polarization, self.polarizations or (own,)),
        }
        for kind, (name, names) in known.items():
            if name is not None and name not in names:
                raise UnknownNameError(kind, name, names)
        first, second = (names.index(name) if name is not None else 0 for name, names in known.values())
        return first, second

    def at(self, receiver: int = 0, polarization: int = 0) -> DatasetHeader:
        """The header of one link, as in a file with only this link; raises `ValueError` for a damaged one."""
        if not self.link_axes:
            return self
        scene = TypeAdapter(Scene).validate_json(self.scene_json)
        if self.receivers:
            names = tuple(receiver.name for receiver in scene.receivers)
            if names != self.receivers:
                raise ValueError(f"header attribute 'receivers_json': the scene has the receivers {names}")
            scene = scene.with_receiver(self.receivers[receiver])
        if self.polarizations:
            scene = scene.with_polarization(self.polarizations[polarization])
        of_all = {name: value for name, value in self.settings.items() if not name.startswith("transmitter_")}
        return replace(
            self,
            scene_json=scene.canonical_json,
            receiver=scene.receiver,
            settings=of_all | scene.antenna_settings,
            receivers=(),
            polarizations=(),
        )

    @property
    def num_bytes(self) -> int:
        """Size of the data set's variables in bytes, without paths, on the default grid of directions."""
        return sum(variable.num_bytes for variable in variables(self, AngularGrid.hemisphere()))

    def attributes(self) -> dict[str, str]:
        """The header as texts of HDF5 attributes, without fields that have their default."""
        stored = TypeAdapter(DatasetHeader).dump_python(
            self, by_alias=True, exclude={"carrier_hz"}, exclude_defaults=True
        )
        return {"schema": SCHEMA, **stored}

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, str], carrier_hz: Float[FloatArray, "F"]) -> DatasetHeader:
        """Inverse of `attributes`; raises a `ValueError` that names an attribute that is missing or of another type."""
        try:
            return TypeAdapter(cls).validate_python({**attributes, "carrier_hz": carrier_hz})
        except ValidationError as error:
            fault = error.errors()[0]
            where = f"header attribute {fault['loc'][0]!r}: " if fault["loc"] else ""
            raise ValueError(f"{where}{fault['msg']}") from error


def variables(header: DatasetHeader, grid: AngularGrid) -> list[Variable]:
    """Every variable of a data set with this header and maps on this grid, in the order of the file."""
    T, F, M = header.num_tx, len(header.carrier_hz), header.receiver.num_elements
    E, A = grid.shape
    rx = {axis: count for axis, count in header.link_axes.items() if axis == RECEIVER}
    receiver_axis = "axis of the receiver's frame; 2 is the pole"
    sent_and_heard = "polarization of the transmitter, then of the receiver"
    named = {RECEIVER: (header.receivers, "receiver"), POLARIZATION: (header.polarizations, sent_and_heard)}
    element_position = "element position about the array centre, in wavelengths, in the receiver's frame"
    frame_axes, frame_shape = (*rx, AXIS, RECEIVER_AXIS), (*rx.values(), 3, 3)
    links, counts = tuple(header.link_axes), tuple(header.link_axes.values())
    sample, channel, angles = (TX, *links, CARRIER), (TX, *links, CARRIER, ELEMENT), (ELEVATION, AZIMUTH)
    response, peak = "channel frequency response, exp(+j2πft)", "peak of the map before it was divided out"
    in_sight, traced = _words("blocked", "visible"), _words("missing", "traced")
    where = ("tx_position_m", "line_of_sight")
    cfr = Variable("cfr", "<c8", (T, *counts, F, M), channel, "1", response, coordinates=where)
    num_paths, direct = "paths that reach at least one element", "1 where nothing blocks the direct path"
    pas, chunk = f"power angular spectrum ({header.pas_kind}), peak 1", (1, *(1 for _ in links), 1, E, A)
    pas_shape, of_map = (T, *counts, F, E, A), (*sample, *angles)
    return [
        Variable(TX, "<i4", (T,), (TX,), "1", "transmitter index"),
        Variable(CARRIER, "<f8", (F,), (CARRIER,), "Hz", "carrier frequency"),
        Variable(ELEMENT, "<i4", (M,), (ELEMENT,), "1", "array element index, row by row"),
        Variable(AXIS, "<i4", (3,), (AXIS,), "1", "world axis: 0 x, 1 y, 2 z", flags=_words("x", "y", "z")),
        Variable(RECEIVER_AXIS, "<i4", (3,), (RECEIVER_AXIS,), "1", receiver_axis),
        Variable(ELEVATION, "<f8", (E,), (ELEVATION,), "degree", "elevation above the frame's equator"),
        Variable(AZIMUTH, "<f8", (A,), (AZIMUTH,), "degree", "azimuth in the frame, periodic"),
        Variable("tx_position_m", "<f8", (T, 3), (TX, AXIS), "m", "transmitter position"),
        Variable("rx_position_m", "<f8", (*rx.values(), 3), (*rx, AXIS), "m", "position of the array centre"),
        Variable("element_position_wavelengths", "<f8", (M, 3), (ELEMENT, RECEIVER_AXIS), "1", element_position),
        Variable("frame_rotation", "<f8", frame_shape, frame_axes, "1", "receiver's frame to world"),
        *(
            Variable(axis, "<i4", (count,), (axis,), "1", named[axis][1], flags=_words(*named[axis][0]))
            for axis, count in header.link_axes.items()
        ),
        *([cfr] if header.channels else []),
        Variable("peak_power", "<f8", (T, *counts, F), sample, "1", peak, coordinates=where),
        Variable("line_of_sight", "u1", (T, *rx.values()), (TX, *rx), "1", direct, flags=in_sight),
        Variable("num_paths", "<i4", (T, *counts, F), sample, "1", num_paths, coordinates=where),
        Variable("complete", "u1", (T,), (TX,), "1", "1 where the transmitter has been traced", flags=traced),
        *([Variable("pas", PACKED, pas_shape, of_map, "1", pas, chunk, coordinates=where)] if header.maps else []),
    ]


def _words(*meanings: str) -> tuple[tuple[int, str], ...]:
    """The flags of a variable whose values 0, 1, … have these meanings, each written as one word."""
    return tuple((value, "_".join(meaning.split())) for value, meaning in enumerate(meanings))


def constants(header: DatasetHeader, grid: AngularGrid) -> dict[str, NDArray[Any]]:
    """The values that are known before the first ray, by variable: axes, grid and receivers."""
    receiver, receivers = header.receiver, [header.at(number).receiver for number in range(len(header.receivers))]
    positions_m = [np.asarray(of_link.position_m) for of_link in receivers or [receiver]]
    rotations = [of_link.rotation for of_link in receivers or [receiver]]
    return {
        TX: np.arange(header.num_tx),
        CARRIER: header.carrier_hz,
        ELEMENT: np.arange(receiver.num_elements),
        AXIS: np.arange(3),
        RECEIVER_AXIS: np.arange(3),
        ELEVATION: np.degrees(grid.elevation_rad).round(9),
        AZIMUTH: np.degrees(grid.azimuth_rad).round(9),
        "rx_position_m": np.stack(positions_m) if receivers else positions_m[0],
        "element_position_wavelengths": receiver.element_position_wavelengths,
        "frame_rotation": np.stack(rotations) if receivers else rotations[0],
        **{axis: np.arange(count) for axis, count in header.link_axes.items()},
    }
