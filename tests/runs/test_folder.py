"""One folder holds records, predictions and checkpoints, and is asked for all of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.stored_records import make_record
from xfreqbench.errors import ClusterError, DataError
from xfreqbench.runs import folder as folder_module
from xfreqbench.runs.folder import ResultsFolder, read_records
from xfreqbench.runs.predictions import write_predictions
from xfreqbench.runs.records import RunRecord, append


def store_predictions(folder: ResultsFolder, record: RunRecord, split_sha256: str | None = None) -> None:
    write_predictions(
        folder.predictions_path(record.id),
        [(np.arange(2), np.ones((2, 3, 4), np.float32))],
        num_rows=2,
        grid_shape=(3, 4),
        dataset_sha256=record.dataset_sha256,
        split_sha256=split_sha256 or record.split_sha256,
    )


def test_records_are_read_once_and_again_only_after_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reads = []
    read = folder_module.read
    monkeypatch.setattr(folder_module, "read", lambda *given: reads.append(1) or read(*given))
    folder = ResultsFolder(tmp_path)
    assert folder.records == ()
    folder.append(make_record("nearest"))
    assert [record.job.method for record in (*folder.records, *folder.records)] == ["nearest"] * 2
    assert len(reads) == 1
    (nearest,) = folder.records
    append(folder.records_path, make_record("line-of-sight"))  # as another process does
    assert [record.job.method for record in folder.records] == ["nearest", "line-of-sight"]
    assert folder.records[0] is nearest, "what was read before is not parsed again"
    assert len(reads) == 2


def test_results_are_a_folder_or_a_file_of_any_name(tmp_path: Path) -> None:
    append(tmp_path / "records.jsonl", make_record("nearest"))
    append(tmp_path / "mine.jsonl", make_record("line-of-sight"))
    assert [record.job.method for record in read_records(tmp_path)] == ["nearest"]
    assert [record.job.method for record in read_records(tmp_path / "mine.jsonl")] == ["line-of-sight"]
    assert read_records(str(tmp_path / "absent")) == ()
    file, whole = ResultsFolder.holding(tmp_path / "mine.jsonl"), ResultsFolder.holding(tmp_path)
    assert file.predictions_path("a") == whole.predictions_path("a")


def test_a_run_is_finished_when_its_record_and_its_predictions_are_stored(tmp_path: Path) -> None:
    folder, early = ResultsFolder(tmp_path), make_record()
    late = make_record(time_utc="2026-02-01T00:00:00+00:00")
    folder.append(early)
    folder.append(late)
    assert folder.finished(early.id) is None
    store_predictions(folder, early)
    assert folder.finished(early.id) == late
    assert folder.finished("another") is None


def test_a_record_is_kept_with_its_predictions_alone_and_its_checkpoints_go(tmp_path: Path) -> None:
    folder, record = ResultsFolder(tmp_path), make_record()
    checkpoint = folder.checkpoints(record.id).path / ".1.partial"
    checkpoint.mkdir(parents=True)
    with pytest.raises(ClusterError, match=r"its predictions are not at .*predictions"):
        folder.keep(record)
    assert folder.records == () and checkpoint.exists()
    store_predictions(folder, record)
    folder.keep(record)
    assert folder.records == (record,)
    assert not checkpoint.parent.exists()
    without = folder.keep(record, with_predictions=False)
    assert without.removed_predictions_sha256 and folder.finished(record.id) == without
    assert folder.predictions_paths() == []
    with pytest.raises(DataError, match="were removed after they were scored"):
        folder.predictions(without)


def test_predictions_that_are_absent_or_of_another_split_are_refused(tmp_path: Path) -> None:
    folder, record = ResultsFolder(tmp_path), make_record()
    with pytest.raises(DataError, match=r"are not at .*predictions"):
        folder.predictions(record)
    store_predictions(folder, record)
    assert folder.predictions(record).path == folder.predictions_path(record.id)
    assert folder.predictions_paths() == [folder.predictions_path(record.id)]
    store_predictions(folder, record, "c" * 64)
    with pytest.raises(DataError, match="another split"):
        folder.predictions(record)
