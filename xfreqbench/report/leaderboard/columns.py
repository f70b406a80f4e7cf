"""The columns of a leaderboard, defined once; `tables` shows them in Markdown, `page` on a web page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import isnan, nan

from xfreqbench.data.recipe import recipe_name
from xfreqbench.maps.metrics import METRICS
from xfreqbench.report.drawing.markdown import ABSENT
from xfreqbench.report.leaderboard.boards import BoardRow, short_name
from xfreqbench.report.leaderboard.comparison import UNKNOWN, Comparison, Interval
from xfreqbench.runs.records import RunRecord
from xfreqbench.units import band_text

# A cost of a method: its title, what it is, the format of its numbers, and its number in a record, None where unknown.
COSTS: dict[str, tuple[str, str, str, Callable[[RunRecord], float | None]]] = {
    "steps": ("steps", "steps of fitting", ",.0f", lambda record: record.step if record.step > 1 else None),
    "maps": ("maps seen", "training maps that all steps have shown", ",.0f", lambda record: record.counts.get("maps")),
    "seconds": ("fit s", "seconds of fitting", ".2f", lambda record: record.fit_seconds),
    "milliseconds": ("ms/map", "milliseconds per predicted map", ".2f", lambda record: record.predict_ms_per_map),
    "memory": ("peak MiB", "largest memory of the process", ".0f", lambda record: record.peak_memory_mib),
    "parameters": ("parameters", "trained parameters", ",.0f", lambda record: record.parameters),
    "gaussians": ("Gaussians", "Gaussians after fitting", ",.0f", lambda record: record.counts.get("gaussians")),
}
OTHER_METRICS = tuple(name for name in METRICS if name != "ssim")
BRIEF = ("rank", "method", "origin", "splits", "average", "skill", "seconds")


@dataclass(frozen=True)
class Column:
    """One column: its title, a hint that explains it, and the cell of each row.

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
    is_board_order: bool = False  # whether rows are sorted by this column at first

    def text(self, row: BoardRow) -> str:
        """The cell of a row without the interval."""
        return self.words(row) if self.words else self._number(self.value(row) if self.value else nan)

    def interval(self, row: BoardRow) -> str:
        """The 95 % interval as text, `[low, high]` or empty."""
        low, high = self.bounds(row)
        return "" if isnan(low) else f"[{self._number(low)}, {self._number(high)}]"

    def cell(self, row: BoardRow) -> str:
        """The text, followed by the interval if that is known."""
        return f"{self.text(row)} {self.interval(row)}".strip()

    def elsewhere(self, scene: str, rows: Sequence[BoardRow]) -> Column:
        """The column for rows of another board, of what rows of the same label have in this one's scene."""
        title, cells = f"{scene}: {self.title}", {row.short_label: self.cell(row) for row in rows}
        return replace(
            self, title=title, words=lambda row: cells.get(row.short_label, ABSENT), bounds=lambda row: UNKNOWN
        )

    def _number(self, value: float) -> str:
        """A number, a dash where it is unknown, ∞ where it is infinite, as the PSNR of a perfect map is."""
        return ABSENT if isnan(value) else f"{value:{self.form}}".replace("inf", "∞")


def cost_of(record: RunRecord, name: str) -> float:
    """One of `COSTS` of a record, nan where it is unknown."""
    value = COSTS[name][-1](record)
    return nan if value is None else value


def metric_title(name: str) -> str:
    """Title of a metric with its unit: `AoA error (°)`."""
    titles = {"ssim": "SSIM", "ssim_wrapped": "wrapped SSIM", "psnr": "PSNR", "aoa_error": "AoA error"}
    unit = METRICS[name].unit
    return titles.get(name, name.replace("_", " ")) + (f" ({unit})" if unit else "")


