"""One run, or one table of a measurement, as one line of JSON: all that a report is made from."""

from __future__ import annotations

import fcntl
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Int
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from xfreqbench.errors import DataError
from xfreqbench.method import Budget
from xfreqbench.storage import storage_errors

RECORDS_FILE = "records.jsonl"
NUM_QUANTILES = 101
_RECORD_START = b'{"'
_BENCH_START = b'{"bench":'  # how a line of a table begins, and none of a run
CURVE_SHARES = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2)  # of the budget; the fit's end comes after
CURVE_MAPS = 64  # scored at every point of a learning curve
Quantiles = Annotated[list[float], Field(min_length=NUM_QUANTILES, max_length=NUM_QUANTILES)]


@dataclass(frozen=True)
class Job:
    """One fit and its scores: what is run. `overrides` are `key=value` texts for the method's options."""

    dataset: str
    method: str
    protocol: str
    split: str
    overrides: tuple[str, ...] = ()
    seed: int = 0
    budget: Budget = field(default_factory=Budget)


class Summary(BaseModel):
    """One metric over the test samples; `interval` is the median's 95 % bootstrap interval."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    mean: float
    median: float
    p10: float
    interval: tuple[float, float]
    quantiles: Quantiles
    median_by_carrier_hz: dict[Annotated[str, Field(pattern=r"^\d{1,18}$")], float]


class CurvePoint(BaseModel):
    """A fit on its way: `ssim` is the median over a fixed sample of test maps, `seconds` are of fitting."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    step: int
    seconds: float
    loss: float
    ssim: float


class External(BaseModel):
    """Predictions that were made elsewhere: `sha256` hashes all that came in one file, maps and declarations.

    `hardware` and `url` are what their authors say.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    sha256: str
    hardware: str | None = None
    url: str | None = None


class RunRecord(BaseModel):
    """What was run, on what, with which result. `id` hashes everything that determines the result.

    `pas_kind` and `settings` are the data set's: its kind of map and what was asked of the rays.
    `counts` are what the method counted last, such as its Gaussians. `curve` has a point at each of
    `CURVE_SHARES` of the budget that was reached, and one at the end of the fit; it is empty without a
    limit, and where the method yielded once. `ssim_by_tx` holds the SSIM of every test sample to four
    decimals, a list for each tested transmitter in the order of their indices; `nearest_trained_m` is the
    median distance from a tested transmitter to the nearest trained one, `code_sha256` hashes the files that
    define the method, `findings` is what the method says it has learned.

    Where `external` is there, nothing was fitted or timed here: `fit_seconds`, `predict_ms_per_map` and
    `parameters` are as declared, None where they are not, `peak_memory_mib` is None, `step` 0 and `hardware`
    empty. Only the scores are computed here, with the software and the commit that are named.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    id: str
    job: Job
    dataset_sha256: str
    scene: str
    pas_kind: str
    settings: dict[str, Any]
    split_sha256: str
    protocol_version: str
    metrics_version: str
    config: dict[str, Any]
    step: int
    fit_seconds: float | None
    predict_ms_per_map: float | None
    peak_memory_mib: float | None
    parameters: int | None
    num_test: int
    num_without_path: int
    shares_transmitters: bool
    scores: dict[str, Summary]
    hardware: dict[str, str]
    software: dict[str, str]
    git_commit: str | None
    time_utc: str
    counts: dict[str, float] = {}
    curve: tuple[CurvePoint, ...] = ()
    ssim_by_tx: tuple[tuple[float, ...], ...] = ()
    nearest_trained_m: float | None = None
    code_sha256: str | None = None
    findings: dict[str, Any] = {}
    external: External | None = None


class BenchPoint(BaseModel):
    """One measurement of a figure: `label` says which settings, `series` which of the figure's lines."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    series: str
    label: str
    x: float
    y: float


class BenchFigure(BaseModel):
    """Measurements against a cost, to be drawn; axes are labelled with their units."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    x_label: str
    y_label: str
    log_x: bool
    points: tuple[BenchPoint, ...]


class BenchRecord(BaseModel):
    """One table of a measurement, cells as printed; `command` prints it again, `note` says how to read it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    bench: str
    title: str
    command: str
    note: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    figure: BenchFigure | None = None
    hardware: dict[str, str]
    software: dict[str, str]
    git_commit: str | None
    time_utc: str


@dataclass(frozen=True)
class StoredRecords:
    """Records of a file; `num_truncated` is 1 where a killed run left half a line at its end."""

    records: tuple[RunRecord, ...]
    benches: tuple[BenchRecord, ...] = ()
    num_truncated: int = 0


def curve_positions(split_sha256: str, num_test: int) -> Int[NDArray[np.int64], "n"]:
    """Positions among a split's test rows of the sample that learning curves are taken on, ascending."""
    generator = np.random.default_rng(int(split_sha256, 16))
    return np.sort(generator.choice(num_test, min(CURVE_MAPS, num_test), replace=False))


def append(path: Path, record: RunRecord | BenchRecord) -> None:
    """Add one line, whole and on disk before this returns; raises `StorageError`.

    Writers take turns. Half a line that a killed run left at the end is removed; raises `DataError` where
    the end of the file is anything else.
    """
    line = record.model_dump_json().encode() + b"\n"
    with storage_errors(path, len(line)):
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            _append_line(path, descriptor, line)
        finally:
            os.close(descriptor)


def read(path: Path) -> StoredRecords:
    """Records in the order they were written; none where there is no file.

    Raises `DataError` naming file and line for a line that is no record. A last line without its end,
    as a killed run leaves it, is counted and not read.
    """
    if not path.exists():
        return StoredRecords(())
    try:
        *lines, rest = path.read_bytes().split(b"\n")
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}.") from error
    _require_half_a_record(path, rest)
    parsed = [_parse(path, number, line) for number, line in enumerate(lines, start=1)]
    runs = tuple(record for record in parsed if isinstance(record, RunRecord))
    benches = tuple(record for record in parsed if isinstance(record, BenchRecord))
    return StoredRecords(runs, benches, num_truncated=int(bool(rest)))


def _require_half_a_record(path: Path, rest: bytes) -> None:
    """Raise `DataError` where what stands behind the last line's end is no record cut short: it would be lost."""
    if not rest.startswith(_RECORD_START[: len(rest)]):
        raise DataError(f"{path} is no file of records: it ends in {rest[:40]!r}. Give the path of another.")


def _append_line(path: Path, descriptor: int, line: bytes) -> None:
    """Write behind the last whole line; a write that fails half way is taken back."""
    with os.fdopen(os.dup(descriptor), "rb") as file:
        content = file.read()
    end = content.rfind(b"\n") + 1
    _require_half_a_record(path, content[end:])
    os.ftruncate(descriptor, end)
    try:
        written = os.pwrite(descriptor, line, end)
        if written < len(line):
            raise OSError(28, "No space left on device")
        os.fsync(descriptor)
    except OSError:
        os.ftruncate(descriptor, end)
        raise


def _parse(path: Path, number: int, line: bytes) -> RunRecord | BenchRecord:
    kind = BenchRecord if line.startswith(_BENCH_START) else RunRecord
    try:
        return kind.model_validate_json(line)
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(map(str, fault["loc"]))
        raise DataError(
            f"{path}, line {number}, is no run record: {place + ': ' if place else ''}{fault['msg']}. "
            "Delete the line; the run it stood for is then run again."
        ) from error
