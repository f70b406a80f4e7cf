"""Reads data sets (schema `xfreqbench/pas/1`): small arrays at once, maps when they are asked for.

A generated data set stores channels, and the maps that are derived from them. A data set that others published as
maps has no channels, and is read in the same way.
"""

from __future__ import annotations

import reprlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from functools import cached_property
from html import escape
from itertools import pairwise, product
from math import prod
from pathlib import Path
from typing import Any, NamedTuple, overload

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from pydantic import TypeAdapter, ValidationError

from xfreqbench.data import hdf5
from xfreqbench.data.paths import GROUP, OFFSET, SamplePaths, path_variables, read_paths, stored_offsets, stored_totals
from xfreqbench.data.recipe import Recipe, job_differences, job_of
from xfreqbench.data.schema import CARRIER, SCHEMA, DatasetHeader, variables
from xfreqbench.errors import DataError
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.model import FAR_M, Scene
from xfreqbench.system.arguments import FilePath, checked
from xfreqbench.system.files import json_sha256, require_own
from xfreqbench.system.remote import located
from xfreqbench.tracing.paths import RaggedPaths
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import format_ghz_list

Rows = slice | Sequence[int] | NDArray[Any]  # which samples are meant, by their numbers or by a mask


class Sample(NamedTuple):
    """One sample of a data set: the map (peak 1) of one transmitter at one carrier."""

    map: Float[NDArray[np.float32], "E A"]
    tx_position_m: Float[FloatArray, "3"]
    carrier_hz: float


