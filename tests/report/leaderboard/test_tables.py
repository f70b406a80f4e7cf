"""The tables of boards: columns, rankings, files of CSV, and what Python shows of them."""

from __future__ import annotations

import csv
import re
import sys
from html import unescape
from itertools import combinations
from math import inf, nan
from pathlib import Path

import pytest

import xfreqbench as xb
from tests.support.leaderboard_records import (
    leaderboard_markdown,
    make_bench,
    make_records,
    of_three_seeds,
    rows_of,
    with_job,
)
from tests.support.stored_records import SPLITS, external, make_record, make_summary, store
from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.maps.metrics import METRICS
from xfreqbench.methods.contract import Budget
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.columns import BRIEF, COSTS, columns, metric_title
from xfreqbench.report.leaderboard.comparison import Comparison
from xfreqbench.report.leaderboard.page import write_page
from xfreqbench.report.leaderboard.report import report_text, write_report
from xfreqbench.report.leaderboard.results import read_results
from xfreqbench.report.leaderboard.tables import Leaderboard, csv_tables


def test_the_summary_goes_by_average_ssim_and_gives_skill() -> None:
    markdown = leaderboard_markdown(make_records())
    assert rows_of(markdown, "ours")[0] == {
        "rank": "one seed",
        "method": "ours",
        "whose": "self-reported",
        "2.4GHz": "0.9500",
        "24.25GHz": "0.9500",
        "77GHz": "0.9500",
        "average": "0.9500",
        "± seeds": "–",
        "skill": "0.500",
        "beam loss (dB)": "0.950",
        "AoA error (°)": "0.95",
        "seeds": "1",
        "fit s": "0.50",
        "ms/map": "1.25",
        "peak MiB": "200",
        "parameters": "1,234",
    }
    order = [markdown.index(f"| {name} ") for name in ("ours", "mean-over-frequency", "nearest", "line-of-sight")]
    assert order == sorted(order)


TRIVIAL, OURS = make_records()[:4], make_record("ours", 0.95, SPLITS[0])
TUNED = with_job(make_record("mean-over-frequency", 0.99, SPLITS[0]), overrides=("num_nearest=3",))


def test_a_row_says_whose_it_is() -> None:
    names = ("nearest", "xfreq-gs", "xfreq-gs-paper", "gsrf", "mine:Method")
    (board,) = boards([*map(make_record, names), external(method="gsrf")])
    assert {row.label: row.whose for row in board.rows} == {
        "nearest": "ours",
        "xfreq-gs": "ours",
        "xfreq-gs-paper": "ours",
        "gsrf": "reduced",
        "mine:Method": "self-reported",
        "gsrf (external)": "self-reported",
    }


@pytest.mark.parametrize(
    ("records", "skills"),
    [
        ([*TRIVIAL, make_record("worse", 0.7, SPLITS[0])], {"worse": "-2.000"}),
        ([*TRIVIAL, TUNED, OURS], {"ours": "0.500", "mean-over-frequency (num_nearest=3)": "0.900"}),
        ([with_job(each, budget=Budget(max_seconds=300), seed=3) for each in (*TRIVIAL, OURS)], {"ours": "0.500"}),
        *(([*TRIVIAL[:left_out], *TRIVIAL[left_out + 1 :], OURS], {"ours": "–"}) for left_out in range(4)),
    ],
    ids=["negative", "a trivial predictor with options sets none", "any budget and seed", *["one was not run"] * 4],
)
def test_skill_is_against_the_best_trivial_predictor_without_options(records: list, skills: dict[str, str]) -> None:
    markdown = leaderboard_markdown(records)
    assert {name: rows_of(markdown, name)[0]["skill"] for name in skills} == skills


def test_averages_are_over_the_same_splits_in_every_row_of_a_table() -> None:
    some = [make_record("partial", 0.97, split) for split in SPLITS[1::-1]]
    lucky = make_record("lucky", 0.99, SPLITS[0])
    markdown = leaderboard_markdown([*make_records(), *some, lucky])
    whole, shared, lone = re.split("best average first;|, best first;", markdown)[1:]
    assert not rows_of(whole, "partial") + rows_of(whole + shared, "lucky")
    assert rows_of(shared, "partial")[0]["average"] == "0.9700"
    assert rows_of(shared, "ours")[0]["average"] == "0.9500"
    assert shared.index("| partial ") < shared.index("| ours ")
    assert rows_of(lone, "lucky")


