from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from queue import SimpleQueue

import pytest

from tests.support.places import ROOT
from xfreqbench.errors import ClusterError, OutOfMemoryError, XFreqBenchError
from xfreqbench.system import machine
from xfreqbench.system.processes import (
    MAX_DEATHS,
    LocalProcesses,
    all_cores,
    open_workers,
    own_cores,
    send_message,
    split_cores,
)
from xfreqbench.system.workers import InThisProcess, side_by_side

PARENT = """
import sys, time
from parallel_calls import note_and_sleep
from xfreqbench.system.processes import LocalProcesses, own_cores
from xfreqbench.system.workers import side_by_side
if __name__ == "__main__":
    imports = ["wave"] if sys.argv[2] == "forks" else []
    with LocalProcesses(own_cores(), imports=imports) as workers:
        for _ in side_by_side(workers, note_and_sleep, [sys.argv[1]]):
            pass
"""
CALLS = """
import os, pathlib, time
def note_and_sleep(path):
    pathlib.Path(path).write_text(str(os.getpid()))
    time.sleep(60)
"""

FORKS = """
import json, os, sys, time
from forked_calls import look
from xfreqbench.system.processes import LocalProcesses, all_cores, own_cores
from xfreqbench.system.workers import side_by_side
if __name__ == "__main__":
    one, both = own_cores(), all_cores()
    asked = (one, ["torch"]), (one, []), (one, ["wave"]), (both, ["torch"])
    for places, imports in asked[: int(sys.argv[1])]:
        os.environ["LOOKED_FOR"] = str(places)
        with LocalProcesses(places, is_fresh=True, imports=imports) as workers:
            seen = [future.result() for _, future in side_by_side(workers, look, range(2))]
        assert {tuple(answer["cores"]) for answer in seen} <= set(map(tuple, map(sorted, places)))
        assert {answer["environment"] for answer in seen} == {str(places)}
        assert len({answer["process"] for answer in seen}) == 2
        assert {answer["is_blocked"] for answer in seen} == {False}
        for answer in seen:
            assert answer["threads"] == [len(answer["cores"])] * len(answer["threads"])
        print({answer["had_torch"] for answer in seen})
"""
LOOK = """
import os, signal, sys
def look(argument):
    had_torch = "torch" in sys.modules
    import torch
    from threadpoolctl import threadpool_info
    return {
        "process": os.getpid(), "cores": sorted(os.sched_getaffinity(0)), "had_torch": had_torch,
        "environment": os.environ["LOOKED_FOR"],
        "threads": [torch.get_num_threads(), *(library["num_threads"] for library in threadpool_info())],
        "is_blocked": signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []),
    }
"""

pytestmark = pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="processes are kept to no core here")


def _cores_of_call(argument: int) -> tuple[int, tuple[int, ...]]:
    return argument, tuple(sorted(os.sched_getaffinity(0)))


def _fails_on_two(argument: int) -> int:
    if argument == 2:
        raise ValueError("two")
    return argument


def _dies_on_two(argument: int) -> int:
    if argument == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def _dies_once(mark: str) -> str:
    if not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def _ends_as_if_all_were_well(argument: int) -> None:
    send_message(argument, "said")
    os._exit(0)


def test_a_process_that_ends_itself_is_an_error_and_what_it_said_is_heard() -> None:
    heard = SimpleQueue[tuple[int, str]]()
    with LocalProcesses(all_cores(), on_message=lambda *said: heard.put(said)) as workers:
        ((_, future),) = side_by_side(workers, _ends_as_if_all_were_well, [7])
    with pytest.raises(ClusterError, match="ended itself with exit status 0"):
        future.result()
    assert heard.get() == (7, "said")
    assert heard.empty()  # it was not called again


