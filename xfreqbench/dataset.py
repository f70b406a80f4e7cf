"""Data sets on disk (schema `xfreqbench/pas/1`): written whole, sealed by a sha256, read lazily.

The channel frequency response is the truth; the maps are derived from it, and stored beside it because
users expect them. A data set that others published as maps alone has no channels, and is read the same way.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray
from pydantic import PositiveInt, TypeAdapter, ValidationError

from xfreqbench.angles import AngularGrid, FloatArray
from xfreqbench.errors import DataError
from xfreqbench.hdf5 import (
    Variable,
    create_sealed,
    open_sealed,
    read_array,
    read_errors,
    require_layout,
    sealed_sha256,
    text_attributes,
    verify_sealed,
)
from xfreqbench.pas import BartlettBeam, PasKind
from xfreqbench.scene import FAR_M, ReceiverArray

SCHEMA = "xfreqbench/pas/1"
IntArray = NDArray[np.int64]
Rows = slice | Sequence[int] | IntArray

_TX, _CARRIER, _ELEMENT = "tx", "carrier_hz", "element"
_AXIS, _FRAME_AXIS = "axis", "receiver_axis"
UNKNOWN_NUM_PATHS = -1
_WRITE_BLOCK = 64  # transmitters whose maps are derived at once: 10 carriers of them are 83 MB


@dataclass(frozen=True, eq=False)
class DatasetHeader:
    """All that a data set says of itself. `settings` are the solver's, `rejected` counts transmitters.

    Without `channels` the maps came as such, and must be stored. What nobody told of them is then marked:
    `peak_power` is 1 where there is a map (less where its PNG was nowhere white), `num_paths` −1, and
    `line_of_sight` 1 unless it is known.
    """

    scene_name: str
    scene_json: str
    scene_sha256: str
    receiver: ReceiverArray
    carrier_hz: Float[FloatArray, "F"]
    num_tx: int
    pas_kind: PasKind
    maps: bool
    settings: Mapping[str, Any]
    software: Mapping[str, str]
    rejected: Mapping[str, int]
    channels: bool = True

    def __post_init__(self) -> None:
        if not (self.maps or self.channels):
            raise ValueError("a data set without channels stores its maps")

    @property
    def num_bytes(self) -> int:
        """Size of the data set's content."""
        return sum(variable.num_bytes for variable in _variables(self, AngularGrid.hemisphere()))

    def attributes(self) -> dict[str, str]:
        """The header as HDF5 text attributes; the carriers are a dataset and stay out."""
        without_channels = {} if self.channels else {"channels": "false"}  # absent where hashes are older
        return {
            "schema": SCHEMA,
            "scene_name": self.scene_name,
            "scene_json": self.scene_json,
            "scene_sha256": self.scene_sha256,
            "receiver_json": TypeAdapter(ReceiverArray).dump_json(self.receiver).decode(),
            "num_tx": str(self.num_tx),
            "pas_kind": self.pas_kind,
            "maps": json.dumps(self.maps),
            "settings_json": json.dumps(self.settings, sort_keys=True),
            "software_json": json.dumps(self.software, sort_keys=True),
            "rejected_json": json.dumps(self.rejected, sort_keys=True),
            **without_channels,
        }

    @classmethod
    def from_attributes(
        cls, attributes: Mapping[str, str], carrier_hz: Float[FloatArray, "F"]
    ) -> DatasetHeader:
        """Inverse of `attributes`; raises `KeyError`, and `ValueError` for one that is not of its type."""
        return cls(
            scene_name=attributes["scene_name"],
            scene_json=attributes["scene_json"],
            scene_sha256=attributes["scene_sha256"],
            receiver=_parsed(ReceiverArray, attributes, "receiver_json"),
            carrier_hz=carrier_hz,
            num_tx=_parsed(PositiveInt, attributes, "num_tx"),
            pas_kind=_parsed(PasKind, {"pas_kind": json.dumps(attributes["pas_kind"])}, "pas_kind"),
            maps=_parsed(bool, attributes, "maps"),
            settings=_parsed(dict[str, Any], attributes, "settings_json"),
            software=_parsed(dict[str, str], attributes, "software_json"),
            rejected=_parsed(dict[str, int], attributes, "rejected_json"),
            channels=_parsed(bool, {"channels": "true", **attributes}, "channels"),
        )


def _parsed(kind: Any, attributes: Mapping[str, str], name: str) -> Any:
    """A header attribute from its JSON; raises `ValueError` naming it."""
    try:
        return TypeAdapter(kind).validate_json(attributes[name], strict=kind is bool)
    except ValidationError as error:
        raise ValueError(f"header attribute {name!r}: {error.errors()[0]['msg']}") from error


