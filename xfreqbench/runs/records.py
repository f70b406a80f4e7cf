"""Records: a run, or a table of a measurement, as one line of JSON. Reports are made from nothing else."""

from __future__ import annotations

import base64
import codecs
import errno
import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC
from functools import partial
from itertools import chain, pairwise
from math import nan
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Int
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainSerializer,
    ValidationError,
    WrapValidator,
    model_validator,
)
from pydantic_core import from_json

from xfreqbench.errors import DataError
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.runs.sealed import SealedModel, StoredModel
from xfreqbench.system.arguments import only_given
from xfreqbench.system.files import exclusive, read_bytes, require_regular, require_text, storage_errors
from xfreqbench.system.machine import git_commit, hardware, now, software
from xfreqbench.types import NDArray
from xfreqbench.units import band_text

NUM_QUANTILES = 101
LEAST_CORE_SHARE = 0.7  # of a core, below which seconds of a fit say little
_BENCH_START = b'{"bench":'  # the line of a table begins so, and that of a run does not
_STARTS = b'{"id":', _BENCH_START
CURVE_SHARES = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2)  # of the budget; the fit's end comes after
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0, lt=2**63)]

_STEP = 1e-4  # of the scores of single samples; medians, which tables print to 1e-5, are finer


def _rounded(number: float) -> float:
    """Seven decimals of a number, or three digits of one below 1e-4."""
    return float(f"{number:.3g}") if abs(number) < 1e-4 else round(number, 7)


def _rounded_within(found: Any) -> Any:
    """Dictionaries and lists with every number in them rounded."""
    if isinstance(found, dict):
        return {name: _rounded_within(value) for name, value in found.items()}
    if isinstance(found, list | tuple):
        return [_rounded_within(value) for value in found]
    return _rounded(found) if isinstance(found, float) else found


def pack(numbers: Sequence[float], step: float) -> str | list[float]:
    """A text that stands for numbers to the nearest multiple of `step`; the numbers themselves where one is infinite.

    Each multiple less the one before is an `int32`. The lowest bytes of all come first, then the second, third and
    fourth; they are deflated (zlib) and written in base64.
    """
    multiples = np.round(np.asarray(numbers, np.float64) / step)
    if not (np.abs(multiples) < 2**30).all():
        return list(numbers)
    differences = np.diff(multiples, prepend=0.0).astype("<i4")
    content = differences.view(np.uint8).reshape(-1, 4).T.tobytes()
    return base64.b64encode(zlib.compress(content, 9)).decode()


def unpack(packed: Any, step: float) -> Any:
    """The numbers that a text of `pack` stands for; what is no text comes back as it is.

    Raises `ValueError` for a text that `pack` does not write.
    """
    if not isinstance(packed, str):
        return packed
    inflate = zlib.decompressobj()
    try:
        content = inflate.decompress(base64.b64decode(packed, validate=True), 4 * 10_000_000)
    except zlib.error as error:
        raise ValueError(f"a packed list cannot be read: {error}") from error
    if not inflate.eof or len(content) % 4:
        raise ValueError("a packed list is cut off, or longer than ten million numbers")
    differences = np.frombuffer(content, np.uint8).reshape(4, -1).T.copy().view("<i4")
    multiples = differences.ravel().cumsum(dtype=np.int64)
    return (multiples if step == 1 else multiples / round(1 / step)).tolist()  # each the number nearest to its decimals


def _pack_by_tx(scores: tuple[tuple[float, ...], ...]) -> list[Any]:
    """The number of samples of each transmitter, and the scores of all, each as one text."""
    every = [score for of_transmitter in scores for score in of_transmitter]
    return [pack([len(of_transmitter) for of_transmitter in scores], 1), pack(every, _STEP)]


def _unpacked_quantiles(packed: Any, validate: Callable[[Any], list[float]]) -> list[float]:
    """Quantiles from their text, or whatever else `validate` takes; a text needs no look at each number."""
    found = unpack(packed, _STEP)
    return found if isinstance(packed, str) and len(found) == NUM_QUANTILES else validate(found)


def _unpacked_by_tx(packed: Any, validate: Callable[[Any], tuple[tuple[float, ...], ...]]) -> Any:
    """Scores by transmitter from the texts of `_pack_by_tx`, from arrays of the same, or what else `validate` takes."""
    if not (
        isinstance(packed, list) and len(packed) == 2 and all(isinstance(each, str | np.ndarray) for each in packed)
    ):
        return validate(packed)
    numbers, scores = (unpack(each, step) for each, step in zip(packed, (1, _STEP), strict=True))
    ends = np.cumsum(numbers, dtype=np.int64)
    if len(scores) != (ends[-1] if len(ends) else 0):
        raise ValueError("there are not as many scores as samples")
    if not (np.diff(ends, prepend=0) > 0).all():
        raise ValueError("a transmitter is without samples")
    scores = scores.tolist() if isinstance(scores, np.ndarray) else scores
    return tuple(tuple(scores[start:end]) for start, end in pairwise([0, *ends.tolist()]))


