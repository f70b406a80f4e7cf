"""Stored predictions turned into the scores of a record: one way, whoever made the predictions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.dataset import IntArray, PasDataset
from xfreqbench.errors import DataError
from xfreqbench.metrics import METRICS_VERSION, bootstrap_interval, quantiles, score_all
from xfreqbench.predictions import read_predictions
from xfreqbench.protocols import Split
from xfreqbench.records import NUM_QUANTILES, RECORDS_FILE, RunRecord, Summary, read

PREDICTIONS_FOLDER = "predictions"  # beside the records, a file a record
BATCH_SIZE = 32  # maps held at once
_BOOTSTRAP_SEED = 0
_SSIM_DECIMALS = 4


def predictions_path(results_dir: Path, record_id: str) -> Path:
    """Where the predictions behind a record are."""
    return results_dir / PREDICTIONS_FOLDER / f"{record_id}.h5"


def stored_record(results_dir: Path, record_id: str) -> RunRecord | None:
    """The latest record of an id; None where it or its predictions are not there. Raises `DataError`."""
    if not predictions_path(results_dir, record_id).exists():
        return None
    known = read(results_dir / RECORDS_FILE).records
    return next((record for record in reversed(known) if record.id == record_id), None)


def scored_fields(dataset: PasDataset, split: Split, predictions: Path) -> dict[str, Any]:
    """Fields of a `RunRecord` that data set, split and stored predictions determine, scores among them.

    Raises `DataError` where the predictions are damaged or another split's.
    """
    scores, test = _stored_scores(dataset, split, predictions), dataset.subset(split.test)
    return {
        "dataset_sha256": dataset.sha256,
        "scene": dataset.header.scene_name,
        "pas_kind": dataset.header.pas_kind,
        "settings": dict(dataset.header.settings),
        "split_sha256": split.sha256,
        "protocol_version": split.version,
        "metrics_version": METRICS_VERSION,
        "num_test": len(split.test),
        "num_without_path": split.num_without_path,
        "shares_transmitters": split.shares_transmitters,
        "nearest_trained_m": split.nearest_trained_m,
        "scores": {name: _summary(each, test.tx_index, test.carrier_hz) for name, each in scores.items()},
        "ssim_by_tx": _by_transmitter(scores["ssim"], test.tx_index),
    }


def median(values: Float[FloatArray, "N"]) -> float:
    """Of one metric's scores."""
    return float(np.median(values))


def _stored_scores(dataset: PasDataset, split: Split, path: Path) -> dict[str, Float[FloatArray, "N"]]:
    """Every metric of every test sample, from the predictions as they are stored."""
    predictions = read_predictions(path)
    if predictions.split_sha256 != split.sha256 or not np.array_equal(predictions.rows, split.test):
        raise DataError(f"{path} holds predictions of another split. Delete it and run again.")
    batches = [
        score_all(maps, dataset.pas(rows), dataset.grid, dataset.header.pas_kind)
        for rows, maps in predictions.batches(BATCH_SIZE)
    ]
    return {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}


def _by_transmitter(
    values: Float[FloatArray, "N"], tx_index: Int[IntArray, "N"]
) -> tuple[tuple[float, ...], ...]:
    """Values of each transmitter, in the order of their indices; `tx_index` ascends, as rows do."""
    starts = np.flatnonzero(np.diff(tx_index)) + 1
    return tuple(tuple(part.tolist()) for part in np.split(values.round(_SSIM_DECIMALS), starts))


def _summary(
    values: Float[FloatArray, "N"], tx_index: Int[NDArray[np.int64], "N"], carrier_hz: Float[FloatArray, "N"]
) -> Summary:
    return Summary(
        mean=float(values.mean()),
        median=median(values),
        p10=float(quantiles(values, [0.1])[0]),
        interval=bootstrap_interval(values, tx_index, median, _BOOTSTRAP_SEED),
        quantiles=quantiles(values, np.linspace(0, 1, NUM_QUANTILES).tolist()).tolist(),
        median_by_carrier_hz={
            f"{carrier:.0f}": median(values[carrier_hz == carrier]) for carrier in np.unique(carrier_hz)
        },
    )
