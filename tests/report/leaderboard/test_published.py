from __future__ import annotations

from tests.support.stored_records import external, make_record
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.published import published_content, sources_of, stands_for


def test_every_method_that_is_named_after_a_system_says_whose_it_is() -> None:
    methods = ("gsrf", "wrf-gs-plus", "wideband-3dgs", "swift-wrf", "xfreq-gs", "nearest")
    (board,) = boards([make_record(method) for method in methods])
    sources = sources_of(board.rows)
    assert {method for source in sources for method in source["methods"]} >= set(methods[:-1])
    assert all(source[kind].startswith("https://") for source in sources for kind in ("paper", "program"))
    assert not sources_of([row for row in board.rows if row.job.method == "nearest"])


def test_an_external_row_has_no_published_counterpart() -> None:
    (counterpart,) = [each for each in published_content()["counterpart"] if each["name"] == "GSRF"]
    rows = boards([external(method="gsrf"), make_record("gsrf")])[0].rows
    assert {row.is_external: stands_for(counterpart, row) for row in rows} == {True: False, False: True}
