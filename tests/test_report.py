from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_boards import external
from test_records import make_record, make_summary

from xfreqbench.angles import AngularGrid
from xfreqbench.boards import boards
from xfreqbench.errors import DataError, OutputExistsError, StorageError
from xfreqbench.method import TRIVIAL, Budget
from xfreqbench.metrics import METRICS
from xfreqbench.plots import TimePanel, plot_error_against_time, plot_pas_maps
from xfreqbench.published import COLUMN
from xfreqbench.records import BenchFigure, BenchPoint, BenchRecord, CurvePoint, append
from xfreqbench.report import BEGIN, END, leaderboard_markdown, leaderboard_summary, write_report

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


def rows_of(markdown, method):
    """Rows of a method in the order of their tables, each by its table's header."""
    header: list[str] = []
    found = []
    for line in markdown.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")] if line.startswith("|") else []
        header = header if cells and header else cells
        if method in cells[:2]:
            found.append(dict(zip(header, cells, strict=True)))
    return found


def test_the_summary_goes_by_average_ssim_and_gives_skill() -> None:
    markdown = leaderboard_markdown(make_records())
    assert rows_of(markdown, "ours")[0] == {
        "rank": "–",
        "method": "ours",
        "2.4GHz": "0.9500",
        "24.25GHz": "0.9500",
        "77GHz": "0.9500",
        "average": "0.9500",
        "± seeds": "–",
        "skill": "0.500",
        "seeds": "1",
        "fit s": "0.50",
        "ms/map": "1.25",
        "peak MiB": "200",
        "parameters": "1,234",
    }
    order = [
        markdown.index(f"| {name} ") for name in ("ours", "mean-over-frequency", "nearest", "line-of-sight")
    ]
    assert order == sorted(order)


def test_a_row_that_loses_to_a_trivial_predictor_stands_with_its_negative_skill() -> None:
    markdown = leaderboard_markdown([*make_records()[:4], make_record("worse", 0.7, SPLITS[0])])
    assert rows_of(markdown, "worse")[0]["skill"] == "-2.000"


def test_without_a_trivial_predictor_there_is_no_skill() -> None:
    markdown = leaderboard_markdown([make_record("ours", 0.95)])
    assert rows_of(markdown, "ours")[0]["skill"] == "–"


def test_averages_are_over_the_same_splits_in_every_row_of_a_table() -> None:
    some = [make_record("partial", 0.97, split) for split in SPLITS[1::-1]]
    lucky = make_record("lucky", 0.99, SPLITS[0])
    markdown = leaderboard_markdown([*make_records(), *some, lucky])
    shared, whole, *of_splits = markdown.split("best average first;")[1:][:2] + markdown.split("### ")[1:]
    whole = whole.partition("###")[0]
    assert not rows_of(whole, "partial") + rows_of(whole + shared, "lucky")
    assert rows_of(shared, "partial")[0]["average"] == "0.9700"
    assert rows_of(shared, "ours")[0]["average"] == "0.9500"
    assert shared.index("| partial ") < shared.index("| ours ")
    assert rows_of(of_splits[0], "lucky")


def test_the_order_in_which_splits_were_run_makes_no_table_of_its_own() -> None:
    later = [
        make_record("ours", 0.95, split).model_copy(update={"time_utc": f"2026-01-02T00:00:0{second}+00:00"})
        for second, split in enumerate(SPLITS[::-1])
    ]
    assert (
        leaderboard_markdown([*make_records()[:4], *make_records()[5:], *later]).count("best average first")
        == 1
    )


def test_targets_stand_in_order_of_frequency() -> None:
    assert boards(make_records()[::-1])[0].splits == SPLITS


def test_the_order_of_records_does_not_matter() -> None:
    assert leaderboard_markdown(make_records()) == leaderboard_markdown(make_records()[::-1])


