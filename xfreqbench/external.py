"""Predictions from anywhere: a file of maps that somebody wrote with whatever they like, scored as a run is.

`xfreqbench split` hands out what a method may know (see `xfreqbench.handout`). Predictions are one HDF5 file, a
group for every split that was predicted, named as the split; these lines write it:

    import h5py

    with h5py.File("split.h5") as splits, h5py.File("predictions.h5", "w") as predictions:
        for name, split in splits.items():
            group = predictions.create_group(name)
            group["pas"] = predict(split["test_tx_position_m"][:], split["test_carrier_hz"][:])
            group.attrs.update(split.attrs, method="mine")

`pas` holds maps (N, E, A) in the order of `test_row`, numbers in [0, 1], peak 1. MATLAB writes the same file from
an array of size [A E N], for HDF5 stores its first index last. One split alone may stand at the file's root.

Attributes of a group, or of the root for all groups: `split_sha256` as copied, `method` a name, and, where
known, `dataset_sha256` as copied, `fit_seconds`, `predict_ms_per_map`, `parameters`, `hardware`, `url` and
`seed`. They are taken as declared; nothing of them is measured here. Others are ignored.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from xfreqbench import machine, records
from xfreqbench.dataset import PasDataset, open_dataset, verify
from xfreqbench.external_file import Part, read_parts, splits_or_none
from xfreqbench.metrics import METRICS_VERSION, Maps
from xfreqbench.predictions import write_predictions
from xfreqbench.records import RECORDS_FILE, External, Job, RunRecord
from xfreqbench.scoring import predictions_path, scored_fields, stored_record
from xfreqbench.storage import exclusive, require_space

_STORED = np.dtype("<f2")  # as `predictions` stores a map

ProgressCallback = Callable[[int, int], None]
Result = TypeVar("Result")


@dataclass(frozen=True)
class ScoredFile:
    """Records of a file's splits, in its order; splits of the same protocols that it leaves out.

    `is_data_known` says whether every split names the data set it was made from.
    """

    records: tuple[RunRecord, ...]
    missing: tuple[str, ...]
    is_data_known: bool


@dataclass(frozen=True, eq=False)
class _Submission:
    """A checked file; `maps_sha256` hashes each part's maps as they will be stored, `sha256` the whole."""

    dataset: PasDataset
    data: str
    parts: Sequence[Part]
    maps_sha256: Sequence[str]

    @property
    def sha256(self) -> str:
        content = [
            [part.split.sha256, part.declared.model_dump_json(), maps]
            for part, maps in zip(self.parts, self.maps_sha256, strict=True)
        ]
        return hashlib.sha256(json.dumps(sorted(content)).encode()).hexdigest()

    def record_id(self, part: Part) -> str:
        content = ["external", self.dataset.sha256, self.sha256, part.split.sha256, METRICS_VERSION]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


def score_file(
    path: Path,
    data: Path,
    results_dir: Path,
    method: str | None = None,
    checking: ProgressCallback | None = None,
    scoring: ProgressCallback | None = None,
) -> ScoredFile:
    """Check a file of predictions, copy it into `results_dir`, score the copy and record it as external.

    `method` replaces the name that the file gives. The same content scored again has the same records, and
    none is added. `checking` and `scoring` are told maps done and in all. Raises `DataError` or
    `UnknownNameError` for whatever is wrong with the file before any map is scored, and `StorageError`.
    """
    dataset = open_dataset(data)
    parts = read_parts(path, dataset, method)
    verify(data)
    num_bytes = sum(_num_bytes(part, dataset) for part in parts)
    require_space(predictions_path(results_dir, "any"), num_bytes)
    maps_sha256 = _each(parts, lambda part: _maps_sha256(part, dataset.grid.shape), checking)
    submission = _Submission(dataset, str(data), parts, maps_sha256)
    scored = _each(parts, lambda part: _scored(submission, part, results_dir), scoring)
    is_data_known = all(part.declared.dataset_sha256 for part in parts)
    return ScoredFile(tuple(scored), tuple(_missing(dataset, parts)), is_data_known)


def _each(
    parts: Sequence[Part], action: Callable[[Part], Result], progress: ProgressCallback | None
) -> list[Result]:
    total, done = sum(len(part.split.test) for part in parts), 0
    results = []
    for part in parts:
        results.append(action(part))
        done += len(part.split.test)
        if progress:
            progress(done, total)
    return results


def _stored(maps: Float[Maps, "n E A"]) -> bytes:
    return maps.astype(_STORED).tobytes()


def _maps_sha256(part: Part, grid_shape: tuple[int, int]) -> str:
    digest = hashlib.sha256()
    for _, maps in part.batches(grid_shape):
        digest.update(_stored(maps))
    return digest.hexdigest()


def _num_bytes(part: Part, dataset: PasDataset) -> int:
    E, A = dataset.grid.shape
    return len(part.split.test) * E * A * _STORED.itemsize


def _scored(submission: _Submission, part: Part, results_dir: Path) -> RunRecord:
    record_id = submission.record_id(part)
    with exclusive(predictions_path(results_dir, record_id).with_suffix(".lock")):
        known = stored_record(results_dir, record_id)
        return known or _new_record(submission, part, record_id, results_dir)


def _new_record(submission: _Submission, part: Part, record_id: str, results_dir: Path) -> RunRecord:
    dataset, path = submission.dataset, predictions_path(results_dir, record_id)
    write_predictions(
        path,
        part.batches(dataset.grid.shape),
        num_rows=len(part.split.test),
        grid_shape=dataset.grid.shape,
        dataset_sha256=dataset.sha256,
        split_sha256=part.split.sha256,
    )
    record = _record(submission, part, record_id, scored_fields(dataset, part.split, path))
    records.append(results_dir / RECORDS_FILE, record)
    return record


def _record(submission: _Submission, part: Part, record_id: str, scored: dict[str, Any]) -> RunRecord:
    declared = part.declared
    return RunRecord(
        id=record_id,
        job=Job(submission.data, declared.method, part.split.protocol, part.split.name, seed=declared.seed),
        **scored,
        config={},
        step=0,
        fit_seconds=declared.fit_seconds,
        predict_ms_per_map=declared.predict_ms_per_map,
        peak_memory_mib=None,
        parameters=declared.parameters,
        hardware={},
        software=machine.software(),
        git_commit=machine.git_commit(),
        time_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        external=External(sha256=submission.sha256, hardware=declared.hardware, url=declared.url),
    )


def _missing(dataset: PasDataset, parts: Sequence[Part]) -> Iterator[str]:
    """Names of the splits that the protocols of a file have by default, and that it leaves out."""
    given = {part.split.name for part in parts}
    for protocol in dict.fromkeys(part.split.protocol for part in parts):
        for split in splits_or_none(dataset, protocol):
            if split.name not in given:
                yield split.name
