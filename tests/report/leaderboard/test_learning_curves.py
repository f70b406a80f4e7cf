from __future__ import annotations

import numpy as np
import pytest

from tests.support.leaderboard_records import leaderboard_markdown, make_followed, make_records, rows_of
from tests.support.stored_records import SPLITS, make_record
from xfreqbench.report.leaderboard.learning_curves import pareto_front


def test_a_learning_curve_stands_by_share_of_the_budget() -> None:
    markdown = leaderboard_markdown([make_followed(), make_record("nearest", 0.6, SPLITS[0])])
    assert list(
        rows_of(markdown.partition("on a fixed sample of 64 test maps")[2], "ours (≤ 64 steps)")[0].values()
    ) == [
        "ours (≤ 64 steps)",
        "2.4GHz",
        "0.5000 (0.10 s)",
        *["–"] * 2,
        "0.6000 (0.90 s)",
        *["–"] * 2,
        "0.7000 (6.4 s)",
        "–",  # without samples nobody knows where the trivial predictor stands on them
    ]
    assert "on a fixed sample" not in leaderboard_markdown(make_records())


@pytest.mark.parametrize(("trivial", "expected"), [(0.55, "0.90 s"), (0.6, "0.90 s"), (0.65, "6.4 s"), (0.75, "never")])
def test_a_fit_reaches_the_best_trivial_predictor_on_the_same_maps(trivial: float, expected: str) -> None:
    records = [make_record("nearest", trivial, SPLITS[0], ssim_by_tx=[(trivial,)] * 100)]
    records += [make_record("line-of-sight", 0.5, SPLITS[0], ssim_by_tx=[(0.5,)] * 100)]
    markdown = leaderboard_markdown([make_followed(), *records]).partition("### Error against time")[2]
    assert rows_of(markdown, "ours (≤ 64 steps)")[0]["best trivial reached after"] == expected


def test_a_point_stands_at_the_share_that_was_spent_and_not_at_a_mean_over_steps() -> None:
    """Points of batches that shrank later: by the mean number of maps of a step the first would lie before 1/64."""
    followed = make_followed()
    points = [point.model_copy(update={"share": 2 * point.step / 64}) for point in followed.curve[:-1]]
    shares = followed.model_copy(update={"curve": (*points, followed.curve[-1])})
    before, after = (
        list(rows_of(leaderboard_markdown([each]).partition("Error against time")[2], "ours (≤ 64 steps)")[0].values())
        for each in (followed, shares)
    )
    assert before[2:5] == ["0.5000 (0.10 s)", "–", "–"]
    assert after[2:5] == ["–", "0.5000 (0.10 s)", "–"]


def test_fits_whose_batches_differ_in_size_have_points_at_different_shares() -> None:
    followed = make_followed()
    larger = [point.model_copy(update={"share": min(1.0, 4 * point.step / 64)}) for point in followed.curve]
    other = make_followed(seed=1).model_copy(update={"curve": (*larger[1:-1], larger[-1])})
    markdown = leaderboard_markdown([followed, other]).partition("### Error against time")[2]
    assert list(rows_of(markdown, "ours (≤ 64 steps)")[0].values())[2:] == [*["–"] * 6, "0.7000 (6.4 s)", "–"]


def test_learning_curves_are_means_over_seeds_and_times_their_medians() -> None:
    trivial = make_record("nearest", 0.68, SPLITS[0], ssim_by_tx=[(0.68,)] * 100)
    followed = [make_followed(seed=seed, end=end) for seed, end in enumerate((0.67, 0.70, 0.73))]
    markdown = leaderboard_markdown([trivial, *followed]).partition("### Error against time")[2]
    row = rows_of(markdown, "ours (≤ 64 steps)")[0]
    assert (row["end"], row["best trivial reached after"]) == ("0.7000 (6.4 s)", "6.4 s")


def test_the_pareto_front_starts_with_the_best_trivial_predictor() -> None:
    trivial = make_record("nearest", 0.55, SPLITS[0], ssim_by_tx=[(0.55,)] * 100, fit_seconds=0.0)
    markdown = leaderboard_markdown([trivial, make_followed(), make_followed("slow", end=0.65)])
    assert "* 2.4GHz: nearest 0.5500 (0.00 s); ours (≤ 64 steps) 0.6000 (0.90 s), 0.7000 (6.4 s)." in markdown


def test_the_front_is_what_a_literal_search_finds() -> None:
    points = [tuple(pair) for pair in np.random.default_rng(0).integers(0, 30, size=(200, 2)).tolist()]
    literal = {(x, y) for x, y in points if not any((a <= x and b > y) or (a < x and b >= y) for a, b in points)}
    front = pareto_front(points, cost=lambda each: each[0], score=lambda each: each[1])
    assert set(front) == literal
    assert len(front) == len(literal) > 1
    assert front == sorted(front)


def test_nothing_has_no_front() -> None:
    assert pareto_front([], cost=float, score=float) == []