@dataclass(frozen=True, eq=False, repr=False)
class PasDataset:
    """N samples (transmitter, carrier) of a data set: all of it, or a subset.

    `dataset[7]` is a `Sample`, and iteration yields samples; a slice, whole numbers or a mask select a subset, which
    is a `PasDataset` too. `rows` are the numbers of the samples in the whole data set: a sample's row is
    tx_index · F + carrier index, where F is the number of carriers. Maps are read from disk when they are asked for,
    or derived from the channels if none are stored. `tables` holds the small arrays, of all transmitters and carriers:
    `tables["peak_power"].flat[rows]` is the peak power that each map was divided by, 0 where no path arrives and 1
    where it is not known; `num_paths`, likewise, is −1 where it is not known; and `tables["line_of_sight"][tx_index]`
    is true where nothing blocks the line from a transmitter to the array centre. A data set is pickled as its path and
    rows.

    A file may hold several links, one for each receiver and pair of polarizations. A data set shows one of them, with
    the header of a file with only this link, and its own `sha256`. `file_header` describes all links, and `link` names
    the receiver and the pair that are shown, None if the file has only one; see `at` and `links`. `other_receivers`
    are the data sets that a method may learn from if the tested receiver is held out (protocol `held-out-receiver`).
    """

    path: Path
    header: DatasetHeader
    file_sha256: str
    beam: BartlettBeam
    tables: Mapping[str, NDArray[Any]]
    rows: Int[IntArray, "N"]
    file_header: DatasetHeader
    link: tuple[str | None, str | None] = (None, None)
    other_receivers: tuple[PasDataset, ...] = ()
    _is_isolated: bool = False

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, rows: int | np.integer) -> Sample: ...

    @overload
    def __getitem__(self, rows: Rows) -> PasDataset: ...

    def __getitem__(self, rows: int | np.integer | Rows) -> Sample | PasDataset:
        """A sample by its number (negative ones count from the end), or a subset; raises `IndexError`."""
        if not isinstance(rows, int | np.integer):
            return replace(self, rows=self.rows[chosen_rows(rows, len(self))])
        one = self[[int(rows)]]
        return Sample(one.pas()[0], one.tx_position_m[0], float(one.carrier_hz[0]))

    def __iter__(self) -> Iterator[Sample]:
        for start in range(0, len(self), 64):
            part = self[start : start + 64]
            yield from map(Sample, part.pas(), part.tx_position_m, part.carrier_hz.tolist())

    def __repr__(self) -> str:
        facts = [f"{name:9} {fact}" for name, fact in self._facts().items()]
        return "\n".join([f"PasDataset {str(self.path)!r}", *facts])

    def _repr_html_(self) -> str:
        """The same as `repr`, as a table for notebooks."""
        facts = {"data set": str(self.path), **self._facts()}
        rows = [f"<tr><th>{escape(name)}</th><td>{escape(fact)}</td></tr>" for name, fact in facts.items()]
        return f"<table>{''.join(rows)}</table>"

    def _facts(self) -> dict[str, str]:
        header, num_samples = self.header, self.header.num_tx * self.header.num_carriers
        carriers_hz = header.carrier_hz.tolist()
        shown = carriers_hz[:12]
        more = f" and {len(carriers_hz) - len(shown)} more" if len(shown) < len(carriers_hz) else ""
        elements = f"{header.receiver.num_elements} elements" if header.channels else "none"
        subset = {} if len(self) == num_samples else {"subset": f"{len(self)} of the {num_samples} samples"}
        axes = zip(("receiver", "tx and rx"), self.link, self.file_header.link_names, strict=True)
        links = {kind: f"{name}, of {', '.join(names)}" for kind, name, names in axes if names}
        return {
            **links,
            "scene": f"{header.scene_name!r}, {header.num_tx} transmitters × {header.num_carriers} carriers",
            "carriers": format_ghz_list(shown) + more,
            "maps": f"{header.pas_kind}, {self.grid.shape[0]} elevations × {self.grid.shape[1]} azimuths",
            "channels": elements,
            **subset,
        }

    def __reduce__(self) -> tuple[Any, ...]:
        return reopen, (str(self.path), self.sha256, self.rows, self.other_receivers, self._is_isolated)

    @checked
    def at(self, receiver: str | None = None, polarization: str | None = None) -> PasDataset:
        """The same samples of another link of the file; the receiver or polarization stays the same if None.

        Raises `UnknownNameError`, and `DataError` for training data of a method, which have only one link.
        """
        if self._is_isolated:
            raise DataError(f"{self.path} is given to methods with only one receiver and one polarization.")
        return open_dataset(self.path, receiver or self.link[0], polarization or self.link[1])[self.rows]

    @cached_property
    def sha256(self) -> str:
        """Hash of the file's content; for a file of several links also of the link that is shown."""
        if not self.file_header.link_axes:
            return self.file_sha256
        return json_sha256([self.file_sha256, *self.file_header.link(*self.link)])

    @property
    def grid(self) -> AngularGrid:
        """Directions of the maps, as they are stored."""
        return self.beam.grid

    @property
    def scene(self) -> Scene:
        """The scene that was traced; raises `DataError` if none is stored, as in maps that others published.

        The folder of its Mitsuba meshes is not stored: `replace(scene, folder=...)` sets it. In old data sets, which do
        not say what reflects, every triangle of these meshes reflects.
        """
        try:
            scene = TypeAdapter(Scene).validate_json(self.header.scene_json)
            settings = self.header.settings
            stated = {name: settings[name] for name in scene.mirror_settings if name in settings}
            return replace(scene, **(stated or {"mirrors": "facets"})) if scene.scene else scene
        except ValidationError as error:
            raise DataError(
                f"{self.path} does not say which scene it was traced in, like data that others published. Use a "
                "data set that was generated."
            ) from error

    @property
    def trace_settings(self) -> TraceSettings:
        """The settings of the rays; raises `DataError` if not all of them are stored."""
        try:
            stored = {field.name: self.header.settings[field.name] for field in fields(TraceSettings)}
            return TypeAdapter(TraceSettings).validate_python(stored)
        except (KeyError, ValidationError) as error:
            raise DataError(f"{self.path} does not say how it was traced. Generate it again.") from error

    @cached_property
    def recipe(self) -> Recipe:
        """The recipe of the whole data set, the same on every machine; `str` gives its name, `office@2-3f9c2ab1`."""
        try:
            how = self.scene, self.trace_settings
        except DataError:
            with self._file() as file, hdf5.read_errors(self.path, "hashes"):
                return Recipe(self.header.scene_name, "data", hdf5.values_sha256(file))
        return Recipe.of_scene(*how, self.header, self.tables["tx_position_m"], self.grid)

    @cached_property
    def tx_index(self) -> Int[IntArray, "N"]:
        """Index of each sample's transmitter in the whole data set."""
        return self.rows // self.header.num_carriers

    @cached_property
    def tx_position_m(self) -> Float[FloatArray, "N 3"]:
        """Transmitter position of each sample in the world, in metres."""
        return self.tables["tx_position_m"][self.tx_index]

    @cached_property
    def carrier_hz(self) -> Float[FloatArray, "N"]:
        """Carrier of each sample in hertz."""
        return self.header.carrier_hz[self.rows % self.header.num_carriers]

    @cached_property
    def has_path(self) -> Bool[NDArray[np.bool_], "N"]:
        """Whether any path arrives; without one the map is all zeros, and is neither trained on nor tested."""
        return np.asarray(self.tables["peak_power"].flat[self.rows] > 0)

    @cached_property
    def cfr(self) -> Complex[NDArray[np.complex64], "N M"]:
        """Channel of each sample at the array's elements (Eq. 1); raises `DataError` for data without channels."""
        if not self.header.channels:
            raise DataError(f"{self.path} has maps, but no channels. Use `pas`, or a data set that was generated.")
        return self.tables["cfr"].reshape(-1, self.header.receiver.num_elements)[self.rows]

    def pas(self, rows: Rows | int = slice(None)) -> Float[NDArray[np.float32], "n E A"]:
        """Maps of some samples, with peak 1; one number gives (1, E, A). Raises `DataError` and `IndexError`.

        A map takes 130 kB of memory. For more than a gigabyte there is a warning.
        """
        rows = chosen_rows(rows, len(self))
        num_bytes = len(self.rows[rows]) * 4 * prod(self.grid.shape)
        if num_bytes > 1e9:
            warnings.warn(
                f"pas() reads {len(self.rows[rows])} maps of {self.path}, {num_bytes / 1e9:.1f} GB. pas(rows) reads "
                "some of them, as in pas([0, 7]) or pas(slice(0, 64)); a loop over the data set reads one at a time.",
                stacklevel=2,
            )
        if not self.header.maps:
            return self.beam.maps(self.cfr[rows], self.header.pas_kind)[0]
        asked = self.rows[rows]
        tx, carrier = np.divmod(asked, self.header.num_carriers)
        maps = np.empty((len(asked), *self.grid.shape), np.float32)
        # consecutive carriers of a transmitter are read at once
        starts = np.flatnonzero((np.diff(asked, prepend=-2) != 1) | (carrier == 0)).tolist()
        with self._file() as file, hdf5.read_errors(self.path, "dataset 'pas'"):
            stored = file["pas"]
            for start, end in pairwise([*starts, len(asked)]):
                carriers = slice(carrier[start], carrier[start] + end - start)
                hdf5.unpacked(stored[(tx[start], *_at(self.file_header, self.link), carriers)], maps[start:end])
        return maps

    @contextmanager
    def _file(self) -> Iterator[Any]:
        """The file, open; raises as `hdf5.open_sealed`, and `DataError` if the file was replaced."""
        with hdf5.open_sealed(self.path, SCHEMA) as file:
            if hdf5.sealed_sha256(file) != self.file_sha256:
                raise DataError(f"{self.path} is another file than when it was opened. Open it again.")
            yield file

    @checked
    def paths(self, sample: int) -> SamplePaths:
        """The paths of a sample to the array centre, by its number; negative ones count from the end.

        Raises `IndexError`, and `DataError` if paths are not stored (see `generate --paths`) or damaged.
        """
        tx, carrier = divmod(int(self[[sample]].rows[0]), self.header.num_carriers)
        first = tx * max(1, len(self.file_header.receivers)) + self.file_header.link(*self.link)[0]
        stored, surface_names = self._paths(slice(first, first + 2))
        return SamplePaths.of(stored, carrier, self.header, surface_names)

    def _paths(self, offsets: slice) -> tuple[RaggedPaths, tuple[str, ...]]:
        """Paths of some of the file's transmitters and receivers, concatenated, and the names of all surfaces."""
        if OFFSET not in self.tables:
            hidden, absent = "is given to methods without its paths.", "holds no paths. Generate it with --paths."
            raise DataError(f"{self.path} {hidden if self.header.paths else absent}")
        with self._file() as file, hdf5.read_errors(self.path, f"group {GROUP!r}"):
            totals = stored_totals(file)
            found = read_paths(file, totals, self.tables[OFFSET][offsets])
        if self.file_header.polarizations:
            found = replace(found, gain=found.gain[:, self.file_header.link(*self.link)[1]])
        return found, totals.surface_names


