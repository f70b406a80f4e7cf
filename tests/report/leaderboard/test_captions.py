from __future__ import annotations

import pytest

from tests.support.leaderboard_records import leaderboard_markdown, make_records, rows_of
from tests.support.stored_records import external, make_record
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.runs.records import Job

UNSEEN = make_record(shares_transmitters=False, nearest_trained_m=0.2)
FARTHER = make_record(split="lofo-77GHz", shares_transmitters=False, nearest_trained_m=0.3)
HERE, THERE = {"processor": "AMD EPYC", "cores": "2"}, {"processor": "AMD EPYC", "cores": "2", "gpu": "H100"}
LOW = [make_record(method, trained_band_hz=(1e9, 10e9)) for method in ("nearest", "ours")]


def test_the_legend_names_window_floor_and_trivial_predictors() -> None:
    legend = leaderboard_markdown(make_records()).partition("## What the columns say")[2]
    for words in ("7×7 uniform window", "−40 dB", *EVERY_TRIVIAL):
        assert words in legend


@pytest.mark.parametrize(
    ("records", "words"),
    [
        (make_records(), "`office@1-aaaaaaaa`: power maps, image solver, specular, depth 1; 100 test maps a split."),
        (make_records(), "Times were taken on AMD EPYC, 2 cores. Commit ?; seed 0."),
        ([make_record(num_without_path=7)], "100 test maps a split; 7 without any path"),
        ([make_record(nearest_trained_m=0.0)], "these scores say nothing about unseen places"),
        ([UNSEEN], "No tested transmitter is trained on at any carrier; the nearest trained one is 0.20 m away"),
        ([UNSEEN, FARTHER], "is 0.20 m to 0.30 m away"),
        (LOW, "Without a rank, which takes 3 seeds (--seeds 0,1,2): ours."),
        (LOW, "not run on the same splits: line-of-sight, mean-over-frequency, log-frequency."),
        (LOW, "Extrapolated: 24.25GHz (trained on 1 to 10 GHz)."),
    ],
)
def test_a_report_says_what_a_number_is_of_and_what_is_missing(records: list, words: str) -> None:
    assert words in leaderboard_markdown(records)


def test_fits_that_had_their_seconds_on_another_machine_are_not_ranked_and_named() -> None:
    """A budget in maps is worth the same on every machine."""

    def ranks(budget: Budget) -> tuple[dict[str, str], str]:
        fits = [
            make_record(name, ssim, job=job, id=f"{name}{seed}", hardware=hardware, ssim_by_tx=[(ssim,)] * 4)
            for name, ssim, hardware in (("one", 0.7, HERE), ("other", 0.8, HERE), ("faster", 0.9, THERE))
            for seed in range(3)
            for job in [Job("data.h5", name, "lofo", "lofo-24.25GHz", seed=seed, budget=budget)]
        ]
        markdown = leaderboard_markdown(fits)
        return {name: rows_of(markdown, name)[0]["rank"] for name in ("one", "other", "faster")}, markdown

    of_time, markdown = ranks(Budget(max_seconds=60.0))
    assert of_time == {"one": "2", "other": "1", "faster": "other machine"}
    assert "as most fits had their seconds on AMD EPYC, 2 cores, and seconds of another machine" in markdown
    assert "hold more or fewer steps: faster." in markdown
    of_maps, markdown = ranks(Budget(max_maps=100))
    assert of_maps == {"one": "3", "other": "2", "faster": "1"}
    assert "hold more or fewer steps" not in markdown


def test_nothing_is_said_that_is_not_so() -> None:
    inside = leaderboard_markdown([UNSEEN, make_record("ours", trained_band_hz=(1e9, 77e9), shares_transmitters=False)])
    for words in ("Extrapolated", "External rows", "say nothing about unseen places", "without any path"):
        assert words not in inside


def test_external_rows_have_dashes_for_what_nobody_declares_and_a_note_whose_word_the_times_are() -> None:
    silent = external(method="silent")
    told = external(method="told", fit_seconds=9.0, external={"sha256": "b" * 64, "hardware": "8 × H200"})
    markdown = leaderboard_markdown([*make_records(), silent, told])
    unknown, declared = (rows_of(markdown, f"{name} (external)")[0] for name in ("silent", "told"))
    costs = ("fit s", "ms/map", "peak MiB", "parameters")
    assert [unknown[name] for name in costs] == ["–"] * 4
    assert declared["fit s"] == "9.00"
    assert "silent (external): hardware not declared; told (external): 8 × H200." in markdown
    assert "Times were taken on AMD EPYC, 2 cores." in markdown
