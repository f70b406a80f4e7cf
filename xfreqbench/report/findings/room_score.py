"""Traces learned rooms at tested rows of their run, and scores the maps beside those that the method predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import find_split
from xfreqbench.errors import DataError
from xfreqbench.maps.metrics import ssim
from xfreqbench.report.findings.compared import ComparedFindings
from xfreqbench.report.findings.residual import DRAW_SEED
from xfreqbench.report.findings.room import RoomSurface
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.scoring import BATCH_SIZE
from xfreqbench.scene.facets import Geometry
from xfreqbench.tracing.image.furnished import image_tracer
from xfreqbench.types import FloatArray, IntArray

NUM_TESTED_TX = 60
HEADER = ("maps", "median SSIM", "mean SSIM", "tested rows")


def score_rooms(
    results: Path, compared: ComparedFindings, rooms: Mapping[str, Sequence[RoomSurface]]
) -> dict[str, Float[FloatArray, "n"]]:
    """SSIM of tested rows: of the stored predictions, where they are there, and of every room, traced as the data were.

    The rows are those of `NUM_TESTED_TX` transmitters, drawn at random, all where there are fewer.
    """
    dataset, record = compared.dataset, compared.record
    tested = find_split(dataset, record.job.protocol, record.job.split).test
    tx = tested // dataset.num_carriers
    chosen = np.random.default_rng(DRAW_SEED).permutation(np.unique(tx))[:NUM_TESTED_TX]
    rows = np.sort(tested[np.isin(tx, chosen)])
    samples = dataset.subset(rows)
    truth, scores = samples.pas(), {}
    try:
        predicted = ResultsFolder.holding(results).predictions(record).maps_of(rows, BATCH_SIZE)
        scores[f"{record.job.method}, as predicted"] = ssim(predicted, truth, samples.grid)
    except (DataError, KeyError):  # not kept, or of other rows
        pass
    for label, room in rooms.items():
        maps = samples.beam.maps(_channels(samples, room, rows), samples.header.pas_kind)[0]
        scores[label] = ssim(maps, truth, samples.grid)
    return scores


def score_rows(scores: Mapping[str, Float[FloatArray, "n"]]) -> list[tuple[str, ...]]:
    """Cells under `HEADER`, a row for each label."""
    return [
        (label, f"{np.median(each):.4f}", f"{each.mean():.4f}", str(len(each)))
        for label, each in scores.items()
    ]


def _channels(
    samples: PasDataset, room: Sequence[RoomSurface], rows: Int[IntArray, "n"]
) -> Complex[NDArray[np.complex128], "n M"]:
    """Channels (n, M) of the samples in a room; a material beyond its band is extrapolated."""
    settings = replace(samples.trace_settings, solver="image", materials="extrapolate")
    carriers = np.unique(samples.carrier_hz)
    geometry = Geometry([surface.mesh for surface in room])
    tracer = image_tracer(samples.scene, carriers.tolist(), settings, geometry=geometry)
    tx, of_tx = np.unique(rows // samples.num_carriers, return_inverse=True)
    cfr = tracer.channel(samples.tables["tx_position_m"][tx]).cfr
    return cfr[of_tx.reshape(-1), np.searchsorted(carriers, samples.carrier_hz)]
