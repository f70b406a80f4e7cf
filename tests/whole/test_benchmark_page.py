from __future__ import annotations

import shutil
from pathlib import Path
from runpy import run_path

import pytest
from matplotlib.figure import Figure

from tests.support.places import ROOT
from xfreqbench.runs.folder import read_records

DETAILS = Path("docs") / "results"


@pytest.mark.slow
def test_the_benchmark_is_what_its_committed_records_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for what its figures show, whose bytes depend on the fonts and the version of matplotlib."""
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **_: Path(path).touch())
    for name in ("BENCHMARK.md", "README.md"):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(ROOT / DETAILS, tmp_path / DETAILS)
    made = run_path(str(ROOT / "docs" / "remake.py"))
    assert sum(len(read_records(path)) for path in made["RECORDS"]) == 2123
    written = made["remake"](tmp_path)
    assert {path.relative_to(tmp_path) for path in written} == {
        Path("BENCHMARK.md"),
        *(path.relative_to(ROOT) for path in (ROOT / DETAILS).rglob("*.*") if path.name != "paper-size.md"),
    }
    for path in (*written, tmp_path / "README.md"):
        if path.parent.name != "figures":
            assert path.read_bytes() == (ROOT / path.relative_to(tmp_path)).read_bytes()


def test_the_benchmark_is_read_in_ten_minutes() -> None:
    assert len((ROOT / "BENCHMARK.md").read_text("utf-8").splitlines()) <= 200
