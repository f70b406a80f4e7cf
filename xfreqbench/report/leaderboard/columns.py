"""The columns of a leaderboard, defined once; `tables` shows them in Markdown, `page` on a web page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
    by its texts. `bounds` are those of the 95 % interval, nan where it is unknown, and `interval` is the same as text,
    `[low, high]` or empty.
    """

    title: str
    hint: str
    text: Callable[[BoardRow], str]
    value: Callable[[BoardRow], float] | None = None
    bounds: Callable[[BoardRow], Interval] = lambda row: UNKNOWN
    interval: Callable[[BoardRow], str] = lambda row: ""
    is_largest_first: bool = False  # in what order the first click sorts
    is_board_order: bool = False  # whether rows stand sorted by this column at first


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
PAGE = (
    *("method", "average", "skill", "rank", "splits", "p10", "seeds"),
    *("psnr", "power_error", "aoa_error", "beam_loss"),
    *("seconds", "milliseconds", "memory", "parameters", "origin", "trained on"),
)


def leaderboard_columns(comparison: Comparison, names: Sequence[str]) -> list[LeaderboardColumn]:
    """Columns of a comparison by name, such as those of `RANKING`, `BRIEF`, `TABLE`, `PAIR` or `PAGE`.

    `splits` stands for a column of each split where there are several. Columns that no record of the board has a
    number for are left out.
    """
    every = (
        _place_columns(comparison)
        | _ssim_columns(comparison)
        | {name: [_metric_column(comparison.splits, name)] for name in _OTHER_METRICS}
        | {name: _cost_columns(comparison, cost) for name, cost in COSTS.items()}
    )
    return [column for name in names for column in every[name]]


def metric_title(name: str) -> str:
    """Title of a metric with its unit: `AoA error (°)`."""
    unit = METRICS[name].unit
    return _METRIC_TITLES[name][0] + (f" ({unit})" if unit else "")


def _place_columns(comparison: Comparison) -> dict[str, list[LeaderboardColumn]]:
    splits = comparison.splits

    def rank_text(row: BoardRow) -> str:
        places = comparison.ranks(row)
        return span(places) if places else ABSENT

    def rank_value(row: BoardRow) -> float:
        best, worst = comparison.ranks(row) or (nan, nan)
        return best + worst / 1e4  # by the best place, then by the worst

    rank = LeaderboardColumn("rank", "places that the intervals leave open", rank_text, rank_value)
    method = LeaderboardColumn("method", "with what differs from a plain run", lambda row: row.short_label)
    seeds = LeaderboardColumn(
        "seeds",
        "runs of each split",
        lambda row: span(row.num_seeds(splits)),
        lambda row: float(row.num_seeds(splits)[0]),
        is_largest_first=True,
    )
    origins = comparison.board.origins

    def origin_text(row: BoardRow) -> str:
        of_row = {origins[comparison.board.origin(record)] for record in row.records}
        return " ".join(label for label in origins.values() if label in of_row)

    trained = LeaderboardColumn("trained on", "data, carriers and transmitters", lambda row: trained_on(row, splits))
    origin = LeaderboardColumn("origin", "machine, code and data, told below the table", origin_text)
    return {
        "rank": [rank],
        "best rank": [_place_column(comparison, 0)],
        "worst rank": [_place_column(comparison, 1)],
        "method": [method],
        "seeds": [seeds],
        "origin": [origin] if origins else [],
        "trained on": [trained],
    }


def _place_column(comparison: Comparison, end: Literal[0, 1]) -> LeaderboardColumn:
    word = ("best", "worst")[end]
    hint = f"{word} place that the intervals leave open"
    return _number_column(f"{word} rank", hint, lambda row: (comparison.ranks(row) or (nan, nan))[end], ".0f")


def _ssim_columns(comparison: Comparison) -> dict[str, list[LeaderboardColumn]]:
    splits = comparison.splits
    ssim = _number_column(
        _METRIC_TITLES["ssim"][0],
        "median SSIM, mean over splits and seeds, and its 95 % interval",
        _average(splits, median_ssim),
        ".4f",
        interval=comparison.interval,
        is_largest_first=True,
    )
    several = splits if len(splits) > 1 else ()
    average = replace(ssim, title="average" if several else short_name(splits[0]), is_board_order=True)
    skill = _number_column(
        "skill",
        "share of what the best trivial predictor leaves open that is closed, and its 95 % interval",
        _average(splits, comparison.board.skill),
        ".3f",
        interval=comparison.skill_interval,
        is_largest_first=True,
    )
    return {
        "ssim": [ssim],
        "average": [average],
        "skill": [skill],
        "splits": [_split_column(split) for split in several],
        **_spread_columns(splits),
    }