def test_of_a_job_run_twice_the_later_record_counts() -> None:
    later = make_record("ours", 0.97, time_utc="2026-01-02T00:00:00+00:00")
    markdown = leaderboard_markdown([later, make_record("ours", 0.95)])
    assert rows_of(markdown, "ours")[0]["24.25GHz"] == "0.9700"
    assert rows_of(markdown, "ours")[0]["seeds"] == "1"


def test_other_options_and_data_sets_are_other_rows_and_other_seeds_are_not() -> None:
    records = [make_record("ours", 0.9), make_record("ours", 0.8, dataset_sha256="c" * 64)]
    seeded = make_record("ours", 0.7)
    job = {"job": seeded.job.__class__(**{**vars(seeded.job), "seed": 2, "overrides": ("a=1",)})}
    again = _changed(make_record("ours", 0.6), seed=2)
    grouped = boards([*records, seeded.model_copy(update=job), again])
    assert [[row.label for row in board.rows] for board in grouped] == [
        ["ours", "ours (a=1)"],
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
    assert list(rows_of(published, "Wideband3DGS")[0].values())[1:] == [
        "0.8000",
        "0.7865",
        "0.7966",
        "0.7944",
    ]
    assert "1,446 transmitters × 10 carriers" in published


XFREQ = {"sees_carrier": True, "footprint": "projected"}


def test_a_method_has_what_was_published_of_it_beside_it_on_the_same_splits() -> None:
    records = [make_record("xfreq-gs", 0.9, split, config=XFREQ) for split in SPLITS]
    summary, *of_splits = rows_of(leaderboard_markdown([*make_records(), *records]), "xfreq-gs")
    assert summary["published, other data"] == "XFreq-GS 0.9098"
    assert [row["published, other data"] for row in of_splits] == [
        "XFreq-GS 0.9085",
        "XFreq-GS 0.8977",
        "XFreq-GS 0.9232",
    ]
    assert (
        rows_of(leaderboard_markdown([*make_records(), *records]), "ours")[0]["published, other data"] == ""
    )


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        (XFREQ | {"sees_carrier": False}, "without frequency modulation 0.8977"),
        (XFREQ | {"footprint": "circular"}, "without AOS 0.8360"),
        ({"sees_carrier": False, "footprint": "circular"}, "baseline of the ablation 0.7204"),
    ],
)
def test_ablations_stand_beside_the_papers(config: dict[str, object], expected: str) -> None:
    markdown = leaderboard_markdown([make_record("xfreq-gs", 0.9, config=config)])
    assert rows_of(markdown, "xfreq-gs")[0]["published, other data"] == expected


def test_sparse_splits_have_their_published_numbers_one_by_one() -> None:
    names = ("10-37GHz", "10-37-94GHz", "1-10-37-60-94GHz")
    records = [
        make_record("xfreq-gs", 0.9, f"sparse-24.25GHz-from-{name}", "sparse", config=XFREQ) for name in names
    ]
    summary = rows_of(leaderboard_markdown(records), "xfreq-gs")[0]
    assert summary["published, other data"] == "XFreq-GS 0.7381 / 0.7642 / 0.8554"


def test_nothing_was_published_of_an_average_over_other_splits() -> None:
    records = [make_record("xfreq-gs", 0.9, split, config=XFREQ) for split in (*SPLITS, "lofo-94GHz")]
    assert "published, other data" not in rows_of(leaderboard_markdown(records), "xfreq-gs")[0]


def test_samples_without_a_path_are_said_to_be_left_out() -> None:
    assert "100 samples; 7 without any path" in leaderboard_markdown([make_record(num_without_path=7)])


def test_the_legend_names_window_floor_and_trivial_predictors() -> None:
    legend = leaderboard_markdown(make_records()).partition("## What the columns say")[2]
    for words in ("7×7 uniform window", "−40 dB", *TRIVIAL):
        assert words in legend


def _store(folder):
    for record in (
        *make_records(),
        make_followed(),
        make_bench(),
        make_bench("render", "Splatting", figure=None),
    ):
        append(folder / "records.jsonl", record)


