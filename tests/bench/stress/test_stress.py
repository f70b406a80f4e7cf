from __future__ import annotations

import math
import re
import warnings
from collections import Counter
from pathlib import Path

import pytest

from tests.support.fuzzing.common import xfreqbench
from xfreqbench.bench.stress import continuity
from xfreqbench.bench.stress import run as stress
from xfreqbench.bench.stress.case import StressCase
from xfreqbench.errors import UnknownNameError
from xfreqbench.runs.records import read
from xfreqbench.scene.toml_files import shipped_scenes

pytestmark = pytest.mark.usefixtures("one_thread")


def raising() -> float:
    raise ValueError("no\nnumber")


def warning() -> float:
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)
    return 0.0


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=[pytest.mark.slow] * (case.area == "continuity")) for case in stress.cases()],
    ids=lambda case: f"{case.area}: {case.name}",
)
def test_the_code_keeps_to_its_reference(case: StressCase, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(continuity, "NUM_STEPS", 50)  # 1,000 take minutes in scenes of meshes
    verdict = case.judge()
    assert verdict.is_within, f"{verdict.error} {case.unit}, limit {case.limit}; {verdict.fault}"


def test_every_area_is_there_and_every_name_once() -> None:
    names = Counter((case.area, case.name) for case in stress.cases())
    assert len(names) >= 40
    assert set(names.values()) == {1}
    areas = {area for area, _ in names}
    assert sum(area == "continuity" for area, _ in names) == len(shipped_scenes())
    assert {"phase", "maps", "composite", "footprints", "geometry"} < areas


def test_an_error_beyond_its_limit_an_exception_and_a_warning_fail_and_are_told_at_the_end(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    runs = {error: lambda error=error: error for error in (1e-3, 1.1e-3, math.inf, math.nan)}
    runs |= {"raises": raising, "warns": warning}
    made_up = tuple(StressCase(str(name), "tests", 1e-3, "rad", run) for name, run in runs.items())
    monkeypatch.setattr(stress, "cases", lambda: made_up)
    outcome = xfreqbench("bench", "stress", "-o", tmp_path / "records.jsonl")
    assert outcome.code == 1
    assert outcome.stdout.endswith("6 cases, 5 FAILED: 0.0011; inf; nan; raises; warns\n")
    (record,) = read(tmp_path / "records.jsonl").benches
    failed = ["FAILED"] * 3 + ["FAILED ValueError: no number", "FAILED RuntimeWarning: overflow"]
    assert [row[-1] for row in record.rows] == ["ok", *failed]


def test_a_selection_takes_areas_and_parts_of_names() -> None:
    assert {case.area for case in stress.selected("Footprints")} >= {"footprints"}
    assert all("94 GHz" in case.name for case in stress.selected("94 ghz"))
    with pytest.raises(UnknownNameError, match=r"'none'.*composite, .*training"):
        stress.selected("none")


def test_the_command_prints_a_line_for_each_case_and_their_number() -> None:
    *_, last = lines = xfreqbench("bench", "stress", "--only", "footprints").stdout.splitlines()
    rows = [line for line in lines if re.fullmatch(r"\| footprints \| .* \| ok \|", line)]
    assert len(rows) > 3
    assert last == f"{len(rows)} cases, all within limits"
