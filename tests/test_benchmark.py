from __future__ import annotations

import re
import shutil
from pathlib import Path

from xfreqbench.report import write_report
from xfreqbench.report_figures import FIGURES_FOLDER

ROOT = Path(__file__).parents[1]


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


def test_every_row_of_the_leaderboards_in_the_readme_stands_in_the_benchmark() -> None:
    marked = re.findall(
        r"<!-- leaderboard -->(.*?)<!-- /leaderboard -->", (ROOT / "README.md").read_text(), re.S
    )
    rows = [line for block in marked for line in block.splitlines() if line.startswith("|")]
    assert rows
    benchmark = (ROOT / "BENCHMARK.md").read_text().splitlines()
    assert [row for row in rows if row not in benchmark] == []