def test_the_same_records_give_the_same_bytes(tmp_path: Path) -> None:
    _store(tmp_path / "results")
    for name in ("a", "b"):
        write_report(tmp_path / "results", tmp_path / name / "BENCHMARK.md")
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*"))
    assert [path.suffix for path in files] == [".md", ".svg", ".svg", ".svg"]
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_report_links_its_figures(tmp_path: Path) -> None:
    _store(tmp_path)
    output, *figures = write_report(tmp_path, tmp_path / "BENCHMARK.md").paths
    assert [path.name for path in figures] == [
        "office-lofo-aaaaaaaa-cdf.svg",
        "office-lofo-aaaaaaaa-time.svg",
        "bench-generate-error-against-run-time.svg",
    ]
    for figure in figures:
        assert f"](figures/{figure.name})" in output.read_text()
    cdf, time, bench = (figure.read_text() for figure in figures)
    assert "mean-over-frequency" in cdf
    assert "ours (≤ 64 steps)" in time
    assert "ms a sample" in bench


def test_half_a_line_at_the_end_of_the_records_is_told_and_changes_nothing(tmp_path: Path) -> None:
    _store(tmp_path)
    output = tmp_path / "BENCHMARK.md"
    assert write_report(tmp_path, output).num_truncated == 0
    whole = output.read_bytes()
    with (tmp_path / "records.jsonl").open("a") as file:
        file.write('{"id": "cut o')
    assert write_report(tmp_path, output).num_truncated == 1
    assert output.read_bytes() == whole


def test_a_report_is_made_from_one_file_of_records_too(tmp_path: Path) -> None:
    _store(tmp_path / "results")
    path = tmp_path / "results" / "records.jsonl"
    assert write_report(path, tmp_path / "out" / "BENCHMARK.md").paths[0].exists()


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
    grid = AngularGrid.hemisphere()
    maps = np.random.default_rng(0).random((2, 90, 360), dtype=np.float32)
    for name in ("a.png", "b.png"):
        plot_pas_maps(maps, grid, ["truth", "predicted"], tmp_path / name)
    plot_pas_maps(maps[::-1], grid, ["truth", "predicted"], tmp_path / "c.png")
    a, b, c = ((tmp_path / name).read_bytes() for name in ("a.png", "b.png", "c.png"))
    assert a == b != c


def _changed(record, **changes):
    return record.model_copy(update={"job": record.job.__class__(**{**vars(record.job), **changes})})


def test_skill_stands_whatever_budget_and_seed_were_given() -> None:
    records = [_changed(record, budget=Budget(max_seconds=300), seed=3) for record in make_records()]
    markdown = leaderboard_markdown(records)
    assert rows_of(markdown, "ours (≤ 300 s)")[0]["skill"] == "0.500"
    assert rows_of(markdown, "nearest")  # budget and seed change nothing in it


def test_a_trivial_predictor_with_other_options_sets_no_skill() -> None:
    tuned = _changed(make_record("mean-over-frequency", 0.99), overrides=("num_nearest=3",))
    markdown = leaderboard_markdown([make_record("nearest", 0.9), tuned, make_record("ours", 0.95)])
    assert rows_of(markdown, "ours")[0]["skill"] == "0.500"
    assert rows_of(markdown, "mean-over-frequency (num_nearest=3)")[0]["skill"] == "0.900"


def test_a_board_says_its_maps_its_rays_and_whose_times_these_are() -> None:
    markdown = leaderboard_markdown(make_records())
    assert "Data set `aaaaaaaaaaaaaaaa`: power maps, image solver, specular, depth 1. **Tested" in markdown
    assert "** Times were taken on AMD EPYC, 2 cores. Commit ?; seed 0." in markdown


