"""The columns of a leaderboard, defined once; `tables` shows them in Markdown, `page` on a web page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import isinf, isnan, nan
from typing import Literal

from xfreqbench.data.recipe import recipe_name
from xfreqbench.maps.metrics import METRICS
from xfreqbench.report.drawing.markdown import ABSENT
from xfreqbench.report.leaderboard.boards import or_nan, short_name
from xfreqbench.report.leaderboard.comparison import UNKNOWN, Comparison, Interval
from xfreqbench.report.leaderboard.rows import BoardRow, Quantity, median_ssim
from xfreqbench.units import band_text


@dataclass(frozen=True)
class LeaderboardColumn:
    """One column: its title, a hint that explains it, and what stands in the cell of a row.

    `value` is the number that rows are sorted by, nan where it is unknown; a column of words has none and is sorted
    by its texts. A text is the number in a `form`, or `words`. `bounds` are those of the 95 % interval, nan where it
    is unknown.
    """

    title: str
    hint: str
    value: Callable[[BoardRow], float] | None
    form: str = ""
    words: Callable[[BoardRow], str] | None = None
    bounds: Callable[[BoardRow], Interval] = lambda row: UNKNOWN
    is_largest_first: bool = False  # in what order the first click sorts
    is_board_order: bool = False  # whether rows stand sorted by this column at first

    def text(self, row: BoardRow) -> str:
        """What stands in the cell of a row, without the interval."""
        if self.words:
            return self.words(row)
        return _number(self.value(row) if self.value else nan, self.form)

    def interval(self, row: BoardRow) -> str:
        """The 95 % interval as text, `[low, high]` or empty."""
        low, high = self.bounds(row)
        return "" if isnan(low) else f"[{_number(low, self.form)}, {_number(high, self.form)}]"

    def cell(self, row: BoardRow) -> str:
        """The text, followed by the interval if that is known."""
        return f"{self.text(row)} {self.interval(row)}".strip()


@dataclass(frozen=True)
class Cost:
    """One cost of a method, where a record has it, and the format of its numbers."""

    title: str
    hint: str
    quantity: Quantity
    form: str


_METRIC_TITLES = {  # with the number of decimals
    "ssim": ("SSIM", 4),
    "ssim_wrapped": ("wrapped SSIM", 4),
    "psnr": ("PSNR", 2),
    "power_error": ("power error", 2),
    "aoa_error": ("AoA error", 2),
    "beam_loss": ("beam loss", 3),
}
COSTS = {
    "steps": Cost("steps", "steps of fitting", lambda record: record.step if record.step > 1 else nan, ",.0f"),
    "maps": Cost(
        "maps seen", "training maps that all steps have shown", lambda record: record.counts.get("maps", nan), ",.0f"
    ),
    "seconds": Cost("fit s", "seconds of fitting", lambda record: or_nan(record.fit_seconds), ".2f"),
    "milliseconds": Cost(
        "ms/map", "milliseconds per predicted map", lambda record: or_nan(record.predict_ms_per_map), ".2f"
    ),
    "memory": Cost("peak MiB", "largest memory of the process", lambda record: or_nan(record.peak_memory_mib), ".0f"),
    "parameters": Cost("parameters", "trained parameters", lambda record: or_nan(record.parameters), ",.0f"),
    "gaussians": Cost(
        "Gaussians", "Gaussians after fitting", lambda record: record.counts.get("gaussians", nan), ",.0f"
    ),
}

_OTHER_METRICS = tuple(name for name in METRICS if name != "ssim")
BRIEF = ("rank", "method", "origin", "splits", "average", "skill", "seconds")
RANKING = (*BRIEF[:5], "seed spread", "skill", "aoa_error", "seeds", *COSTS)
OVERVIEW = (*BRIEF[:-1], "aoa_error", BRIEF[-1])
TABLE = (
    *("best rank", "worst rank", "method", "origin", "ssim", "mean", "p10", *_OTHER_METRICS),
    *("skill", "seed spread", "seeds", *COSTS, "trained on"),
)
PAIR = (*_OTHER_METRICS, *COSTS)
OTHER_SCORES = ("method", "mean", "p10", *_OTHER_METRICS)
PAGE = ("rank", "method", "average", "skill", "splits", "aoa_error", "seconds", "milliseconds")
PAGE_MORE = (  # which the page shows when it is asked to
    *("seeds", "p10", "psnr", "power_error", "beam_loss"),
    *("memory", "parameters", "origin", "trained on"),
)


def leaderboard_columns(comparison: Comparison, names: Sequence[str]) -> list[LeaderboardColumn]:
    """Columns of a comparison by name, such as those of `RANKING`, `BRIEF`, `TABLE`, `PAIR`, `PAGE` or `PAGE_MORE`.

    `splits` stands for a column of each split where there are several. Columns that no record of the board has a
    number for are left out.
    """
    every = _columns(comparison)
    return [column for name in names for column in every[name]]


def metric_title(name: str) -> str:
    """Title of a metric with its unit: `AoA error (°)`."""
    unit = METRICS[name].unit
    return _METRIC_TITLES[name][0] + (f" ({unit})" if unit else "")


def _columns(comparison: Comparison) -> dict[str, list[LeaderboardColumn]]:
    board, splits = comparison.board, comparison.splits

    def average(quantity: Quantity) -> Callable[[BoardRow], float]:
        return lambda row: row.average(splits, quantity)

    def place(end: Literal[0, 1]) -> Callable[[BoardRow], float]:
        return lambda row: (comparison.ranks(row) or (nan, nan))[end]

    def origin_text(row: BoardRow) -> str:
        of_row = {board.origins[board.origin(record)] for record in row.records}
        return " ".join(label for label in board.origins.values() if label in of_row)

    ssim = LeaderboardColumn(
        _METRIC_TITLES["ssim"][0],
        "median SSIM, mean over splits and seeds, and its 95 % interval",
        average(median_ssim),
        ".4f",
        bounds=comparison.interval,
        is_largest_first=True,
    )
    several = splits if len(splits) > 1 else ()
    found = [
        LeaderboardColumn(
            "rank",
            "places that the intervals leave open, or why there is no rank",
            lambda row: place(0)(row) + place(1)(row) / 1e4,  # by the best place, then by the worst
            words=lambda row: comparison.unranked(row) or _span(comparison.ranks(row)),
        ),
        LeaderboardColumn("best rank", "best place that the intervals leave open", place(0), ".0f"),
        LeaderboardColumn("worst rank", "worst place that the intervals leave open", place(1), ".0f"),
        LeaderboardColumn("method", "with what differs from a plain run", None, words=lambda row: row.short_label),
        LeaderboardColumn(
            "seeds",
            "runs of each split",
            lambda row: float(row.num_seeds(splits)[0]),
            words=lambda row: _span(row.num_seeds(splits)),
            is_largest_first=True,
        ),
        LeaderboardColumn(
            "trained on", "data, carriers and transmitters", None, words=lambda row: _trained_on(row, splits)
        ),
        LeaderboardColumn(
            "skill",
            "share of what the best trivial predictor leaves open that is closed, and its 95 % interval",
            average(board.skill),
            ".3f",
            bounds=comparison.skill_interval,
            is_largest_first=True,
        ),
        LeaderboardColumn(
            "mean",
            "mean SSIM over the test maps, splits and seeds",
            average(lambda record: record.scores["ssim"].mean),
            ".4f",
            is_largest_first=True,
        ),
    ]
    origin = LeaderboardColumn("origin", "machine, code and data, told below the table", None, words=origin_text)
    return {column.title: [column] for column in found} | {
        "ssim": [ssim],
        "average": [replace(ssim, title="average" if several else short_name(splits[0]), is_board_order=True)],
        "splits": [
            LeaderboardColumn(
                short_name(split),
                f"median SSIM of {split}, mean over the seeds",
                partial(BoardRow.value, split=split, quantity=median_ssim),
                ".4f",
                is_largest_first=True,
            )
            for split in several
        ],
        "seed spread": [
            LeaderboardColumn(
                "± seeds",
                "standard deviation of the average over the seeds",
                lambda row: row.seed_spread(splits, median_ssim),
                ".4f",
            )
        ],
        "p10": [
            LeaderboardColumn(
                "10th pct.",
                "SSIM that a tenth of the test maps lies below, mean over splits and seeds",
                average(lambda record: record.scores["ssim"].p10),
                ".4f",
                is_largest_first=True,
            )
        ],
        "origin": [origin] if board.origins else [],
        **{name: [_metric_column(name, average)] for name in _OTHER_METRICS},
        **{
            name: [
                LeaderboardColumn(
                    cost.title, f"{cost.hint}, mean over splits and seeds", average(cost.quantity), cost.form
                )
            ]
            if any(not isnan(cost.quantity(record)) for record in board.records)
            else []
            for name, cost in COSTS.items()
        },
    }


def _metric_column(name: str, average: Callable[[Quantity], Callable[[BoardRow], float]]) -> LeaderboardColumn:
    return LeaderboardColumn(
        metric_title(name),
        f"median, mean over splits and seeds: {METRICS[name].description}",
        average(lambda record: record.scores[name].median),
        f".{_METRIC_TITLES[name][1]}f",
        is_largest_first=METRICS[name].higher_is_better,
    )


def _number(value: float, form: str) -> str:
    """A number, a dash where it is unknown, ∞ where it is infinite, as the PSNR of a perfect map is."""
    if isnan(value):
        return ABSENT
    return ("∞" if value > 0 else "-∞") if isinf(value) else f"{value:{form}}"


def _trained_on(row: BoardRow, splits: Sequence[str]) -> str:
    """Data, band and transmitters of a row's training: `office@2-3f9c2ab1, 1–94 GHz, tested transmitters too`."""
    records = [record for split in splits for record in row.by_split[split]]
    bands = [record.trained_band_hz for record in records if record.trained_band_hz]
    band = band_text(min(low for low, _ in bands), max(high for _, high in bands)) if bands else ""
    shared = any(record.shares_transmitters for record in records)
    transmitters = "tested transmitters at other carriers or samples" if shared else "other transmitters"
    return ", ".join(filter(None, [recipe_name(records[0].scene, records[0].recipe), band, transmitters]))


def _span(numbers: tuple[int, int] | None) -> str:
    """A range as text, `2–4`, one number where both ends are equal, a dash for None."""
    return "–".join(map(str, dict.fromkeys(numbers))) if numbers else ABSENT
