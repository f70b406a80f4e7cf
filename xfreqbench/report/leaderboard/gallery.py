"""Pictures of the best, the median and the worst predicted map of each method, from stored predictions."""

from __future__ import annotations

import hashlib
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.protocols import SPARSE_TEST_HZ, VALIDATIONS
from xfreqbench.errors import DataError
from xfreqbench.maps.bartlett import power_of
from xfreqbench.maps.metrics import Maps, score_all
from xfreqbench.report.drawing.figures import map_png
from xfreqbench.report.leaderboard.boards import Board, short_name
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.predictions import Predictions
from xfreqbench.runs.records import RunRecord
from xfreqbench.runs.scoring import BATCH_SIZE
from xfreqbench.types import FloatArray

SHOWN_CARRIER_HZ = SPARSE_TEST_HZ  # which both of the paper's protocols test
RANGE_DB = 30.0
LARGEST_ERROR = 0.3
_STRIDE = 2  # the array's beam is 26° wide: two degrees show it
_POWER_COLOURS, _ERROR_COLOURS = "magma", "viridis"


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


def gallery(board: Board, folders: Sequence[ResultsFolder]) -> Gallery:
    """Pictures of all rows but ablations, for the first seed of each, from the predictions in one of `folders`."""
    split = shown_split(board)
    dataset = _open(board)
    if dataset is None:
        return Gallery(split, missing=_missing_data(board))
    found: dict[str, list[Case]] = {}
    pictures: dict[str, str] = {}
    absent = []
    for row in board.rows:
        if split not in row.by_split or row.family == "ablation":
            continue
        record = row.by_split[split][0]
        predictions = _predictions(folders, record, dataset)
        if predictions is None or sum(map(len, record.ssim_by_tx)) != len(predictions.rows):
            absent.append(row.label)
        else:
            found[row.label] = [*_cases(dataset, record, predictions, pictures)]
    return Gallery(split, found, pictures, _missing_predictions(board, absent) if absent else "")


def shown_split(board: Board) -> str:
    """The split that tests 24.25 GHz; the middle one where several do, and the middle one of all where none does."""
    tested = {record.job.split: record.scores["ssim"].median_by_carrier_hz for record in board.records}
    chosen = [split for split in board.splits if f"{SHOWN_CARRIER_HZ:.0f}" in tested[split]] or board.splits
    return chosen[len(chosen) // 2]


def scales() -> dict[str, str]:
    """The colour bars of `power` and `error`, from low to high, as PNG files in base64."""
    ramp = np.linspace(0, 1, 64, dtype=np.float32)[None]
    bars = {"power": _POWER_COLOURS, "error": _ERROR_COLOURS}
    return {name: b64encode(map_png(ramp, colours)).decode() for name, colours in bars.items()}


def _open(board: Board) -> PasDataset | None:
    """The board's data set, from the first path in its records where it still is; None where it is at none."""
    for path in dict.fromkeys(record.job.dataset for record in board.records):
        try:
            dataset = open_dataset(path)
        except DataError:
            continue
        if board.is_of(dataset):
            return dataset
    return None


def _predictions(
    folders: Sequence[ResultsFolder], record: RunRecord, dataset: PasDataset
) -> Predictions | None:
    """The predictions of a record; None where they are absent, damaged or of another split in every folder."""
    for folder in folders:
        try:
            predictions = folder.predictions(record)
            predictions.require_of(dataset)
        except DataError:
            continue
        return predictions
    return None


def _cases(
    dataset: PasDataset, record: RunRecord, predictions: Predictions, pictures: dict[str, str]
) -> Iterable[Case]:
    chosen = _chosen(np.concatenate([np.asarray(ssim) for ssim in record.ssim_by_tx]))
    rows = predictions.rows[list(chosen.values())]
    predicted, truth = predictions.maps_of(rows, BATCH_SIZE), dataset.pas(rows)
    scores = score_all(predicted, truth, dataset.grid, dataset.header.pas_kind)
    samples = dataset.subset(rows)
    for index, place in enumerate(chosen):
        names = _draw(truth[index], predicted[index], dataset, pictures)
        yield Case(
            place,
            tx_position_m=samples.tx_position_m[index].round(2).tolist(),
            carrier_ghz=samples.carrier_hz[index].item() / 1e9,
            ssim=round(scores["ssim"][index].item(), 4),
            psnr=round(scores["psnr"][index].item(), 4),
            truth=names[0],
            predicted=names[1],
            error=names[2],
        )


def _chosen(ssim: Float[FloatArray, "N"]) -> dict[str, int]:
    """Positions of the best, the median and the worst among N scores."""
    order = np.argsort(-ssim, kind="stable").tolist()
    return {"best": order[0], "median": order[len(order) // 2], "worst": order[-1]}


def _draw(
    truth: Float[Maps, "E A"], predicted: Float[Maps, "E A"], dataset: PasDataset, pictures: dict[str, str]
) -> list[str]:
    """Draw truth, prediction and error into `pictures`, and return the names of the three, which are hashes."""
    levels = [_level(pas_map, dataset) for pas_map in (truth, predicted)]
    drawn = [*((level, _POWER_COLOURS) for level in levels)]
    drawn.append((np.abs(predicted - truth) / LARGEST_ERROR, _ERROR_COLOURS))
    upwards = np.argsort(-dataset.grid.elevation_rad)[::_STRIDE]  # the pole is the upper edge
    names = []
    for values, colours in drawn:
        png = map_png(values[upwards, ::_STRIDE], colours)
        names.append(hashlib.sha256(png).hexdigest()[:12])
        pictures[names[-1]] = b64encode(png).decode()
    return names


def _level(pas_map: Float[Maps, "E A"], dataset: PasDataset) -> NDArray[np.float32]:
    """The power of a map in dB, scaled: 0 at 30 dB below the peak or less, 1 at the peak."""
    power = power_of(pas_map[None], dataset.header.pas_kind)[0]
    return 1 + 10 * np.log10(np.maximum(power, np.float32(10 ** (-RANGE_DB / 10)))) / np.float32(RANGE_DB)


def _missing_data(board: Board) -> str:
    path = board.records[0].job.dataset
    made = (
        f"xfreqbench generate {board.scene} -o {path}" if "solver" in board.settings else "xfreqbench import"
    )
    return f"No pictures: {path}, {board.data_name}, is not here. `{made}` makes it."


def _missing_predictions(board: Board, absent: list[str]) -> str:
    job = board.records[0].job
    on = " --on validation" if job.protocol in VALIDATIONS else ""
    protocol = VALIDATIONS.get(job.protocol, job.protocol)
    command = f"xfreqbench run --data {job.dataset} --protocol {protocol}{on} --results FOLDER"
    return f"Without stored predictions: {', '.join(absent)}. `{command}` stores them."
