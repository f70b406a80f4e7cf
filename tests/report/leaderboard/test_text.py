"""The leaderboard as Python shows it: the numbers of the report, in a shell, in a notebook, and in a data frame."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import xfreqbench as xb
from tests.support.leaderboard_records import make_records, of_three_seeds
from tests.support.stored_records import SPLITS, store
from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.maps.metrics import METRICS
from xfreqbench.report.leaderboard.columns import metric_title
from xfreqbench.report.leaderboard.tables import Leaderboard


def of(*records: object) -> Leaderboard:
    return Leaderboard(records)  # type: ignore[arg-type]


def test_it_reads_a_folder_and_prints_as_the_command_does(tmp_path: Path) -> None:
    shown = xb.leaderboard(store(tmp_path, *make_records()))
    assert repr(shown) == str(shown) == shown._repr_markdown_() == str(Leaderboard(tuple(make_records())))
    assert repr(xb.leaderboard(tmp_path / "records.jsonl")) == repr(shown)
    with pytest.raises(DataError, match="does not exist"):
        xb.leaderboard(tmp_path / "nowhere")


def test_a_data_frame_has_the_columns_of_the_reports_as_numbers() -> None:
    frame = of(*make_records()).to_pandas()
    titles = {*map(metric_title, METRICS), "method", "best rank", "worst rank", "mean", "10th pct.", "skill", "± seeds"}
    titles |= {"seeds", "fit s", "ms/map", "peak MiB", "parameters", "trained on"}
    where = {"scene", "protocol", "maps", "data", "budget", "splits"}
    assert titles <= set(frame.columns)
    assert set(frame.columns) - titles - where <= {f"{title} {end}" for title in titles for end in ("low", "high")}
    ours = frame.set_index("method").loc["ours"]
    assert (ours["scene"], ours["splits"]) == ("office", SPLITS)
    assert ours["SSIM"] == pytest.approx(0.95)
    assert ours["skill"] == pytest.approx(0.5)
    assert frame["parameters"].tolist() == [1234] * 5
    assert frame["SSIM"].is_monotonic_decreasing


def test_intervals_and_ranks_are_numbers_of_their_own() -> None:
    frame = of(*of_three_seeds("ours", 0.05, 1), *of_three_seeds("theirs", 0.0, 9)).to_pandas()
    assert frame[["best rank", "worst rank"]].to_numpy().tolist() == [[1, 1], [2, 2]]
    assert (frame["SSIM low"] < frame["SSIM"]).all() and (frame["SSIM"] < frame["SSIM high"]).all()


def test_without_pandas_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(XFreqBenchError, match=r'pip install "xfreqbench\[notebooks\]"'):
        of(*make_records()).to_pandas()
