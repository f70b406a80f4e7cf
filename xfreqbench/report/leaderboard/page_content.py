"""The numbers that the page's script draws charts from, ready for JSON; those of curves are rounded."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, nan
from typing import Any

import numpy as np

from xfreqbench.maps.metrics import METRICS
from xfreqbench.report.leaderboard.boards import Board, pooled_quantiles, short_name
from xfreqbench.report.leaderboard.columns import COSTS, metric_title
from xfreqbench.report.leaderboard.comparison import Comparison
from xfreqbench.report.leaderboard.gallery import Gallery
from xfreqbench.report.leaderboard.learning_curves import best_trivial
from xfreqbench.report.leaderboard.rows import BoardRow, median_ssim
from xfreqbench.runs.records import BenchRecord, RunRecord

Content = dict[str, Any]
CHART_COSTS = ("seconds", "milliseconds", "parameters")  # against which the page draws accuracy
_DIGITS = 4


def board_content(comparisons: Sequence[Comparison], pictures: Gallery) -> Content:
    """A board's curves and pictures, and the averages of its rows in each comparison, one for each set of splits."""
    board = comparisons[0].board
    return {
        "slug": board.slug,
        "title": board.title,
        "splits": {
            split: {"name": short_name(split), "trivial": _trivial_ssim(board, split)}
            for split in board.splits
        },
        "rows": {row.label: _row_content(row) for row in board.rows},
        "sets": [_set_content(each) for each in comparisons],
        "metrics": {name: metric_title(name) for name in METRICS},
        "gallery": pictures.content(),
    }


def ordered_labels(boards: Sequence[Board]) -> list[str]:
    """The labels of all rows, by which a method has the same colour on every board: ablations come last."""
    rows = {row.label: row for board in boards for row in board.rows}
    return sorted(rows, key=lambda label: (rows[label].family == "ablation", label))


def figure_content(bench: BenchRecord) -> Content | None:
    """The points of a measurement's figure; None where it has none."""
    return {"title": bench.title, **bench.figure.model_dump()} if bench.figure else None


def _trivial_ssim(board: Board, split: str) -> float:
    """Median SSIM of the best trivial predictor on the maps of the learning curves, nan where it is unknown."""
    trivial = best_trivial(board, split)
    return _rounded(trivial.ssim) if trivial else nan


def _row_content(row: BoardRow) -> Content:
    return {
        "family": row.family,
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
    """Pairs of a carrier in GHz and the median SSIM there, mean over the seeds."""
    medians = [record.scores["ssim"].median_by_carrier_hz for record in records]
    carriers = sorted(medians[0], key=float)
    return [
        [float(carrier) / 1e9, _rounded(float(np.mean([each.get(carrier, nan) for each in medians])))]
        for carrier in carriers
    ]


def _set_content(comparison: Comparison) -> Content:
    return {
        "splits": list(comparison.splits),
        "rows": {row.label: _standing(comparison, row) for row in comparison.rows},
    }


def _standing(comparison: Comparison, row: BoardRow) -> Content:
    splits = comparison.splits
    return {
        "ssim": _rounded(row.average(splits, median_ssim)),
        "interval": [_rounded(bound) for bound in comparison.interval(row)],
        "skill": _rounded(row.average(splits, comparison.board.skill)),
        **{name: row.average(splits, COSTS[name].quantity) for name in CHART_COSTS},
    }


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}") if isfinite(value) else value
