from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_records import make_record

from xfreqbench.errors import DataError, OutputExistsError, StorageError
from xfreqbench.method import TRIVIAL, Budget
from xfreqbench.plots import plot_pas_maps
from xfreqbench.records import CurvePoint, append
from xfreqbench.report import BEGIN, END, boards, leaderboard_markdown, leaderboard_summary, write_report

SPLITS = ("lofo-2.4GHz", "lofo-24.25GHz", "lofo-77GHz")


def make_records():
    ssim = {
        "line-of-sight": 0.8,
        "nearest": 0.85,
        "mean-over-frequency": 0.9,
        "log-frequency": 0.88,
        "ours": 0.95,
    }
    return [make_record(method, value, split) for split in SPLITS for method, value in ssim.items()]


def cells(markdown, method, table=0):
    rows = [line for line in markdown.splitlines() if line.startswith(f"| {method} ")]
    return [cell.strip() for cell in rows[table].strip("|").split("|")]


def test_the_summary_ranks_by_average_ssim_and_gives_skill() -> None:
    markdown = leaderboard_markdown(make_records())
    assert cells(markdown, "ours") == [
        "ours",
        *["0.9500 [0.9400, 0.9600]"] * 3,
        "0.9500",
        "0.500",
        "0.50",
        "1.25",
        "200",
    ]
    order = [
        markdown.index(f"| {name} ") for name in ("ours", "mean-over-frequency", "nearest", "line-of-sight")
    ]
    assert order == sorted(order)


def test_a_row_that_loses_to_a_trivial_predictor_stands_with_its_negative_skill() -> None:
    markdown = leaderboard_markdown([*make_records()[:4], make_record("worse", 0.7, SPLITS[0])])
    assert cells(markdown, "worse", table=1)[2] == "-2.000"


def test_without_a_trivial_predictor_there_is_no_skill() -> None:
    markdown = leaderboard_markdown([make_record("ours", 0.95)])
    assert cells(markdown, "ours")[3] == "–"


def test_averages_are_over_the_same_splits_in_every_row_of_a_table() -> None:
    some = [make_record("partial", 0.97, split) for split in SPLITS[1::-1]]
    lucky = make_record("lucky", 0.99, SPLITS[0])
    markdown = leaderboard_markdown([*make_records(), *some, lucky])
    whole, shared, *of_splits = markdown.split("best average first:")[1:][:2] + markdown.split("### ")[1:]
    assert "| partial " not in whole and "| lucky " not in whole + shared.partition("###")[0]
    assert cells(shared, "partial")[1:4] == ["0.9700 [0.9600, 0.9800]"] * 2 + ["0.9700"]
    assert cells(shared, "ours")[3] == "0.9500"
    assert shared.index("| partial ") < shared.index("| ours ")
    assert "| lucky " in of_splits[0]


def test_the_order_in_which_splits_were_run_makes_no_table_of_its_own() -> None:
    later = [
        make_record("ours", 0.95, split).model_copy(update={"time_utc": f"2026-01-02T00:00:0{second}+00:00"})
        for second, split in enumerate(SPLITS[::-1])
    ]
    assert leaderboard_markdown([*make_records()[:4], *make_records()[5:], *later]).count("best average") == 1


def test_targets_stand_in_order_of_frequency() -> None:
    assert boards(make_records()[::-1])[0].splits == SPLITS


def test_the_order_of_records_does_not_matter() -> None:
    assert leaderboard_markdown(make_records()) == leaderboard_markdown(make_records()[::-1])


def test_of_a_job_run_twice_the_later_record_counts() -> None:
    later = make_record("ours", 0.97, time_utc="2026-01-02T00:00:00+00:00")
    assert "0.9700 [" in leaderboard_markdown([later, make_record("ours", 0.95)])


def test_other_options_seeds_and_data_sets_are_other_rows() -> None:
    records = [make_record("ours", 0.9), make_record("ours", 0.8, dataset_sha256="c" * 64)]
    seeded = make_record("ours", 0.7)
    job = {"job": seeded.job.__class__(**{**vars(seeded.job), "seed": 2, "overrides": ("a=1",)})}
    grouped = boards([*records, seeded.model_copy(update=job)])
    assert [[row.label for row in board.rows] for board in grouped] == [
        ["ours", "ours (a=1, seed 2)"],
        ["ours"],
    ]


@pytest.mark.parametrize("field", ["protocol_version", "metrics_version"])
def test_records_of_different_versions_are_not_ranked_together(field: str) -> None:
    with pytest.raises(DataError, match=r"different versions \(protocol .* with metrics"):
        leaderboard_markdown([make_record("ours", 0.9), make_record("nearest", 0.9, **{field: "2"})])


