"""How long threads of OpenMP that wait keep their core: `xfreqbench bench load` measures what it is good for."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from xfreqbench.system import waiting, workers

NAMES = "GOMP_SPINCOUNT", "OMP_WAIT_POLICY"


@pytest.mark.parametrize(
    ("num_running", "spins"), [(1, "1001"), (os.cpu_count(), "1001"), (os.cpu_count() + 1, "1")]
)
@pytest.mark.parametrize("parents", ["1", "1001"])
def test_threads_spin_where_no_other_program_wants_their_core(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, num_running: int, spins: str, parents: str
) -> None:
    monkeypatch.setenv("GOMP_SPINCOUNT", parents)
    (tmp_path / "loadavg").write_text(f"0.20 0.18 0.12 {num_running}/80 11206\n")
    monkeypatch.setattr(waiting, "_LOAD", tmp_path / "loadavg")
    waiting.choose_spinning()
    assert os.environ["GOMP_SPINCOUNT"] == spins


@pytest.mark.parametrize("content", [None, "", "0.20 0.18 0.12 some/80"])
def test_where_nothing_tells_the_load_threads_spin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str | None
) -> None:
    monkeypatch.setenv("GOMP_SPINCOUNT", "1")
    if content is not None:
        (tmp_path / "loadavg").write_text(content)
    monkeypatch.setattr(waiting, "_LOAD", tmp_path / "loadavg")
    waiting.choose_spinning()
    assert os.environ["GOMP_SPINCOUNT"] == "1001"


@pytest.mark.parametrize("spins", ["0", "7", "infinite", "many"])
def test_what_the_user_says_stands(monkeypatch: pytest.MonkeyPatch, spins: str) -> None:
    monkeypatch.setenv("GOMP_SPINCOUNT", spins)
    waiting.choose_spinning()
    assert os.environ["GOMP_SPINCOUNT"] == spins


@pytest.mark.parametrize(
    ("given", "then"),
    [
        ({}, "1001"),
        ({"OMP_WAIT_POLICY": "passive"}, "0"),
        ({"OMP_WAIT_POLICY": "ACTIVE"}, "infinite"),
        ({"GOMP_SPINCOUNT": "7"}, "7"),
    ],
)
def test_the_package_lets_threads_spin_for_a_moment_unless_told_otherwise(
    given: dict[str, str], then: str
) -> None:
    environment = {name: text for name, text in os.environ.items() if name not in NAMES} | given
    program = "import xfreqbench, os; print(os.environ['GOMP_SPINCOUNT'])"
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == then


def test_new_processes_choose_by_the_load_of_their_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "_is_busy", lambda: True)
    monkeypatch.setattr(workers, "_end_with_parent", lambda: None)
    monkeypatch.setenv("GOMP_SPINCOUNT", "1001")
    workers._settle(frozenset(), is_alone=True)
    assert os.environ["GOMP_SPINCOUNT"] == "1"
