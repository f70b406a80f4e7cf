"""What stands around the tables of boards, and whose records they are of: those of several people share a board."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import xfreqbench as xb
from tests.support.leaderboard_records import leaderboard_markdown, make_records, rows_of, with_job
from tests.support.places import ROOT
from tests.support.stored_records import SPLITS, external, make_record, store
from xfreqbench.data.recipe import Recipe
from xfreqbench.errors import DataError
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.trivial import EVERY_TRIVIAL, NEEDED_TRIVIAL
from xfreqbench.report.leaderboard.boards import boards, machine_name
from xfreqbench.report.leaderboard.results import read_results
from xfreqbench.report.leaderboard.side_by_side import compare_results
from xfreqbench.runs.benchmark import Benchmark
from xfreqbench.runs.folder import read_records
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


RECIPE = "1-" + "3f9c2ab1" * 8
OTHER = {
    "dataset_sha256": "c" * 64,
    "hardware": {"processor": "Intel Xeon", "cores": "16"},
    "git_commit": "beef" * 10,
    "time_utc": "2026-02-01T00:00:00+00:00",
}


def ours(method="ours", ssim=0.9, split=SPLITS[0], **changes):
    return make_record(method, ssim, split, **{"recipe": RECIPE, "code_sha256": "e" * 64, **changes})


def theirs(method="ours", ssim=0.8, split=SPLITS[0], **changes):
    return ours(method, ssim, split, **{**OTHER, **changes})


def test_a_machine_that_used_fewer_threads_than_it_has_cores_says_so() -> None:
    here = {"processor": "AMD EPYC", "cores": "2", "system": "Linux x86_64"}
    assert machine_name(here) == "AMD EPYC, 2 cores, Linux x86_64"
    assert machine_name({**here, "threads": "1"}) == "AMD EPYC, 2 cores, Linux x86_64, 1 thread"


def test_data_of_one_recipe_are_one_board_whatever_their_bytes() -> None:
    (board,) = boards([ours(), theirs("other method")])
    assert board.data_name == "office@1-3f9c2ab1"
    assert board.slug == "office-lofo-1-3f9c2ab1"
    assert {row.label for row in board.rows} == {"ours", "other method"}
    assert len(boards([ours(), theirs(recipe="1-" + "0" * 64)])) == 2
    assert len(boards([ours(), theirs(scene="two_rooms")])) == 2


def test_each_row_says_which_machine_and_code_made_it_where_there_are_several() -> None:
    markdown = leaderboard_markdown([ours(), theirs("third"), *(ours(method) for method in NEEDED_TRIVIAL)])
    assert {rows_of(markdown, name)[0]["origin"] for name in ("ours", *NEEDED_TRIVIAL)} == {"m1"}
    assert rows_of(markdown, "third")[0]["origin"] == "m2"
    first, second = "AMD EPYC, 2 cores, data aaaaaaaa: m1", "Intel Xeon, 16 cores, data cccccccc: m2"
    told = f"Origins: {first} (commit ?); {second} (commit beefbee). Times compare on one machine alone."
    assert told in markdown
    alone = leaderboard_markdown([ours(), ours("third", git_commit="beef" * 10)])
    assert "origin" not in alone.partition("## What the columns say")[0]


def test_the_same_method_on_two_machines_is_two_rows_and_a_trivial_predictor_one() -> None:
    seeds = [with_job(ours(ssim=0.9), seed=seed) for seed in range(3)]
    again = [with_job(theirs(ssim=0.7, git_commit=None), seed=seed) for seed in range(3)]
    (board,) = boards([*seeds, *again, ours("nearest", 0.5), theirs("nearest", 0.6)])
    values = {row.label: row.average(SPLITS[:1]) for row in board.rows}
    assert values == pytest.approx({"ours (data aaaaaaa)": 0.9, "ours (data ccccccc)": 0.7, "nearest": 0.5})


def test_records_that_test_other_samples_are_refused_and_named() -> None:
    fewer = theirs("third", split_sha256="d" * 64, num_test=99)
    with pytest.raises(DataError, match=r"of office@1-3f9c2ab1 test other samples .* \(100 and 99\)"):
        boards([ours(), fewer])


def test_where_results_are_given_side_by_side_a_row_says_in_which_it_lies(tmp_path: Path) -> None:
    a, b = store(tmp_path / "reference", ours()), store(tmp_path / "alice", theirs("third"))
    (board,) = read_results([a, b]).boards
    assert [place for place, _ in board.origins] == [
        "AMD EPYC, 2 cores, data aaaaaaaa, from reference",
        "Intel Xeon, 16 cores, data cccccccc, from alice",
    ]
    (alone,) = read_results(store(tmp_path / "both", ours(), theirs("third"))).boards
    assert all("from" not in place for place, _ in alone.origins)
    same = store(tmp_path / "elsewhere", ours(), theirs("third"))
    named = read_results([same, b, a]).boards[0].origins
    assert all("from" not in place for place, _ in named)  # all of them lie in the first


def test_results_of_the_same_name_are_named_by_their_paths(tmp_path: Path) -> None:
    paths = store(tmp_path / "a" / "results", ours()), store(tmp_path / "b" / "results", theirs("third"))
    (board,) = read_results(paths).boards
    assert [place.partition("from ")[2] for place, _ in board.origins] == [path.as_posix() for path in paths]


def test_results_of_two_machines_are_compared_side_by_side(tmp_path: Path) -> None:
    a, b = store(tmp_path / "a", ours(ssim=0.9)), store(tmp_path / "b", theirs(ssim=0.8))
    assert "| 0.9000 | 0.8000 | -0.1000 |" in " ".join(compare_results(a, b).split())


def test_the_reference_records_are_of_the_data_that_the_standard_benchmark_generates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = {xb.load(f"office_cluttered_{solver}").recipe.id for solver in ("image", "sionna")}
    reference = [
        board
        for board in boards(read_records(ROOT / "baselines" / "reference_results.parquet"))
        if board.data not in shipped and not board.is_imported
    ]
    benchmark, scenes = Benchmark("standard", tmp_path, tmp_path), {board.scene for board in reference}
    assert {"office", "two_rooms"} <= scenes <= set(benchmark.scenes)
    monkeypatch.setattr(Benchmark, "scenes", scenes)  # others are not planned
    for scene, plan in benchmark.plans.items():
        data = {board.data for board in reference if board.scene == scene}
        versions = {name.partition("-")[0] for name in data}  # of the physics with which they were generated
        headers = [replace(plan.header, physics=version) for version in versions]
        asked = (plan.tx_position_m, AngularGrid.hemisphere())
        assert data <= {
            Recipe.of_scene(plan.tracing.scene, plan.tracing.settings, header, *asked).id for header in headers
        }
