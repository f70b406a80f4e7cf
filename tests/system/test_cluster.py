"""A real cluster: a scheduler and two workers, each a process of its own, that are killed in mid-work."""

from __future__ import annotations

import json
import os
import re
import signal
import socketserver
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from xfreqbench.baselines.nearest import Nearest

from tests.support.forked import command_line
from tests.support.places import ROOT
from tests.support.plans import plan_generation
from tests.support.synthetic import paper_dataset
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import Plan
from xfreqbench.errors import ClusterError, StorageError
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.runs.records import RunRecord, read
from xfreqbench.runs.run import require_shared
from xfreqbench.scene.model import load_scene
from xfreqbench.system import cluster
from xfreqbench.system.cluster import dask_workers, local_cluster
from xfreqbench.system.processes import open_workers
from xfreqbench.system.workers import InThisProcess, side_by_side
from xfreqbench.tracing.tracer import TraceSettings

distributed = pytest.importorskip("distributed", reason="needs the extra `cluster`")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(600),  # a dozen interpreters start here, which on a busy machine takes minutes
    # sockets to a worker that was killed are closed by the garbage collector
    pytest.mark.filterwarnings("ignore:unclosed .*:ResourceWarning"),
]

ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
ALLOWED_FAILURES = 2
WORKER = ["worker", "--nthreads", "1", "--no-dashboard"]
ENVIRONMENT = {
    **os.environ,
    **ONE_THREAD,
    "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),  # calls of this file
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(ALLOWED_FAILURES),
}


@dataclass(frozen=True)
class Started:
    """A cluster of processes, seen by a client of the tests' own."""

    address: str
    scheduler: subprocess.Popen[bytes] = field(repr=False)
    client: Any = field(repr=False)

    def wait_for(self, num_workers: int) -> None:
        if num_workers:
            self.client.wait_for_workers(num_workers, timeout=120)

    def signal_a_busy_worker(self, sent: signal.Signals = signal.SIGKILL) -> int:
        """A signal to one that holds a task, as soon as there is one; its process id."""
        processes: list[int] = []

        def one_answers() -> bool:  # which the scheduler may have dropped meanwhile, on a machine that is busy
            busy = [worker for worker, tasks in self.client.processing().items() if tasks][:1]
            processes[:] = self.client.run(os.getpid, workers=busy).values() if busy else []
            return len(processes) == 1

        _wait(one_answers)
        os.kill(processes[0], sent)
        return processes[0]

    def num_lost_tasks(self) -> int:
        """Tasks, each as often as it was lost with a worker."""
        return self.client.run_on_scheduler(_num_suspicious)


def _num_suspicious(dask_scheduler: Any) -> int:
    return sum(prefix.suspicious for prefix in dask_scheduler.task_prefixes.values())


@contextmanager
def started(folder: Path, num_workers: int, **scheduler_options: str) -> Iterator[Started]:
    """`dask scheduler` on a free port and a `dask worker`, as a user starts them, which end with the block."""
    file = folder / "scheduler.json"
    scheduler = ["scheduler", "--port", "0", "--host", "127.0.0.1", "--no-dashboard"]
    with ExitStack() as stack:
        command = [*scheduler, "--scheduler-file", str(file)]
        variables = {f"DASK_DISTRIBUTED__SCHEDULER__{name}": value for name, value in scheduler_options.items()}
        process = stack.enter_context(_process(command, folder / "scheduler.log", variables))
        _wait(lambda: file.exists() and file.read_text().rstrip().endswith("}"))  # it is written whole
        if num_workers:
            options = ["--nworkers", str(num_workers), "--scheduler-file", str(file)]
            stack.enter_context(_process([*WORKER, *options], folder / "worker.log"))
        address = json.loads(file.read_text())["address"].removeprefix("tcp://")
        client = stack.enter_context(distributed.Client(f"tcp://{address}", set_as_default=False))
        running = Started(f"dask://{address}", process, client)
        running.wait_for(num_workers)
        yield running


@contextmanager
def _process(
    arguments: list[str], log: Path, variables: Mapping[str, str] = MappingProxyType({}), before: tuple[str, ...] = ()
) -> Iterator[subprocess.Popen[bytes]]:
    command, environment = [*before, sys.executable, "-m", "dask", *arguments], {**ENVIRONMENT, **variables}
    with log.open("wb") as output:
        process = subprocess.Popen(command, cwd=log.parent, env=environment, stdout=output, stderr=output)
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)  # a nanny that is killed leaves its workers behind for a while
            process.wait(timeout=30)


def _wait(is_done: Callable[[], bool], timeout_s: float = 240) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not is_done():
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"{is_done} did not come true in {timeout_s} s")
        time.sleep(0.01)


