"""Maps of a dozen test samples of a board, true and predicted: shipped in one file beside the records, and shown.

Each line of the file is a `ShownMaps` as JSON. Maps are levels of 8 bits on every fourth row and column: 0 is 30 dB
below the peak or less, 255 the peak. The array's beam is 26° wide, so that four degrees show it. The page shows the
best, the median and the worst predicted map of each method, from stored predictions where they are found.
"""

from __future__ import annotations

import hashlib
import shlex
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from pydantic import Field, ValidationError, model_validator

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.splits import SPARSE_TEST_HZ, VALIDATIONS
from xfreqbench.errors import DataError, StorageError, UnknownNameError
from xfreqbench.maps.bartlett import power_of
from xfreqbench.maps.metrics import score_all
from xfreqbench.report.leaderboard.boards import Board, BoardRow, short_name
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.predictions import Predictions
from xfreqbench.runs.records import FiniteScore, RunRecord, fault_of_fields
from xfreqbench.runs.scoring import BATCH_SIZE
from xfreqbench.runs.sealed import SealedModel, StoredModel
from xfreqbench.system.files import read_bytes, require_own
from xfreqbench.types import IntArray, Maps, NDArray

NUM_SHOWN = 12  # samples of a split
_RANGE_DB = 30.0
Levels = UInt8[NDArray[np.uint8], "n R C"]


class _PredictedMaps(StoredModel):
    """What one run predicts for the samples: scores of the whole maps, and their levels as a PNG in base64."""

    ssim: tuple[FiniteScore, ...]
    psnr: tuple[float, ...]
    maps: str


class ShownMaps(SealedModel):
    """Samples of one split with their true maps, and what several runs predict, by the ids of their records.

    The maps of all samples are one below the other in a picture, the pole at the upper edge of each.
    """

    split: str
    tx_position_m: Annotated[
        tuple[tuple[FiniteScore, FiniteScore, FiniteScore], ...], Field(min_length=1, max_length=NUM_SHOWN)
    ]
    carrier_hz: tuple[FiniteScore, ...]
    truth: str
    predicted: dict[str, _PredictedMaps]

    @model_validator(mode="after")
    def _require_equal_lengths(self) -> ShownMaps:
        counted = [self.carrier_hz, *(scores for run in self.predicted.values() for scores in (run.ssim, run.psnr))]
        if any(len(values) != len(self.tx_position_m) for values in counted):
            raise ValueError(f"not all of its lists have {len(self.tx_position_m)} samples")
        return self

    def levels(self, record_id: str | None = None) -> Levels:
        """The levels of the maps of a run, or of the true ones, a byte each; raises `DataError`."""
        from xfreqbench.report.drawing.figures import grey_levels

        number = len(self.carrier_hz)
        try:
            png = self.truth if record_id is None else self.predicted[record_id].maps
            levels = grey_levels(b64decode(png, validate=True))
            return levels.reshape(number, -1, levels.shape[1])
        except ValueError as error:
            raise DataError(f"Maps to be shown are no picture of {number} maps: {error}. Write them again.") from error


def _power_levels(maps: Float[Maps, "n E A"], dataset: PasDataset) -> Levels:
    """The levels of maps on every fourth row and column, the row next to the pole first."""
    power = power_of(maps, dataset.header.pas_kind)
    level = 1 + 10 * np.log10(np.maximum(power, np.float32(10 ** (-_RANGE_DB / 10)))) / np.float32(_RANGE_DB)
    upwards = np.argsort(-dataset.grid.elevation_rad)[::4]
    return np.round(np.clip(level, 0, 1) * 255).astype(np.uint8)[:, upwards, ::4]


def _chosen_samples(records: Iterable[RunRecord], num_test: int) -> Int[IntArray, "n"]:
    """Positions of a dozen among the tested samples, from the easiest to the hardest by the records' mean SSIM.

    They are equally far apart in that order, and include its ends. All of fewer than a dozen are chosen.
    """
    ssim = [np.concatenate([np.asarray(values) for values in record.ssim_by_tx]) for record in records]
    mean = np.mean([values for values in ssim if len(values) == num_test] or [np.zeros(num_test)], axis=0)
    order = np.argsort(-mean, kind="stable")
    return order[np.unique(np.linspace(0, num_test - 1, min(NUM_SHOWN, num_test)).round().astype(np.int64))]


def require_own_maps(path: Path) -> None:
    """Raise `OutputExistsError` where a file exists that holds something else."""

    def fault_of(file: Path) -> str | None:
        try:
            read_maps(file)
        except DataError:
            return "holds no maps to be shown"
        return None

    require_own(path, fault_of)


