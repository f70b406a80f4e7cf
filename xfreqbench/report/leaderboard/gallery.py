"""Pictures of the best, the median and the worst predicted map of each method, of a dozen test samples of a board.

They are drawn from stored predictions, or where these are not there from the maps that are shipped beside the records.
"""

from __future__ import annotations

import hashlib
import shlex
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.splits import SPARSE_TEST_HZ, VALIDATIONS
from xfreqbench.errors import DataError, StorageError, UnknownNameError
from xfreqbench.report.leaderboard.boards import Board, short_name
from xfreqbench.report.leaderboard.shown_maps import RANGE_DB, ShownMaps, chosen_samples, shown_maps
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.predictions import Predictions
from xfreqbench.runs.records import RunRecord
from xfreqbench.types import IntArray, NDArray

SHOWN_CARRIER_HZ = SPARSE_TEST_HZ  # which both of the paper's protocols test
_POWER_COLOURS, _ERROR_COLOURS = "magma", "viridis"
_HIGHEST = np.float32(255)  # level


@dataclass(frozen=True)
class Case:
    """One test sample: `best`, `median` or `worst` of its method, its scores, and the names of its three pictures."""

    place: str
    tx_position_m: list[float]
    carrier_ghz: float
    ssim: float
    psnr: float
    truth: str
    predicted: str
    error: str


@dataclass(frozen=True)
class Gallery:
    """Cases of each method of a board on one split.

    `pictures` are PNG files in base64 by name. `missing` says which methods have no pictures, and the command that
    stores what is missing.
    """

    split: str
    cases: dict[str, list[Case]] = field(default_factory=dict)
    pictures: dict[str, str] = field(default_factory=dict)
    missing: str = ""

    def content(self) -> dict[str, Any]:
        """The gallery as the page's script reads it."""
        return asdict(self) | {"split": short_name(self.split)}


def gallery(board: Board, folders: Sequence[ResultsFolder], shipped: Mapping[str, ShownMaps] | None = None) -> Gallery:
    """Pictures of all rows but ablations, for the first seed of each, from the predictions in one of `folders`.

    Where these are not found, they are drawn from `shipped`, maps by the ids of records.
    """
    split, dataset = shown_split(board), open_data(board)
    stored = dozen_of(board, dataset, folders) if dataset else None
    found: dict[str, list[Case]] = {}
    pictures: dict[str, str] = {}
    absent: dict[str, RunRecord] = {}
    for label, record in shown_records(board, split).items():
        known = stored if stored and record.id in stored.predicted else (shipped or {}).get(record.id)
        if known is None:
            absent[label] = record
        else:
            found[label] = [*_cases(known, record.id, pictures)]
    missing = ""
    if absent:
        missing = _missing_predictions(board, absent) if dataset or found else _missing_data(board)
    return Gallery(split, found, pictures, missing)


def shown_records(board: Board, split: str) -> dict[str, RunRecord]:
    """The records whose maps are shown, by the labels of their rows: the first seed of all rows but ablations."""
    rows = [row for row in board.rows if split in row.by_split and row.family != "ablation"]
    return {row.short_label: row.by_split[split][0] for row in rows}


def dozen_of(board: Board, dataset: PasDataset, folders: Sequence[ResultsFolder]) -> ShownMaps | None:
    """The maps of a dozen samples of the shown split, of all shown records whose predictions are stored; else None.

    The samples are chosen by how easy they are for the trivial predictors, if these were run.
    """
    split = shown_split(board)
    records = list(shown_records(board, split).values())
    trivial = [row.by_split[split][0] for row in board.rows if row.is_trivial and split in row.by_split]

    def choose(rows: IntArray) -> IntArray:
        return rows[chosen_samples(trivial or records, len(rows))]

    return stored_maps(dataset, records, folders, choose)


def stored_maps(
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
    if not known:
        return None
    rows = choose(next(iter(known.values())).rows)
    return shown_maps(dataset, records[0].job.split, rows, known) if len(rows) else None


def shown_split(board: Board) -> str:
    """The split that tests 24.25 GHz; the middle one where several do, and the middle one of all where none does."""
    tested = {record.job.split: record.scores["ssim"].median_by_carrier_hz for record in board.records}
    chosen = [split for split in board.splits if f"{SHOWN_CARRIER_HZ:.0f}" in tested[split]] or board.splits
    return chosen[len(chosen) // 2]


def scales() -> dict[str, str]:
    """The colour bars of `power` and `error`, from low to high, as PNG files in base64."""
    from xfreqbench.report.drawing.figures import map_png

    ramp = np.linspace(0, 1, 64, dtype=np.float32)[None]
    bars = {"power": _POWER_COLOURS, "error": _ERROR_COLOURS}
    return {name: b64encode(map_png(ramp, colours)).decode() for name, colours in bars.items()}


def open_data(board: Board) -> PasDataset | None:
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


def _cases(shown: ShownMaps, record_id: str, pictures: dict[str, str]) -> Iterable[Case]:
    run = shown.predicted[record_id]
    truth, predicted = shown.true_levels() / _HIGHEST, shown.levels_of(record_id) / _HIGHEST
    if truth.shape != predicted.shape:
        raise DataError(f"Maps to be shown of record {record_id} have another shape than the true ones.")
    order = np.argsort(-np.asarray(run.ssim), kind="stable").tolist()
    chosen = {"best": order[0], "median": order[len(order) // 2], "worst": order[-1]}
    for place, index in chosen.items():
        names = _draw(truth[index], predicted[index], pictures)
        yield Case(
            place,
            tx_position_m=np.round(shown.tx_position_m[index], 2).tolist(),
            carrier_ghz=shown.carrier_hz[index] / 1e9,
            ssim=run.ssim[index],
            psnr=run.psnr[index],
            truth=names[0],
            predicted=names[1],
            error=names[2],
        )


def _draw(
    truth: Float[NDArray[np.float32], "E A"], predicted: Float[NDArray[np.float32], "E A"], pictures: dict[str, str]
) -> list[str]:
    """Draw levels of truth and prediction, and their error, into `pictures`; returns the names, which are hashes."""
    from xfreqbench.report.drawing.figures import map_png

    power = [np.where(level > 0, 10 ** ((level - 1) * RANGE_DB / 10), 0) for level in (truth, predicted)]
    drawn = [(truth, _POWER_COLOURS), (predicted, _POWER_COLOURS), (np.abs(power[1] - power[0]) / 0.3, _ERROR_COLOURS)]
    names = []
    for values, colours in drawn:
        png = map_png(values, colours)
        names.append(hashlib.sha256(png).hexdigest()[:12])
        pictures[names[-1]] = b64encode(png).decode()
    return names


def _missing_data(board: Board) -> str:
    path = board.records[0].job.dataset
    made = f"xfreqbench generate {board.scene} -o {path}" if "solver" in board.settings else "xfreqbench import"
    return f"No pictures: {path}, {board.data_name}, is not here. `{made}` makes it."


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