def test_scores_of_transmitters_that_were_trained_on_are_said_to_tell_nothing_of_unseen_places() -> None:
    leak = (
        "Tested transmitters are trained on at other carriers: these scores say nothing about unseen places."
    )
    assert leak in leaderboard_markdown([make_record(nearest_trained_m=0.0)])
    assert leak not in leaderboard_markdown([make_record(shares_transmitters=False)])


def test_unseen_transmitters_come_with_their_distance_to_the_nearest_trained_one() -> None:
    unseen = make_record(shares_transmitters=False, nearest_trained_m=0.2)
    other = make_record(split="lofo-77GHz", shares_transmitters=False, nearest_trained_m=0.3)
    start = "No tested transmitter is trained on at any carrier"
    assert f"{start}; the nearest trained one is 0.20 m away (median).**" in leaderboard_markdown([unseen])
    assert "is 0.20 m to 0.30 m away" in leaderboard_markdown([unseen, other])
    assert f"{start}.**" in leaderboard_markdown([make_record(shares_transmitters=False)])


def test_every_machine_that_took_times_is_named() -> None:
    other = make_record("ours", hardware={"processor": "Intel Xeon", "cores": "16"})
    assert "on AMD EPYC, 2 cores; Intel Xeon, 16 cores." in leaderboard_markdown([make_record(), other])


def test_sets_of_different_kinds_of_map_have_different_headings() -> None:
    records = [make_record(), make_record(pas_kind="amplitude", dataset_sha256="c" * 64)]
    markdown = leaderboard_markdown(records)
    assert "## office · lofo · power maps\n" in markdown
    assert "## office · lofo · amplitude maps\n" in markdown
    assert "office · lofo · amplitude maps. Tested" in leaderboard_summary(records)


def test_the_summary_for_a_terminal_is_one_table_a_board() -> None:
    assert leaderboard_summary(make_records()).count("| method") == 1


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
    ours, nearest = (rows_of(markdown, name)[0] for name in ("ours", "nearest"))
    assert ours["Gaussians"] == "2,000"
    assert (
        rows_of(markdown.partition("### 2.4GHz")[2], "nearest")[0]["Gaussians"] == "–" == nearest["Gaussians"]
    )
    assert "Gaussians" not in leaderboard_markdown(make_records())


def test_runs_that_differ_in_their_seed_alone_are_one_row_of_means() -> None:
    seeded = [
        _changed(make_record("ours", ssim, split), seed=seed, budget=Budget(max_seconds=300))
        for split in SPLITS[:2]
        for seed, ssim in enumerate((0.90, 0.92, 0.94))
    ]
    records = [*seeded, make_record("nearest", 0.8, SPLITS[0]), make_record("nearest", 0.8, SPLITS[1])]
    row = rows_of(leaderboard_markdown(records), "ours (≤ 300 s)")[0]
    assert [row[name] for name in ("2.4GHz", "average", "± seeds", "seeds")] == [
        "0.9200",
        "0.9200",
        "0.0200",
        "3",
    ]
    assert "seeds 0, 1, 2." in leaderboard_markdown(records)


def _of_seeds(method, shift, first):
    """Records whose samples differ between transmitters alike for every method."""
    records = []
    for seed in range(3):
        place = np.random.default_rng(0).normal(0.8, 0.02, 50)
        noise = np.random.default_rng(first + seed).normal(shift, 0.002, 50)
        ssim = np.round(place + noise, 4)
        record = make_record(method, float(np.median(ssim)), ssim_by_tx=[(float(value),) for value in ssim])
        records.append(_changed(record, seed=seed))
    return records