def stored_paths(dataset: PasDataset) -> tuple[RaggedPaths, tuple[str, ...]]:
    """All paths of a whole data set, concatenated, and the names of the surfaces; raises as `PasDataset.paths`."""
    of_all, surface_names = dataset._paths(slice(None))
    header = dataset.file_header
    return of_all.every(max(1, len(header.receivers)), header.link(*dataset.link)[0]), surface_names


def links(dataset: PasDataset) -> Iterator[PasDataset]:
    """The same samples of each link of the file: all polarizations of the first receiver, then of the next."""
    for receiver, polarization in product(*(names or (None,) for names in dataset.file_header.link_names)):
        yield dataset.at(receiver, polarization) if dataset.file_header.link_axes else dataset


def isolated(dataset: PasDataset) -> PasDataset:
    """The same samples, with the channels of all others set to zero: the training data of a method.

    It is a copy, so a method that writes to it changes nothing else. It has no paths, because they would reveal the
    tested carriers.
    """
    tables = {name: table.copy() for name, table in dataset.tables.items() if name != OFFSET}
    for name in tables.keys() & {"cfr", "peak_power", "num_paths"}:
        samples = tables[name].reshape(-1, *tables[name].shape[2:])
        samples[np.setdiff1d(np.arange(len(samples)), dataset.rows)] = 0
    names = ("header", "file_header", "beam", "rows")
    own = {name: deepcopy(getattr(dataset, name)) for name in names}
    return replace(dataset, tables=tables, _is_isolated=True, **own)


