"""Records as a Parquet table: the same records come back, and damage is named."""

from __future__ import annotations

import math
from pathlib import Path

import pyarrow
import pyarrow.parquet
import pytest

from tests.support.damage import flip
from tests.support.leaderboard_records import make_bench
from tests.support.stored_records import make_record, make_summary
from xfreqbench.errors import DataError
from xfreqbench.runs.folder import read_records
from xfreqbench.runs.record_table import read_table, write_table
from xfreqbench.runs.records import CurvePoint, External, StoredRecords


@pytest.fixture
def stored() -> StoredRecords:
    ssim_by_tx = ((0.1234, -0.5), (1.0,))
    curve = (CurvePoint(step=1, seconds=0.5, loss=math.inf, ssim=0.4, share=0.5),)
    scores = {"ssim": make_summary(0.1234), "psnr": make_summary(3.0)}
    first = make_record(scores=scores, ssim_by_tx=ssim_by_tx, curve=curve)
    external = External(sha256="a" * 64, url="https://example.org")
    second = make_record(
        "theirs", scene="[a room]", scores=scores, external=external, findings={"planes": [1.5]}, fit_seconds=None
    )
    return StoredRecords((first, second), (make_bench("stress"),))


@pytest.fixture
def path(stored: StoredRecords, tmp_path: Path) -> Path:
    write_table(tmp_path / "records.parquet", stored)
    return tmp_path / "records.parquet"


def test_the_same_records_come_back(stored: StoredRecords, path: Path) -> None:
    assert (read_table(path).records, read_table(path).benches) == (stored.records, stored.benches)
    assert read_records(path) == stored.records


def test_what_is_damaged_or_something_else_is_refused(path: Path) -> None:
    other = path.with_name("other.parquet")
    columns = pyarrow.parquet.ParquetFile(path).metadata.row_group(0)
    (ssim,) = [each for each in map(columns.column, range(columns.num_columns)) if each.path_in_schema[:4] == "ssim"]
    end = ssim.data_page_offset + ssim.total_compressed_size
    pyarrow.parquet.write_table(pyarrow.table({"a": [1]}), other)
    for refused, change in (
        (path, lambda: flip(path, end - 1)),
        (path, lambda: path.write_bytes(path.read_bytes()[:-9])),
        (other, lambda: None),
    ):
        change()
        with pytest.raises(DataError, match="is damaged, or no table of records"):
            read_table(refused)


def test_a_row_that_is_no_record_is_named(path: Path) -> None:
    table = pyarrow.parquet.read_table(path)
    seeds = table.set_column(table.column_names.index("step"), "step", [[1, -5, None]])
    pyarrow.parquet.write_table(seeds, path)
    with pytest.raises(DataError, match=r"row 1, is no record: step: Input should be greater than or equal to 0"):
        read_table(path)