# The digits that mean something. Numbers are rounded where a record is made or read, so that both are the same.
Amount = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Seconds = Annotated[Amount, AfterValidator(partial(round, ndigits=6))]
Score = Annotated[float, AfterValidator(partial(round, ndigits=8))]
FiniteScore = Annotated[Score, Field(allow_inf_nan=False)]
Quantiles = Annotated[
    list[Annotated[float, AfterValidator(partial(round, ndigits=4))]],
    Field(min_length=NUM_QUANTILES, max_length=NUM_QUANTILES),
    WrapValidator(_unpacked_quantiles),
    PlainSerializer(partial(pack, step=_STEP), when_used="json"),
]
ScoresByTransmitter = Annotated[
    tuple[Annotated[tuple[FiniteScore, ...], Field(min_length=1)], ...],
    WrapValidator(_unpacked_by_tx),
    PlainSerializer(_pack_by_tx, when_used="json"),
]
Cells = Annotated[
    tuple[Count, ...],
    BeforeValidator(partial(unpack, step=1)),
    PlainSerializer(partial(pack, step=1), when_used="json"),
]
Findings = Annotated[dict[str, Any], AfterValidator(_rounded_within)]


@dataclass(frozen=True)
class Job:
    """What is asked for: one method, fitted on one split of a data set with one seed, and scored.

    `dataset` is the path of the data set; `overrides` are texts `key=value` for the method's options. `receiver` and
    `polarization` say which link is used of a file with several, and are left out of the JSON for other files.
    """

    dataset: str
    method: str
    protocol: str
    split: str
    overrides: tuple[str, ...] = ()
    seed: Count = 0
    budget: Budget = field(default_factory=Budget)
    receiver: str | None = None
    polarization: str | None = None

    _json = only_given

    def __post_init__(self) -> None:
        for text in (self.dataset, self.method, *self.overrides):
            require_text(text)

    @property
    def is_trivial(self) -> bool:
        """Whether the method is a trivial predictor without options, which is not fitted."""
        return self.method in EVERY_TRIVIAL and not self.overrides


class Summary(StoredModel):
    """One metric over the test samples: `p10` is the 10 % quantile, `quantiles` are those of 0, 1, … 100 %."""

    mean: Score
    median: Score
    p10: Score
    quantiles: Quantiles
    median_by_carrier_hz: dict[Annotated[str, Field(pattern=r"^\d{1,18}$")], Score]


class CurvePoint(StoredModel):
    """How a fit stood at one step: `ssim` is the median over a sample of test maps, `seconds` is the fitting time.

    `share` is the part of the budget that was spent.
    """

    step: Count
    seconds: Seconds
    loss: Annotated[float, AfterValidator(_rounded)]
    ssim: FiniteScore
    share: Amount


class External(StoredModel):
    """Where predictions come from that were made elsewhere.

    `sha256` is the hash of all maps and declarations that came in one file. `hardware` and `url` are as declared
    by their authors.
    """

    sha256: Sha256
    hardware: str | None = None
    url: str | None = None


