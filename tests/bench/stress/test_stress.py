from __future__ import annotations

import math
import re
import subprocess
import sys
import warnings
from collections import Counter
from pathlib import Path

import pytest
import torch

from tests.support.forked import command_line
from xfreqbench.bench.stress import run as stress
from xfreqbench.bench.stress.case import NothingToCompareError, StressCase, needing_two_threads
from xfreqbench.errors import UnknownNameError
from xfreqbench.methods.splatting import composite_kernels
from xfreqbench.runs.records import read

pytestmark = pytest.mark.usefixtures("one_thread")


def case_of(error: float, name: str = "made up") -> StressCase:
    return StressCase(name, "tests", 1e-3, "rad", lambda: error)


def raising() -> float:
    raise ValueError("no\nnumber")


def on_a_lesser_machine() -> float:
    raise NothingToCompareError("one thread")


def warning() -> float:
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)
    return 0.0


@pytest.mark.parametrize("case", stress.cases(), ids=lambda case: f"{case.area}: {case.name}")
def test_the_code_keeps_to_its_reference(case: StressCase) -> None:
    verdict = case.judge()
    if verdict.is_skipped:
        pytest.skip(verdict.fault)
    assert verdict.is_within, f"{verdict.error} {case.unit}, limit {case.limit}; {verdict.fault}"


def test_every_area_is_there_and_every_name_once() -> None:
    names = Counter((case.area, case.name) for case in stress.cases())
    assert len(names) >= 40
    assert set(names.values()) == {1}
    areas = {area for area, _ in names}
    assert {"phase", "maps", "scores", "composite", "footprints", "materials", "seeds", "geometry"} < areas


@pytest.mark.parametrize(
    ("error", "is_within"), [(0.0, True), (1e-3, True), (1.1e-3, False), (math.inf, False), (math.nan, False)]
)
def test_an_error_keeps_its_limit_or_fails(error: float, is_within: bool) -> None:
    verdict = case_of(error).judge()
    assert verdict.is_within == is_within
    assert verdict.cells[-1] == ("ok" if is_within else "FAILED")


@pytest.mark.parametrize(
    ("run", "words"), [(raising, "FAILED ValueError: no number"), (warning, "FAILED RuntimeWarning: overflow")]
)
def test_what_is_raised_or_warned_of_fails_in_one_line(run: object, words: str) -> None:
    verdict = StressCase("made up", "tests", math.inf, "rad", run).judge()  # type: ignore[arg-type]
    assert not verdict.is_within
    assert verdict.cells[-1] == words


def test_a_failed_case_stops_nothing_and_is_told_at_the_end(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made_up = (case_of(1.0, "bad"), StressCase("broken", "tests", 1, "rad", raising), case_of(0.0, "good"))
    monkeypatch.setattr(stress, "cases", lambda: made_up)
    said: list[str] = []
    records = tmp_path / "records.jsonl"
    assert not stress.stress(None, records, said.append)
    assert [line.split()[1] for line in said[1:-1]] == ["bad", "broken", "good"]
    assert said[-1] == "3 cases, 2 FAILED: bad; broken"
    (record,) = read(records).benches
    assert record.bench == "stress"
    assert [row[-1] for row in record.rows] == ["FAILED", "FAILED ValueError: no number", "ok"]


def test_a_skipped_case_neither_fails_nor_passes_and_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made_up = (StressCase("two threads", "tests", 1, "rad", on_a_lesser_machine), case_of(0.0, "good"))
    monkeypatch.setattr(stress, "cases", lambda: made_up)
    said: list[str] = []
    records = tmp_path / "records.jsonl"
    assert stress.stress(None, records, said.append)
    assert said[-1] == "2 cases, 1 skipped, all others within limits"
    (record,) = read(records).benches
    assert [row[-1] for row in record.rows] == ["skipped: one thread", "ok"]
    assert not made_up[0].judge().is_within


def test_one_thread_is_not_compared_with_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    before = composite_kernels.use_threads(1)
    monkeypatch.setattr(composite_kernels, "NUMBA_NUM_THREADS", 1)
    verdict = StressCase("made up", "tests", 0, "rad", needing_two_threads(lambda: 0.0)).judge()
    monkeypatch.undo()
    composite_kernels.use_threads(before)
    assert verdict.is_skipped


def test_a_selection_takes_areas_and_parts_of_names() -> None:
    assert {case.area for case in stress.selected("Footprints")} >= {"footprints"}
    assert all("94 GHz" in case.name for case in stress.selected("94 ghz"))
    with pytest.raises(UnknownNameError, match=r"'none'.*composite, .*seeds"):
        stress.selected("none")


def test_the_command_prints_a_line_for_each_case_and_their_number() -> None:
    command = [command_line(), "bench", "stress", "--only", "encoding"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    *rows, last = done.stdout.splitlines()[1:]
    assert len(rows) > 3
    assert all(re.search(r"^encoding .* ok$", row) for row in rows)
    assert last == f"{len(rows)} cases, all within limits"


def test_a_failed_command_ends_with_code_1() -> None:
    program = """
from xfreqbench.cli import main as cli
from xfreqbench.bench.stress import run as stress
from xfreqbench.bench.stress.case import StressCase
stress.cases = lambda: (StressCase("bad", "made up", 0, "rad", lambda: 1.0),)
cli.app(["bench", "stress"])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert done.stdout.endswith("1 case, 1 FAILED: bad\n")


def test_cases_leave_the_number_of_threads_as_it_was() -> None:
    for case in stress.selected("thread"):
        case.judge()
    assert torch.get_num_threads() == 1
