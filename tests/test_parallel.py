from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from xfreqbench.parallel import all_cores, own_cores, side_by_side

ROOT = Path(__file__).parents[1]
PARENT = """
import sys, time
from parallel_calls import note_and_sleep
from xfreqbench.parallel import own_cores, side_by_side
if __name__ == "__main__":
    for _ in side_by_side(note_and_sleep, [sys.argv[1]], own_cores()):
        pass
"""
CALLS = """
import os, pathlib, time
def note_and_sleep(path):
    pathlib.Path(path).write_text(str(os.getpid()))
    time.sleep(60)
"""


pytestmark = pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity"), reason="processes are kept to no core here"
)


def _cores_of_call(argument: int) -> tuple[int, tuple[int, ...]]:
    return argument, tuple(sorted(os.sched_getaffinity(0)))


def _fails_on_two(argument: int) -> int:
    if argument == 2:
        raise ValueError("two")
    return argument


def test_every_call_has_a_core_to_itself() -> None:
    places = own_cores()
    found = [future.result() for _, future in side_by_side(_cores_of_call, [1, 2, 3], places)]
    assert sorted(argument for argument, _ in found) == [1, 2, 3]
    for _, cores in found:
        assert frozenset(cores) in places
        assert len(cores) == 1


def test_one_place_may_hold_every_core() -> None:
    ((_, future),) = side_by_side(_cores_of_call, [1], all_cores())
    assert set(future.result()[1]) == os.sched_getaffinity(0)


def test_a_call_that_fails_stops_no_other() -> None:
    outcomes = {
        argument: future.exception()
        for argument, future in side_by_side(_fails_on_two, [1, 2, 3], own_cores())
    }
    assert {argument for argument, error in outcomes.items() if error} == {2}


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_calls_end_with_the_process_that_made_them(tmp_path: Path, sent: signal.Signals) -> None:
    (tmp_path / "parent.py").write_text(PARENT)
    (tmp_path / "parallel_calls.py").write_text(CALLS)
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{tmp_path}"}
    with subprocess.Popen(
        [sys.executable, "parent.py", str(tmp_path / "child")],
        cwd=tmp_path,
        env=environment,
        stderr=subprocess.DEVNULL,
    ) as parent:
        child = int(_text_of(tmp_path / "child"))
        parent.send_signal(sent)
        parent.wait(timeout=20)
    deadline_s = time.monotonic() + 20
    while _runs(child) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert not _runs(child)


def _text_of(path: Path) -> str:
    deadline_s = time.monotonic() + 60
    while time.monotonic() < deadline_s:
        if path.exists() and path.read_text():
            return path.read_text()
        time.sleep(0.05)
    raise TimeoutError(path)


def _runs(process: int) -> bool:
    status = Path(f"/proc/{process}/stat")
    try:
        return status.read_text().rpartition(")")[2].split()[0] != "Z"  # ended, its parent gone
    except FileNotFoundError:
        return False
