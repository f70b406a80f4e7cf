"""Two results side by side: which rows are paired, and what is said of their difference."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.leaderboard_records import make_records, of_three_seeds, rows_of, with_job
from tests.support.stored_records import SPLITS, make_record, store
from xfreqbench.errors import DataError
from xfreqbench.report.leaderboard.side_by_side import compare_results
from xfreqbench.runs.records import RunRecord

SHIFT = 0.05


def numbers(cell: str) -> list[float]:
    return [float(number) for number in re.findall(r"[-+]?\d+\.\d+", cell)]


def first_row(tables: str, method: str) -> dict[str, str]:
    return rows_of(tables, method)[0]


def test_a_shift_of_every_map_is_found_with_its_interval(tmp_path: Path) -> None:
    a = store(tmp_path / "a", *of_three_seeds("ours", 0.0, 1))
    b = store(tmp_path / "b", *of_three_seeds("ours", SHIFT, 11))
    row = first_row(compare_results(a, b), "ours")
    difference, low, high = numbers(row["B − A, 95 % interval"])
    assert low < SHIFT < high
    assert low < difference < high
    assert high - low < SHIFT / 5  # transmitters differ by 0.02, but alike in both
    assert difference == pytest.approx(float(row["B"]) - float(row["A"]), abs=2e-4)
    assert (row["splits"], row["seeds"], row["B is"]) == ("24.25GHz", "3 and 3", "better")
    assert first_row(compare_results(b, a), "ours")["B is"] == "worse"
    with pytest.raises(DataError, match="Records are not compared with themselves"):
        compare_results(a, a)


def test_scores_and_costs_stand_side_by_side(tmp_path: Path) -> None:
    a = store(tmp_path / "a", make_record("ours", 0.9, fit_seconds=2.0))
    b = store(tmp_path / "b", make_record("ours", 0.8, fit_seconds=4.0))
    scores, costs = rows_of(compare_results(a, b), "ours")
    assert scores["B − A, 95 % interval"] == "-0.1000"  # without samples there is no interval
    assert scores["B is"] == "–"
    assert costs["fit s"] == "2.00 → 4.00"
    assert costs["wrapped SSIM"] == "0.9000 → 0.8000"


def test_averages_are_over_the_splits_of_both(tmp_path: Path) -> None:
    a = store(tmp_path / "a", *(make_record("ours", 0.5, split) for split in SPLITS))
    b = store(tmp_path / "b", *(make_record("ours", 0.7, split) for split in SPLITS[1:]))
    row = first_row(compare_results(a, b), "ours")
    assert row["splits"] == "24.25GHz, 77GHz"
    assert numbers(row["B − A, 95 % interval"]) == [0.2]


@pytest.mark.parametrize(
    ("of_a", "of_b", "paired", "alone"),
    [
        (("line-of-sight", "log-frequency", "nearest"), ("nearest", "theirs", "more"), ["nearest"], True),
        (("ours", "nearest"), ("ours (width=8)", "nearest"), ["ours and ours (width=8)", "nearest"], False),
        (("ours",), ("theirs",), ["ours and theirs"], False),
    ],
)
def test_rows_are_paired_by_label_then_by_method_and_at_last_the_only_ones(
    tmp_path: Path, of_a: tuple[str, ...], of_b: tuple[str, ...], paired: list[str], alone: bool
) -> None:
    folders = [
        store(tmp_path / name, *(labelled(label, best - nth / 10) for nth, label in enumerate(labels)))
        for name, best, labels in (("a", 0.9, of_a), ("b", 0.8, of_b))
    ]
    tables = compare_results(*folders)
    assert all(rows_of(tables, label) for label in paired)
    assert ("Only in A: line-of-sight, log-frequency." in tables) == ("Only in B: theirs, more." in tables) == alone


def labelled(label: str, ssim: float) -> RunRecord:
    method, _, option = label.rstrip(")").partition(" (")
    return with_job(make_record(method, ssim), overrides=(option,) if option else ())


def test_a_lone_row_is_the_reference_of_every_other_row(tmp_path: Path) -> None:
    trivial = [record for record in make_records() if record.job.method != "ours"]
    folder = store(tmp_path / "a", *of_three_seeds("ours", SHIFT, 1), *trivial)
    tables = compare_results(folder / "ours", folder)
    for method in ("nearest", "log-frequency"):
        assert first_row(tables, f"ours and {method}")["B is"] == "–"  # of one seed
    assert not rows_of(tables, "ours")  # not with itself
    assert "Only in" not in tables


def versions_of(method: str, *codes: str) -> list[RunRecord]:
    """Records of versions of a method, the oldest first, each better than the one before by `SHIFT`."""
    return [
        record.model_copy(
            update={"code_sha256": code * 64, "time_utc": f"2026-11-2{day}T10:02:00+00:00", "id": f"{code}{seed}"}
        )
        for day, code in enumerate(codes)
        for seed, record in enumerate(of_three_seeds(method, day * SHIFT, 1 + 10 * day))
    ]


def test_each_older_version_of_a_method_is_compared_with_the_newest(tmp_path: Path) -> None:
    versions = versions_of("ours", "a", "b", "c")
    folder = store(tmp_path / "results", *versions, *of_three_seeds("theirs", 0.0, 90))
    tables = compare_results(folder / "ours", folder)
    labels = [f"ours (2026-11-2{day} 10:02, code {code * 6})" for day, code in enumerate("abc")]
    for label, lost in zip(labels[:2], (2, 1), strict=True):
        row = first_row(tables, f"{label} and {labels[2]}")
        low, high = numbers(row["B − A, 95 % interval"])[1:]
        assert low < lost * SHIFT < high and row["B is"] == "better"
    assert not rows_of(tables, labels[2])
    assert "Only in B: theirs." in tables and "Only in A" not in tables

    earlier = store(tmp_path / "earlier", *versions[:3])  # an older state of the folder
    assert rows_of(compare_results(earlier, folder / "ours"), f"ours and {labels[2]}")


def test_a_version_of_a_method_is_named_by_the_hash_of_its_code(tmp_path: Path) -> None:
    folder = store(tmp_path / "results", *versions_of("ours", "a", "b"))
    for older, newer in (("ours@a", "ours@b"), (f"ours@{'a' * 6}", f"ours@{'b' * 64}")):
        row = first_row(compare_results(folder / older, folder / newer), "ours")
        assert row["B is"] == "better"
    expected = r"ours@bbbbbb \(2026-11-21 10:02\), ours@aaaaaa \(2026-11-20 10:02\)"
    for name in ("ours@c", "ours@"):
        with pytest.raises(DataError, match=f"newest first, it has {expected}"):
            compare_results(folder / name, folder)


def test_the_records_of_a_method_are_named_by_its_folder_and_its_name(tmp_path: Path) -> None:
    folder = store(tmp_path / "results", *make_records())
    tables = compare_results(folder / "nearest", folder / "ours")
    assert first_row(tables, "nearest and ours")["splits"].count("GHz") == 3
    methods = ", ".join(sorted({record.job.method for record in make_records()}))
    with pytest.raises(DataError, match=f"none of the methods of .*, which are {re.escape(methods)}, and begins"):
        compare_results(folder / "neerest", folder)


def test_a_record_is_named_by_its_folder_and_the_beginning_of_its_id(tmp_path: Path) -> None:
    folder = store(tmp_path / "results", *make_records())
    tables = compare_results(folder / "nearest-lofo-77", folder / "ours-lofo-77")
    assert numbers(first_row(tables, "nearest and ours")["B − A, 95 % interval"]) == [0.1]
    with pytest.raises(DataError, match=r"begins the ids of 3 records .* ours-lofo-2\.4GHz, ours-lofo-24"):
        compare_results(folder / "ours-lofo", folder)
    with pytest.raises(DataError, match=r"begins the ids of 0 records .* and 9 more"):
        compare_results(folder / "absent", folder)


def test_data_of_others_cannot_be_compared(tmp_path: Path) -> None:
    a = store(tmp_path / "a", make_record("ours"))
    b = store(tmp_path / "b", make_record("ours", dataset_sha256="c" * 64))
    with pytest.raises(DataError, match=r"data office@1-a{8}, versions 1 and 1 .*\(ours\).* data office@1-c{8}"):
        compare_results(a, b)
    later = store(tmp_path / "later", make_record("ours", metrics_version="9"))
    with pytest.raises(DataError, match="versions 1 and 9 of protocol and metrics"):
        compare_results(a, later)
    with pytest.raises(DataError, match="does not exist"):
        compare_results(a, tmp_path / "nowhere")


def test_other_samples_of_one_recipe_are_not_paired(tmp_path: Path) -> None:
    of_recipe = {"recipe": "1-" + "d" * 64}
    a = store(tmp_path / "a", make_record("ours", **of_recipe))
    others = {"dataset_sha256": "c" * 64, "split_sha256": "e" * 64}
    b = store(tmp_path / "b", make_record("ours", **of_recipe, **others))
    with pytest.raises(DataError, match="test other samples on the split"):
        compare_results(a, b)