def read_maps(path: Path) -> dict[str, ShownMaps]:
    """The maps of a file, by the ids of the records whose predictions are in them; none if there is no such file.

    Raises `DataError` that names file and line.
    """
    if not path.exists():
        return {}
    found: dict[str, ShownMaps] = {}
    try:
        lines = read_bytes(path).splitlines()
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}.") from error
    for number, line in enumerate(lines, start=1):
        try:
            shown = ShownMaps.model_validate_json(line)
        except ValidationError as error:
            raise DataError(
                f"{path}, line {number}, holds no maps to be shown: {fault_of_fields(error)}. Delete the file, or "
                "write it again: xfreqbench report RESULTS --maps FILE"
            ) from error
        found |= dict.fromkeys(shown.predicted, shown)
    return found


def _open_data(board: Board) -> PasDataset | None:
    """The board's data set, from the first path in its records where it still is; None where it is at none."""
    jobs = [record.job for record in board.records]
    for place in dict.fromkeys((job.dataset, job.receiver, job.polarization) for job in jobs):
        try:
            dataset = open_dataset(*place)
        except (DataError, StorageError, UnknownNameError):
            continue
        if board.is_of(dataset):
            return dataset
    return None


def stored_maps(board: Board, folders: Sequence[ResultsFolder], papers: Sequence[BoardRow]) -> list[ShownMaps]:
    """The maps of the shown split, and those of the paper's methods and the same transmitters on other splits.

    There are none where the data set or predictions are not found.
    """
    dataset = _open_data(board)
    dozen = _dozen_of(board, dataset, folders) if dataset else None
    if dataset is None or dozen is None:
        return []
    distance_m = np.abs(dataset.tx_position_m[:, None] - np.asarray(dozen.tx_position_m)).max(axis=2)
    is_shown = distance_m.min(axis=1) < 1e-3  # positions of shown maps are rounded

    def chosen(rows: IntArray) -> IntArray:
        return rows[is_shown[rows]]

    others = [
        _maps_at(dataset, [row.by_split[split][0] for row in papers if split in row.by_split], folders, chosen)
        for split in board.splits
        if split != dozen.split and any(split in row.by_split for row in papers)
    ]
    return [dozen, *(other for other in others if other)]


def _maps_at(
    dataset: PasDataset,
    records: Sequence[RunRecord],
    folders: Sequence[ResultsFolder],
    choose: Callable[[IntArray], IntArray],
) -> ShownMaps | None:
    """The maps of those records of one split whose predictions are stored; None if no predictions are stored.

    `choose` takes all tested rows and returns those whose maps are wanted.
    """
    found = {record.id: _predictions(folders, record, dataset) for record in records}
    known = {key: predictions for key, predictions in found.items() if predictions is not None}
    rows = choose(next(iter(known.values())).rows) if known else np.empty(0, np.int64)
    if not len(rows):
        return None
    samples, truth = dataset[rows], dataset.pas(rows)
    predicted = {}
    for record_id, predictions in known.items():
        maps = predictions.maps_of(rows, BATCH_SIZE)
        scores = score_all(maps, truth, dataset.grid, dataset.header.pas_kind)
        ssim, psnr = (tuple(scores[name].round(4).tolist()) for name in ("ssim", "psnr"))
        predicted[record_id] = _PredictedMaps(ssim=ssim, psnr=psnr, maps=_png(_power_levels(maps, dataset)))
    return ShownMaps(
        split=records[0].job.split,
        tx_position_m=tuple(map(tuple, samples.tx_position_m.round(4).tolist())),
        carrier_hz=tuple(samples.carrier_hz.tolist()),
        truth=_png(_power_levels(truth, dataset)),
        predicted=predicted,
    )


def _predictions(folders: Sequence[ResultsFolder], record: RunRecord, dataset: PasDataset) -> Predictions | None:
    """The predictions of a record; None where they are absent, damaged or of another split in every folder."""
    for folder in folders:
        try:
            predictions = folder.predictions(record)
            predictions.require_of(dataset)
        except (DataError, StorageError):
            continue
        return predictions
    return None


def _png(levels: Levels) -> str:
    """A picture of maps, one below the other, in base64."""
    from xfreqbench.report.drawing.figures import grey_png

    return b64encode(grey_png(levels.reshape(-1, levels.shape[-1]))).decode()


def _dozen_of(board: Board, dataset: PasDataset, folders: Sequence[ResultsFolder]) -> ShownMaps | None:
    """The maps of a dozen samples of the shown split, of all shown records whose predictions are stored; else None.

    The samples are chosen by how easy they are for the trivial predictors, if these were run.
    """
    split = _shown_split(board)
    records = list(_shown_records(board, split).values())
    trivial = [row.by_split[split][0] for row in board.rows if row.is_trivial and split in row.by_split]

    def choose(rows: IntArray) -> IntArray:
        return rows[_chosen_samples(trivial or records, len(rows))]

    return _maps_at(dataset, records, folders, choose)


