"""Traces learned rooms at tested rows of their run, and scores the maps beside those that the method predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from xfreqbench.data.splits import find_split
from xfreqbench.errors import DataError
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.virtual_source.surfaces import RoomSurface
from xfreqbench.methods.virtual_source.traced import channels_in
from xfreqbench.report.findings.compared import ComparedFindings
from xfreqbench.report.findings.residual import DRAW_SEED
from xfreqbench.report.findings.room import settings_in_room
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.scoring import BATCH_SIZE
from xfreqbench.types import FloatArray

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
        cfr = channels_in(room, samples, settings_in_room(samples))
        maps = samples.beam.maps(cfr, samples.header.pas_kind)[0]
        scores[label] = ssim(maps, truth, samples.grid)
    return scores


def score_rows(scores: Mapping[str, Float[FloatArray, "n"]]) -> list[tuple[str, ...]]:
    """Cells under `HEADER`, a row for each label."""
    return [
        (label, f"{np.median(each):.4f}", f"{each.mean():.4f}", str(len(each)))
        for label, each in scores.items()
    ]
