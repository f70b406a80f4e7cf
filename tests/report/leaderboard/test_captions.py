from __future__ import annotations

from tests.support.leaderboard_records import leaderboard_markdown, make_records, rows_of
from tests.support.stored_records import SPLITS, external, make_record
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.report.leaderboard.report import leaderboard_summary


def test_samples_without_a_path_are_said_to_be_left_out() -> None:
    assert "100 test maps a split; 7 without any path" in leaderboard_markdown([make_record(num_without_path=7)])


def test_the_legend_names_window_floor_and_trivial_predictors() -> None:
    legend = leaderboard_markdown(make_records()).partition("## What the columns say")[2]
    for words in ("7×7 uniform window", "−40 dB", *EVERY_TRIVIAL):
        assert words in legend


def test_a_board_says_its_maps_its_rays_and_whose_times_these_are() -> None:
    markdown = leaderboard_markdown(make_records())
    assert (
        "Data set `office@1-aaaaaaaa`: power maps, image solver, specular, depth 1; 100 test maps a split. **Tested"
        in markdown
    )
    assert "** Times were taken on AMD EPYC, 2 cores. Commit ?; seed 0." in markdown


def test_scores_of_transmitters_that_were_trained_on_are_said_to_tell_nothing_of_unseen_places() -> None:
    leak = "Tested transmitters are trained on at other carriers: these scores say nothing about unseen places."
    assert leak in leaderboard_markdown([make_record(nearest_trained_m=0.0)])
    assert leak not in leaderboard_markdown([make_record(shares_transmitters=False)])


def test_unseen_transmitters_come_with_their_distance_to_the_nearest_trained_one() -> None:
    unseen = make_record(shares_transmitters=False, nearest_trained_m=0.2)
    other = make_record(split="lofo-77GHz", shares_transmitters=False, nearest_trained_m=0.3)
    start = "No tested transmitter is trained on at any carrier"
    assert f"{start}; the nearest trained one is 0.20 m away (median).**" in leaderboard_markdown([unseen])
    assert "is 0.20 m to 0.30 m away" in leaderboard_markdown([unseen, other])
    assert f"{start}.**" in leaderboard_markdown([make_record(shares_transmitters=False)])


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
    assert "External rows" not in leaderboard_markdown(make_records())


def test_a_missing_rank_or_skill_and_an_extrapolated_target_are_explained_below_the_table() -> None:
    band = {"trained_band_hz": (1e9, 10e9)}
    records = [make_record("nearest", **band), make_record("ours", **band)]
    summary = leaderboard_summary(records)
    assert "Without a rank, which takes 3 seeds (--seeds 0,1,2): ours." in summary
    assert "were not run on the same splits: line-of-sight, mean-over-frequency, log-frequency." in summary
    assert "Extrapolated: 24.25GHz (trained on 1 to 10 GHz)." in summary
    inside = [make_record("nearest", trained_band_hz=(1e9, 77e9)), make_record("nearest", split=SPLITS[0])]
    assert "Extrapolated" not in leaderboard_summary(inside)