def _shown_records(board: Board, split: str) -> dict[str, RunRecord]:
    """The records whose maps are shown, by the labels of their rows: the first seed of all rows but ablations."""
    rows = [row for row in board.rows if split in row.by_split and row.family != "ablation"]
    return {row.short_label: row.by_split[split][0] for row in rows}


def _shown_split(board: Board) -> str:
    """The split that tests 24.25 GHz, as both of the paper's protocols do.

    It is the middle one where several do, and the middle one of all where none does.
    """
    tested = {record.job.split: record.scores["ssim"].median_by_carrier_hz for record in board.records}
    chosen = [split for split in board.splits if f"{SPARSE_TEST_HZ:.0f}" in tested[split]] or board.splits
    return chosen[len(chosen) // 2]


def gallery(
    board: Board, folders: Sequence[ResultsFolder], shipped: Mapping[str, ShownMaps] | None = None
) -> dict[str, Any]:
    """Pictures of all rows but ablations, for the first seed of each, from the predictions in one of `folders`.

    Where these are not found, they are drawn from `shipped`, maps by the ids of records. `cases` has the `best`, the
    `median` and the `worst` sample of each method: position, carrier, scores and the names of three pictures.
    `pictures` are PNG files in base64 by name. `missing` says which methods have no pictures, and the command that
    stores what is missing.
    """
    split, dataset = _shown_split(board), _open_data(board)
    stored = _dozen_of(board, dataset, folders) if dataset else None
    cases: dict[str, list[dict[str, Any]]] = {}
    pictures: dict[str, str] = {}
    absent: dict[str, RunRecord] = {}
    for label, record in _shown_records(board, split).items():
        known = stored if stored and record.id in stored.predicted else (shipped or {}).get(record.id)
        if known is None:
            absent[label] = record
        else:
            cases[label] = [*_cases(known, record.id, pictures)]
    path = board.records[0].job.dataset
    words = ("generate", board.scene, "-o", path) if "solver" in board.settings else ("import",)
    made = shlex.join(("xfreqbench", *words))
    missing = f"No pictures: {path}, {board.data_name}, is not here. `{made}` makes it." if absent else ""
    if absent and (dataset or cases):
        missing = _missing_predictions(board, absent)
    return {"split": short_name(split), "cases": cases, "pictures": pictures, "missing": missing}


def _cases(shown: ShownMaps, record_id: str, pictures: dict[str, str]) -> Iterator[dict[str, Any]]:
    run = shown.predicted[record_id]
    truth, predicted = (shown.levels(each) / np.float32(255) for each in (None, record_id))
    if truth.shape != predicted.shape:
        raise DataError(f"Maps to be shown of record {record_id} have another shape than the true ones.")
    order = np.argsort(-np.asarray(run.ssim), kind="stable").tolist()
    for place, index in {"best": order[0], "median": order[len(order) // 2], "worst": order[-1]}.items():
        yield {
            "place": place,
            "tx_position_m": np.round(shown.tx_position_m[index], 2).tolist(),
            "carrier_ghz": shown.carrier_hz[index] / 1e9,
            "ssim": run.ssim[index],
            "psnr": run.psnr[index],
            **_draw(truth[index], predicted[index], pictures),
        }


def _draw(
    truth: Float[NDArray[np.float32], "E A"], predicted: Float[NDArray[np.float32], "E A"], pictures: dict[str, str]
) -> dict[str, str]:
    """Draw levels of truth and prediction, and their error, into `pictures`; returns their names, which are hashes."""
    from xfreqbench.report.drawing.figures import map_png

    power = [np.where(level > 0, 10 ** ((level - 1) * _RANGE_DB / 10), 0) for level in (truth, predicted)]
    error = np.abs(power[1] - power[0]) / 0.3
    names = {}
    for kind, values, colours in (
        ("truth", truth, "magma"),
        ("predicted", predicted, "magma"),
        ("error", error, "viridis"),
    ):
        png = map_png(values, colours)
        names[kind] = hashlib.sha256(png).hexdigest()[:12]
        pictures[names[kind]] = b64encode(png).decode()
    return names


def _missing_predictions(board: Board, absent: Mapping[str, RunRecord]) -> str:
    job = board.records[0].job
    methods = shlex.quote(",".join(dict.fromkeys(record.job.method for record in absent.values())))
    on = " --on validation" if job.protocol in VALIDATIONS else ""
    on += f" --receiver {shlex.quote(job.receiver)}" if job.receiver else ""
    on += f" --polarization {job.polarization}" if job.polarization else ""
    protocol = VALIDATIONS.get(job.protocol, job.protocol)
    data = shlex.quote(job.dataset)
    command = f"xfreqbench run --data {data} --method {methods} --protocol {protocol}{on} --results FOLDER"
    return (
        f"Without stored predictions: {', '.join(absent)}. `{command}`, with the targets, seeds, budget and options of "
        "these runs, stores them."
    )
