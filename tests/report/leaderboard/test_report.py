from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.leaderboard_records import make_bench, make_followed, make_records
from xfreqbench.errors import DataError, OutputExistsError, StorageError
from xfreqbench.report.leaderboard.report import BEGIN, END, write_report
from xfreqbench.runs.records import append


def store_all(folder):
    for record in (*make_records(), make_followed(), make_bench(), make_bench("render", "Splatting", figure=None)):
        append(folder / "records.jsonl", record)


def test_the_same_records_give_the_same_bytes(tmp_path: Path) -> None:
    store_all(tmp_path / "results")
    for name in ("a", "b"):
        write_report(tmp_path / "results", tmp_path / name / "BENCHMARK.md")
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*"))
    assert [path.suffix for path in files] == [".csv", ".csv", ".md", ".svg", ".svg"]
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_report_links_its_figures(tmp_path: Path) -> None:
    store_all(tmp_path)
    output, *beside = write_report(tmp_path, tmp_path / "BENCHMARK.md").paths
    figures = [path for path in beside if path.suffix == ".svg"]
    for path in beside:
        assert f"]({path.relative_to(tmp_path).as_posix()})" in output.read_text()
    assert [path.name for path in figures] == [
        "office-lofo-1-aaaaaaaa-64steps-time.svg",
        "bench-generate-error-against-run-time.svg",
    ]
    time, bench = (figure.read_text() for figure in figures)
    assert "ours (≤ 64 steps)" in time
    assert "ms a sample" in bench


def test_half_a_line_at_the_end_of_the_records_is_told_and_changes_nothing(tmp_path: Path) -> None:
    store_all(tmp_path)
    output = tmp_path / "BENCHMARK.md"
    assert write_report(tmp_path, output).num_truncated == 0
    whole = output.read_bytes()
    with (tmp_path / "records.jsonl").open("a") as file:
        file.write('{"id": "cut o')
    assert write_report(tmp_path, output).num_truncated == 1
    assert output.read_bytes() == whole


def test_several_folders_are_ranked_together_and_each_run_counts_once(tmp_path: Path) -> None:
    store_all(tmp_path / "all")
    lines = (tmp_path / "all" / "records.jsonl").read_text().splitlines(keepends=True)
    for name, part in (("one", lines[:8]), ("other", lines[5:])):  # some runs are in both
        (tmp_path / name).mkdir()
        (tmp_path / name / "records.jsonl").write_text("".join(part))
    (together, *_), (alone, *_) = (
        write_report(given, tmp_path / f"{name}.md").paths
        for name, given in (("two", [tmp_path / "one", tmp_path / "other"]), ("all", tmp_path / "all"))
    )
    assert together.read_text().replace("two-", "all-") == alone.read_text()
    with pytest.raises(DataError, match=r"empty.* holds no records"):
        write_report([tmp_path / "one", tmp_path / "empty"], tmp_path / "none.md")


@pytest.mark.parametrize("scene", ["measurements", "b"])
def test_two_pages_are_never_one_file(tmp_path: Path, scene: str) -> None:
    for record in make_records():
        append(tmp_path / "records.jsonl", record.model_copy(update={"scene": scene}))
    with pytest.raises(OutputExistsError, match="Two pages of the report"):
        write_report(tmp_path, tmp_path / "pages" / "b.md", tmp_path / "pages")
    assert not (tmp_path / "pages").exists()


def test_text_outside_the_markers_is_kept(tmp_path: Path) -> None:
    store_all(tmp_path)
    output = tmp_path / "BENCHMARK.md"
    output.write_text(f"# Ours\n\nRead this.\n\n{BEGIN}\nold\n{END}\n\nAnd that.\n")
    write_report(tmp_path, output)
    text = output.read_text()
    assert text.startswith(f"# Ours\n\nRead this.\n\n{BEGIN}")
    assert text.endswith(f"{END}\n\nAnd that.\n")
    assert "\nold\n" not in text


def test_a_report_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds no records"):
        write_report(tmp_path, tmp_path / "BENCHMARK.md")


def test_a_file_that_is_no_text_is_not_overwritten(tmp_path: Path) -> None:
    store_all(tmp_path)
    output = tmp_path / "data.h5"
    output.write_bytes(b"\x89HDF\r\n\xff")
    with pytest.raises(OutputExistsError, match="not a text"):
        write_report(tmp_path, output)
    assert output.read_bytes() == b"\x89HDF\r\n\xff"


def test_a_folder_is_no_place_for_a_report(tmp_path: Path) -> None:
    store_all(tmp_path)
    with pytest.raises(StorageError, match="is a folder"):
        write_report(tmp_path, tmp_path)
    assert not (tmp_path / "figures").exists()


def test_a_figure_of_somebody_else_is_left_and_named(tmp_path: Path) -> None:
    store_all(tmp_path)
    theirs = tmp_path / "figures" / "office-lofo-1-aaaaaaaa-64steps-time.svg"
    theirs.parent.mkdir()
    theirs.write_bytes(b"<svg>mine</svg>")
    with pytest.raises(OutputExistsError, match=r"aaaaaaaa-64steps-time\.svg exists and is no figure of"):
        write_report(tmp_path, tmp_path / "BENCHMARK.md")
    assert theirs.read_bytes() == b"<svg>mine</svg>"
    assert [path.name for path in theirs.parent.iterdir()] == [theirs.name]
    assert not (tmp_path / "BENCHMARK.md").exists()
    theirs.unlink()
    for _ in range(2):
        assert theirs in write_report(tmp_path, tmp_path / "BENCHMARK.md").paths