def test_the_order_of_records_does_not_matter() -> None:
    assert leaderboard_markdown(make_records()) == leaderboard_markdown(make_records()[::-1])


def test_of_a_job_run_twice_the_later_record_counts() -> None:
    later = make_record("ours", 0.97, time_utc="2026-01-02T00:00:00+00:00")
    markdown = leaderboard_markdown([later, make_record("ours", 0.95)])
    assert rows_of(markdown, "ours")[0]["24.25GHz"] == "0.9700"
    assert rows_of(markdown, "ours")[0]["seeds"] == "1"


@pytest.mark.parametrize("field", ["protocol_version", "metrics_version"])
def test_records_of_different_versions_are_not_ranked_together(field: str) -> None:
    with pytest.raises(DataError, match=r"different versions \(protocol .* with metrics"):
        boards([make_record("ours", 0.9), make_record("nearest", 0.9, **{field: "2"})])


def test_the_summary_shows_the_whole_board_that_a_run_stands_on_and_no_other(tmp_path: Path) -> None:
    others = [make_record(dataset_sha256="c" * 64), make_record("old", protocol_version="0")]
    results = store(tmp_path, *make_records(), *others)
    summary = str(Leaderboard.beside(results, [make_records()[-1]]))
    assert rows_of(summary, "ours")[0]["skill"] == "0.500"
    assert rows_of(summary, "nearest") and not rows_of(summary, "old")
    assert summary.count("| method") == 1


def test_pairs_say_what_beats_what_and_what_is_level() -> None:
    records = [*of_three_seeds("best", 0.02, 10), *of_three_seeds("second", 0.0, 20), *of_three_seeds("third", 0.0, 30)]
    unranked = make_record("fast", 0.7, ssim_by_tx=[(0.7,)] * 50)
    pairs = {(row["method"], row["other"]): row for row in csv_tables(boards([*records, unranked]))["pairs"]}
    assert {pair for pair, row in pairs.items() if row["low"] > 0} == {("best", "second"), ("best", "third")}
    assert {frozenset(pair) for pair in pairs} == {
        frozenset(pair) for pair in combinations(("best", "second", "third"), 2)
    }


def test_of_trivial_predictors_only_the_best_is_paired_with_methods() -> None:
    trivial = [
        record
        for shift, name in ((0, "nearest"), (-0.1, "line-of-sight"))
        for record in of_three_seeds(name, shift, 40)
    ]
    both = {
        (row["method"], row["other"])
        for row in csv_tables(boards([*of_three_seeds("ours", 0.02, 10), *trivial]))["pairs"]
    }
    assert both == {("ours", "nearest")}
    assert [row["other"] for row in csv_tables(boards(trivial))["pairs"]] == ["line-of-sight"]


def test_every_split_stands_in_the_table_of_scores_with_its_carriers() -> None:
    by_carrier = {"24250000000": 0.9, "1000000000": 0.7}
    scores = {name: make_summary(0.9).model_copy(update={"median_by_carrier_hz": by_carrier}) for name in METRICS}
    several = make_record("ours", 0.9, "held-out-tx", "held-out-tx", scores=scores)
    rows = csv_tables(boards([several, *make_records()]))["scores"]
    (of_several,) = [row for row in rows if row["protocol"] == "held-out-tx"]
    assert (of_several["SSIM at 1 GHz"], of_several["SSIM at 24.25 GHz"]) == (0.7, 0.9)
    ours = [row for row in rows if row["method"] == "ours" and row["protocol"] == "lofo"]
    assert [row["splits"] for row in ours] == [SPLITS, *((split,) for split in SPLITS)]
    assert not any("SSIM at 1 GHz" in row for row in ours)