class PasWriter:
    """Writes one data set: a context manager that is fed transmitters and leaves a whole file, or none.

    It takes channels by `append`, or maps on `grid` by `append_maps` where the header has no channels.
    Raises `StorageError` where the file cannot be written, up front where space is known to be short,
    and `DataError` where the transmitters appended are not the header's number. A file at `path` is
    replaced at the end, not before.
    """

    def __init__(self, path: Path, header: DatasetHeader, grid: AngularGrid | None = None) -> None:
        self._header = header
        grid = grid or AngularGrid.hemisphere()
        self._beam = BartlettBeam(header.receiver.element_position_wavelengths, grid)
        variables = _variables(header, self._beam.grid)
        self._context = create_sealed(path, variables, header.attributes())

    def __enter__(self) -> PasWriter:
        self._file = self._context.__enter__()
        for name, values in _constants(self._header, self._beam.grid).items():
            self._file.append(name, values)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        return self._context.__exit__(kind, error, trace)

    def append(
        self,
        tx_position_m: Float[FloatArray, "T 3"],
        line_of_sight: Bool[NDArray[np.bool_], "T"],
        cfr: Complex[NDArray[np.complexfloating], "T F M"],
        num_paths: Int[NDArray[np.integer], "T F"],
    ) -> None:
        """Write the next T transmitters; the maps are derived from the channel as it is stored."""
        for start in range(0, len(cfr), _WRITE_BLOCK):
            self._append_channels(cfr[start : start + _WRITE_BLOCK].astype(np.complex64))
        self._append_transmitters(tx_position_m, line_of_sight, num_paths)

    def append_maps(
        self,
        tx_position_m: Float[FloatArray, "T 3"],
        line_of_sight: Bool[NDArray[np.bool_], "T"],
        maps: Float[NDArray[np.float32], "T F E A"],
        peak_power: Float[FloatArray, "T F"] | None = None,
    ) -> None:
        """Write the next T transmitters of a data set without channels; each map has peak 1, or is zero.

        `peak_power` is 0 where the map is; 1 at all others unless it is given.
        """
        is_heard = np.asarray(maps.any(axis=(2, 3)))
        self._file.append("pas", maps)
        self._file.append("peak_power", is_heard if peak_power is None else peak_power)
        self._append_transmitters(tx_position_m, line_of_sight, np.where(is_heard, UNKNOWN_NUM_PATHS, 0))

    def _append_transmitters(
        self,
        tx_position_m: Float[FloatArray, "T 3"],
        line_of_sight: Bool[NDArray[np.bool_], "T"],
        num_paths: Int[NDArray[np.integer], "T F"],
    ) -> None:
        self._file.append("tx_position_m", tx_position_m)
        self._file.append("line_of_sight", line_of_sight)
        self._file.append("num_paths", num_paths)
        self._file.append("complete", np.ones(len(num_paths)))

    def _append_channels(self, cfr: Complex[NDArray[np.complex64], "T F M"]) -> None:
        maps, peak_power = self._beam.maps(cfr.reshape(-1, cfr.shape[-1]), self._header.pas_kind)
        self._file.append("cfr", cfr)
        self._file.append("peak_power", peak_power.reshape(cfr.shape[:2]))
        if self._header.maps:
            self._file.append("pas", maps.reshape(*cfr.shape[:2], *self._beam.grid.shape))