@pytest.mark.parametrize(("places", "num_cores"), [(own_cores(), 1), (all_cores(), len(own_cores()))])
def test_every_call_has_the_cores_of_its_place(places: Sequence[frozenset[int]], num_cores: int) -> None:
    assert frozenset().union(*places) == os.sched_getaffinity(0)
    with LocalProcesses(places) as workers:
        found = [future.result() for _, future in side_by_side(workers, _cores_of_call, [1, 2, 3])]
    assert sorted(argument for argument, _ in found) == [1, 2, 3]
    assert {frozenset(cores) for _, cores in found} <= {*places}
    assert {len(cores) for _, cores in found} == {num_cores}


def test_cores_are_dealt_out_and_shared_where_processes_are_more() -> None:
    cores = os.sched_getaffinity(0)
    for number in (1, 2, 3, 5):
        places = split_cores(number)
        assert len(places) == number
        assert all(places)
        assert frozenset().union(*places) == cores
    assert sum(map(len, split_cores(len(cores)))) == len(cores)


def test_a_call_that_fails_stops_no_other() -> None:
    with LocalProcesses(own_cores()) as processes:
        for workers in (InThisProcess(), processes):
            outcomes = dict(side_by_side(workers, _fails_on_two, [1, 2, 3]))
            assert {argument for argument, future in outcomes.items() if future.exception()} == {2}


def test_processes_stay_for_the_next_call_unless_each_call_asks_for_a_new_one() -> None:
    for is_fresh, number in ((False, 1), (True, 3)):
        with LocalProcesses(all_cores(), is_fresh=is_fresh) as workers:
            processes = {future.result() for _, future in side_by_side(workers, _dies_on_two, [1, 3, 4])}
        assert len(processes) == number


def test_processes_that_are_forked_have_imports_made_and_threads_and_environment_of_their_own(tmp_path: Path) -> None:
    """Only those of the first places and imports are; all others start from nothing."""
    (tmp_path / "forks.py").write_text(FORKS)
    (tmp_path / "forked_calls.py").write_text(LOOK)
    environment = {name: value for name, value in os.environ.items() if not name.endswith("NUM_THREADS")}
    (long := tmp_path / ("temporary" * 12)).mkdir()
    no_socket_has_so_long_a_name = {"TMPDIR": str(long)}
    for extra, seen in (({}, ["{True}", *3 * ["{False}"]]), (no_socket_has_so_long_a_name, ["{False}"])):
        command = [sys.executable, "forks.py", str(len(seen))]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment | extra, capture_output=True, text=True, check=False
        )
        assert (done.stdout.split("\n")[:-1], done.stderr) == (seen, "")


def test_a_call_whose_process_dies_is_made_again_and_one_that_processes_die_of_is_an_error(tmp_path: Path) -> None:
    with LocalProcesses(own_cores()) as workers:
        ((_, future),) = side_by_side(workers, _dies_once, [str(tmp_path / "mark")])
        outcomes = dict(side_by_side(workers, _dies_on_two, [1, 2, 3]))
    assert future.result() == "done"
    assert {argument for argument, future in outcomes.items() if future.exception()} == {2}
    assert isinstance(outcomes[2].exception(), ClusterError)
    assert f"{MAX_DEATHS} workers died of it, the last by SIGKILL. Most often memory ran out" in str(
        outcomes[2].exception()
    )


def test_ctrl_c_reaches_the_parent_alone_and_where_memory_runs_out_a_worker_is_killed_and_not_its_parent() -> None:
    score = Path("/proc/self/oom_score_adj")
    with LocalProcesses(own_cores()[:1]) as workers:
        assert workers.submit(signal.getsignal, signal.SIGINT).result() is signal.SIG_IGN
        if score.exists():  # on Linux
            assert int(workers.submit(Path.read_text, score).result()) > int(score.read_text(encoding="utf-8"))


def test_more_processes_than_memory_holds_are_not_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "available_memory_mib", lambda processes: 1000 / processes)
    with pytest.raises(
        OutOfMemoryError, match=r"Each worker of --executor 40 needs at least 50 MiB .* 25 MiB are left for each"
    ):
        open_workers("40")


