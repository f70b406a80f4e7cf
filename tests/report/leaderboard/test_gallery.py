"""What the gallery says of pictures that it does not have."""

from __future__ import annotations

import fcntl
from pathlib import Path

import pytest

import xfreqbench as xb
from tests.support.synthetic import paper_dataset
from xfreqbench.cli.main import app
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.gallery import gallery, open_data


@pytest.mark.parametrize("on", ["test", "validation"])
def test_the_command_that_stores_missing_predictions_makes_the_same_records(tmp_path: Path, on: str) -> None:
    data = paper_dataset(tmp_path / "data.h5")
    asked = {"results": tmp_path / "results", "targets_ghz": [24.25], "on": on}
    (record,) = xb.run(data, "nearest", **asked)  # type: ignore[arg-type]
    (board,) = boards([record])
    command = gallery(board, []).missing.split("`")[1].split()
    assert command[:1] == ["xfreqbench"]
    _, given, _ = app.parse_args(command[1:], exit_on_error=False, print_error=False, help_on_error=False)
    again = {"protocol": "lofo", "on": "test"} | given.arguments
    (split,) = xb.make_splits(data, again["protocol"], [24.25], again["on"])
    assert split.sha256 == record.split_sha256


def test_data_that_another_program_holds_open_are_passed_over(tmp_path: Path) -> None:
    data = paper_dataset(tmp_path / "data.h5")
    (board,) = boards(xb.run(data, "nearest", results=tmp_path / "results", targets_ghz=[24.25]))
    assert open_data(board) is not None
    with data.path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # as HDF5 does to write
        assert open_data(board) is None