@dataclass(frozen=True, eq=False)
class PasDataset:
    """N samples (transmitter, carrier) of a data set; row = tx_index · F + carrier index in the whole of it.

    Maps stay on disk until `pas` asks for them, or are derived from the channel where none are stored.
    Pickles as path and rows.
    """

    path: Path
    header: DatasetHeader
    sha256: str
    beam: BartlettBeam
    tables: Mapping[str, NDArray[Any]]
    rows: Int[IntArray, "N"]

    def __len__(self) -> int:
        return len(self.rows)

    def __reduce__(self) -> tuple[Any, ...]:
        return reopen, (str(self.path), self.sha256, self.rows)

    @property
    def grid(self) -> AngularGrid:
        """Directions of the maps, from the stored coordinates."""
        return self.beam.grid

    @property
    def num_carriers(self) -> int:
        """F of the whole data set."""
        return len(self.header.carrier_hz)

    @cached_property
    def tx_index(self) -> Int[IntArray, "N"]:
        """Index of each row's transmitter in the whole data set."""
        return self.rows // self.num_carriers

    @cached_property
    def tx_position_m(self) -> Float[FloatArray, "N 3"]:
        """Transmitter positions in the world."""
        return self.tables["tx_position_m"][self.tx_index]

    @cached_property
    def carrier_hz(self) -> Float[FloatArray, "N"]:
        """Carrier of each row."""
        return self.header.carrier_hz[self.rows % self.num_carriers]

    @cached_property
    def line_of_sight(self) -> Bool[NDArray[np.bool_], "N"]:
        """Whether nothing stands between transmitter and array centre."""
        return self.tables["line_of_sight"][self.tx_index].astype(bool)

    @cached_property
    def peak_power(self) -> Float[FloatArray, "N"]:
        """Peak of each map before it was divided out; 0 where no path arrives, 1 where it is not known."""
        return self._samples("peak_power")

    @cached_property
    def has_path(self) -> Bool[NDArray[np.bool_], "N"]:
        """Whether any path arrives: without one the map is all zeros and scores nothing."""
        return self.peak_power > 0

    @cached_property
    def num_paths(self) -> Int[NDArray[np.int32], "N"]:
        """Paths that reach at least one element; −1 where nobody told."""
        return self._samples("num_paths")

    @cached_property
    def cfr(self) -> Complex[NDArray[np.complex64], "N M"]:
        """Channel at the array's elements (Eq. 1); raises `DataError` for a data set of maps alone."""
        if not self.header.channels:
            raise DataError(
                f"{self.path} holds maps alone, no channels. Use `pas`, or a data set that was generated."
            )
        return self._samples("cfr")

    def pas(self, rows: Rows = slice(None)) -> Float[NDArray[np.float32], "n E A"]:
        """Maps of some rows, peak 1; raises `DataError`. A map is 130 kB: see `batches`."""
        if not self.header.maps:
            return self.beam.maps(self.cfr[rows], self.header.pas_kind)[0]
        maps = np.empty((len(self.rows[rows]), *self.grid.shape), np.float32)
        with open_sealed(self.path, SCHEMA) as file, read_errors(self.path, "dataset 'pas'"):
            stored = file["pas"]
            for index, row in enumerate(self.rows[rows].tolist()):
                maps[index] = stored[divmod(row, self.num_carriers)]
        return maps

    def batches(self, size: int) -> Iterator[tuple[IntArray, Float[NDArray[np.float32], "n E A"]]]:
        """Rows and their maps, `size` at a time."""
        for start in range(0, len(self), size):
            rows = np.arange(start, min(start + size, len(self)))
            yield rows, self.pas(rows)

    def subset(self, rows: Rows) -> PasDataset:
        """View of some rows."""
        return replace(self, rows=self.rows[rows])

    def isolated(self) -> PasDataset:
        """The same view with the channels of all other samples erased: what a method is given to train on."""
        tables = dict(self.tables)
        for name in self.tables.keys() & {"cfr", "peak_power", "num_paths"}:
            samples = tables[name].reshape(-1, *tables[name].shape[2:])
            kept = np.zeros_like(samples)
            kept[self.rows] = samples[self.rows]
            tables[name] = kept.reshape(tables[name].shape)
        return replace(self, tables=tables)

    def _samples(self, name: str) -> NDArray[Any]:
        table = self.tables[name]
        return table.reshape(-1, *table.shape[2:])[self.rows]


def open_dataset(path: str | Path) -> PasDataset:
    """Every sample of a data set; raises `DataError` for a missing, truncated or foreign file."""
    path = Path(path)
    with open_sealed(path, SCHEMA) as file:
        header = DatasetHeader.from_attributes(text_attributes(file), read_array(file, "carrier_hz"))
        grid = AngularGrid(
            *(np.radians(read_array(file, f"{name}_deg")) for name in ("elevation", "azimuth"))
        )
        require_layout(file, _variables(header, grid))
        names = ("tx_position_m", "line_of_sight", "peak_power", "num_paths", "cfr")
        tables = {name: file[name][...] for name in names if header.channels or name != "cfr"}
        beam = BartlettBeam(file["element_position_wavelengths"][...], grid)
        angles = {"elevation_deg": grid.elevation_rad, "azimuth_deg": grid.azimuth_rad}
        elements = {"element_position_wavelengths": beam.element_position_wavelengths}
        _require_meaning({_CARRIER: header.carrier_hz, **angles, **elements, **tables})
        rows = np.arange(tables["peak_power"].size, dtype=np.int64)
        return PasDataset(path.resolve(), header, sealed_sha256(file), beam, tables, rows)


def _require_meaning(tables: Mapping[str, NDArray[Any]]) -> None:
    for name, values in tables.items():
        if not np.isfinite(values).all():
            raise ValueError(f"dataset {name!r} holds numbers that are not finite")
    if not (np.diff(tables[_CARRIER], prepend=0) > 0).all():
        raise ValueError(f"dataset {_CARRIER!r} holds {tables[_CARRIER]}; carriers ascend from above 0")
    if (np.abs(tables["tx_position_m"]) > FAR_M).any():
        raise ValueError(f"dataset 'tx_position_m' holds positions beyond {FAR_M:g} m")


