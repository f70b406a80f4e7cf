from __future__ import annotations

import json
import math
import multiprocessing
from pathlib import Path

import pytest
from stored_records import make_record, make_summary

from xfreqbench.errors import DataError, StorageError
from xfreqbench.methods.contract import Budget
from xfreqbench.runs.records import CurvePoint, Job, append, read


def test_records_come_back_in_order_with_infinite_scores(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    infinite = make_summary(math.inf).model_copy(update={"mean": math.nan})
    first = make_record(scores={"psnr": infinite})
    append(path, first)
    append(path, make_record("line-of-sight"))
    stored = read(path)
    assert [record.job.method for record in stored.records] == ["nearest", "line-of-sight"]
    assert stored.records[0].scores["psnr"].median == math.inf
    assert math.isnan(stored.records[0].scores["psnr"].mean)
    assert stored.records[0].job == first.job
    assert stored.num_truncated == 0


def test_a_job_comes_back_with_its_budget_and_options(tmp_path: Path) -> None:
    job = Job("data.h5", "nearest", "lofo", "lofo-1GHz", ("a=1",), seed=3, budget=Budget(5, 1.5))
    append(tmp_path / "records.jsonl", make_record().model_copy(update={"job": job}))
    assert read(tmp_path / "records.jsonl").records[0].job == job


def test_a_learning_curve_without_a_loss_comes_back(tmp_path: Path) -> None:
    points = (
        CurvePoint(step=1, seconds=0.5, loss=math.nan, ssim=0.4),
        CurvePoint(step=2, seconds=1, loss=0.1, ssim=0.5),
    )
    append(tmp_path / "records.jsonl", make_record(curve=points, counts={"gaussians": 1024}))
    (stored,) = read(tmp_path / "records.jsonl").records
    assert math.isnan(stored.curve[0].loss)
    assert stored.curve[1] == points[1]
    assert stored.counts == {"gaussians": 1024}


def test_a_record_from_before_curves_and_counts_is_still_read(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    content = json.loads(make_record().model_dump_json())
    del content["curve"], content["counts"]
    path.write_text(json.dumps(content) + "\n")
    (stored,) = read(path).records
    assert (stored.curve, stored.counts) == ((), {})


def test_a_record_with_the_intervals_of_version_0_1_is_still_read(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    content = json.loads(make_record().model_dump_json())
    for summary in content["scores"].values():
        summary["interval"] = [0.8, "Infinity"]
    path.write_text(json.dumps(content) + "\n")
    assert read(path).records == (make_record(),)


def test_no_file_holds_no_records(tmp_path: Path) -> None:
    assert read(tmp_path / "records.jsonl").records == ()


def test_a_broken_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    append(path, make_record())
    path.write_text(path.read_text() + '{"id": "x"}\n')
    append(path, make_record())
    with pytest.raises(DataError, match=r"records\.jsonl, line 2, is no run record: job"):
        read(path)


def test_a_line_that_a_kill_cut_off_is_counted_and_replaced_by_the_next_record(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    append(path, make_record())
    path.write_bytes(path.read_bytes() + path.read_bytes()[:100])
    assert (len(read(path).records), read(path).num_truncated) == (1, 1)
    append(path, make_record("line-of-sight"))
    assert [record.job.method for record in read(path).records] == ["nearest", "line-of-sight"]
    assert read(path).num_truncated == 0


def _append_many(path, method):
    for _ in range(20):
        append(path, make_record(method))


def test_two_processes_append_whole_lines(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    context = multiprocessing.get_context("spawn")
    workers = [
        context.Process(target=_append_many, args=(path, name)) for name in ("nearest", "line-of-sight")
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert len(read(path).records) == 40


def test_a_place_that_cannot_be_written_is_a_storage_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        append(tmp_path / "file" / "records.jsonl", make_record())


def test_a_summary_has_a_hundred_and_one_quantiles() -> None:
    with pytest.raises(ValueError, match="quantiles"):
        make_summary(0.5).model_validate(make_summary(0.5).model_dump() | {"quantiles": [0.0] * 100})