@pytest.mark.parametrize("start", ["=", "+", "-", "@", "\t", "\r"])
def test_no_name_is_a_formula_of_a_spreadsheet(tmp_path: Path, start: str) -> None:
    name = f'{start}HYPERLINK("http://x","y")'
    store(tmp_path, *make_records(), make_record(name), make_bench(rows=[("-1.5", name)] * 13))
    write_page(tmp_path, tmp_path / "page.html")
    write_report(tmp_path, tmp_path / "B.md")
    for path in (tmp_path / "page.csv", tmp_path / "B-scores.csv", *tmp_path.glob("bench-*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            cells = [cell for row in csv.reader(file) for cell in row]
        assert {True} == {cell.startswith("'") for cell in cells if name in cell}, path
    assert "-1.5" in cells


@pytest.mark.parametrize("num_rows", [12, 13])
def test_a_long_measurement_is_cut_and_stands_whole_beside_the_page(tmp_path: Path, num_rows: int) -> None:
    store(tmp_path, make_bench(columns=("ms", "ms"), rows=[(f"{n}", "x") for n in range(num_rows)]))
    for _ in range(2):  # the second time over files of its own
        page, *_ = write_report(tmp_path, tmp_path / "B.md")
    whole = tmp_path / "bench-generate-error-against-run-time.csv"
    assert whole.exists() == (f"]({whole.name})" in page.read_text("utf-8")) == (num_rows > 12)
    if whole.exists():
        first, *_, last = whole.read_text("utf-8").splitlines()
        assert (first, last) == ("measurement,ms 1,ms 2", "Error against run time,12,x")


def test_of_a_measurement_taken_twice_the_later_counts(tmp_path: Path) -> None:
    later = make_bench(rows=(("image", "0.5"),), time_utc="2026-01-02T00:00:00+00:00")
    text = report_text(store(tmp_path, later, make_bench(), make_bench(title="another")))
    assert "0.5" in text
    assert text.count("1.5") == 1  # the other title's


def columns_of(records, names):
    """Columns of the first board on all its splits by title, and its rows by label."""
    board = boards(records)[0]
    comparison = Comparison(board, board.splits)
    found = columns(comparison, names)
    assert len({column.title for column in found}) == len(found)
    return {column.title: column for column in found}, {row.label: row for row in comparison.rows}


def test_markdown_and_the_page_show_the_same_texts_under_the_same_titles(tmp_path: Path) -> None:
    records = [*of_three_seeds("ours", 0.02, 10), *of_three_seeds("nearest", 0.0, 20)]
    html = write_page(store(tmp_path, *records), tmp_path / "page.html").read_text()
    table = html.partition('<table class="leaderboard">')[2].partition("</table>")[0]
    titles = [unescape(text) for text in re.findall(r"<th scope=\"col\"[^>]*>(.*?)</th>", table)]
    cells = re.findall(r"<t(?:d|h scope=\"row\")[^>]*>(.*?)</t[hd]>", table)
    ours = dict(zip(titles, cells, strict=False))
    written = rows_of(leaderboard_markdown(records), "ours")[0]
    shared = [title for title in titles if title in written]
    assert len(shared) > 8
    for title in shared:
        text = ours[title].replace("<small>", " ").replace("</small>", "").replace("−", "-")
        assert text == written[title], title


def test_scores_are_sorted_with_the_best_first_and_costs_with_the_least() -> None:
    shown, _ = columns_of([make_record()], (*METRICS, *COSTS))
    for name, metric in METRICS.items():
        assert shown[metric_title(name)].is_largest_first == metric.higher_is_better
    known = [title for title, *_ in COSTS.values() if title in shown]
    assert len(known) == 4 and not any(shown[title].is_largest_first for title in known)


PSNR = make_record().scores["psnr"].model_copy(update={"median": inf})
PERFECT = make_record().model_copy(update={"scores": make_record().scores | {"psnr": PSNR}})
RANKED = [
    record for name, shift in (("a", 0.02), ("b", 0), ("c", 0)) for record in of_three_seeds(name, shift, ord(name))
]
TWO_SEEDS = [with_job(make_record("two", id=str(seed)), seed=seed) for seed in range(2)]


@pytest.mark.parametrize(
    ("records", "label", "title", "text", "value"),
    [
        *(
            ([make_record(), external("lofo-24.25GHz")], "theirs (external)", title, "–", nan)
            for title in ("fit s", "parameters")
        ),
        ([PERFECT], "nearest", "PSNR (dB)", "∞", inf),
        (RANKED, "a", "rank", "1", 1.0001),
        (RANKED, "b", "rank", "2–3", 2.0003),
        ([*RANKED, make_record("one")], "one", "rank", "one seed", nan),
        ([*RANKED, *TWO_SEEDS], "two", "rank", "2 seeds", nan),
        ([*RANKED, make_record()], "nearest", "rank", "no samples", nan),
    ],
)
def test_a_cell_has_a_text_and_what_it_is_sorted_by(
    records: list, label: str, title: str, text: str, value: float
) -> None:
    shown, rows = columns_of(records, ("rank", "psnr", *COSTS))
    assert (shown[title].text(rows[label]), shown[title].value(rows[label])) == (
        text,
        pytest.approx(value, nan_ok=True),
    )


def test_one_split_has_one_column_of_its_name_and_several_have_an_average_too() -> None:
    alone, _ = columns_of([make_record(split=SPLITS[0])], BRIEF)
    assert "average" not in alone and alone["2.4GHz"].is_board_order
    several, _ = columns_of(make_records(), BRIEF)
    assert several["average"].is_board_order and not several["2.4GHz"].is_board_order


def test_what_no_record_tells_has_no_column() -> None:
    shown, _ = columns_of([external()], (*BRIEF[:-1], *COSTS))
    assert not {title for title, *_ in COSTS.values()} & shown.keys()


def test_it_reads_a_folder_and_prints_as_the_command_does(tmp_path: Path) -> None:
    shown = xb.leaderboard(store(tmp_path, *make_records()))
    assert repr(shown) == str(shown) == shown._repr_markdown_() == str(Leaderboard(tuple(make_records())))
    assert repr(xb.leaderboard(tmp_path / "records.jsonl")) == repr(shown)
    with pytest.raises(DataError, match="does not exist"):
        xb.leaderboard(tmp_path / "nowhere")


def test_a_data_frame_has_the_columns_of_the_reports_as_numbers() -> None:
    frame = Leaderboard(tuple(make_records())).to_pandas()
    titles = {*map(metric_title, METRICS), "method", "best rank", "worst rank", "mean", "10th pct.", "skill", "± seeds"}
    titles |= {"seeds", "fit s", "ms/map", "peak MiB", "parameters", "trained on"}
    where = {"scene", "protocol", "maps", "data", "budget", "splits"}
    assert titles <= set(frame.columns)
    assert set(frame.columns) - titles - where <= {f"{title} {end}" for title in titles for end in ("low", "high")}
    ours = frame.set_index("method").loc["ours"]
    assert (ours["scene"], ours["splits"]) == ("office", SPLITS)
    assert ours["SSIM"] == pytest.approx(0.95)
    assert ours["skill"] == pytest.approx(0.5)
    assert frame["parameters"].tolist() == [1234] * 5
    assert frame["SSIM"].is_monotonic_decreasing


def test_intervals_and_ranks_are_numbers_of_their_own() -> None:
    frame = Leaderboard((*of_three_seeds("ours", 0.05, 1), *of_three_seeds("theirs", 0.0, 9))).to_pandas()
    assert frame[["best rank", "worst rank"]].to_numpy().tolist() == [[1, 1], [2, 2]]
    assert (frame["SSIM low"] < frame["SSIM"]).all() and (frame["SSIM"] < frame["SSIM high"]).all()


def test_without_pandas_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(XFreqBenchError, match=r'pip install "xfreqbench\[notebooks\]"'):
        Leaderboard(tuple(make_records())).to_pandas()


def test_records_of_before_a_metric_was_added_are_reported_without_it(tmp_path: Path) -> None:
    older, newer = make_record("nearest", 0.8), make_record("ours", 0.9)
    older = older.model_copy(update={"scores": {"ssim": older.scores["ssim"]}})
    results = store(tmp_path, older, newer)
    rows = {row["method"]: row for row in csv_tables(boards([older, newer]))["scores"]}
    title = metric_title("psnr")
    assert title in rows["ours"] and title not in {name for name, value in rows["nearest"].items() if value == value}
    write_report(read_results(results), tmp_path / "report.md")
    write_page(results, tmp_path / "page.html")
