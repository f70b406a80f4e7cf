"""What the columns of a report say, in words."""

from __future__ import annotations

from collections.abc import Sequence

from xfreqbench.maps.metrics import METRICS, NUM_RESAMPLES
from xfreqbench.methods.trivial import EVERY_TRIVIAL, NEEDED_TRIVIAL
from xfreqbench.report.leaderboard.columns import COSTS, metric_title
from xfreqbench.report.leaderboard.comparison import MIN_SEEDS
from xfreqbench.report.leaderboard.published import PUBLISHED_TITLE

_EXPLAINED_COSTS = ("seconds", "milliseconds", "memory", "parameters")
_OF_ALL_TRIVIAL = f"1 − (1 − SSIM) / (1 − SSIM of the best of {', '.join(EVERY_TRIVIAL)} on the same split)"
LEADERBOARD_TERMS = {
    "skill": f"{_OF_ALL_TRIVIAL}; negative where a method is worse than that predictor, a dash unless the first "
    f"{len(NEEDED_TRIVIAL)} of them were run; the others count where they were. Every resample finds the best anew",
    "[low, high]": f"95 % percentile interval of {NUM_RESAMPLES:,} bootstrap resamples, which draw "
    "transmitters with all their samples, the same ones for every method (paired), and seeds, whose deviations "
    "are widened as Student's t asks for their number. Of a hundred pairs of equally good methods, five may "
    "still be told apart",
    "rank": "best and worst place that the intervals of the differences leave open; not corrected for the "
    f"number of comparisons. A dash: fewer than {MIN_SEEDS} seeds, so not ranked (a trivial predictor has no seed)",
}
_OTHER_TERMS = {
    "seeds**, **± seeds": "fits of each split, over which every number is a mean, and the standard deviation of the "
    "average over them",
    "best trivial reached after": "time of the first point of the learning curve at which the SSIM is that of "
    "the best trivial predictor or higher; the fit may have reached it earlier",
    **{COSTS[name].title: f"{COSTS[name].hint}, mean over splits and seeds" for name in _EXPLAINED_COSTS},
    PUBLISHED_TITLE: "median SSIM from the paper named below the table, of other data and another machine; not "
    "comparable",
}


def legend() -> str:
    """The section that explains every column of a report."""
    metrics = {metric_title(name): metric.description for name, metric in METRICS.items()}
    means = {
        "mean**, **10th pct.": "mean SSIM of the test maps, and the SSIM that a tenth of them lies below"
    }
    return _section(metrics | means | LEADERBOARD_TERMS | _OTHER_TERMS)


def short_legend() -> str:
    """The section that explains the columns of a short leaderboard."""
    metrics = {metric_title(name): METRICS[name].description for name in ("ssim", "aoa_error")}
    return _section(metrics | LEADERBOARD_TERMS)


def _section(terms: dict[str, str]) -> str:
    lines: Sequence[str] = [f"* **{name}**: {words}" for name, words in terms.items()]
    return "\n".join(["## What the columns say", "", *lines])