def reopen(path: str, sha256: str, rows: Rows) -> PasDataset:
    """The rows of a data set that was open before; raises `DataError` where the file has changed since."""
    dataset = open_dataset(path)
    if dataset.sha256 != sha256:
        raise DataError(f"{path} is another data set than before: its sha256 was {sha256}.")
    return dataset.subset(rows)


def verify(path: str | Path) -> None:
    """Compare every byte of a data set with its hashes; raises `DataError` naming the first damaged part."""
    verify_sealed(Path(path), SCHEMA)


def geometry(dataset: PasDataset) -> list[tuple[Variable, NDArray[Any]]]:
    """Grid and receiver as a data set stores them, each with its values: all that any method may know."""
    known = _constants(dataset.header, dataset.grid)
    variables = _variables(dataset.header, dataset.grid)
    return [(each, known[each.name]) for each in variables if each.name in known.keys() - {_TX, _CARRIER}]


def _variables(header: DatasetHeader, grid: AngularGrid) -> list[Variable]:
    T, F, M = header.num_tx, len(header.carrier_hz), header.receiver.num_elements
    E, A = grid.shape
    sample = (_TX, _CARRIER)
    angles = ("elevation_deg", "azimuth_deg")
    cfr = Variable(
        "cfr", "<c8", (T, F, M), (*sample, _ELEMENT), "1", "channel frequency response, exp(+j2πft)"
    )
    variables = [
        Variable(_TX, "<i4", (T,), (_TX,), "1", "transmitter index"),
        Variable(_CARRIER, "<f8", (F,), (_CARRIER,), "Hz", "carrier frequency"),
        Variable(_ELEMENT, "<i4", (M,), (_ELEMENT,), "1", "array element index, row by row"),
        Variable(_AXIS, "<i4", (3,), (_AXIS,), "1", "world axis: 0 x, 1 y, 2 z"),
        Variable(
            _FRAME_AXIS, "<i4", (3,), (_FRAME_AXIS,), "1", "axis of the receiver's frame; 2 is the pole"
        ),
        Variable(angles[0], "<f8", (E,), angles[:1], "degree", "elevation above the frame's equator"),
        Variable(angles[1], "<f8", (A,), angles[1:], "degree", "azimuth in the frame, periodic"),
        Variable("tx_position_m", "<f8", (T, 3), (_TX, _AXIS), "m", "transmitter position"),
        Variable("rx_position_m", "<f8", (3,), (_AXIS,), "m", "position of the array centre"),
        Variable(
            "element_position_wavelengths",
            "<f8",
            (M, 3),
            (_ELEMENT, _FRAME_AXIS),
            "1",
            "element position about the array centre, in wavelengths, in the receiver's frame",
        ),
        Variable("frame_rotation", "<f8", (3, 3), (_AXIS, _FRAME_AXIS), "1", "receiver's frame to world"),
        *([cfr] if header.channels else []),
        Variable("peak_power", "<f8", (T, F), sample, "1", "peak of the map before it was divided out"),
        Variable("line_of_sight", "u1", (T,), (_TX,), "1", "1 where nothing blocks the direct path"),
        Variable("num_paths", "<i4", (T, F), sample, "1", "paths that reach at least one element"),
        Variable("complete", "u1", (T,), (_TX,), "1", "1 where the transmitter has been traced"),
    ]
    if header.maps:
        long_name = f"power angular spectrum ({header.pas_kind}), peak 1"
        variables.append(
            Variable("pas", "<f2", (T, F, E, A), (*sample, *angles), "1", long_name, chunk=(1, 1, E, A))
        )
    return variables


def _constants(header: DatasetHeader, grid: AngularGrid) -> dict[str, NDArray[Any]]:
    """Everything that is known before the first ray."""
    receiver = header.receiver
    return {
        _TX: np.arange(header.num_tx),
        _CARRIER: header.carrier_hz,
        _ELEMENT: np.arange(receiver.num_elements),
        _AXIS: np.arange(3),
        _FRAME_AXIS: np.arange(3),
        "elevation_deg": np.degrees(grid.elevation_rad).round(9),
        "azimuth_deg": np.degrees(grid.azimuth_rad).round(9),
        "rx_position_m": np.asarray(receiver.position_m),
        "element_position_wavelengths": receiver.element_position_wavelengths,
        "frame_rotation": receiver.rotation,
    }
