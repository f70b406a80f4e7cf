"""Scores of stored predictions, in the same way whether a run here made them or they come from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import Split
from xfreqbench.errors import DataError
from xfreqbench.maps.metrics import METRICS_VERSION, quantiles, score_all
from xfreqbench.runs.predictions import read_predictions
from xfreqbench.runs.records import NUM_QUANTILES, Summary
from xfreqbench.types import FloatArray, IntArray

BATCH_SIZE = 32  # maps that are in memory at a time
_SSIM_DECIMALS = 4


def scored_fields(dataset: PasDataset, split: Split, predictions: Path) -> dict[str, Any]:
    """Score the file `predictions`: the fields of a `RunRecord` that depend on data set, split and predictions alone.

    Raises `DataError` if the predictions are damaged or of another split.
    """
    scores, test = _stored_scores(dataset, split, predictions), dataset.subset(split.test)
    return {
        "dataset_sha256": dataset.sha256,
        "recipe": dataset.recipe.id,
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
        "scores": {name: _summary(each, test.carrier_hz) for name, each in scores.items()},
        "ssim_by_tx": _by_transmitter(scores["ssim"], test.tx_index),
    }


def median(values: Float[FloatArray, "N"]) -> float:
    """Median of scores, as a Python number."""
    return float(np.median(values))


def _stored_scores(dataset: PasDataset, split: Split, path: Path) -> dict[str, Float[FloatArray, "N"]]:
    """The score of every test sample, (N,), by the name of the metric; computed from the predictions as stored."""
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
    """Values, rounded, in one tuple for each transmitter; `tx_index` ascends, as rows do."""
    starts = np.flatnonzero(np.diff(tx_index)) + 1
    return tuple(tuple(part.tolist()) for part in np.split(values.round(_SSIM_DECIMALS), starts))


def _summary(values: Float[FloatArray, "N"], carrier_hz: Float[FloatArray, "N"]) -> Summary:
    return Summary(
        mean=float(values.mean()),
        median=median(values),
        p10=float(quantiles(values, [0.1])[0]),
        quantiles=quantiles(values, np.linspace(0, 1, NUM_QUANTILES).tolist()).tolist(),
        median_by_carrier_hz={
            f"{carrier:.0f}": median(values[carrier_hz == carrier]) for carrier in np.unique(carrier_hz)
        },
    )