@checked
def open_dataset(path: FilePath, receiver: str | None = None, polarization: str | None = None) -> PasDataset:
    """The samples of a data set; raises `DataError` for a file that is missing, damaged or not a data set.

    If a file has several receivers or pairs of polarizations, one of each is opened: the first unless one is named.
    Raises `UnknownNameError` for one that the file does not have, and `StorageError` if the file cannot be read.

    `path` may be an address (http, https). Then header and channels are read at once, and maps when they are asked
    for, in ranges of bytes; each is compared with its hash or checksum. Needs `pip install "xfreqbench[remote]"`.
    """
    path = located(path)
    with hdf5.open_sealed(path, SCHEMA) as file:
        whole = DatasetHeader.from_attributes(hdf5.text_attributes(file), hdf5.read_array(file, "carrier_hz"))
        numbers = whole.link(receiver, polarization)
        header = whole.at(*numbers)
        first, second = ((*names, None)[number] for names, number in zip(whole.link_names, numbers, strict=True))
        link = first, second
        grid = AngularGrid(*(np.radians(hdf5.read_array(file, f"{name}_deg")) for name in ("elevation", "azimuth")))
        hdf5.require_layout(file, variables(whole, grid))
        names = ("tx_position_m", "line_of_sight", "peak_power", "num_paths", "cfr")
        tables = {name: hdf5.read_array(file, name) for name in names if header.channels or name != "cfr"}
        tables["line_of_sight"] = tables["line_of_sight"].astype(bool)
        for name in ("rx_position_m", "frame_rotation"):  # the header holds them too; other programs read these
            hdf5.read_array(file, name)
        if header.paths:
            totals = stored_totals(file)
            hdf5.require_layout(file, path_variables(whole, totals))
            tables[OFFSET] = stored_offsets(file, totals.num_paths)
        beam = BartlettBeam(hdf5.read_array(file, "element_position_wavelengths"), grid)
        angles = {"elevation_deg": grid.elevation_rad, "azimuth_deg": grid.azimuth_rad}
        elements = {"element_position_wavelengths": beam.element_position_wavelengths}
        _require_meaning({CARRIER: header.carrier_hz, **angles, **elements, **tables})
        if whole.link_axes:
            at: Any = (slice(None), *_at(whole, link))
            for name in tables.keys() & {"peak_power", "num_paths", "cfr"}:
                tables[name] = np.ascontiguousarray(tables[name][at])
            if whole.receivers:
                tables["line_of_sight"] = np.ascontiguousarray(tables["line_of_sight"][:, numbers[0]])
        rows = np.arange(tables["peak_power"].size, dtype=np.int64)
        return PasDataset(path.resolve(), header, hdf5.sealed_sha256(file), beam, tables, rows, whole, link)


