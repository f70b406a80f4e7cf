from __future__ import annotations

import pytest

from tests.support.leaderboard_records import leaderboard_markdown, make_records, rows_of
from tests.support.stored_records import SPLITS, external, make_record
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.published import PUBLISHED_TITLE, sources_of
from xfreqbench.report.leaderboard.tables import csv_tables

XFREQ = {"sees_carrier": True, "footprint": "projected"}


def test_a_method_has_what_was_published_of_it_beside_it_on_the_same_splits() -> None:
    records = [make_record("xfreq-gs", 0.9, split, config=XFREQ) for split in SPLITS]
    summary, *of_splits = [
        row for row in csv_tables(boards([*make_records(), *records]))["scores"] if row["method"] == "xfreq-gs"
    ]
    assert summary["published, other data"] == "XFreq-GS 0.9098"
    assert [row["published, other data"] for row in of_splits] == [
        "XFreq-GS 0.9085",
        "XFreq-GS 0.8977",
        "XFreq-GS 0.9232",
    ]
    assert rows_of(leaderboard_markdown([*make_records(), *records]), "ours")[0]["published, other data"] == ""


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
    records = [make_record("xfreq-gs", 0.9, f"sparse-24.25GHz-from-{name}", "sparse", config=XFREQ) for name in names]
    summary = rows_of(leaderboard_markdown(records), "xfreq-gs")[0]
    assert summary["published, other data"] == "XFreq-GS 0.7381 / 0.7642 / 0.8554"


def test_nothing_was_published_of_an_average_over_other_splits() -> None:
    records = [make_record("xfreq-gs", 0.9, split, config=XFREQ) for split in (*SPLITS, "lofo-94GHz")]
    assert "published, other data" not in rows_of(leaderboard_markdown(records), "xfreq-gs")[0]


def test_every_method_that_is_named_after_a_system_says_whose_it_is() -> None:
    methods = ("gsrf", "wrf-gs-plus", "wideband-3dgs", "swift-wrf", "xfreq-gs", "nearest")
    (board,) = boards([make_record(method) for method in methods])
    sources = sources_of(board.rows)
    assert {method for source in sources for method in source["methods"]} >= set(methods[:-1])
    assert all(source[kind].startswith("https://") for source in sources for kind in ("paper", "program"))
    assert not sources_of([row for row in board.rows if row.job.method == "nearest"])


def test_an_external_row_has_no_published_counterpart() -> None:
    theirs = leaderboard_markdown([external(split, method="xfreq-gs") for split in SPLITS])
    ours = leaderboard_markdown([make_record("xfreq-gs", 0.9, split) for split in SPLITS])
    assert PUBLISHED_TITLE not in rows_of(theirs, "xfreq-gs (external)")[0]
    assert rows_of(ours, "xfreq-gs")[0][PUBLISHED_TITLE] == "XFreq-GS 0.9098"