class _Counting(InThisProcess):
    """Notes how many arguments were taken and not given back yet."""

    num_places = 2
    most_held = 0
    held = 0

    def submit(self, call, argument):
        self.held += 1
        self.most_held = max(self.most_held, self.held)
        return super().submit(call, argument)


@pytest.mark.parametrize(("ahead", "limit"), [(0, 2), (1, 4)])
def test_no_more_calls_are_taken_than_places_have_use_for(ahead: int, limit: int) -> None:
    """A million arguments are never held at a time, and neither are their results."""
    workers, given = _Counting(), iter(range(20))
    for _ in side_by_side(workers, abs, given, ahead=ahead):
        workers.held -= 1
    assert workers.most_held == limit
    assert next(given, None) is None


class _Waiting(InThisProcess):
    """Never comes to any call but the first."""

    num_places = 3

    def __init__(self) -> None:
        self.futures = list[Future[int]]()

    def submit(self, call, argument):
        self.futures.append(super().submit(call, argument) if not self.futures else Future())
        return self.futures[-1]


def test_leaving_early_cancels_what_waits() -> None:
    workers = _Waiting()
    calls = side_by_side(workers, abs, range(10))
    next(calls)
    calls.close()
    assert [future.cancelled() for future in workers.futures] == [False, True, True]


def test_other_processes_of_the_caller_outlive_an_exception() -> None:
    mine = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,))
    mine.start()
    try:
        with pytest.raises(KeyError), LocalProcesses(own_cores()[:1]) as processes:
            future = processes.submit(time.sleep, 60)
            while not future.running():
                time.sleep(0.01)
            raise KeyError
        assert mine.is_alive()
    finally:
        mine.kill()


@pytest.mark.parametrize("text", ["", "0", "-1", "two", "tcp://host:1", "dask://host", "Serial"])
def test_an_executor_that_is_none_names_those_there_are(text: str) -> None:
    with pytest.raises(XFreqBenchError, match="serial, a number of processes, or dask://"):
        open_workers(text)


@pytest.mark.parametrize("way", ["pool", "forks"])
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_calls_end_with_the_process_that_made_them(tmp_path: Path, sent: signal.Signals, way: str) -> None:
    """Nor do their processes import a file of the working folder that has a standard name."""
    (tmp_path / "parent.py").write_text(PARENT)
    (tmp_path / "parallel_calls.py").write_text(CALLS)
    (folder := tmp_path / "working").mkdir()
    for name in ("types", "random", "queue"):
        (folder / f"{name}.py").write_text("open('imported', 'w')")
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{tmp_path}"}
    command = [sys.executable, str(tmp_path / "parent.py"), str(tmp_path / "child"), way]
    with subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.DEVNULL) as parent:
        child = int(_text_of(tmp_path / "child"))
        parent.send_signal(sent)
        parent.wait()
    while _runs(child):
        time.sleep(0.05)
    assert not (folder / "imported").exists()


def _text_of(path: Path) -> str:
    while not path.exists() or not path.read_text(encoding="utf-8"):
        time.sleep(0.05)
    return path.read_text(encoding="utf-8")


def _runs(process: int) -> bool:
    status = Path(f"/proc/{process}/stat")
    try:
        return status.read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"  # ended, its parent gone
    except FileNotFoundError:
        return False


def test_locks_of_processes_that_are_ended_are_removed_without_a_word() -> None:
    """Numba makes one where it starts threads, which multiprocessing's tracker of such locks complains of."""
    done = subprocess.run(
        [sys.executable, "-c", LEAVES_A_LOCK], cwd=ROOT, capture_output=True, text=True, timeout=120, check=True
    )
    assert (done.stdout, done.stderr) == ("True\n", "")


LEAVES_A_LOCK = """
from xfreqbench.system.processes import open_workers
if __name__ == "__main__":
    with open_workers("1", is_fresh=True, imports=("numba",)) as workers:
        print(workers.submit(eval, "__import__('numba').get_num_threads() > 0").result())
"""
