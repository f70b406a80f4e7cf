from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import xfreqbench as xb
from tests.support.places import ROOT
from xfreqbench.report.leaderboard.figures import FIGURES_FOLDER
from xfreqbench.report.leaderboard.report import write_report

DETAILS = Path("docs") / "results"


@pytest.mark.slow
def test_the_benchmark_is_what_its_committed_records_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for what its figures show, whose bytes depend on the fonts and the version of matplotlib."""
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **_: Path(path).touch())
    shutil.copy(ROOT / "BENCHMARK.md", tmp_path)
    shutil.copytree(ROOT / DETAILS, tmp_path / DETAILS)
    records, pages = ROOT / "baselines", tmp_path / DETAILS
    reports = [
        write_report(
            [records / "reference_results.jsonl", records / "unseen_rooms_results.jsonl"],
            tmp_path / "BENCHMARK.md",
            pages,
        ),
        write_report(records / "paper_size_results.jsonl", pages / "paper-size.md"),
    ]
    assert not any(report.num_truncated for report in reports)
    written = [path for report in reports for path in report.paths]
    assert {path.relative_to(tmp_path) for path in written} == {
        Path("BENCHMARK.md"),
        *(path.relative_to(ROOT) for path in (ROOT / DETAILS).rglob("*.*")),
    }
    for path in written:
        if path.suffix == ".md":
            assert path.read_bytes() == (ROOT / path.relative_to(tmp_path)).read_bytes()
        else:
            assert path.parent.name == FIGURES_FOLDER


def test_the_benchmark_is_read_in_ten_minutes() -> None:
    assert len((ROOT / "BENCHMARK.md").read_text("utf-8").splitlines()) <= 250


def test_the_leaderboard_in_the_readme_is_what_the_committed_records_say() -> None:
    (marked,) = re.findall(
        r"<!-- leaderboard -->(.*?)<!-- /leaderboard -->", (ROOT / "README.md").read_text("utf-8"), re.S
    )
    printed = str(xb.leaderboard(ROOT / "baselines" / "reference_results.jsonl"))
    assert marked.count("\n| ") > 10
    assert marked.strip() in printed