def _at(whole: DatasetHeader, link: tuple[str | None, str | None]) -> tuple[int, ...]:
    """The indices of a link along the axes that a file has for links."""
    return tuple(number for names, number in zip(whole.link_names, whole.link(*link), strict=True) if names)


def _require_meaning(tables: Mapping[str, NDArray[Any]]) -> None:
    for name, values in tables.items():
        if not np.isfinite(values).all():
            raise ValueError(f"dataset {name!r} holds numbers that are not finite")
    if not (np.diff(tables[CARRIER], prepend=0) > 0).all():
        raise ValueError(f"dataset {CARRIER!r} holds {tables[CARRIER]}; carriers ascend from above 0")
    for name in ("elevation_deg", "azimuth_deg"):
        if not (np.diff(tables[name]) > 0).all():
            raise ValueError(f"dataset {name!r} holds angles that do not ascend")
    if (np.abs(tables["tx_position_m"]) > FAR_M).any():
        raise ValueError(f"dataset 'tx_position_m' holds positions beyond {FAR_M:g} m")


def reopen(
    path: str, sha256: str, rows: Rows, other_receivers: tuple[PasDataset, ...] = (), is_isolated: bool = False
) -> PasDataset:
    """The rows of a data set that was pickled; raises `DataError` if the file has changed since."""
    dataset = next((link for link in links(open_dataset(path)) if link.sha256 == sha256), None)
    if dataset is None:
        raise DataError(f"{path} is another data set than before: its sha256 was {sha256}.")
    kept = replace(dataset[rows], other_receivers=other_receivers)
    return isolated(kept) if is_isolated else kept


def verify(path: str | Path) -> None:
    """Compare every byte of a data set with its hashes, and raise `DataError` naming the first damaged part."""
    hdf5.verify_sealed(located(path), SCHEMA)


def holds_same_job(path: Path, header: DatasetHeader, tx_position_m: Float[FloatArray, "T 3"]) -> bool:
    """Whether `path` holds the complete data set of a header and transmitters; False if it is absent.

    It does not matter which software made it: see `job_of`. Raises `OutputExistsError`, which says what differs, for
    another file, and `StorageError` for one that another program holds open.
    """
    asked = job_of(header, tx_position_m)

    def fault_of(file: Path) -> str | None:
        try:
            verify(file)
            existing = open_dataset(file)
        except DataError as error:
            return f"is not a data set that can be read: {error}"
        differing = job_differences(asked, job_of(existing.file_header, existing.tables["tx_position_m"]))
        return f"holds another data set: {differing}" if differing else None

    return require_own(path, fault_of)


def chosen_rows(rows: Any, num_samples: int) -> slice | NDArray[Any]:
    """The numbers (n,) of samples among `num_samples`, or a slice or a mask of all, as NumPy indexes by them.

    `rows` is one number, several, a slice or a mask; negative numbers count from the end. Raises `IndexError` that
    says what there is.
    """
    if isinstance(rows, slice):
        return rows
    numbers = np.asarray(rows)
    if not numbers.size:
        return np.zeros(0, np.int64)
    if numbers.dtype == bool and numbers.shape == (num_samples,):
        return numbers
    if numbers.ndim > 1 or not np.issubdtype(numbers.dtype, np.integer):
        given = f"{numbers.dtype} of shape {numbers.shape}" if numbers.ndim else reprlib.repr(rows)
        raise IndexError(
            f"Samples are chosen by whole numbers of shape (n,), or by a mask of shape ({num_samples},), but got "
            f"{given}."
        )
    numbers = np.atleast_1d(numbers)
    beyond = numbers[(numbers < -num_samples) | (numbers >= num_samples)]
    if beyond.size:
        there = f"samples 0 to {num_samples - 1}" if num_samples else "no samples"
        raise IndexError(f"There are {there}, but {beyond[0]} is asked for.")
    return numbers