def test_published_numbers_stand_apart_and_digit_for_digit() -> None:
    markdown = leaderboard_markdown(make_records())
    own, _, published = markdown.partition("### Published, other data, not comparable")
    assert "XFreq-GS" not in own
    assert cells(published, "Wideband3DGS") == ["Wideband3DGS", "0.8000", "0.7865", "0.7966", "0.7944"]
    assert "1,446 transmitters × 10 carriers" in published


def test_samples_without_a_path_are_said_to_be_left_out() -> None:
    assert "100 samples; 7 without any path" in leaderboard_markdown([make_record(num_without_path=7)])


def test_the_legend_names_window_floor_and_trivial_predictors() -> None:
    legend = leaderboard_markdown(make_records()).partition("## What the columns say")[2]
    for words in ("7×7 uniform window", "−40 dB", *TRIVIAL):
        assert words in legend


def _store(folder):
    for record in make_records():
        append(folder / "records.jsonl", record)


def test_the_same_records_give_the_same_bytes(tmp_path: Path) -> None:
    _store(tmp_path / "results")
    for name in ("a", "b"):
        write_report(tmp_path / "results", tmp_path / name / "BENCHMARK.md")
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*"))
    assert [path.suffix for path in files] == [".md", ".svg"]
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_report_links_its_figure(tmp_path: Path) -> None:
    _store(tmp_path)
    output, figure = write_report(tmp_path, tmp_path / "BENCHMARK.md")
    assert f"](figures/{figure.name})" in output.read_text()
    assert "mean-over-frequency" in figure.read_text()


def test_a_report_is_made_from_one_file_of_records_too(tmp_path: Path) -> None:
    _store(tmp_path / "results")
    path = tmp_path / "results" / "records.jsonl"
    assert write_report(path, tmp_path / "out" / "BENCHMARK.md")[0].exists()


def test_text_outside_the_markers_is_kept(tmp_path: Path) -> None:
    _store(tmp_path)
    output = tmp_path / "BENCHMARK.md"
    output.write_text(f"# Ours\n\nRead this.\n\n{BEGIN}\nold\n{END}\n\nAnd that.\n")
    write_report(tmp_path, output)
    text = output.read_text()
    assert text.startswith(f"# Ours\n\nRead this.\n\n{BEGIN}")
    assert text.endswith(f"{END}\n\nAnd that.\n")
    assert "\nold\n" not in text


def test_a_file_that_is_no_report_is_not_overwritten(tmp_path: Path) -> None:
    _store(tmp_path)
    output = tmp_path / "NOTES.md"
    output.write_text("mine")
    with pytest.raises(OutputExistsError, match="no generated part"):
        write_report(tmp_path, output)
    assert output.read_text() == "mine"


def test_a_report_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds no records"):
        write_report(tmp_path, tmp_path / "BENCHMARK.md")


def test_pictures_of_maps_are_equal_bytes_for_equal_maps(tmp_path: Path) -> None:
    maps = np.random.default_rng(0).random((2, 90, 360), dtype=np.float32)
    for name in ("a.png", "b.png"):
        plot_pas_maps(maps, ["truth", "predicted"], tmp_path / name)
    plot_pas_maps(maps[::-1], ["truth", "predicted"], tmp_path / "c.png")
    a, b, c = ((tmp_path / name).read_bytes() for name in ("a.png", "b.png", "c.png"))
    assert a == b != c


def _changed(record, **changes):
    return record.model_copy(update={"job": record.job.__class__(**{**vars(record.job), **changes})})


def test_skill_stands_whatever_budget_and_seed_were_given() -> None:
    records = [_changed(record, budget=Budget(max_seconds=300), seed=3) for record in make_records()]
    markdown = leaderboard_markdown(records)
    assert cells(markdown, "ours (≤ 300 s, seed 3)")[5] == "0.500"
    assert cells(markdown, "nearest")[0] == "nearest"  # budget and seed change nothing in it


def test_a_trivial_predictor_with_other_options_sets_no_skill() -> None:
    tuned = _changed(make_record("mean-over-frequency", 0.99), overrides=("num_nearest=3",))
    markdown = leaderboard_markdown([make_record("nearest", 0.9), tuned, make_record("ours", 0.95)])
    assert cells(markdown, "ours")[3] == "0.500"
    assert cells(markdown, "mean-over-frequency (num_nearest=3)")[3] == "0.900"


def test_a_board_says_its_maps_its_rays_and_whose_times_these_are() -> None:
    markdown = leaderboard_markdown(make_records())
    assert (
        "Data set `aaaaaaaaaaaaaaaa`: power maps, image solver, specular, depth 1. Tested "
        "transmitters are trained on at other carriers. Times were taken on AMD EPYC, 2 cores." in markdown
    )


