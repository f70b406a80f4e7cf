from __future__ import annotations

import base64
import json
import math
import multiprocessing
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st
from pydantic_core import from_json

from tests.support.fuzzing.common import cut_or_flipped, fuzz, refusal
from tests.support.leaderboard_records import make_bench
from tests.support.stored_records import make_record, make_summary
from xfreqbench.errors import DataError
from xfreqbench.methods.contract import Budget
from xfreqbench.runs.records import BenchRecord, CurvePoint, External, Job, RunRecord, append, pack, read
from xfreqbench.runs.sealed import SEAL, SealedModel, content_sha256


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "records.jsonl"


def test_records_come_back_in_order_with_jobs_curves_and_infinite_scores(path: Path) -> None:
    counts = {"gaussians": 1024}
    assert read(path).records == ()
    infinite = make_summary(math.inf).model_copy(update={"mean": math.nan})
    job = Job("data.h5", "nearest", "lofo", "lofo-1GHz", ("a=1",), seed=3, budget=Budget(5, 1.5))
    curve = tuple(CurvePoint(step=1, seconds=0.5, loss=loss, ssim=0.4, share=0.5) for loss in (math.nan, 0.1))
    append(path, make_record(scores={"psnr": infinite}, job=job, curve=curve, counts=counts))
    append(path, make_record("line-of-sight"))
    stored = read(path)
    first, second = stored.records
    assert (first.job, second.job.method, first.counts, stored.num_truncated) == (job, "line-of-sight", counts, 0)
    assert first.scores["psnr"].median == math.inf and math.isnan(first.scores["psnr"].mean)
    assert math.isnan(first.curve[0].loss) and first.curve[1] == curve[1]


def test_numbers_are_those_that_are_stored(path: Path) -> None:
    """To 1e-4 where there are many of a kind; findings to 1e-7, and small ones to three digits."""
    ssim_by_tx = ((0.1234, -0.5), (1.0,), tuple(np.linspace(-0.5, 0.7468, 1001).round(4).tolist()))
    findings = {"planes": [{"distance_m": 2.59996491812, "std_m": 1.70976e-05}], "blend": "none"}
    summary = make_summary(0.123456789)
    record = make_record(scores={"ssim": summary}, ssim_by_tx=ssim_by_tx, findings=findings, cell_of_tx=(2, 0, 1))
    append(path, record)
    assert read(path).records == (record,)
    assert (record.ssim_by_tx, record.cell_of_tx) == (ssim_by_tx, (2, 0, 1))
    assert record.scores["ssim"].median == 0.12345679
    np.testing.assert_allclose(record.scores["ssim"].quantiles, summary.quantiles, atol=0.5e-4)
    assert record.findings == {"planes": [{"distance_m": 2.5999649, "std_m": 1.71e-05}], "blend": "none"}


def test_a_list_of_what_is_infinite_or_far_is_not_packed() -> None:
    for number in (math.inf, math.nan, 1e9):
        assert pack([0.5, number], 1e-4)[0] == 0.5


def test_a_line_that_a_kill_cut_off_is_counted_and_replaced_by_the_next_record(path: Path) -> None:
    append(path, make_record())
    path.write_bytes(path.read_bytes() + path.read_bytes()[:100])
    assert (len(read(path).records), read(path).num_truncated) == (1, 1)
    append(path, make_record("line-of-sight"))
    assert [record.job.method for record in read(path).records] == ["nearest", "line-of-sight"]
    assert read(path).num_truncated == 0


BOM = b"\xef\xbb\xbf"
JOURNEYS = {
    "no end of the last line": lambda raw: raw[:-1],
    "line ends of Windows": lambda raw: raw.replace(b"\n", b"\r\n"),
    "line ends of Windows, the last cut": lambda raw: raw.replace(b"\n", b"\r\n")[:-1],
    "line ends of old": lambda raw: raw.replace(b"\n", b"\r"),
    "a byte order mark": lambda raw: BOM + raw,
    "a byte order mark in an empty file": lambda raw: BOM,
    "blank lines": lambda raw: b"\n \n" + raw.replace(b"\n", b"\n\n") + b" ",
    "two lines joined": lambda raw: raw.replace(b"\n", b"", 1),
    "all lines joined": lambda raw: raw.replace(b"\n", b""),
}


