from __future__ import annotations

import shutil
from pathlib import Path

from xfreqbench.report import FIGURES_FOLDER, write_report

ROOT = Path(__file__).parents[1]


def test_the_benchmark_is_what_its_committed_records_say(tmp_path: Path) -> None:
    shutil.copy(ROOT / "BENCHMARK.md", tmp_path)
    written = write_report(ROOT / "baselines" / "reference_results.jsonl", tmp_path / "BENCHMARK.md")
    for path in written:
        committed = ROOT / path.relative_to(tmp_path)
        if path.suffix == ".md":  # a figure's bytes depend on the fonts and the version of matplotlib
            assert path.read_bytes() == committed.read_bytes()
        else:
            assert committed.parent.name == FIGURES_FOLDER
            assert committed.exists()
