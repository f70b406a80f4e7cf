"""Reads and checks files of predictions that other programs wrote; `score_file` describes them. Nothing is trusted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.hdf5 import is_group, open_foreign, read_errors, stands_elsewhere
from xfreqbench.data.splits import PROTOCOL_VERSION, PROTOCOLS, VALIDATIONS, Split, make_splits
from xfreqbench.errors import DataError, ProtocolError, UnknownNameError
from xfreqbench.runs.predictions import MapBatch, fault_of_maps
from xfreqbench.runs.scoring import BATCH_SIZE
from xfreqbench.types import NDArray

PAS = "pas"
_ADVICE = {
    "split_sha256": "Copy it from the split file: group.attrs.update(split.attrs).",
    "method": "Write group.attrs['method'] = 'mine', or give --method.",
    "url": "It begins with https://.",
}


def _one_line(text: str) -> str:
    if not text.isprintable() or not text.strip():
        raise ValueError("it must be printable text on one line")
    return text.strip()


Line = Annotated[str, Field(max_length=120), AfterValidator(_one_line)]
Amount = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0, lt=2**63)]


class Declaration(BaseModel):
    """What the attributes of the predictions of one split say."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    split_sha256: Line
    method: Line
    dataset_sha256: Line | None = None
    fit_seconds: Amount | None = None
    predict_ms_per_map: Amount | None = None
    parameters: Count | None = None
    hardware: Line | None = None
    url: Annotated[Line, Field(pattern=r"^\s*https?://\S+\s*$")] | None = None
    seed: Count = 0


@dataclass(frozen=True, eq=False)
class Part:
    """Predictions of one split, whose maps are not read yet; `group` is None if they are at the root of the file."""

    path: Path
    group: str | None
    split: Split
    declared: Declaration

    def batches(self, grid_shape: tuple[int, int]) -> Iterator[MapBatch]:
        """Rows of the data set and their maps, a batch at a time; raises `DataError` naming map and value."""
        test = self.split.test
        with open_foreign(self.path) as file:
            for start in range(0, len(test), BATCH_SIZE):
                rows = test[start : start + BATCH_SIZE]
                with read_errors(self.path, f"the maps of {self.split.name!r}"):
                    group = file[self.group] if self.group else file
                    values = np.asarray(group[PAS][start : start + BATCH_SIZE])
                if values.shape != (len(rows), *grid_shape):
                    raise DataError(f"{self.path} was changed while it was read. Run the same command again.")
                self._require_maps(values, start)
                yield rows, values.astype(np.float32)

    def _require_maps(self, values: NDArray[Any], start: int) -> None:
        fault = fault_of_maps(values)
        if fault:
            number, words = start + fault[0], fault[1]
            place = _place(self.path, self.group)
            raise DataError(f"{place}: map {number} (row {self.split.test[number]}) {words}")


def read_parts(path: Path, dataset: PasDataset, method: str | None = None) -> list[Part]:
    """The predictions in a file, one part for each split; all is checked but the values of the maps.

    `method` replaces the method's name that the file gives. Raises `DataError` and `UnknownNameError`.
    """
    reader = _Reader(path, dataset, known_splits(dataset), method)
    with open_foreign(path) as file, read_errors(path):
        return [reader.part(name, file) for name in reader.names(file)]


def known_splits(dataset: PasDataset) -> dict[str, Split]:
    """All splits that the protocols and their validations can make of a data set, by name."""
    heard = np.unique(dataset.carrier_hz[dataset.has_path]).tolist()
    targets = [None, *([carrier / 1e9] for carrier in heard)]
    protocols = (*PROTOCOLS, *VALIDATIONS)
    found = (splits_or_none(dataset, protocol, target) for protocol in protocols for target in targets)
    return {split.name: split for splits in found for split in splits}


def splits_or_none(dataset: PasDataset, protocol: str, targets_ghz: Sequence[float] | None = None) -> list[Split]:
    """Splits of a protocol or of its validation; an empty list if the data set lacks what they need."""
    is_validation = protocol in VALIDATIONS
    tested = VALIDATIONS[protocol] if is_validation else protocol
    try:
        return make_splits(dataset, tested, targets_ghz, "validation" if is_validation else "test")
    except ProtocolError:
        return []


