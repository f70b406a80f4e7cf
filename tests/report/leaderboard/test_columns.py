"""The columns of a leaderboard, and that Markdown and the page show the same of them."""

from __future__ import annotations

import re
from html import unescape
from math import inf, isnan
from pathlib import Path

from tests.support.leaderboard_records import leaderboard_markdown, make_records, of_three_seeds, rows_of, with_job
from tests.support.stored_records import SPLITS, external, make_record, store
from xfreqbench.maps.metrics import METRICS
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.columns import BRIEF, COSTS, columns, metric_title
from xfreqbench.report.leaderboard.comparison import Comparison
from xfreqbench.report.leaderboard.page import write_page


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
    cells = re.findall(r"<t[hd](?: scope=\"row\"| data-value)[^>]*>(.*?)</t[hd]>", table)
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


def test_an_unknown_number_is_a_dash_and_has_no_place_in_the_order() -> None:
    shown, rows = columns_of([make_record(), external("lofo-24.25GHz")], (*BRIEF[:-1], *COSTS))
    theirs = rows["theirs (external)"]
    for title, text in {"rank": "one seed", "fit s": "–", "parameters": "–"}.items():
        assert shown[title].text(theirs) == text
        assert isnan(shown[title].value(theirs))


def test_the_cell_of_the_rank_says_why_a_row_has_none() -> None:
    seeds = [with_job(make_record("two", id=str(seed)), seed=seed) for seed in range(2)]
    shown, rows = columns_of([*of_three_seeds("ours", 0.02, 10), make_record("one"), *seeds, make_record()], BRIEF)
    said = {label: shown["rank"].text(row) for label, row in rows.items()}
    assert said == {"ours": "1", "one": "one seed", "two": "2 seeds", "nearest": "no samples"}


def test_ranks_are_sorted_by_the_best_place_and_then_by_the_worst() -> None:
    records = [*of_three_seeds("a", 0.02, 10), *of_three_seeds("b", 0, 20), *of_three_seeds("c", 0, 30)]
    shown, rows = columns_of(records, (*BRIEF[:-1], *COSTS))
    ranks = {shown["rank"].text(row): shown["rank"].value(row) for row in rows.values()}
    assert ranks == {"1": 1.0001, "2–3": 2.0003}


def test_an_infinite_score_is_written_as_infinite() -> None:
    record = make_record()
    psnr = record.scores["psnr"].model_copy(update={"median": inf})
    perfect = record.model_copy(update={"scores": record.scores | {"psnr": psnr}})
    shown, rows = columns_of([perfect], ["psnr"])
    (row,) = rows.values()
    assert (shown["PSNR (dB)"].text(row), shown["PSNR (dB)"].value(row)) == ("∞", inf)


def test_one_split_has_one_column_of_its_name_and_several_have_an_average_too() -> None:
    alone, _ = columns_of([make_record(split=SPLITS[0])], BRIEF)
    assert "average" not in alone and alone["2.4GHz"].is_board_order
    several, _ = columns_of(make_records(), BRIEF)
    assert several["average"].is_board_order and not several["2.4GHz"].is_board_order


def test_what_no_record_tells_has_no_column() -> None:
    shown, _ = columns_of([external()], (*BRIEF[:-1], *COSTS))
    assert not {title for title, *_ in COSTS.values()} & shown.keys()
