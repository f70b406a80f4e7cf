"""What one run's maps lack: the paths at planes that it did not find, or the gains of the paths at those it did.

Some of the tested transmitters are traced once more by the exact image method. Maps of their true paths, with some
paths left out, are scored in the same way as the predicted maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.maps.metrics import psnr, ssim
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.predictions import Predictions
from xfreqbench.runs.records import RunRecord
from xfreqbench.runs.scoring import BATCH_SIZE
from xfreqbench.scene.facets import Geometry
from xfreqbench.tracing.image.furnished import image_tracer
from xfreqbench.tracing.image.tracer import can_solve
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.tracing.waves import spherical_waves
from xfreqbench.types import FloatArray, IntArray, ProgressCallback

from .compared import ComparedFindings
from .true_paths import SELECTIONS, path_kinds

DRAW_SEED = 0


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of n maps, in the order of their rows."""

    ssim: Float[FloatArray, "n"]
    psnr: Float[FloatArray, "n"]


@dataclass(frozen=True, eq=False)
class ResidualPlan:
    """What is scored: `rows` of the data set, ascending, and stored predictions by label, the method's first."""

    compared: ComparedFindings
    settings: TraceSettings
    predictions: dict[str, Predictions]
    rows: Int[IntArray, "n"]


@dataclass(frozen=True, eq=False)
class Residual:
    """Scores by label, of what was predicted and of true paths with some left out; the method's come first.

    `share_not_found` is the share of the true power, at a row's carrier, that comes over edges or over paths which are
    not found.
    """

    compared: ComparedFindings
    scores: dict[str, Scores]
    samples: PasDataset
    share_not_found: Float[FloatArray, "n"]


def plan_residual(results: Path, compared: ComparedFindings, num_tx: int) -> ResidualPlan:
    """Draw `num_tx` of the tested transmitters, all where there are fewer, with all their tested rows.

    `results` is the record's folder, or its file of records. Raises `XFreqBenchError` for a number below 1, and
    `DataError` where predictions are missing or another split's, or where the image method cannot trace the scene.
    """
    if num_tx < 1:
        raise XFreqBenchError(f"--tx takes a number of transmitters from 1 on, but got {num_tx}.")
    settings = _settings_of(compared)
    folder = ResultsFolder.holding(results)
    record = compared.record
    predictions = {f"{record.job.method}, as predicted": folder.predictions(record)}
    if trivial := _best_trivial(record, folder):
        predictions[f"{trivial.job.method}, the best trivial predictor"] = folder.predictions(trivial)
    tested = next(iter(predictions.values())).rows
    for each in predictions.values():
        each.require_of(compared.dataset)
        if not np.array_equal(each.rows, tested):
            raise DataError(f"{each.path} holds other rows of {record.job.split}. Delete it and run again.")
    tx = tested // compared.dataset.num_carriers
    chosen = np.random.default_rng(DRAW_SEED).permutation(np.unique(tx))[:num_tx]
    return ResidualPlan(compared, settings, predictions, np.sort(tested[np.isin(tx, chosen)]))


def compute_residual(plan: ResidualPlan, tracing: ProgressCallback, scoring: ProgressCallback) -> Residual:
    """Trace the drawn transmitters, then score all maps; the callbacks get transmitters done and their number."""
    samples = plan.compared.dataset.subset(plan.rows)
    channels, share_not_found = _channels(plan, samples, tracing)
    stored = {label: each.maps_of(plan.rows, BATCH_SIZE) for label, each in plan.predictions.items()}
    labels = [*stored, *(selection.label for selection in SELECTIONS)]
    parts: dict[str, list[Scores]] = {label: [] for label in labels}
    for done, rows in enumerate(transmitters := rows_by_transmitter(samples), start=1):
        truth = samples.pas(rows)
        of_channels = channels[rows].reshape(-1, channels.shape[-1])
        derived = samples.beam.maps(of_channels, samples.header.pas_kind)[0]
        by_selection = derived.reshape(len(rows), len(SELECTIONS), *truth.shape[1:]).swapaxes(0, 1)
        maps = [*(each[rows] for each in stored.values()), *by_selection]
        for label, shown in zip(labels, maps, strict=True):
            parts[label].append(Scores(ssim(shown, truth, samples.grid), psnr(shown, truth, samples.grid)))
        scoring(done, len(transmitters))
    scores = {
        label: Scores(
            np.concatenate([part.ssim for part in own]), np.concatenate([part.psnr for part in own])
        )
        for label, own in parts.items()
    }
    return Residual(plan.compared, scores, samples, share_not_found)


def rows_by_transmitter(samples: PasDataset) -> list[Int[IntArray, "f"]]:
    """The places of each transmitter's rows among the samples, whose rows ascend."""
    starts = np.flatnonzero(np.diff(samples.tx_index)) + 1
    return np.split(np.arange(len(samples)), starts)


def _channels(
    plan: ResidualPlan, samples: PasDataset, progress: ProgressCallback
) -> tuple[Complex[NDArray[np.complex128], "n S M"], Float[FloatArray, "n"]]:
    """Channel of each row and selection, and each row's share of power over paths that are not found."""
    scene = samples.scene
    tracer = image_tracer(scene, samples.header.carrier_hz.tolist(), plan.settings)
    channels = np.zeros((len(samples), len(SELECTIONS), scene.receiver.num_elements), np.complex128)
    share = np.zeros(len(samples))
    for done, rows in enumerate(transmitters := rows_by_transmitter(samples), start=1):
        tx_m = samples.tx_position_m[rows[0]].astype(np.float64)
        paths = tracer.paths(tx_m)
        kinds = path_kinds(paths, tx_m, plan.compared.findings)
        kept = np.array([selection.keeps(kinds) for selection in SELECTIONS])
        for row, carrier in zip(rows, samples.rows[rows] % samples.num_carriers, strict=True):
            channels[row] = kept @ spherical_waves(paths, int(carrier), scene.receiver)
            power = np.abs(paths.gain[carrier]) ** 2
            is_left = kinds.is_diffracted | ~kinds.is_found
            share[row] = power[is_left].sum() / (power.sum() or 1.0)
        progress(done, len(transmitters))
    return channels, share


def _settings_of(compared: ComparedFindings) -> TraceSettings:
    """How the data set was traced; raises `DataError` where the image method cannot trace it so."""
    dataset = compared.dataset
    settings = dataset.trace_settings
    if not can_solve(Geometry(compared.meshes), settings):
        raise DataError(
            f"{dataset.path} was traced with {', '.join(settings.interactions)} to depth {settings.max_depth}, but "
            "exact paths are known for specular, refraction and diffraction among planar facets alone. Use a data set "
            "of `xfreqbench generate --solver image`."
        )
    return settings


def _best_trivial(record: RunRecord, folder: ResultsFolder) -> RunRecord | None:
    """The trivial predictor with the largest median SSIM on the same split, of those with stored predictions."""
    stored = [
        each
        for each in folder.records
        if each.job.method in EVERY_TRIVIAL
        and not each.job.overrides
        and each.external is None
        and (each.dataset_sha256, each.split_sha256) == (record.dataset_sha256, record.split_sha256)
        and folder.predictions_path(each.id).exists()
    ]
    by_score = sorted(stored, key=lambda each: each.scores["ssim"].median)
    return by_score[-1] if by_score else None
