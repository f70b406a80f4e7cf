"""Scores predictions that any other program wrote into a file, in the same way as those of a run. Nothing is trusted.

`xfreqbench split` writes what a method may know (see `xfreqbench.exchange.split_file`). The predictions are one HDF5
file with a group for each split that was predicted, named as the split. These lines write it:

    import h5py

    with h5py.File("split.h5") as splits, h5py.File("predictions.h5", "w") as predictions:
        for name, split in splits.items():
            group = predictions.create_group(name)
            group["pas"] = predict(split["test_tx_position_m"][:], split["test_carrier_hz"][:])
            group.attrs.update(split.attrs, method="mine")

`pas` holds maps (N, E, A) in the order of `test_row`: numbers in [0, 1], peak 1, or all zero where the method expects
no power. Coordinates may be added by their names in the split file; they are compared with it. MATLAB writes the same
file from an array of size [A E N], because its first index is the last one in HDF5. A single split may be at the root
of the file.

The attributes of a group, or of the root for all groups, are `split_sha256` (copied), `method` (a name) and, if they
are known, `dataset_sha256` (copied), `fit_seconds`, `predict_ms_per_map`, `parameters`, `hardware`, `url` and `seed`.
They are recorded as they are given, for nothing of them can be measured here. Other attributes are ignored.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.fingerprint import require_fingerprint
from xfreqbench.data.hdf5 import PACKED, foreign_item, is_group, open_foreign, packed
from xfreqbench.data.splits import PROTOCOL_VERSION, PROTOCOLS, VALIDATIONS, Split, make_splits
from xfreqbench.errors import DataError, ProtocolError, UnknownNameError
from xfreqbench.maps.metrics import METRICS_VERSION
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.predictions import MapBatch, fault_of_maps, write_predictions
from xfreqbench.runs.records import Amount, Count, External, Job, RunRecord
from xfreqbench.runs.scoring import BATCH_SIZE, record_of, scored_on_split
from xfreqbench.system.files import exclusive, json_sha256, require_space, require_text
from xfreqbench.types import ProgressCallback, ignore_progress


def _one_line(text: str) -> str:
    if not text.isprintable() or not text.strip():
        raise ValueError("it must be printable text on one line")
    return text.strip()


Line = Annotated[str, Field(max_length=120), AfterValidator(_one_line)]


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
        with open_foreign(self.path, f"the maps of {self.split.name!r}") as file:
            for start in range(0, len(test), BATCH_SIZE):
                rows = test[start : start + BATCH_SIZE]
                values = np.asarray((file[self.group] if self.group else file)["pas"][start : start + BATCH_SIZE])
                if values.shape != (len(rows), *grid_shape):
                    raise DataError(f"{self.path} was changed while it was read. Run the same command again.")
                if fault := fault_of_maps(values):
                    number, words = start + fault[0], fault[1]
                    place = _place(self.path, self.group)
                    raise DataError(f"{place}: map {number} (row {test[number]}) {words}")
                yield rows, values.astype(np.float32)


@dataclass(frozen=True)
class ScoredFile:
    """The records of the splits in a file, in its order.

    `missing` names the splits of the same protocols that the file leaves out, and `silent` those whose predicted maps
    are all zero everywhere. `is_data_known` says whether every split in the file names the data set that it was made
    from.
    """

    records: tuple[RunRecord, ...]
    missing: tuple[str, ...]
    silent: tuple[str, ...]
    is_data_known: bool


def score_file(
    path: Path,
    data: Path,
    results_dir: Path,
    method: str | None = None,
    checking: ProgressCallback = ignore_progress,
    scoring: ProgressCallback = ignore_progress,
) -> ScoredFile:
    """Check a file of predictions for the data set `data`, copy them into `results_dir`, and score and record the copy.

    `method` replaces the method's name that the file gives. If the same content is scored again, its records are
    returned and none is added. `checking` and `scoring` are called with the number of maps that are done and of all.
    Raises `DataError` or `UnknownNameError` for anything wrong with the file, before a map is scored, and
    `StorageError`.
    """
    data_name = require_text(data)
    dataset = open_dataset(data)
    parts = read_parts(path, dataset, method)
    require_fingerprint(dataset)
    folder = ResultsFolder(results_dir)
    num_maps = sum(len(part.split.test) for part in parts)
    require_space(folder.predictions_path("any"), num_maps * prod(dataset.grid.shape) * np.dtype(PACKED).itemsize)
    done = np.cumsum([len(part.split.test) for part in parts]).tolist()
    content, silent, scored = [], [], []
    for part, so_far in zip(parts, done, strict=True):
        digest, has_power = hashlib.sha256(), False
        for _, maps in part.batches(dataset.grid.shape):  # which checks them
            digest.update(packed(maps).tobytes())
            has_power = has_power or bool(maps.any())
        content.append([part.split.sha256, part.declared.model_dump_json(), digest.hexdigest()])
        silent += [] if has_power else [part.split.name]
        checking(so_far, num_maps)
    sha256 = json_sha256(sorted(content))  # the order of the parts does not matter
    for part, so_far in zip(parts, done, strict=True):
        scored.append(_scored(part, dataset, data_name, sha256, folder))
        scoring(so_far, num_maps)
    is_data_known = all(part.declared.dataset_sha256 for part in parts)
    given = {part.split.name for part in parts}
    protocols = dict.fromkeys(part.split.protocol for part in parts)
    usual = [split.name for protocol in protocols for split in _splits_or_none(dataset, protocol)]
    missing = tuple(name for name in usual if name not in given)
    return ScoredFile(tuple(scored), missing, tuple(silent), is_data_known)


def _scored(part: Part, dataset: PasDataset, data: str, file_sha256: str, folder: ResultsFolder) -> RunRecord:
    """The record of a part: the one in `folder` if there is one, otherwise a new one, which is stored."""
    split, declared = part.split, part.declared
    record_id = json_sha256(["external", dataset.sha256, file_sha256, split.sha256, METRICS_VERSION])[:16]
    with exclusive(folder.run_lock_path(record_id)):
        record = folder.finished(record_id)
        if record is None:
            path = folder.predictions_path(record_id)
            write_predictions(
                path,
                part.batches(dataset.grid.shape),
                num_rows=len(split.test),
                grid_shape=dataset.grid.shape,
                dataset_sha256=dataset.sha256,
                split_sha256=split.sha256,
            )
            declarations = declared.model_dump(include={"fit_seconds", "predict_ms_per_map", "parameters"})
            external = External(sha256=file_sha256, hardware=declared.hardware, url=declared.url)
            unknown = {"config": {}, "step": 0, "peak_memory_mib": None, "hardware": {}}
            job = Job(data, declared.method, split.protocol, split.name, seed=declared.seed)
            scored = scored_on_split(dataset, split, path)
            record = record_of(record_id, job, scored, {**declarations, **unknown, "external": external})
            folder.append(record)
    return record


def read_parts(path: Path, dataset: PasDataset, method: str | None = None) -> list[Part]:
    """The predictions in a file, one part for each split; all is checked but the values of the maps.

    `method` replaces the method's name that the file gives. Raises `DataError` and `UnknownNameError`.
    """
    heard = np.unique(dataset.carrier_hz[dataset.has_path]).tolist()
    targets = [None, *([carrier / 1e9] for carrier in heard)]
    found = (_splits_or_none(dataset, protocol, each) for protocol in (*PROTOCOLS, *VALIDATIONS) for each in targets)
    known = {split.name: split for splits in found for split in splits}
    with open_foreign(path) as file:
        return [_part(path, file, name, dataset, known, method) for name in _groups(path, file, dataset, known)]


def _splits_or_none(dataset: PasDataset, protocol: str, targets_ghz: Sequence[float] | None = None) -> list[Split]:
    """Splits of a protocol or of its validation; an empty list if the data set lacks what they need."""
    is_validation = protocol in VALIDATIONS
    tested = VALIDATIONS[protocol] if is_validation else protocol
    try:
        return make_splits(dataset, tested, targets_ghz, "validation" if is_validation else "test")
    except ProtocolError:
        return []


def _groups(path: Path, file: Any, dataset: PasDataset, known: Mapping[str, Split]) -> list[str | None]:
    """The groups with predictions in a file, or `[None]` if they are at its root; links are not followed."""
    members = list(file)
    if "pas" in members:
        twice = [name for name in members if name in known]
        if twice:
            raise DataError(
                f"{path} has 'pas' at its root and group {twice[0]!r}: one split may be there twice. "
                "Keep one of the two."
            )
        return [None]
    if not members:
        raise DataError(f"{path} is empty. Write a group for each split, with a dataset 'pas'.")
    for name in members:
        if name not in known:
            raise UnknownNameError(f"split of {dataset.path.name} for {path},", name, known)
        if not is_group(foreign_item(file, name)):
            raise DataError(f"{path}: {name!r} is not a group of this file. Make it a group with a dataset 'pas'.")
    return members


def _part(
    path: Path, file: Any, name: str | None, dataset: PasDataset, known: Mapping[str, Split], method: str | None
) -> Part:
    """The checked predictions in a group, or at the root of the file."""
    place, group = _place(path, name), file[name] if name else file
    declared = _declaration(place, (file, group), method)
    if declared.dataset_sha256 not in (None, dataset.sha256):
        raise DataError(
            f"{place}: made for the data set with sha256 {declared.dataset_sha256}, but {dataset.path.name} has "
            f"{dataset.sha256}. Give that data set with --data, or make a split file of this one."
        )
    for split in [known[name]] if name else known.values():
        if split.sha256 == declared.split_sha256:
            _check_dataset(place, group, (len(split.test), *dataset.grid.shape))
            _check_coordinates(place, group, dataset, split)
            return Part(path, name, split, declared)
    raise DataError(
        f"{place}: split_sha256 {declared.split_sha256!r} is not that of {name or 'any split'} of "
        f"{dataset.path.name} under version {PROTOCOL_VERSION} of the protocols. Copy it from the group "
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
        advice = {
            "split_sha256": "Copy it from the split file: group.attrs.update(split.attrs).",
            "method": "Write group.attrs['method'] = 'mine', or give --method.",
            "url": "It begins with https://.",
        }
        raise DataError(f"{place}, attribute {name!r}: {words}. {advice.get(name, '')}") from error


def _plain(value: Any) -> Any:
    """The value of an attribute, also if it was written as bytes, or in an array of one, as MATLAB does."""
    array = np.asarray(value)
    if array.size != 1:
        return array.tolist()
    item = array.reshape(-1).tolist()[0]
    return item.decode("utf-8", "replace") if isinstance(item, bytes) else item


def _check_dataset(place: str, group: Any, shape: tuple[int, int, int]) -> None:
    """Raise `DataError` unless `pas` is a dataset of real numbers with that shape, in the file itself."""
    if "pas" not in list(group):
        raise DataError(f"{place}: there is no dataset 'pas'; it holds {', '.join([*group][:9]) or 'nothing'}.")
    stored = foreign_item(group, "pas")
    if stored is None or is_group(stored):
        raise DataError(
            f"{place}: 'pas' is a link, not a dataset, or in chunks far larger than its data. Write it as a dataset of "
            f"shape {shape} into the file itself."
        )
    if stored.shape != shape:
        is_reversed = stored.shape == shape[::-1]
        advice = f"{shape} backwards: MATLAB's first index is HDF5's last. Write permute(pas, [3 2 1])."
        needed = f"but {shape[0]} test rows need {shape}: row, elevation, azimuth."
        raise DataError(f"{place}: 'pas' has shape {stored.shape}, {advice if is_reversed else needed}")
    if stored.dtype.kind not in "fiu":
        raise DataError(f"{place}: 'pas' has dtype {stored.dtype}; it must be real numbers, best float32.")


def _check_coordinates(place: str, group: Any, dataset: PasDataset, split: Split) -> None:
    """Raise `DataError` if the group's coordinates are not those of the split, in its order."""
    tested, grid = dataset[split.test], dataset.grid
    known = {"row": split.test, "tx_position_m": tested.tx_position_m, "carrier_hz": tested.carrier_hz}
    known |= {f"test_{name}": values for name, values in known.items()} | {"sample": split.test}
    known |= {"elevation_deg": np.degrees(grid.elevation_rad), "azimuth_deg": np.degrees(grid.azimuth_rad)}
    for name in sorted(known.keys() & set(group)):
        expected, stored = known[name].ravel(), foreign_item(group, name)
        if stored is not None and "not a netCDF variable" in str(stored.attrs.get("NAME")):
            continue  # only an axis, without values
        is_alike = getattr(stored, "size", None) == expected.size and stored.dtype.kind in "fiu"
        tolerance = {"rtol": 0} if expected.dtype.kind == "i" else {"rtol": 1e-6, "atol": 1e-5}  # of single precision
        if not (is_alike and np.allclose(np.ravel(stored), expected, **tolerance)):
            raise DataError(
                f"{place}: {name!r} is not that of the split file, so maps would be assigned wrongly. Write them "
                "in its order: test_row, elevation_deg, azimuth_deg."
            )
