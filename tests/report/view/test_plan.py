"""What is refused before anything of a data set is shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.damage import data_offset, flip
from tests.support.synthetic import write_dataset
from xfreqbench.errors import DataError
from xfreqbench.report.view.plan import plan_view
from xfreqbench.report.view.write import write_view


def test_a_damaged_data_set_is_not_shown(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5")
    flip(dataset.path, data_offset(dataset.path, "pas"))
    with pytest.raises(DataError, match=r"is damaged.*dataset 'pas'"):
        write_view(plan_view(str(dataset.path)), tmp_path / "out")
    assert not list(tmp_path.glob("out/*"))