@pytest.mark.parametrize("journey", JOURNEYS)
def test_whole_records_survive_a_journey_and_what_is_appended_after_it(path: Path, journey: str) -> None:
    for record in (make_record(), make_bench(), make_record("line-of-sight")):
        append(path, record)
    content = JOURNEYS[journey](path.read_bytes())
    methods, benches = ([], 0) if content == BOM else (["nearest", "line-of-sight"], 1)
    for more in ([], ["k-nearest"]):
        path.write_bytes(content)
        for method in more:
            append(path, make_record(method))
        assert path.read_bytes().startswith(content)
        stored = read(path)
        assert [record.job.method for record in stored.records] == methods + more
        assert (len(stored.benches), stored.num_truncated) == (benches, 0)


@pytest.mark.parametrize(
    "end",
    [
        pytest.param(make_record().sealed_json().replace(b"2026-01-01", b"2026-01-02"), id="changed"),
        pytest.param(make_record().sealed_json()[:100] + b"\0" * 50, id="zeros of a disk that lost power"),
        pytest.param(b'{"foo":1,"b', id="another program's"),
        pytest.param(b"note to myself", id="text"),
    ],
)
def test_a_last_line_that_is_neither_whole_nor_half_a_record_is_refused_and_stays(path: Path, end: bytes) -> None:
    append(path, make_record())
    content = path.read_bytes() + end
    path.write_bytes(content)
    for use in (lambda: read(path), lambda: append(path, make_record("k-nearest"))):
        with pytest.raises(DataError, match="line 2, is no run record"):
            use()
        assert path.read_bytes() == content


def test_what_a_kill_leaves_of_a_line_is_told_from_a_whole_one_wherever_it_was_cut(path: Path) -> None:
    whole = make_record(findings={"µ": ['é "\\', -1e-7, True]}).sealed_json()
    for end in range(1, len(whole) + 1):
        path.write_bytes(whole[:end])
        stored = read(path)
        assert (len(stored.records), stored.num_truncated) == ((1, 0) if end == len(whole) else (0, 1)), whole[:end]


def test_five_hundred_damages_lose_no_whole_record(path: Path) -> None:
    for record in (make_record(), make_bench(), make_record("line-of-sight", findings={"µ": ['é "\\', -1e-7]})):
        append(path, record)
    content = path.read_bytes()
    whole = [line.rstrip() for line in content.splitlines()]
    ends = st.sampled_from([b"", b"\n", b"\r\n", b"\r", b"\n\n", b"\xef\xbb\xbf", b"\0"])
    lines = st.lists(st.tuples(st.sampled_from([*whole, whole[0][:90], b"{}"]), ends), max_size=4)
    composed = lines.map(lambda parts: b"".join(line + end for line, end in parts))

    def check(damaged: bytes) -> None:
        path.write_bytes(damaged)
        if refusal(lambda: read(path)):
            return
        before = read(path)
        assert len(before.records) + len(before.benches) == sum(map(damaged.count, whole))
        append(path, make_record("k-nearest"))
        after = read(path)
        assert after.records[:-1] == before.records and after.benches == before.benches
        assert (after.records[-1].job.method, after.num_truncated) == ("k-nearest", 0)

    fuzz(500, cut_or_flipped(content) | composed, check)


def _append_many(path, method):
    for _ in range(20):
        append(path, make_record(method))


def test_two_processes_append_whole_lines(path: Path) -> None:
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=_append_many, args=(path, name)) for name in ("nearest", "line-of-sight")]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert len(read(path).records) == 40