def columns(comparison: Comparison, names: Sequence[str]) -> list[Column]:
    """Columns of a comparison by name: those of `METRICS` and `COSTS`, and the others below.

    `splits` is a column of each split where there are several. Columns that no record of the board has a number for
    are left out.
    """
    board, splits = comparison.board, comparison.splits

    def average(quantity: Callable[[RunRecord], float]) -> Callable[[BoardRow], float]:
        return lambda row: row.average(splits, quantity)

    def place(end: int) -> Callable[[BoardRow], float]:
        return lambda row: (comparison.ranks(row) or (nan, nan))[end]

    def of_ssim(title: str, hint: str, value: Callable[[BoardRow], float]) -> Column:
        return Column(title, hint, value, ".4f", is_largest_first=True)

    def of_metric(name: str) -> Column:
        hint = f"median, mean over splits and seeds: {METRICS[name].description}"
        form = {"ssim_wrapped": ".4f", "beam_loss": ".3f"}.get(name, ".2f")
        value = average(lambda record: record.scores[name].median if name in record.scores else nan)
        return Column(metric_title(name), hint, value, form, is_largest_first=METRICS[name].higher_is_better)

    def of_cost(name: str) -> Column:
        title, hint, form, _ = COSTS[name]
        return Column(title, f"{hint}, mean over splits and seeds", average(lambda each: cost_of(each, name)), form)

    def origins(row: BoardRow) -> str:
        of_row = set(map(board.origin, row.records))
        return " ".join(label for origin, label in board.origins.items() if origin in of_row)

    ssim = replace(
        of_ssim(
            metric_title("ssim"),
            "median SSIM, mean over splits and seeds, and its 95 % interval",
            lambda row: row.average(splits),
        ),
        bounds=comparison.interval,
    )
    every = {
        "rank": Column(
            "rank",
            "places that the intervals leave open, or why there is no rank",
            lambda row: place(0)(row) + place(1)(row) / 1e4,  # by the best place, then by the worst
            words=lambda row: comparison.unranked(row) or _span(comparison.ranks(row)),
        ),
        "best rank": Column("best rank", "best place that the intervals leave open", place(0), ".0f"),
        "worst rank": Column("worst rank", "worst place that the intervals leave open", place(1), ".0f"),
        "method": Column("method", "with what differs from a plain run", None, words=lambda row: row.short_label),
        "whose": Column("whose", "ours, or of others: see below", None, words=lambda row: row.whose),
        "origin": Column("origin", "machine, code and data, told below the table", None, words=origins),
        "ssim": ssim,
        "average": replace(ssim, title="average" if len(splits) > 1 else short_name(splits[0]), is_board_order=True),
        "mean": of_ssim(
            "mean", "mean SSIM over the test maps, splits and seeds", average(lambda each: each.scores["ssim"].mean)
        ),
        "p10": of_ssim(
            "10th pct.",
            "SSIM that a tenth of the test maps lies below, mean over splits and seeds",
            average(lambda record: record.scores["ssim"].p10),
        ),
        "skill": Column(
            "skill",
            "share of the best baseline's error that is removed, and its 95 % interval",
            average(board.skill),
            ".3f",
            bounds=comparison.skill_interval,
            is_largest_first=True,
        ),
        "seed spread": Column(
            "± seeds", "standard deviation of the average over the seeds", lambda row: row.seed_spread(splits), ".4f"
        ),
        "seeds": Column(
            "seeds",
            "runs of each split",
            lambda row: float(row.num_seeds(splits)[0]),
            words=lambda row: _span(row.num_seeds(splits)),
            is_largest_first=True,
        ),
        "trained on": Column(
            "trained on", "data, carriers and transmitters", None, words=lambda row: _trained_on(row, splits)
        ),
    }
    found: list[Column] = []
    for name in names:
        if name == "splits":
            for split in splits if len(splits) > 1 else ():
                hint, value = f"median SSIM of {split}, mean over the seeds", partial(BoardRow.average, splits=[split])
                found.append(of_ssim(short_name(split), hint, value))
        elif name in COSTS:
            found += [of_cost(name)] if any(not isnan(cost_of(record, name)) for record in board.records) else []
        elif name in every:
            found += [every[name]] if name != "origin" or board.origins else []
        else:
            found += [of_metric(name)] if any(name in record.scores for record in board.records) else []
    return found


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