class RunRecord(SealedModel):
    """One run: what was run, on which data, with which result. `id` is the hash of all that determines the result.

    * `recipe` is the `Recipe.id` of the data set, the same on every machine, where `dataset_sha256` is the hash of
      its bytes, whose last digits depend on the processor.
    * `pas_kind` and `settings` are those of the data set: the kind of its maps, and the settings of the tracer.
    * `counts` are the last that the method reported, such as its number of Gaussians.
    * `curve` has a point at each of `CURVE_SHARES` of the budget that was reached and one at the end of the fit. It is
      empty for a fit without a limit, and for a method that yielded only once.
    * `ssim_by_tx` holds the SSIM of every test sample, rounded to four decimals: a list for each tested transmitter,
      in the order of their indices.
    * `cell_of_tx` has for each of these transmitters the number of its cell, a square of the floor (`splits.cell_m`).
    * `nearest_trained_m` is the median distance from a tested transmitter to the nearest trained one.
    * `code_sha256` is the hash of the method's code, see `xfreqbench.methods.registry.code_sha256`.
    * `findings` is what the method says it has learned.
    * `fit_processor_seconds` is the time of all cores during the fit; see `core_share`.
    * `trained_band_hz` are the lowest and the highest carrier that was trained on.
    * `removed_predictions_sha256` is the hash of the file of predictions, if that was removed after it was scored.

    If `external` is given, nothing was fitted or timed here: `fit_seconds`, `predict_ms_per_map` and `parameters` are
    as declared, or None; `peak_memory_mib` is None, `step` is 0 and `hardware` is empty. Only the scores were computed
    here, with the software and the commit that the record names.
    """

    id: str
    job: Job
    dataset_sha256: Sha256
    recipe: Annotated[str, Field(pattern=r"^([0-9]{1,9}|data)-[0-9a-f]{64}$")]
    scene: str
    pas_kind: str
    settings: dict[str, Any]
    split_sha256: Sha256
    protocol_version: str
    metrics_version: str
    config: dict[str, Any]
    step: Count
    fit_seconds: Seconds | None
    predict_ms_per_map: Amount | None
    peak_memory_mib: Amount | None
    parameters: Count | None
    num_test: Annotated[Count, Field(ge=1)]
    num_without_path: Count
    shares_transmitters: bool
    scores: dict[str, Summary]
    hardware: dict[str, str]
    software: dict[str, str]
    git_commit: str | None
    time_utc: str
    counts: dict[str, float] = Field(default_factory=dict)
    curve: tuple[CurvePoint, ...] = ()
    ssim_by_tx: ScoresByTransmitter = ()
    nearest_trained_m: Amount | None = None
    code_sha256: str | None = None
    findings: Findings = Field(default_factory=dict)
    external: External | None = None
    fit_processor_seconds: Seconds | None = None
    trained_band_hz: tuple[Amount, Amount] | None = None
    removed_predictions_sha256: Sha256 | None = None
    cell_of_tx: Cells = ()

    @model_validator(mode="after")
    def _require_own_median(self) -> RunRecord:
        if self.ssim_by_tx and "ssim" in self.scores:
            ssim = np.fromiter(chain.from_iterable(self.ssim_by_tx), np.float64)
            claimed, found = self.scores["ssim"].median, float(np.median(ssim))
            if not abs(claimed - found) < _STEP:  # scores of samples have four decimals
                raise ValueError(f"scores.ssim.median is {claimed:.5f}, but the median of ssim_by_tx is {found:.5f}")
        return self

    @property
    def extrapolated_from(self) -> str:
        """The band of the training carriers, as text, if a carrier outside of it is tested; else empty."""
        if self.trained_band_hz is None:
            return ""
        low, high = self.trained_band_hz
        tested_hz = map(float, self.scores["ssim"].median_by_carrier_hz)
        return "" if all(low <= tested <= high for tested in tested_hz) else band_text(low, high)

    def __repr__(self) -> str:
        job, ssim = self.job, self.scores.get("ssim")
        score = f"median SSIM {ssim.median:.4f}, " if ssim else ""
        options = f" ({', '.join(job.overrides)})" if job.overrides else ""
        return (
            f"<RunRecord {self.id}: {job.method}{options} on {job.split} of {self.scene}, seed {job.seed}, "
            f"{score}{self.num_test} test samples>"
        )

    __str__ = __repr__

    @property
    def core_share(self) -> float:
        """Processor time of the fit by its wall time; nan where it is not known, and for fits of under a second.

        It is below 1 where other programs were busy, or the method waited for something. What a method computes on a
        GPU or in other processes does not count, so there it is nan too.
        """
        if self.fit_processor_seconds is None or self.fit_seconds is None or self.fit_seconds < 1:
            return nan
        is_here = str(self.config.get("device", "cpu")).startswith("cpu")
        return self.fit_processor_seconds / self.fit_seconds if is_here else nan


class BenchPoint(StoredModel):
    """A point of a figure: `series` names the line it belongs to, `label` the settings that were measured."""

    series: str
    label: str
    x: float
    y: float


class BenchFigure(StoredModel):
    """Points to draw, with labels of both axes that include their units.

    Where `x_is_cost`, less of it is better, and the figure marks what nothing cheaper beats.
    """

    x_label: str
    y_label: str
    log_x: bool
    points: tuple[BenchPoint, ...]
    x_is_cost: bool = True


class BenchRecord(SealedModel):
    """A table of a measurement, with cells as printed. `command` makes it again; `note` says how to read it."""

    bench: str
    title: str
    command: str
    note: str
    columns: Annotated[tuple[str, ...], Field(min_length=1)]
    rows: tuple[tuple[str, ...], ...]
    figure: BenchFigure | None = None
    hardware: dict[str, str]
    software: dict[str, str]
    git_commit: str | None
    time_utc: str

    @model_validator(mode="after")
    def _require_cells(self) -> BenchRecord:
        for number, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise ValueError(f"row {number} has {len(row)} cells for {len(self.columns)} columns")
        return self


@dataclass(frozen=True)
class StoredRecords:
    """What a file of records holds: runs and tables, and each by its line in `by_line`.

    `num_truncated` is 1 if its last line is cut off.
    """

    records: tuple[RunRecord, ...]
    benches: tuple[BenchRecord, ...] = ()
    num_truncated: int = 0
    by_line: Mapping[bytes, RunRecord | BenchRecord] = field(default_factory=dict, repr=False, compare=False)


