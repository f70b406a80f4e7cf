from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from xfreqbench.report.leaderboard.plots import TimePanel, plot_error_against_time


def test_error_against_time_is_equal_bytes_for_equal_curves(tmp_path: Path) -> None:
    panel = TimePanel({"ours": [(1.0, 0.5), (10.0, 0.7)]}, front=[(10.0, 0.7)], trivial=0.6)
    for name, panels in (
        ("a", {"x": panel}),
        ("b", {"x": panel}),
        ("c", {"x": replace(panel, trivial=None)}),
    ):
        plot_error_against_time(panels, tmp_path / f"{name}.svg")
    a, b, c = ((tmp_path / f"{name}.svg").read_text() for name in "abc")
    assert a == b != c
    assert "best trivial predictor" in a and "best trivial predictor" not in c