def _split_column(split: str) -> LeaderboardColumn:
    hint = f"median SSIM of {split}, mean over the seeds"
    return _number_column(
        short_name(split), hint, lambda row: row.value(split, median_ssim), ".4f", is_largest_first=True
    )


def _spread_columns(splits: Sequence[str]) -> dict[str, list[LeaderboardColumn]]:
    """How SSIM is spread over seeds and over test maps."""
    seeds = _number_column(
        "± seeds",
        "standard deviation of the average over the seeds",
        lambda row: row.seed_spread(splits, median_ssim),
        ".4f",
    )
    mean = _number_column(
        "mean",
        "mean SSIM over the test maps, splits and seeds",
        _average(splits, lambda record: record.scores["ssim"].mean),
        ".4f",
        is_largest_first=True,
    )
    p10 = _number_column(
        "10th pct.",
        "SSIM that a tenth of the test maps lies below, mean over splits and seeds",
        _average(splits, lambda record: record.scores["ssim"].p10),
        ".4f",
        is_largest_first=True,
    )
    return {"seed spread": [seeds], "mean": [mean], "p10": [p10]}


def _metric_column(splits: Sequence[str], name: str) -> LeaderboardColumn:
    _, decimals = _METRIC_TITLES[name]
    return _number_column(
        metric_title(name),
        f"median, mean over splits and seeds: {METRICS[name].description}",
        _average(splits, lambda record: record.scores[name].median),
        f".{decimals}f",
        is_largest_first=METRICS[name].higher_is_better,
    )


def _cost_columns(comparison: Comparison, cost: Cost) -> list[LeaderboardColumn]:
    """The column of a cost; none where no record of the board has it."""
    if all(isnan(cost.quantity(record)) for record in comparison.board.records):
        return []
    hint = f"{cost.hint}, mean over splits and seeds"
    return [_number_column(cost.title, hint, _average(comparison.splits, cost.quantity), cost.form)]


def _average(splits: Sequence[str], quantity: Quantity) -> Callable[[BoardRow], float]:
    return lambda row: row.average(splits, quantity)


def _number_column(
    title: str,
    hint: str,
    value: Callable[[BoardRow], float],
    form: str,
    *,
    interval: Callable[[BoardRow], Interval] = lambda row: UNKNOWN,
    is_largest_first: bool = False,
) -> LeaderboardColumn:
    def interval_text(row: BoardRow) -> str:
        low, high = interval(row)
        return "" if isnan(low) else f"[{_number(low, form)}, {_number(high, form)}]"

    return LeaderboardColumn(
        title,
        hint,
        lambda row: _number(value(row), form),
        value,
        interval,
        interval_text,
        is_largest_first=is_largest_first,
    )


def _number(value: float, form: str) -> str:
    """A number, a dash where it is unknown, ∞ where it is infinite, as the PSNR of a perfect map is."""
    if isnan(value):
        return ABSENT
    return ("∞" if value > 0 else "-∞") if isinf(value) else f"{value:{form}}"


def trained_on(row: BoardRow, splits: Sequence[str]) -> str:
    """Data, band and transmitters of a row's training: `office@2-3f9c2ab1, 1–94 GHz, tested transmitters too`."""
    records = [record for split in splits for record in row.by_split[split]]
    bands = [record.trained_band_hz for record in records if record.trained_band_hz]
    band = band_text(min(low for low, _ in bands), max(high for _, high in bands)) if bands else ""
    shared = any(record.shares_transmitters for record in records)
    transmitters = "tested transmitters at other carriers or samples" if shared else "other transmitters"
    return ", ".join(filter(None, [recipe_name(records[0].scene, records[0].recipe), band, transmitters]))


def span(numbers: tuple[int, int]) -> str:
    """A range as text, `2–4`, or one number where both ends are equal."""
    low, high = numbers
    return str(low) if low == high else f"{low}–{high}"