def curve_positions(split_sha256: str, num_test: int) -> Int[NDArray[np.int64], "n"]:
    """Which of a split's test rows the points of a learning curve are scored on: ascending positions, shape (n,)."""
    generator = np.random.default_rng(int(split_sha256, 16))
    return np.sort(generator.choice(num_test, min(64, num_test), replace=False))


def append(path: Path, record: RunRecord | BenchRecord) -> None:
    """Add a record to a file as one line, whole and on disk before this returns.

    Processes that append to one file take turns. Half a line that a killed run left at the end is removed, and nothing
    else. Raises `StorageError`, and `DataError` where the last line lacks its end and is neither that nor a record.
    """
    line = record.sealed_json() + b"\n"
    with exclusive(path.with_name(f".{path.name}.lock")), storage_errors(path, len(line)):
        if path.exists():
            require_regular(path)
        with os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o644), "r+b", buffering=0) as file:
            content = file.read()
            lines, half = _lines(content)
            end = len(content) - len(half)
            if end and not content.endswith(b"\n", 0, end):
                if lines:
                    _parse(path, *lines[-1])
                line = b"\n" + line
            file.truncate(end)
            try:
                if os.pwrite(file.fileno(), line, end) < len(line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.fsync(file.fileno())
            except OSError:
                file.truncate(end)
                raise


def read(path: Path, known: StoredRecords | None = None) -> StoredRecords:
    """The records of a file, in the order in which they were written; none if there is no such file.

    Half a line at the end, as a killed run leaves it, is not read, but counted. Lines may end as on any system,
    the last without an end, and two may follow each other without one. Lines that `known` was read from are not
    parsed again, so that a file that grows is read in the time of what is new. Raises `DataError` that names file
    and line for a line that is not a record.
    """
    if not path.exists():
        return StoredRecords(())
    by_line = known.by_line if known else {}
    try:
        lines, half = _lines(read_bytes(path))
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}.") from error
    parsed = [by_line.get(line) or _parse(path, number, line) for number, line in lines]
    runs = tuple(record for record in parsed if isinstance(record, RunRecord))
    benches = tuple(record for record in parsed if isinstance(record, BenchRecord))
    return StoredRecords(
        runs, benches, int(bool(half)), {line: record for (_, line), record in zip(lines, parsed, strict=True)}
    )


def _lines(content: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """The lines of a file that are not blank, with their numbers, and what a killed run wrote of one more."""
    lines = list[tuple[int, bytes]]()
    for number, line in enumerate(content.removeprefix(codecs.BOM_UTF8).splitlines(), start=1):
        for start in _STARTS:  # after a brace it is in no JSON: two lines were joined there
            line = line.replace(b"}" + start, b"}\n" + start)
        lines += [(number, part) for part in line.splitlines() if part.strip()]
    is_cut = lines and content.endswith(lines[-1][1]) and _is_half(lines[-1][1])
    return lines, lines.pop()[1] if is_cut else b""


def _is_half(line: bytes) -> bool:
    """Whether bytes are the beginning of a record's line, and not all of it."""
    if not any(line.startswith(start[: len(line)]) for start in _STARTS):
        return False
    try:
        from_json(codecs.getincrementaldecoder("utf-8")().decode(line))
    except ValueError as error:
        return str(error).startswith("EOF")
    return False


def _parse(path: Path, number: int, line: bytes) -> RunRecord | BenchRecord:
    kind = BenchRecord if line.startswith(_BENCH_START) else RunRecord
    try:
        return kind.model_validate_json(line)
    except ValidationError as error:
        if number == 1 and not line.startswith(b"{"):
            raise DataError(
                f"{path} is no file of records, which are lines of JSON. Give a results folder, or its records.jsonl."
            ) from error
        raise DataError(
            f"{path}, line {number}, is no run record: {fault_of_fields(error)}. "
            "Delete the line; the run it stood for is then run again."
        ) from error


def fault_of_fields(error: ValidationError) -> str:
    """The first field that was refused, and why: `job.seed: Input should be a valid integer`."""
    fault = error.errors(include_url=False, include_context=False, include_input=False)[0]
    place = ".".join(map(str, fault["loc"]))
    return f"{place}: {fault['msg']}" if place else fault["msg"]


def made_here(versions: Mapping[str, str] | None = None) -> dict[str, Any]:
    """The fields of a record that is made on this machine, now; `versions` are those of further libraries."""
    told = {"hardware": hardware(), "software": software() | dict(versions or {})}
    return told | {"git_commit": git_commit(), "time_utc": utc_now()}


def utc_now() -> str:
    """The time as records have it, in UTC to the second."""
    return now().astimezone(UTC).isoformat(timespec="seconds")