def test_pairs_say_what_beats_what_and_what_is_level() -> None:
    records = [*_of_seeds("best", 0.02, 10), *_of_seeds("second", 0.0, 20), *_of_seeds("third", 0.0, 30)]
    unranked = make_record("fast", 0.7, ssim_by_tx=[(0.7,)] * 50)
    markdown = leaderboard_markdown([*records, unranked])
    ranks = {name: rows_of(markdown, name)[0]["rank"] for name in ("best", "second", "third", "fast")}
    assert ranks == {"best": "1", "second": "2–3", "third": "2–3", "fast": "–"}
    pairs = markdown.partition("× 1000")[2].partition("###")[0]
    first = next(line for line in pairs.splitlines() if line.startswith("| 1 best"))
    assert first.count("+") == 2
    middle = next(line for line in pairs.splitlines() if line.startswith("| 2 "))
    assert [cell.strip() for cell in middle.strip("|").split("|")][1:] == ["", "="]
    assert "fast" not in pairs


def test_of_trivial_predictors_only_the_best_is_paired_with_methods() -> None:
    trivial = [
        record
        for shift, name in ((0, "nearest"), (-0.1, "line-of-sight"))
        for record in _of_seeds(name, shift, 40)
    ]
    with_method = leaderboard_markdown([*_of_seeds("ours", 0.02, 10), *trivial]).partition("× 1000")[2]
    assert "| 2 nearest " in with_method and " line-of-sight " not in with_method.partition("###")[0]
    assert "| 2 line-of-sight " in leaderboard_markdown(trivial).partition("× 1000")[2]


def test_one_ranked_row_has_nothing_to_be_paired_with() -> None:
    assert "× 1000" not in leaderboard_markdown(_of_seeds("ours", 0.0, 10))


def test_samples_give_the_score_and_the_skill_an_interval() -> None:
    row = rows_of(
        leaderboard_markdown([*_of_seeds("ours", 0.02, 10), *_of_seeds("nearest", 0.0, 20)]), "ours"
    )[0]
    pattern = r"0\.\d+ \[0\.\d+, 0\.\d+\]"
    assert re.fullmatch(pattern, row["24.25GHz"])
    assert re.fullmatch(pattern, row["skill"])


def test_a_split_of_several_carriers_has_a_table_by_carrier() -> None:
    by_carrier = {"24250000000": 0.9, "1000000000": 0.7}
    scores = {
        name: make_summary(0.9).model_copy(update={"median_by_carrier_hz": by_carrier}) for name in METRICS
    }
    markdown = leaderboard_markdown([make_record("ours", 0.9, "held-out-tx", "held-out-tx", scores=scores)])
    assert rows_of(markdown.partition("by carrier")[2], "ours")[0] == {
        "method": "ours",
        "1 GHz": "0.7000",
        "24.25 GHz": "0.9000",
    }
    assert "by carrier" not in leaderboard_markdown(make_records())


def test_splits_on_which_fewer_methods_were_run_are_folded() -> None:
    lone = make_record("nearest", 0.8, "lofo-94GHz")
    opened, _, folded = leaderboard_markdown([*make_records(), lone]).partition(
        "<details><summary>94GHz</summary>"
    )
    assert "### 77GHz" in opened
    assert "### 94GHz" in folded.partition("</details>")[0]
    assert "<details>" not in leaderboard_markdown(make_records())


def make_followed(method="ours", seed=0, end=0.7):
    """A fit of 64 steps with a learning curve that has no point at half of its shares."""
    points = [
        CurvePoint(step=step, seconds=step / 10, loss=0.1, ssim=ssim)
        for step, ssim in ((1, 0.5), (9, 0.6), (64, end))
    ]
    record = make_record(method, 0.7, SPLITS[0], curve=points)
    return _changed(record, budget=Budget(max_steps=64), seed=seed)


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


@pytest.mark.parametrize(
    ("trivial", "expected"), [(0.55, "0.90 s"), (0.6, "0.90 s"), (0.65, "6.4 s"), (0.75, "never")]
)
def test_a_fit_reaches_the_best_trivial_predictor_on_the_same_maps(trivial: float, expected: str) -> None:
    records = [make_record("nearest", trivial, SPLITS[0], ssim_by_tx=[(trivial,)] * 100)]
    records += [make_record("line-of-sight", 0.5, SPLITS[0], ssim_by_tx=[(0.5,)] * 100)]
    markdown = leaderboard_markdown([make_followed(), *records]).partition("### Error against time")[2]
    assert rows_of(markdown, "ours (≤ 64 steps)")[0]["best trivial reached after"] == expected


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


