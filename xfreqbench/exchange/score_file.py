"""Scores predictions that any other program wrote into a file, in the same way as those of a run.

`xfreqbench split` writes what a method may know (see `xfreqbench.exchange.split_file`). The predictions are one HDF5
file with a group for each split that was predicted, named as the split. These lines write it:

    import h5py

    with h5py.File("split.h5") as splits, h5py.File("predictions.h5", "w") as predictions:
        for name, split in splits.items():
            group = predictions.create_group(name)
            group["pas"] = predict(split["test_tx_position_m"][:], split["test_carrier_hz"][:])
            group.attrs.update(split.attrs, method="mine")

`pas` holds maps (N, E, A) in the order of `test_row`: numbers in [0, 1], peak 1, or all zero where the method hears
nothing. MATLAB writes the same file from an
array of size [A E N], because its first index is the last one in HDF5. A single split may be at the root of the file.

The attributes of a group, or of the root for all groups, are `split_sha256` (copied), `method` (a name) and, if they
are known, `dataset_sha256` (copied), `fit_seconds`, `predict_ms_per_map`, `parameters`, `hardware`, `url` and `seed`.
They are recorded as they are given, for nothing of them can be measured here. Other attributes are ignored.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import TypeVar

import numpy as np

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.fingerprint import require_fingerprint
from xfreqbench.data.hdf5 import PACKED, packed
from xfreqbench.exchange.prediction_file import Part, read_parts, splits_or_none
from xfreqbench.maps.metrics import METRICS_VERSION
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.predictions import write_predictions
from xfreqbench.runs.records import External, Job, RunRecord
from xfreqbench.runs.scoring import FitOutcome, scored_record
from xfreqbench.system.files import exclusive, require_space, require_text
from xfreqbench.types import ProgressCallback, ignore_progress

Result = TypeVar("Result")


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


@dataclass(frozen=True, eq=False)
class _Submission:
    """A checked file. `maps_sha256` has a hash of the maps of each part, as they will be stored."""

    dataset: PasDataset
    data: str
    parts: Sequence[Part]
    maps_sha256: Sequence[str]

    @property
    def sha256(self) -> str:
        """Hash of all that the file says; the order of its parts does not matter."""
        content = [
            [part.split.sha256, part.declared.model_dump_json(), maps]
            for part, maps in zip(self.parts, self.maps_sha256, strict=True)
        ]
        return hashlib.sha256(json.dumps(sorted(content)).encode()).hexdigest()

    def record_id(self, part: Part) -> str:
        """The id of the record of a part, 16 hexadecimal digits."""
        content = ["external", self.dataset.sha256, self.sha256, part.split.sha256, METRICS_VERSION]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


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
    returned and none is added. `checking` and `scoring` are told how many maps are done and how many there are.
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
    maps_sha256, has_power = zip(*_each(parts, lambda part: _checked(part, dataset.grid.shape), checking), strict=True)
    submission = _Submission(dataset, data_name, parts, maps_sha256)
    scored = _each(parts, lambda part: _scored(submission, part, folder), scoring)
    is_data_known = all(part.declared.dataset_sha256 for part in parts)
    given = {part.split.name for part in parts}
    protocols = dict.fromkeys(part.split.protocol for part in parts)
    usual = [split.name for protocol in protocols for split in splits_or_none(dataset, protocol)]
    missing = tuple(name for name in usual if name not in given)
    silent = tuple(part.split.name for part, is_heard in zip(parts, has_power, strict=True) if not is_heard)
    return ScoredFile(tuple(scored), missing, silent, is_data_known)


def _each(parts: Sequence[Part], action: Callable[[Part], Result], progress: ProgressCallback) -> list[Result]:
    """What `action` returns for each part, in order; `progress` is told maps done and in all."""
    total, done = sum(len(part.split.test) for part in parts), 0
    results = []
    for part in parts:
        results.append(action(part))
        done += len(part.split.test)
        progress(done, total)
    return results


def _checked(part: Part, grid_shape: tuple[int, int]) -> tuple[str, bool]:
    """Hash of the maps of a part as they will be stored, and whether any has power; reads and checks all of them."""
    digest, has_power = hashlib.sha256(), False
    for _, maps in part.batches(grid_shape):
        digest.update(packed(maps).tobytes())
        has_power = has_power or bool(maps.any())
    return digest.hexdigest(), has_power


def _scored(submission: _Submission, part: Part, folder: ResultsFolder) -> RunRecord:
    """The record of a part: the one in `folder` if it is there, else a new one, which is stored."""
    record_id, dataset = submission.record_id(part), submission.dataset
    with exclusive(folder.run_lock_path(record_id)):
        record = folder.finished(record_id)
        if record is None:
            path = folder.predictions_path(record_id)
            write_predictions(
                path,
                part.batches(dataset.grid.shape),
                num_rows=len(part.split.test),
                grid_shape=dataset.grid.shape,
                dataset_sha256=dataset.sha256,
                split_sha256=part.split.sha256,
            )
            record = _record(submission, part, record_id, path)
            folder.append(record)
    return record


def _record(submission: _Submission, part: Part, record_id: str, predictions: Path) -> RunRecord:
    declared = part.declared
    job = Job(submission.data, declared.method, part.split.protocol, part.split.name, seed=declared.seed)
    outcome = FitOutcome(
        step=0,
        fit_seconds=declared.fit_seconds,
        predict_ms_per_map=declared.predict_ms_per_map,
        parameters=declared.parameters,
        external=External(sha256=submission.sha256, hardware=declared.hardware, url=declared.url),
    )
    return scored_record(record_id, job, submission.dataset, part.split, predictions, outcome)