@pytest.fixture(scope="module")
def two_workers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Started]:
    with started(tmp_path_factory.mktemp("cluster"), 2) as running:
        yield running


@pytest.fixture
def running(two_workers: Started) -> Started:
    """The cluster with both its workers back, whatever became of them before."""
    two_workers.wait_for(2)
    return two_workers


def _plan(num_tx: int = 96) -> Plan:
    settings = TraceSettings(interactions=("specular", "refraction"), rays=20_000, max_depth=5)
    return plan_generation(load_scene("two_rooms"), [1e9, 24.25e9], settings, tx=num_tx)


@pytest.fixture(scope="module")
def serial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate_planned(_plan(), tmp_path_factory.mktemp("serial") / "rooms.h5")


def test_a_worker_killed_in_mid_work_changes_no_byte_of_the_data(
    running: Started, serial: Path, tmp_path: Path
) -> None:
    lost_before, killed = running.num_lost_tasks(), list[int]()

    def kill_one(done: int, total: int) -> None:
        if done and not killed:
            killed.append(running.signal_a_busy_worker())

    with open_workers(running.address) as workers:
        path = generate_planned(_plan(), tmp_path / "rooms.h5", kill_one, workers=workers)
    assert path.read_bytes() == serial.read_bytes()
    assert running.num_lost_tasks() > lost_before
    assert not list(tmp_path.glob("*.parts"))


def _driver(arguments: str, folder: Path) -> subprocess.Popen[str]:
    command = [command_line(), *arguments.split()]
    return subprocess.Popen(command, cwd=folder, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)


def _given(arguments: str, folder: Path) -> None:
    with _driver(arguments, folder) as driver:
        _, message = driver.communicate()
    assert driver.returncode == 0, message


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_a_driver_that_ends_leaves_the_cluster_usable_and_its_command_goes_on(
    running: Started, serial: Path, tmp_path: Path, sent: signal.Signals
) -> None:
    path = tmp_path / "rooms.h5"
    options = "--freqs 1,24.25 --tx 96 --rays 20000 --max-depth 5 --interactions specular,refraction --quiet"
    command = f"generate two_rooms {options} --executor {running.address} -o {path}"
    with _driver(command, tmp_path) as driver:
        _wait(lambda: bool(list(tmp_path.glob("rooms.h5.parts/*.npz"))) or driver.poll() is not None)
        driver.send_signal(sent)
        _, message = driver.communicate()
    assert driver.returncode == (130 if sent == signal.SIGINT else -signal.SIGKILL)
    assert ("the same command continues" in message) == (sent == signal.SIGINT)
    assert "Traceback" not in message
    kept = {part: part.stat().st_mtime_ns for part in tmp_path.glob("rooms.h5.parts/*.npz")}
    assert kept
    _wait(lambda: not any(running.client.processing().values()))  # nothing is left of it on the workers
    _given(command, tmp_path)
    assert path.read_bytes() == serial.read_bytes()


def test_what_fails_in_the_clients_own_thread_is_not_printed(
    running: Started, caplog: pytest.LogCaptureFixture
) -> None:
    """Ctrl-C in the first instant of a call ends in such a failure, of which the user has no use."""
    with dask_workers(running.address) as workers:
        failed = threading.Event()
        workers._client.loop.add_callback(lambda: failed.set() or 1 / 0)
        assert failed.wait(10) and workers.ask(os.getpid)
    assert not caplog.records


class Patient(Nearest):
    """A second of fitting, so that whoever kills its worker finds it at work."""

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        time.sleep(1)
        yield from super().fit(train, budget, seed)


class Gated(Patient):
    """Does not end before there is a file `go` in the working folder."""

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        _wait(Path("go").exists)
        yield from super().fit(train, budget, seed)


def _told(results: Path) -> dict[tuple[str, str, int], RunRecord]:
    """Records without what time and machine make of them."""
    measured = ("fit_seconds", "fit_processor_seconds", "predict_ms_per_map", "peak_memory_mib")
    blank: dict[str, Any] = {**dict.fromkeys(measured, 0.0), "hardware": {}, "time_utc": "", "git_commit": None}
    untimed = {"seconds": 0.0, "share": None}
    stored = read(results / "records.jsonl").records
    assert len({record.id for record in stored}) == len(stored)
    return {
        (record.job.method, record.job.split, record.job.seed): record.model_copy(
            update={**blank, "curve": [point.model_copy(update=untimed) for point in record.curve]}
        )
        for record in stored
    }


