from __future__ import annotations

import math
import re
import subprocess
import sys
import warnings
from collections import Counter
from pathlib import Path

import pytest

from tests.support.forked import command_line
from xfreqbench.bench.stress import run as stress
from xfreqbench.bench.stress.case import StressCase
from xfreqbench.bench.tables import Bench
from xfreqbench.errors import UnknownNameError
from xfreqbench.runs.records import read

pytestmark = pytest.mark.usefixtures("one_thread")


def case_of(error: float, name: str = "made up") -> StressCase:
    return StressCase(name, "tests", 1e-3, "rad", lambda: error)


def raising() -> float:
    raise ValueError("no\nnumber")


def warning() -> float:
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)
    return 0.0


@pytest.mark.parametrize("case", stress.cases(), ids=lambda case: f"{case.area}: {case.name}")
def test_the_code_keeps_to_its_reference(case: StressCase) -> None:
    verdict = case.judge()
    assert verdict.is_within, f"{verdict.error} {case.unit}, limit {case.limit}; {verdict.fault}"


def test_every_area_is_there_and_every_name_once() -> None:
    names = Counter((case.area, case.name) for case in stress.cases())
    assert len(names) >= 40
    assert set(names.values()) == {1}
    areas = {area for area, _ in names}
    assert {"phase", "maps", "composite", "footprints", "materials", "geometry"} < areas


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
    assert not stress.bench_stress(Bench("stress", "command", said.append, records), None)
    assert [line.split(" | ")[1] for line in said if line.startswith("| ")] == ["bad", "broken", "good"]
    assert said[-1] == "3 cases, 2 FAILED: bad; broken"
    (record,) = read(records).benches
    assert record.bench == "stress"
    assert [row[-1] for row in record.rows] == ["FAILED", "FAILED ValueError: no number", "ok"]


def test_a_selection_takes_areas_and_parts_of_names() -> None:
    assert {case.area for case in stress.selected("Footprints")} >= {"footprints"}
    assert all("94 GHz" in case.name for case in stress.selected("94 ghz"))
    with pytest.raises(UnknownNameError, match=r"'none'.*composite, .*training"):
        stress.selected("none")


def test_the_command_prints_a_line_for_each_case_and_their_number() -> None:
    command = [command_line(), "bench", "stress", "--only", "encoding"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    *_, last = lines = done.stdout.splitlines()
    rows = [line for line in lines if re.fullmatch(r"\| encoding \| .* \| ok \|", line)]
    assert len(rows) > 3
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
