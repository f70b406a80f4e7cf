"""Scores of stored predictions, in the same way whether a run here made them or they come from elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Num
from pydantic import InstanceOf, SkipValidation

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.hdf5 import packed, unpacked
from xfreqbench.data.recipe import micrometres
from xfreqbench.data.splits import Split, cell_m
from xfreqbench.errors import ArgumentError, DataError
from xfreqbench.maps.metrics import METRICS_VERSION, quantiles, score_all
from xfreqbench.runs.predictions import MapBatch, fault_of_maps, read_predictions
from xfreqbench.runs.records import NUM_QUANTILES, Job, RunRecord, Summary, made_here
from xfreqbench.system.arguments import checked
from xfreqbench.types import FloatArray, IntArray, NDArray

BATCH_SIZE = 32  # maps that are in memory at a time


def record_of(record_id: str, job: Job, scored: Mapping[str, Any], outcome: Mapping[str, Any]) -> RunRecord:
    """The record of a job, made here and now, of `scored_on_split` or `scored_in_rooms` and of what its fit was.

    Both are fields of `RunRecord` by their names.
    """
    return RunRecord(id=record_id, job=job, metrics_version=METRICS_VERSION, **{**made_here(), **scored, **outcome})


def scored_on_split(dataset: PasDataset, split: Split, predictions: Path) -> dict[str, Any]:
    """What a record holds of a split and of the scores of its stored maps, which are computed here.

    Raises `DataError` if the predictions are damaged or of another split.
    """
    stored, test = read_predictions(predictions), dataset[split.test]
    if stored.split_sha256 != split.sha256 or not np.array_equal(stored.rows, split.test):
        raise DataError(f"{predictions} holds predictions of another split. Delete it and run again.")
    scores = _scores(dataset, stored.batches(BATCH_SIZE))
    return {
        "dataset_sha256": dataset.sha256,
        "recipe": dataset.recipe.id,
        "scene": dataset.header.scene_name,
        "pas_kind": dataset.header.pas_kind,
        "settings": dict(dataset.header.settings),
        "split_sha256": split.sha256,
        "protocol_version": split.version,
        "num_test": len(split.test),
        "num_without_path": split.num_without_path,
        "shares_transmitters": split.shares_transmitters,
        "nearest_trained_m": split.nearest_trained_m,
        "trained_band_hz": split.trained_band_hz(dataset),
        **summaries(scores, test.carrier_hz, test.tx_index),
        "cell_of_tx": cells(test.tx_position_m[np.diff(test.tx_index, prepend=-1) > 0], cell_m(dataset)),
    }


def cells(position_m: Float[FloatArray, "T 3"], side_m: float) -> tuple[int, ...]:
    """The number of the square of the floor in which each position lies, whatever its height."""
    square = micrometres(position_m)[:, :2] // max(1, round(side_m * 1e6))
    return tuple(np.unique(square, axis=0, return_inverse=True)[1].ravel().tolist())


@checked
def score(
    maps: SkipValidation[Num[NDArray[Any], "N E A"]], split: InstanceOf[Split], dataset: InstanceOf[PasDataset]
) -> dict[str, Float[FloatArray, "N"]]:
    """Scores (N,) of maps that were predicted for the N test samples of a split, by the name of the metric.

    `maps` (N, E, A) are in the order of `split.test`, on the grid of `dataset`, the whole data set that was split:
    numbers in [0, 1], peak 1. A map that is zero everywhere is scored as it is. Maps are rounded to 1/65280
    first, as those of `run` are stored, so that the scores are those that a run would have. Nothing is stored.

    Raises `ArgumentError` for maps of another shape, and for one that is no map.
    """
    try:
        asked, rows = np.asarray(maps), split.test
    except ValueError as error:  # lists of different lengths
        raise ArgumentError(f"The maps to score are one array of numbers (N, E, A), but {error}.") from error
    shape = (len(rows), *dataset.grid.shape)
    if rows[-1] >= len(dataset):
        raise ArgumentError(
            f"Split {split.name!r} has sample {rows[-1]}, but the data set has {len(dataset)} samples. Give the whole "
            "data set that was split."
        )
    if asked.shape != shape or asked.dtype.kind not in "fiu":
        raise ArgumentError(
            f"The maps to score are numbers of shape {shape}, one map for each test sample of {split.name!r}, but got "
            f"{asked.dtype} of shape {asked.shape}."
        )
    if fault := fault_of_maps(asked):
        raise ArgumentError(f"The map of row {rows[fault[0]]} (number {fault[0]}) {fault[1]}")
    starts = range(0, len(rows), BATCH_SIZE)
    parts = (slice(n, n + BATCH_SIZE) for n in starts)
    return _scores(dataset, ((rows[part], unpacked(packed(asked[part]))) for part in parts))


def median(values: Float[FloatArray, "N"]) -> float:
    """Median of scores, as a Python number."""
    return float(np.median(values))


def _scores(dataset: PasDataset, predicted: Iterable[MapBatch]) -> dict[str, Float[FloatArray, "N"]]:
    """The score of every predicted map, (N,), by the name of the metric, from batches of rows and maps."""
    batches = [score_all(maps, dataset.pas(rows), dataset.grid, dataset.header.pas_kind) for rows, maps in predicted]
    return {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}


def summaries(
    scores: Mapping[str, Float[FloatArray, "N"]], carrier_hz: Float[FloatArray, "N"], group: Int[IntArray, "N"]
) -> dict[str, Any]:
    """The fields `scores` and `ssim_by_tx` of a record, of the scores of N samples by the name of the metric.

    `group` is the number of each sample's transmitter, or of its room; it ascends, as rows do.
    """
    parts = np.split(scores["ssim"].round(4), np.flatnonzero(np.diff(group)) + 1)
    return {
        "scores": {name: _summary(values, carrier_hz) for name, values in scores.items()},
        "ssim_by_tx": tuple(tuple(part.tolist()) for part in parts),
    }


def _summary(values: Float[FloatArray, "N"], carrier_hz: Float[FloatArray, "N"]) -> Summary:
    """What a record holds of the scores of N samples by one metric."""
    return Summary(
        mean=float(values.mean()),
        median=median(values),
        p10=float(quantiles(values, [0.1])[0]),
        quantiles=quantiles(values, np.linspace(0, 1, NUM_QUANTILES).tolist()).tolist(),
        median_by_carrier_hz={
            f"{carrier:.0f}": median(values[carrier_hz == carrier]) for carrier in np.unique(carrier_hz)
        },
    )
