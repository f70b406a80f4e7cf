from __future__ import annotations

import re
import shutil
from pathlib import Path

from places import ROOT

import xfreqbench as xb
from xfreqbench.report.leaderboard.figures import FIGURES_FOLDER
from xfreqbench.report.leaderboard.report import write_report


def test_the_benchmark_is_what_its_committed_records_say(tmp_path: Path) -> None:
    shutil.copy(ROOT / "BENCHMARK.md", tmp_path)
    written = write_report(ROOT / "baselines" / "reference_results.jsonl", tmp_path / "BENCHMARK.md")
    assert written.num_truncated == 0
    for path in written.paths:
        committed = ROOT / path.relative_to(tmp_path)
        if path.suffix == ".md":  # a figure's bytes depend on the fonts and the version of matplotlib
            assert path.read_bytes() == committed.read_bytes()
        else:
            assert committed.parent.name == FIGURES_FOLDER
            assert committed.exists()


def test_the_leaderboard_in_the_readme_is_what_the_committed_records_say() -> None:
    (marked,) = re.findall(
        r"<!-- leaderboard -->(.*?)<!-- /leaderboard -->", (ROOT / "README.md").read_text("utf-8"), re.S
    )
    printed = str(xb.leaderboard(ROOT / "baselines" / "reference_results.jsonl"))
    assert marked.count("\n| ") > 10
    assert marked.strip() in printed
