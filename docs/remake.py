"""Makes BENCHMARK.md, docs/results and the table of README.md again, from the records that lie in `baselines/`.

    python docs/remake.py [--page page.html] [RESULTS FOLDER …]

With results folders, as `xfreqbench benchmark` leaves them, their records first replace those of
`baselines/reference_results.jsonl`, and their maps those that are shipped beside them. Run it then where the benchmark
was run: maps are shipped with the truth, which is read from the data sets where they lay.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from xfreqbench.report.leaderboard.columns import BRIEF
from xfreqbench.report.leaderboard.overview import first_comparison, short_ranking
from xfreqbench.report.leaderboard.page import write_page
from xfreqbench.report.leaderboard.paper import ship_maps
from xfreqbench.report.leaderboard.report import BEGIN, END, WrittenReport, write_report
from xfreqbench.report.leaderboard.results import read_results, results_at

ROOT = Path(__file__).resolve().parents[1]
RECORDS = [ROOT / "baselines" / f"{name}_results.jsonl" for name in ("reference", "paper_size", "unseen_rooms")]
BY_HAND = "paper-size.md"  # among the pages of results
# What is generated in BENCHMARK.md has marks of its own, so that no other `xfreqbench report` replaces it.
MARKS = {BEGIN: "<!-- docs/remake.py: begin -->", END: "<!-- docs/remake.py: end -->"}
TABLE = re.compile(r"(?<=<!-- leaderboard -->\n).*?(?=\n<!-- /leaderboard -->)", re.DOTALL)


def take(folders: list[Path]) -> None:
    """Replace the reference records by those of results folders, and the maps beside them."""
    ship_maps(folders, RECORDS[0].with_name("reference_results_maps.jsonl"))
    RECORDS[0].write_bytes(b"".join((folder / "records.jsonl").read_bytes() for folder in folders))


def remake(root: Path, page: Path | None = None) -> WrittenReport:
    """Make the pages below `root`, and the web page; pages of results that are made no more are removed."""
    found, details = read_results(RECORDS), root / "docs" / "results"
    page_md = root / "BENCHMARK.md"
    _replace(page_md, {ours: theirs for theirs, ours in MARKS.items()})
    try:
        written = write_report(found, page_md, details, results_at("v1"))
    finally:
        _replace(page_md, MARKS)
    for path in set(details.rglob("*.*")) - set(written.paths):
        if path.name != BY_HAND:
            path.unlink()
    office = next(board for board in found.boards if board.title.startswith("office · lofo · power maps · quick"))
    shown = short_ranking(first_comparison(office), BRIEF).split("\n\n")
    table = next(part for part in shown if part.startswith("| "))
    readme = root / "README.md"
    readme.write_text(TABLE.sub(lambda _: table, readme.read_text("utf-8")), "utf-8")
    if page is not None:
        write_page(found, page, results_at("v1"))
    return written


def _replace(path: Path, texts: dict[str, str]) -> None:
    content = path.read_text("utf-8")
    for before, after in texts.items():
        content = content.replace(before, after)
    path.write_text(content, "utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    if given.folders:
        take(given.folders)
    remake(ROOT, given.page)
