from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.leaderboard_records import make_bench, make_followed, make_records, rows_of
from tests.support.stored_records import make_record, store
from xfreqbench.errors import DataError, OutputExistsError, StorageError
from xfreqbench.maps.metrics import METRICS
from xfreqbench.report.leaderboard.columns import metric_title
from xfreqbench.report.leaderboard.report import BEGIN, END, report_text, write_report
from xfreqbench.report.leaderboard.results import read_results


def test_the_same_records_give_the_same_bytes_of_files_that_the_report_links(tmp_path: Path) -> None:
    benches = make_bench(), make_bench("render", "Splatting", figure=None)
    results = store(tmp_path / "results", *make_records(), make_followed(), *benches)
    written = [write_report(results, tmp_path / name / "B.md") for name in "ab"]
    output, *beside = written[0]
    assert [path.name for path in beside] == [
        "office-lofo-1-aaaaaaaa-64steps-time.svg",
        "bench-generate-error-against-run-time.svg",
        "B-scores.csv",
        "B-curves.csv",
    ]
    for path, again in zip(*written, strict=True):
        assert path.read_bytes() == again.read_bytes()
    for path in beside:
        assert f"]({path.relative_to(output.parent).as_posix()})" in output.read_text()
    time, bench = (figure.read_text() for figure in beside[:2])
    assert "ours (≤ 64 steps)" in time and "ms a sample" in bench


def test_without_a_file_the_report_has_every_metric_and_row_in_itself_and_nothing_is_written(tmp_path: Path) -> None:
    bench = make_bench(rows=tuple((f"setting {number}", "1.5") for number in range(40)))
    results = store(tmp_path / "results", *make_records(), make_followed(), bench)
    before = set(tmp_path.rglob("*"))
    text = report_text(results)
    assert set(tmp_path.rglob("*")) == before
    assert "](" not in text and "| setting 39 " in text
    ranking, others, *_ = rows_of(text, "ours")
    assert ranking["24.25GHz"] == "0.9500"
    titles = {metric_title(name) for name in METRICS if name not in ("ssim", "aoa_error")}
    assert titles | {"mean", "10th pct."} <= others.keys()


def test_half_a_line_at_the_end_of_the_records_is_told_and_changes_nothing(tmp_path: Path) -> None:
    output = tmp_path / "B.md"
    write_report(store(tmp_path, *make_records()), output)
    assert read_results(tmp_path).num_truncated == 0
    whole = output.read_bytes()
    with (tmp_path / "records.jsonl").open("a") as file:
        file.write('{"id": "cut o')
    write_report(tmp_path, output)
    assert read_results(tmp_path).num_truncated == 1
    assert output.read_bytes() == whole


def test_several_folders_are_ranked_together_and_each_run_counts_once(tmp_path: Path) -> None:
    lines = (store(tmp_path / "all", *make_records()) / "records.jsonl").read_text().splitlines(keepends=True)
    for name, part in (("one", lines[:8]), ("other", lines[5:])):  # some runs are in both
        (tmp_path / name).mkdir()
        (tmp_path / name / "records.jsonl").write_text("".join(part))
    (together, *_), (alone, *_) = (
        write_report(given, tmp_path / f"{name}.md")
        for name, given in (("two", [tmp_path / "one", tmp_path / "other"]), ("all", tmp_path / "all"))
    )
    assert together.read_text().replace("two-", "all-") == alone.read_text()
    with pytest.raises(DataError, match=r"empty does not exist"):
        write_report([tmp_path / "one", tmp_path / "empty"], tmp_path / "none.md")


@pytest.mark.parametrize("scene", ["measurements", "b"])
def test_two_pages_are_never_one_file(tmp_path: Path, scene: str) -> None:
    with pytest.raises(OutputExistsError, match="Two pages of the report"):
        write_report(store(tmp_path, make_record(scene=scene)), tmp_path / "pages" / "b.md", tmp_path / "pages")
    assert not (tmp_path / "pages").exists()


def test_text_outside_the_markers_is_kept(tmp_path: Path) -> None:
    output = tmp_path / "B.md"
    output.write_text(f"# Ours\n\nRead this.\n\n{BEGIN}\nold\n{END}\n\nAnd that.\n")
    write_report(store(tmp_path, *make_records()), output)
    text = output.read_text()
    assert text.startswith(f"# Ours\n\nRead this.\n\n{BEGIN}")
    assert text.endswith(f"{END}\n\nAnd that.\n")
    assert "\nold\n" not in text


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("B.md", b"\x89HDF\r\n\xff", "is not a text"),
        ("figures/office-lofo-1-aaaaaaaa-64steps-time.svg", b"<svg>mine</svg>", "is no figure of"),
        ("B-scores.csv", b"mine", "is no table of ours"),
        ("all/office.md", b"my notes on the office", "has no generated part"),
    ],
)
def test_a_file_of_somebody_else_is_left_and_named_and_nothing_is_written(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    results, theirs = store(tmp_path / "results", *make_records(), make_followed()), tmp_path / "out" / name
    theirs.parent.mkdir(parents=True)
    theirs.write_bytes(content)
    with pytest.raises(OutputExistsError, match=f"{theirs.name} exists and {words}"):
        write_report(results, tmp_path / "out" / "B.md", theirs.parent if theirs.parent.name == "all" else None)
    assert theirs.read_bytes() == content
    assert [path for path in (tmp_path / "out").rglob("*") if path.is_file()] == [theirs]


def test_a_folder_is_no_place_for_a_report(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="is a folder"):
        write_report(store(tmp_path, *make_records(), make_followed()), tmp_path)
    assert not (tmp_path / "figures").exists()