def test_runs_on_a_cluster_are_those_of_one_process_though_a_worker_is_killed(running: Started, tmp_path: Path) -> None:
    paper_dataset(tmp_path / "data.h5", num_tx=4)
    methods = f"aperture-gs,{Patient.__module__}:{Patient.__name__}"
    options = f"--data data.h5 --targets 77 --method {methods} --seed 0,1 --budget 2steps --quiet"
    _given(f"run {options} --results here", tmp_path)
    lost_before = running.num_lost_tasks()
    command = f"run {options} --results there --executor {running.address}"
    with _driver(command, tmp_path) as driver:
        _wait(lambda: (tmp_path / "there" / "records.jsonl").exists() or driver.poll() is not None)
        running.signal_a_busy_worker()
        _, message = driver.communicate()
    assert driver.returncode == 0, message
    assert running.num_lost_tasks() > lost_before
    here, there = _told(tmp_path / "here"), _told(tmp_path / "there")
    assert len(here) == 4
    assert there == here
    for record in here.values():
        mine, theirs = (tmp_path / folder / "predictions" / f"{record.id}.h5" for folder in ("here", "there"))
        assert theirs.read_bytes() == mine.read_bytes()
    assert not list((tmp_path / "there").glob("checkpoints/*"))


def _ends_on_three(argument: int) -> int:
    if argument == 3:
        os._exit(1)
    return 2 * argument


def test_a_call_that_workers_die_of_is_named_and_the_others_are_made(running: Started) -> None:
    with dask_workers(running.address) as workers:
        outcomes = dict(side_by_side(workers, _ends_on_three, range(8)))
    assert {argument for argument, ended in outcomes.items() if ended.exception()} == {3}
    assert {outcomes[argument].result() for argument in outcomes if argument != 3} == {0, 2, 4, 8, 10, 12, 14}
    assert isinstance(outcomes[3].exception(), ClusterError)
    assert f"{ALLOWED_FAILURES + 1} workers died of it" in str(outcomes[3].exception())


def _imports_from_the_working_folder() -> bool:
    return not sys.flags.safe_path


def test_workers_of_a_cluster_of_our_own_import_nothing_from_the_working_folder() -> None:
    with local_cluster(1) as address, dask_workers(address) as workers:
        assert not any(workers.ask(_imports_from_the_working_folder).values())


def _raises(argument: int) -> None:
    raise StorageError(f"no room for {argument}")


def test_an_error_of_a_call_is_the_error_that_was_raised(running: Started) -> None:
    with dask_workers(running.address) as workers:
        ((_, raised),) = side_by_side(workers, _raises, [7])
    with pytest.raises(StorageError, match="no room for 7"):
        raised.result()


def test_workers_with_other_versions_are_refused_before_any_work(
    running: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    version = cluster.installed_version
    cluster.fingerprint.cache_clear()
    monkeypatch.setattr(cluster, "installed_version", lambda name: "1.0" if name == "numpy" else version(name))
    words = r"Worker tcp://.* has other software: numpy 2.* \(here 1.0\)"
    with pytest.raises(ClusterError, match=words), dask_workers(running.address):
        pass
    cluster.fingerprint.cache_clear()


def test_a_worker_that_joins_later_with_other_code_spoils_no_run(tmp_path: Path) -> None:
    """The idle newcomer gets jobs, each of which fails and names it; the same command makes them without it."""
    paper_dataset(tmp_path / "data.h5", num_tx=4)
    results = tmp_path / "results"
    (tmp_path / "older.py").write_text(
        "from xfreqbench.system import cluster\ncluster.installed_version = lambda name: '0.1'"
    )
    with started(tmp_path, 1) as running:
        method = f"{Gated.__module__}:{Gated.__name__}"
        command = f"run --data data.h5 --targets 77 --method {method} --seed 0,1,2,3 --budget 2steps"
        command += f" --results results --executor {running.address}"
        with _driver(command, tmp_path) as driver, ExitStack() as late:
            _wait(lambda: bool(list(results.glob("predictions/*.lock"))) or driver.poll() is not None)
            options = [*WORKER, "--no-nanny", running.address.removeprefix("dask://")]
            late.enter_context(_process([*options, "--preload", str(tmp_path / "older.py")], tmp_path / "older.log"))
            running.wait_for(2)
            (tmp_path / "go").touch()
            _, message = driver.communicate()
        assert driver.returncode == 2 and re.search(r"Worker tcp://\S+ has other software: .*xfreqbench 0\.1", message)
        _given(command, tmp_path)
    assert sorted(record.job.seed for record in read(results / "records.jsonl").records) == [0, 1, 2, 3]


def test_the_run_of_a_suspended_worker_is_made_by_another_once_its_nanny_has_ended_it(tmp_path: Path) -> None:
    paper_dataset(tmp_path / "data.h5", num_tx=4)
    method = f"{Gated.__module__}:{Gated.__name__}"
    command = f"run --data data.h5 --targets 77 --method {method} --budget 2steps --results results"
    with started(tmp_path, 2, WORKER_TTL="5s") as running:
        with _driver(f"{command} --executor {running.address}", tmp_path) as driver:
            _wait(lambda: bool(list(tmp_path.glob("results/predictions/*.lock"))) or driver.poll() is not None)
            suspended = running.signal_a_busy_worker(signal.SIGSTOP)
            (tmp_path / "go").touch()
            _, message = driver.communicate()
        with suppress(ProcessLookupError):
            os.kill(suspended, signal.SIGKILL)  # or the end of the cluster waits for it
        assert driver.returncode == 0, message
    assert len(read(tmp_path / "results" / "records.jsonl").records) == 1


def test_without_a_worker_or_a_scheduler_the_error_says_what_to_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "FIRST_WORKER_S", 1.0)
    to_start = r"has no worker\. Start some: dask worker 127\.0\.0\.1:\d+"
    with started(tmp_path, 0) as idle, pytest.raises(ClusterError, match=to_start), dask_workers(idle.address):
        pass
    monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
    no_answer = r"No Dask scheduler answers at dask://127\.0\.0\.1:1"
    with pytest.raises(ClusterError, match=no_answer), dask_workers("dask://127.0.0.1:1"):
        pass


