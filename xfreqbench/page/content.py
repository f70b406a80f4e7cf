"""What the page's charts are drawn from, as JSON: numbers of the records, rounded to what a line shows."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, nan
from typing import Any

import numpy as np

from xfreqbench.boards import Board, Row, family, median_ssim, or_nan, pooled_quantiles, short_name
from xfreqbench.comparison import Comparison
from xfreqbench.learning_curves import best_trivial
from xfreqbench.metrics import METRICS
from xfreqbench.page.gallery import Gallery
from xfreqbench.records import BenchRecord, RunRecord

Content = dict[str, Any]
_DIGITS = 4


def board_content(comparisons: Sequence[Comparison], pictures: Gallery) -> Content:
    """A board's curves, and for each set of splits where its rows stand; `comparisons` has one a set."""
    board = comparisons[0].board
    return {
        "title": board.title,
        "splits": {split: _split_content(board, split) for split in board.splits},
        "rows": {row.label: _row_content(row) for row in board.rows},
        "sets": [_set_content(each) for each in comparisons],
        "metrics": {name: _metric_label(name) for name in METRICS},
        "gallery": pictures.content(),
    }


def figure_content(bench: BenchRecord) -> Content | None:
    """A measurement's points; None where it has no figure."""
    return {"title": bench.title, **bench.figure.model_dump()} if bench.figure else None


def _split_content(board: Board, split: str) -> Content:
    trivial = best_trivial(board, split)  # on the maps that learning curves are taken on
    return {"name": short_name(split), "trivial": _rounded(trivial.ssim if trivial else nan)}


def _row_content(row: Row) -> Content:
    return {
        "family": family(row),
        "splits": {split: _curves(records) for split, records in row.by_split.items()},
    }


def _curves(records: Sequence[RunRecord]) -> Content:
    return {
        "cdf": {
            name: [_rounded(each) for each in pooled_quantiles(records, name)] for name in records[0].scores
        },
        "carriers": _by_carrier(records),
        "curve": [[_rounded(point.seconds), _rounded(point.ssim)] for point in records[0].curve],
    }


def _by_carrier(records: Sequence[RunRecord]) -> list[list[float]]:
    """Carriers in GHz and the median SSIM there, mean over the seeds."""
    medians = [record.scores["ssim"].median_by_carrier_hz for record in records]
    carriers = sorted(medians[0], key=float)
    return [
        [float(carrier) / 1e9, _rounded(float(np.mean([each[carrier] for each in medians])))]
        for carrier in carriers
    ]


def _set_content(comparison: Comparison) -> Content:
    return {
        "splits": list(comparison.splits),
        "rows": {row.label: _standing(comparison, row) for row in comparison.rows},
    }


def _standing(comparison: Comparison, row: Row) -> Content:
    splits = comparison.splits
    return {
        "ssim": _rounded(row.average(splits, median_ssim)),
        "interval": [_rounded(bound) for bound in comparison.interval(row)],
        "skill": _rounded(row.average(splits, comparison.board.skill)),
        "seconds": _rounded(row.average(splits, lambda record: or_nan(record.fit_seconds))),
        "milliseconds": _rounded(row.average(splits, lambda record: or_nan(record.predict_ms_per_map))),
        "parameters": row.average(splits, lambda record: or_nan(record.parameters)),
    }


def _metric_label(name: str) -> str:
    metric = METRICS[name]
    title = {"ssim": "SSIM", "ssim_wrapped": "SSIM, azimuth periodic", "psnr": "PSNR"}
    return title.get(name, name.replace("_", " ").replace("aoa", "AoA")) + (
        f" ({metric.unit})" if metric.unit else ""
    )


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}") if isfinite(value) else value