def edited(record: SealedModel, place: str, value: object) -> str:
    """The record as a line of JSON with one field changed, and with the hash that it then has."""
    content = json.loads(record.model_dump_json())
    *parents, last = [int(name) if name.isdigit() else name for name in place.split(".")]
    part = content
    for name in parents:
        part = part[name]
    part[last] = value
    line = json.dumps(content)
    return f'{line[:-1]}, "{SEAL}": "{content_sha256(from_json(line))}"}}\n'


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("split_sha256", "nothing hexadecimal"),
        ("split_sha256", "b" * 65),
        ("dataset_sha256", ""),
        ("num_test", 10**400),
        ("num_test", 0),
        ("fit_seconds", "NaN"),
        ("fit_seconds", -1.0),
        ("predict_ms_per_map", "Infinity"),
        ("nearest_trained_m", -0.5),
        ("ssim_by_tx", [["NaN"]]),
        ("ssim_by_tx", [[]]),
        ("ssim_by_tx", ["", ""]),
        ("ssim_by_tx.0", pack([2], 1)),
        ("ssim_by_tx.0", ""),
        ("ssim_by_tx.0", "?"),
        ("ssim_by_tx.0", "AAAA"),
        ("ssim_by_tx.0", pack([0.5, 0.25], 1e-4)[:-8]),
        ("ssim_by_tx.0", base64.b64encode(zlib.compress(b"123")).decode()),
        ("cell_of_tx", "?"),
        ("cell_of_tx", [-1]),
        ("job", None),
        ("curve.0.seconds", "NaN"),
        ("curve.0.seconds", -1.0),
        ("curve.0.ssim", "Infinity"),
        ("job.budget.max_steps", 0),
        ("job.budget.max_seconds", "NaN"),
        ("external.sha256", "abc"),
    ],
)
def test_a_field_that_no_run_writes_is_refused_by_file_line_and_field(path: Path, place: str, value: object) -> None:
    point = CurvePoint(step=1, seconds=0.5, loss=0.1, ssim=0.4, share=1)
    whole = make_record(curve=(point,), ssim_by_tx=((0.9,),), external=External(sha256="a" * 64))
    append(path, make_record())
    path.write_text(path.read_text(encoding="utf-8") + edited(whole, place, value), encoding="utf-8")
    with pytest.raises(DataError, match=rf"records\.jsonl, line 2, is no run record: {place.partition('.')[0]}"):
        read(path)


def test_a_table_with_other_cells_than_columns_is_refused(path: Path) -> None:
    for place, value in (("rows.0", ["image"]), ("columns", []), ("note", None)):
        path.write_text(edited(make_bench(), place, value).replace('{"bench": ', '{"bench":'), encoding="utf-8")
        with pytest.raises(DataError, match=r"records\.jsonl, line 1, is no run record"):
            read(path)


def test_a_line_without_its_hash_is_refused(path: Path) -> None:
    path.write_text(make_record().model_dump_json() + "\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"line 1, .*it has no content_sha256.*Delete the line"):
        read(path)


@pytest.mark.parametrize("record", [make_record(), make_bench()], ids=["run", "bench"])
def test_a_record_that_was_changed_afterwards_is_refused(path: Path, record: RunRecord | BenchRecord) -> None:
    append(path, record)
    append(path, record)
    stored = read(path)
    assert [*stored.records, *stored.benches] == [record, record]
    first, second = path.read_text(encoding="utf-8").splitlines()
    assert list(json.loads(second))[-1] == "content_sha256"
    path.write_text(f"{first}\n{second.replace('2026-01-01', '2026-01-02')}\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"line 2, .*it was changed after it was written.*Delete the line"):
        read(path)


def test_a_record_whose_median_is_not_that_of_its_own_samples_is_refused_though_its_hash_holds(path: Path) -> None:
    whole = make_record(ssim_by_tx=((0.2, 0.90004), (1.0,)))  # samples have four decimals
    append(path, whole)
    assert len(read(path).records) == 1
    path.write_text(edited(whole, "scores.ssim.median", 0.95), encoding="utf-8")
    with pytest.raises(DataError, match=r"line 1, .*median is 0\.95000, but the median of ssim_by_tx is 0\.90000"):
        read(path)


def test_of_a_file_that_has_grown_only_new_lines_are_parsed(path: Path) -> None:
    append(path, make_record("nearest"))
    append(path, make_bench())
    before = read(path)
    append(path, make_record("k-nearest"))
    after = read(path, before)
    assert after == read(path) and len(after.records) == 2
    assert after.records[0] is before.records[0] and after.benches[0] is before.benches[0]
    path.write_text(path.read_text(encoding="utf-8").replace("2026-01-01", "2026-01-02", 1), encoding="utf-8")
    with pytest.raises(DataError, match=r"line 1, .*it was changed after it was written"):
        read(path, after)


def test_the_hash_of_a_record_does_not_depend_on_how_its_json_is_spaced(path: Path) -> None:
    infinite = make_record(scores={"psnr": make_summary(math.inf)}, findings={"size": 1e-7, "µ": [1, None]})
    append(path, infinite)
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")), sort_keys=True) + "\n", encoding="utf-8")
    assert read(path).records == (infinite,)


def test_a_summary_has_a_hundred_and_one_quantiles() -> None:
    with pytest.raises(ValueError, match="quantiles"):
        make_summary(0.5).model_validate(make_summary(0.5).model_dump() | {"quantiles": [0.0] * 100})


def test_a_file_of_something_else_is_told_what_records_are(tmp_path: Path) -> None:
    path = tmp_path / "data.h5"
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(DataError, match=r"data\.h5 is no file of records, which are lines of JSON\. Give a"):
        read(path)