@dataclass(frozen=True, eq=False)
class _Reader:
    path: Path
    dataset: PasDataset
    known: Mapping[str, Split]
    method: str | None

    def names(self, file: Any) -> list[str | None]:
        """The groups with predictions in a file, or `[None]` if they are at its root; links are not followed."""
        members = list(file)
        if PAS in members:
            twice = [name for name in members if name in self.known]
            if twice:
                raise DataError(
                    f"{self.path} has {PAS!r} at its root and group {twice[0]!r}: one split may be there twice. "
                    "Keep one of the two."
                )
            return [None]
        if not members:
            raise DataError(f"{self.path} is empty. Write a group for each split, with a dataset {PAS!r}.")
        for name in members:
            if name not in self.known:
                raise UnknownNameError(f"split of {self.dataset.path.name} for {self.path},", name, self.known)
            if stands_elsewhere(file, name) or not is_group(file[name]):
                raise DataError(
                    f"{self.path}: {name!r} is no group of this file. Make it a group with a dataset {PAS!r}."
                )
        return members

    def part(self, name: str | None, file: Any) -> Part:
        place, group = _place(self.path, name), file[name] if name else file
        declared = _declaration(place, (file, group), self.method)
        split = self._split(place, name, declared)
        _check_dataset(place, group, (len(split.test), *self.dataset.grid.shape))
        return Part(self.path, name, split, declared)

    def _split(self, place: str, name: str | None, declared: Declaration) -> Split:
        if declared.dataset_sha256 not in (None, self.dataset.sha256):
            raise DataError(
                f"{place}: made for the data set with sha256 {declared.dataset_sha256}, but "
                f"{self.dataset.path.name} has {self.dataset.sha256}. Give that data set with --data, or make a "
                "split file of this one."
            )
        for split in [self.known[name]] if name else self.known.values():
            if split.sha256 == declared.split_sha256:
                return split
        raise DataError(
            f"{place}: split_sha256 {declared.split_sha256!r} is not that of {name or 'any split'} of "
            f"{self.dataset.path.name} under version {PROTOCOL_VERSION} of the protocols. Copy it from the group "
            "of that name in the file that `xfreqbench split` makes of this data set."
        )


def _place(path: Path, group: str | None) -> str:
    return f"{path}, group {group!r}" if group else f"{path}, at its root"


def _declaration(place: str, owners: Sequence[Any], method: str | None) -> Declaration:
    """The attributes of the root and of a group; those of the group replace those of the root. Raises `DataError`."""
    names = Declaration.model_fields
    given = {name: _plain(owner.attrs[name]) for owner in owners for name in names if name in owner.attrs}
    if method is not None:
        given["method"] = method
    try:
        return Declaration.model_validate(given)
    except ValidationError as error:
        fault = error.errors()[0]
        name = str(fault["loc"][0])
        words = "it is missing" if fault["type"] == "missing" else fault["msg"]
        raise DataError(f"{place}, attribute {name!r}: {words}. {_ADVICE.get(name, '')}") from error


def _plain(value: Any) -> Any:
    """The value of an attribute, also if it was written as bytes, or in an array of one, as MATLAB does."""
    array = np.asarray(value)
    if array.size != 1:
        return array.tolist()
    item = array.reshape(-1).tolist()[0]
    return item.decode("utf-8", "replace") if isinstance(item, bytes) else item


def _check_dataset(place: str, group: Any, shape: tuple[int, int, int]) -> None:
    """Raise `DataError` unless `pas` is a dataset of real numbers with that shape, in the file itself."""
    if PAS not in list(group):
        raise DataError(f"{place}: there is no dataset {PAS!r}; it holds {', '.join(group) or 'nothing'}.")
    if stands_elsewhere(group, PAS):
        raise DataError(f"{place}: {PAS!r} is a link to data elsewhere. Write the maps into the file itself.")
    if is_group(group[PAS]):
        raise DataError(f"{place}: {PAS!r} is a group. Make it a dataset of shape {shape}.")
    found, dtype = tuple(group[PAS].shape or ()), group[PAS].dtype
    if found != shape:
        is_reversed = found == shape[::-1]
        advice = f"{shape} backwards: MATLAB's first index is HDF5's last. Write permute({PAS}, [3 2 1])."
        needed = f"but {shape[0]} test rows need {shape}: row, elevation, azimuth."
        raise DataError(f"{place}: {PAS!r} has shape {found}, {advice if is_reversed else needed}")
    if dtype.kind not in "fiu":
        raise DataError(f"{place}: {PAS!r} has dtype {dtype}; it must be real numbers, best float32.")
