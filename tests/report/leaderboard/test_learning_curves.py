from __future__ import annotations

from math import inf, isnan
from pathlib import Path

import numpy as np
import pytest

from tests.support.leaderboard_records import make_followed, make_records
from tests.support.stored_records import SPLITS, make_record
from xfreqbench.report.leaderboard import plots
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.figures import figures_of, pareto_front
from xfreqbench.report.leaderboard.tables import csv_tables

REACHED = "best trivial reached after s"


def curve_of(*records):
    """The rows of `ours` in the table of learning curves: share, seconds and SSIM of each; and when it beat trivial."""
    rows = [row for row in csv_tables(boards(records)).get("curves", []) if row["method"] == "ours (≤ 64 steps)"]
    return [(row["share"], row["seconds"], row["SSIM"]) for row in rows], [row[REACHED] for row in rows][-1:]


def test_a_learning_curve_stands_by_share_of_the_budget() -> None:
    points, (reached,) = curve_of(make_followed(), make_record("nearest", 0.6, SPLITS[0]))
    assert points == [(1 / 64, 0.1, 0.5), (1 / 8, 0.9, 0.6), (1, 6.4, 0.7)]
    assert isnan(reached)  # without samples nobody knows where the trivial predictor stands on them
    assert curve_of(*make_records()) == ([], [])


@pytest.mark.parametrize(("trivial", "expected"), [(0.55, 0.9), (0.6, 0.9), (0.65, 6.4), (0.75, inf)])
def test_a_fit_reaches_the_best_trivial_predictor_on_the_same_maps(trivial: float, expected: float) -> None:
    records = [make_record("nearest", trivial, SPLITS[0], ssim_by_tx=[(trivial,)] * 100)]
    records += [make_record("line-of-sight", 0.5, SPLITS[0], ssim_by_tx=[(0.5,)] * 100)]
    assert curve_of(make_followed(), *records)[1] == [expected]


def test_a_point_stands_at_the_share_that_was_spent_and_not_at_a_mean_over_steps() -> None:
    """Points of batches that shrank later: by the mean number of maps of a step the first would lie before 1/64."""
    followed = make_followed()
    points = [point.model_copy(update={"share": 2 * point.step / 64}) for point in followed.curve[:-1]]
    shares = followed.model_copy(update={"curve": (*points, followed.curve[-1])})
    assert [curve_of(each)[0][0] for each in (followed, shares)] == [(1 / 64, 0.1, 0.5), (1 / 32, 0.1, 0.5)]


def test_fits_whose_batches_differ_in_size_have_points_at_different_shares() -> None:
    followed = make_followed()
    larger = [point.model_copy(update={"share": min(1.0, 4 * point.step / 64)}) for point in followed.curve]
    other = make_followed(seed=1).model_copy(update={"curve": (*larger[1:-1], larger[-1])})
    assert curve_of(followed, other)[0] == [(1, 6.4, 0.7)]


def test_learning_curves_are_means_over_seeds_and_times_their_medians() -> None:
    trivial = make_record("nearest", 0.68, SPLITS[0], ssim_by_tx=[(0.68,)] * 100)
    followed = [make_followed(seed=seed, end=end) for seed, end in enumerate((0.67, 0.70, 0.73))]
    points, reached = curve_of(trivial, *followed)
    assert (points[-1], reached) == ((1, 6.4, 0.7), [6.4])


def test_the_figure_has_the_front_above_the_best_trivial_predictor(monkeypatch: pytest.MonkeyPatch) -> None:
    trivial = make_record("nearest", 0.55, SPLITS[0], ssim_by_tx=[(0.55,)] * 100, fit_seconds=0.0)
    ranked, drawn = boards([trivial, make_followed(), make_followed("slow", end=0.65)]), []
    monkeypatch.setattr(plots, "plot_error_against_time", lambda panels, path: drawn.append(panels))
    for draw in figures_of(ranked, []).values():
        draw(Path("unused.svg"))
    ((lines, front, level),) = drawn[0].values()
    assert lines.keys() == {"ours (≤ 64 steps)", "slow (≤ 64 steps)"} and level == 0.55
    assert front == [(0.9, 0.6), (6.4, 0.7)]


def test_the_front_is_what_a_literal_search_finds() -> None:
    points = [tuple(pair) for pair in np.random.default_rng(0).integers(0, 30, size=(200, 2)).tolist()]
    literal = {(x, y) for x, y in points if not any((a <= x and b > y) or (a < x and b >= y) for a, b in points)}
    front = pareto_front(points, cost=lambda each: each[0], score=lambda each: each[1])
    assert set(front) == literal
    assert len(front) == len(literal) > 1
    assert front == sorted(front)