def make_bench(bench="generate", title="Error against run time", **changes):
    points = [BenchPoint(series="image", label=f"depth {x}", x=x, y=40 + x) for x in (1, 2)]
    fields = {
        "bench": bench,
        "title": title,
        "command": f"xfreqbench bench {bench}",
        "note": "Two columns.",
        "columns": ("setting", "ms"),
        "rows": (("image", "1.5"),),
        "figure": BenchFigure(x_label="ms a sample", y_label="PSNR (dB)", log_x=True, points=tuple(points)),
        "hardware": {"processor": "AMD EPYC", "cores": "2"},
        "software": {},
        "git_commit": "0123456789",
        "time_utc": "2026-01-01T00:00:00+00:00",
    }
    return BenchRecord.model_validate(fields | changes)


def test_measurements_stand_under_their_headings_with_command_machine_and_date() -> None:
    benches = [
        make_bench(name, f"table of {name}")
        for name in ("odd", "stress", "savings", "render", "plain", "generate")
    ]
    markdown = leaderboard_markdown(make_records(), benches)
    headings = [line[3:] for line in markdown.splitlines() if line.startswith("## ")]
    assert headings[1:-1] == [
        "Generator",
        "Rendering and training",
        "Savings",
        "Stress",
        "Other measurements",
    ]
    assert (
        "### table of render\n\n    xfreqbench bench render\n\nTwo columns.\n\n"
        "| setting |  ms |\n| ------- | --: |\n| image   | 1.5 |\n\n"
        "AMD EPYC, 2 cores; commit 0123456; 2026-01-01." in markdown
    )


def test_what_was_run_comes_first() -> None:
    markdown = leaderboard_markdown(
        make_records(), [make_bench("benchmark", "What was run", note="Left out: none.")]
    )
    assert markdown.startswith(
        "## What was run\n\n    xfreqbench bench benchmark\n\nLeft out: none.\n\n| setting"
    )


def test_of_a_measurement_taken_twice_the_later_counts() -> None:
    later = make_bench(rows=(("image", "0.5"),), time_utc="2026-01-02T00:00:00+00:00")
    markdown = leaderboard_markdown([], [later, make_bench(), make_bench(title="another")])
    assert "0.5" in markdown
    assert markdown.count("1.5") == 1  # the other title's


def test_error_against_time_is_equal_bytes_for_equal_curves(tmp_path: Path) -> None:
    panel = TimePanel({"ours": [(1.0, 0.5), (10.0, 0.7)]}, front=[(10.0, 0.7)], trivial=0.6)
    for name, panels in (
        ("a", {"x": panel}),
        ("b", {"x": panel}),
        ("c", {"x": replace(panel, trivial=None)}),
    ):
        plot_error_against_time(panels, tmp_path / f"{name}.svg")
    a, b, c = ((tmp_path / f"{name}.svg").read_text() for name in "abc")
    assert a == b != c
    assert "best trivial predictor" in a and "best trivial predictor" not in c


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


def test_a_board_of_external_rows_alone_names_no_machine() -> None:
    markdown = leaderboard_markdown([external()])
    assert "Times were taken" not in markdown and "External rows" in markdown


def test_an_external_row_has_no_published_counterpart() -> None:
    theirs = leaderboard_markdown([external(split, method="xfreq-gs") for split in SPLITS])
    ours = leaderboard_markdown([make_record("xfreq-gs", 0.9, split) for split in SPLITS])
    assert COLUMN not in rows_of(theirs, "xfreq-gs (external)")[0]
    assert rows_of(ours, "xfreq-gs")[0][COLUMN] == "XFreq-GS 0.9098"