def test_every_machine_that_took_times_is_named() -> None:
    other = make_record("ours", hardware={"processor": "Intel Xeon", "cores": "16"})
    assert "on AMD EPYC, 2 cores; Intel Xeon, 16 cores." in leaderboard_markdown([make_record(), other])


def test_sets_of_different_kinds_of_map_have_different_headings() -> None:
    records = [make_record(), make_record(pas_kind="amplitude", dataset_sha256="c" * 64)]
    markdown = leaderboard_markdown(records)
    assert "## office · lofo · power maps\n" in markdown
    assert "## office · lofo · amplitude maps\n" in markdown
    assert "office · lofo · amplitude maps. Median" in leaderboard_summary(records)


def test_a_file_that_is_no_text_is_not_overwritten(tmp_path: Path) -> None:
    _store(tmp_path)
    output = tmp_path / "data.h5"
    output.write_bytes(b"\x89HDF\r\n\xff")
    with pytest.raises(OutputExistsError, match="not a text"):
        write_report(tmp_path, output)
    assert output.read_bytes() == b"\x89HDF\r\n\xff"


def test_a_folder_is_no_place_for_a_report(tmp_path: Path) -> None:
    _store(tmp_path)
    with pytest.raises(StorageError, match="is a folder"):
        write_report(tmp_path, tmp_path)
    assert not (tmp_path / "figures").exists()


def test_gaussians_are_counted_where_a_method_has_any() -> None:
    counted = [
        make_record("ours", 0.95, split, counts={"gaussians": number})
        for split, number in zip(SPLITS, (1000, 2000, 3000), strict=True)
    ]
    markdown = leaderboard_markdown([make_record("nearest", 0.9, SPLITS[0]), *counted])
    assert cells(markdown, "method")[-1] == "Gaussians"
    assert cells(markdown, "ours")[-1] == "2000"
    assert cells(markdown, "nearest")[-1] == "–"
    assert "Gaussians" not in leaderboard_markdown(make_records())


def test_runs_that_differ_in_their_seed_alone_are_summed_up() -> None:
    seeded = [
        _changed(make_record("ours", ssim, split), seed=seed, budget=Budget(max_seconds=300))
        for split in SPLITS[:2]
        for seed, ssim in enumerate((0.90, 0.92, 0.94))
    ]
    records = [*seeded, make_record("nearest", 0.8, SPLITS[0]), make_record("nearest", 0.8, SPLITS[1])]
    assert (
        "* ours (≤ 300 s): median SSIM, mean ± standard deviation over seeds 0, 1, 2: "
        "2.4GHz 0.9200 ± 0.0200, 24.25GHz 0.9200 ± 0.0200, average 0.9200 ± 0.0200."
        in leaderboard_markdown(records)
    )
    assert "over seeds 0, 1, 2" in leaderboard_summary(records)


def test_a_split_that_one_seed_was_not_run_on_has_no_spread() -> None:
    records = [_changed(make_record("ours", 0.9, SPLITS[0]), seed=seed) for seed in (1, 2)]
    records.append(_changed(make_record("ours", 0.9, SPLITS[1]), seed=1))
    assert "over seeds 1, 2: 2.4GHz 0.9000 ± 0.0000." in leaderboard_markdown(records)


def test_rows_of_other_defaults_are_told_apart_by_their_commits() -> None:
    older, newer = make_record("ours", 0.8), make_record("ours", 0.9)
    older = older.model_copy(update={"config": {"width": 1}, "git_commit": "a" * 40})
    newer = newer.model_copy(update={"config": {"width": 2}, "git_commit": "b" * 40})
    markdown = leaderboard_markdown([older, newer])
    assert "| ours @ aaaaaaa " in markdown
    assert "| ours @ bbbbbbb " in markdown


def test_one_seed_alone_has_no_spread() -> None:
    assert "over seeds" not in leaderboard_markdown(make_records())


def test_a_learning_curve_stands_by_share_of_the_budget() -> None:
    points = [
        CurvePoint(step=step, seconds=step / 10, loss=0.1, ssim=ssim)
        for step, ssim in ((1, 0.5), (9, 0.6), (64, 0.7))
    ]
    record = _changed(make_record("ours", 0.7, SPLITS[0], curve=points), budget=Budget(max_steps=64))
    markdown = leaderboard_markdown([record, make_record("nearest", 0.6, SPLITS[0])])
    assert cells(markdown.partition("on a fixed sample")[2], "ours (≤ 64 steps)") == [
        "ours (≤ 64 steps)",
        "2.4GHz",
        "0.5000 (0.1 s)",
        *["–"] * 2,
        "0.6000 (0.9 s)",
        *["–"] * 2,
        "0.7000 (6.4 s)",
    ]
    assert "on a fixed sample" not in leaderboard_markdown(make_records())