@pytest.mark.parametrize(
    "says", [None, b"", b"SSH-2.0-OpenSSH_9.2\r\n", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\0" * 64, b"\xff" * 64]
)
def test_what_listens_there_and_is_no_scheduler_is_refused_in_one_line(
    says: bytes | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None: it accepts and says nothing; no bytes: it closes at once."""
    assert cluster.CONNECT_S < 10
    monkeypatch.setattr(cluster, "CONNECT_S", 1.0)

    class Says(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            if says is None:
                self.request.recv(10**6)
                has_ended.wait()
            self.request.sendall(says or b"")

    has_ended = threading.Event()
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Says) as server:
        threading.Thread(target=server.serve_forever).start()
        address = f"dask://127.0.0.1:{server.server_address[1]}"
        refusal = r"^No Dask scheduler answers at dask:.*, or fix --executor\.$"
        try:
            with pytest.raises(ClusterError, match=refusal) as refused, dask_workers(address):
                pass
            assert not re.search("allocate|unpack|array", str(refused.value))  # what Dask makes of such bytes
        finally:
            has_ended.set()
            server.shutdown()


def test_a_worker_is_no_scheduler(running: Started) -> None:
    worker = next(iter(running.client.nthreads())).removeprefix("tcp://")
    with pytest.raises(ClusterError, match="a Dask worker listens there"), dask_workers(f"dask://{worker}"):
        pass


def test_a_scheduler_that_dies_ends_the_driver_in_words(tmp_path: Path) -> None:
    path = tmp_path / "rooms.h5"
    with started(tmp_path, 1) as lonely:
        command = "generate two_rooms --tx 640 --rays 20000 --interactions specular,refraction --quiet"
        command += f" --executor {lonely.address} -o {path}"
        with _driver(command, tmp_path) as driver:
            _wait(lambda: bool(list(tmp_path.glob("rooms.h5.parts/*.npz"))) or driver.poll() is not None)
            lonely.scheduler.kill()
            _, message = driver.communicate()
    assert driver.returncode == 2, message
    assert "The scheduler at dask://127.0.0.1:" in message
    assert "the same command continues" in message
    assert "Traceback" not in message
    assert list(tmp_path.glob("rooms.h5.parts/*.npz"))


def test_without_the_extra_the_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = r'pip install "xfreqbench\[cluster\]"'
    with pytest.raises(ClusterError, match=words), open_workers("dask://127.0.0.1:8786"):
        pass


class _OtherDisk(InThisProcess):
    """Workers of another machine, where the same paths lead to another disk."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def ask(self, question: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        (token, *paths) = (self.root / path.relative_to("/") for path in (arguments[0], *arguments[1]))
        return {"tcp://other": question(token, paths)}


def test_folders_and_data_that_workers_do_not_see_are_refused(tmp_path: Path) -> None:
    data = paper_dataset(tmp_path / "data.h5", num_tx=2)
    elsewhere = _OtherDisk(tmp_path / "other")
    with pytest.raises(ClusterError, match="same path on every machine"):
        require_shared(elsewhere, tmp_path / "results", {})
    assert list((tmp_path / "results").iterdir()) == []
    same = _OtherDisk(Path("/"))
    require_shared(same, tmp_path / "results", {data.path: data.sha256})
    with pytest.raises(ClusterError, match="finds no data set"):
        require_shared(same, tmp_path / "results", {tmp_path / "gone.h5": data.sha256})
