"""Workers by name, and processes of this machine, each with cores of its own."""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import Any, TypeVar

from xfreqbench.errors import ClusterError, XFreqBenchError
from xfreqbench.system.bars import ANNOUNCES
from xfreqbench.system.cluster import SCHEME, dask_workers
from xfreqbench.system.machine import require_memory, safe_path
from xfreqbench.system.workers import HERE, Workers, lost_workers

Result = TypeVar("Result")
Cores = frozenset[int]
SERIAL = "serial"
MAX_DEATHS = 4  # processes that may die of one call; Dask allows as many workers by default
_UNKNOWN_STATUS = 255
# for multiprocessing's tracker, which removes the locks of processes that are killed, as Numba's threads have one
_UNSAID = "ignore:resource_tracker:UserWarning"
_INTERRUPT = {signal.SIGINT}
_THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def open_workers(
    executor: str,
    *,
    is_fresh: bool = False,
    imports: Sequence[str] = (),
    on_message: Callable[..., object] | None = None,
) -> AbstractContextManager[Workers]:
    """The workers that `--executor` names: `serial`, a number of processes, or `dask://host:port`.

    The others are those of `LocalProcesses`. Raises `XFreqBenchError` for any other text and for more processes than
    memory can hold, and what `xfreqbench.system.cluster.dask_workers` raises.
    """
    require_executor(executor)
    if executor == SERIAL:
        return nullcontext(HERE)
    if executor.isdecimal():
        # what a process shares with no other once it has imported the toolkit
        require_memory(50, f"Each worker of --executor {executor}", int(executor))
        return LocalProcesses(split_cores(int(executor)), is_fresh=is_fresh, imports=imports, on_message=on_message)
    return dask_workers(executor)


def require_executor(executor: str) -> None:
    """Raise `XFreqBenchError` for a text that names no workers; none are started or looked for."""
    is_number = executor.isdecimal() and len(executor) < 5 and int(executor) > 0
    if not (executor == SERIAL or is_number or re.fullmatch(rf"{SCHEME}[^\s/]+:\d{{1,5}}", executor)):
        raise XFreqBenchError(
            f"--executor takes serial, a number of processes, or {SCHEME}host:port of a scheduler, but got "
            f"{executor!r}."
        )


def own_cores() -> list[Cores]:
    """A place for each core that this process may use; empty sets if the system cannot keep processes to cores."""
    if hasattr(os, "sched_getaffinity"):
        return [frozenset({core}) for core in sorted(os.sched_getaffinity(0))]
    return [frozenset()] * (os.cpu_count() or 1)


def all_cores() -> list[Cores]:
    """A single place, with every core that this process may use."""
    return [frozenset().union(*own_cores())]


def split_cores(num_places: int) -> list[Cores]:
    """`num_places` places that divide this process's cores; if there are more places than cores, some share one."""
    cores = own_cores()
    return [frozenset().union(*cores[place % len(cores) :: num_places]) for place in range(num_places)]


class LocalProcesses(Workers):
    """Processes of this machine, each kept to the cores of its place; a context manager.

    They end with this process, however it ends. With `is_fresh` every call is made in a new process, so that timings
    have equal conditions. `imports` names modules that calls will import anyway: if the system can, processes are
    forked from one that has imported them and did nothing else. `on_message` is called in a thread of this process,
    with the arguments of each `send_message` of the others.
    """

    def __init__(
        self,
        places: Sequence[Cores],
        *,
        is_fresh: bool = False,
        imports: Sequence[str] = (),
        on_message: Callable[..., object] | None = None,
    ) -> None:
        self.num_places = len(places)
        sys.warnoptions += [_UNSAID] * (_UNSAID not in sys.warnoptions)
        # a fork of this process would inherit its threads and locks
        context = _forking(places, tuple(imports)) or multiprocessing.get_context("spawn")
        self._is_fresh = is_fresh
        self._is_ending = threading.Event()
        self._threads = ThreadPoolExecutor(len(places))
        self._free: SimpleQueue[_Place] = SimpleQueue()
        self._places = [
            _Place(context, partial(_settle, cores, len(places) == 1), place == 0, on_message)
            for place, cores in enumerate(places)
        ]
        for place in self._places:
            self._free.put(place)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for the calls that are being made; after an exception, Ctrl-C included, end their processes."""
        self._is_ending.set()
        self._threads.shutdown(wait=error is None, cancel_futures=True)
        while self._free.qsize() < self.num_places:  # a thread may be starting another process
            for place in self._places:
                place.kill()
            time.sleep(0.05)
        for place in self._places:
            place.kill()
            place.close()

    def submit(self, call: Callable[..., Result], /, *arguments: Any, **options: Any) -> Future[Result]:
        """Have a process make a call."""
        return self._threads.submit(self._made, partial(call, *arguments, **options))

    def _made(self, call: Callable[[], Result]) -> Result:
        place = self._free.get()
        try:
            return self._tried(place, call)
        finally:
            if self._is_fresh:
                place.kill()
                place.close()
            self._free.put(place)

    def _tried(self, place: _Place, call: Callable[[], Result]) -> Result:
        died = ""
        for _ in range(MAX_DEATHS):
            if self._is_ending.is_set():
                raise ClusterError("The call was ended together with others.")
            with suppress(BrokenProcessPool):
                return place.submit(call).result()
            status = place.close()
            if 0 <= status < _UNKNOWN_STATUS:
                raise ClusterError(
                    f"A process ended itself with exit status {status}, before its work was done. Code that runs "
                    "there, such as a method's, has to return or to raise an exception."
                )
            died = f", the last by {signal.Signals(-status).name}" if status < 0 else ""
        raise ClusterError(lost_workers(MAX_DEATHS, died))


@dataclass
class _Place:
    """A place for one process at a time; each process first calls `settle`."""

    context: BaseContext
    settle: Callable[[Mapping[str, str], Connection | None], None]
    is_first: bool  # only this process announces compilation
    on_message: Callable[..., object] | None = None
    _process: ProcessPoolExecutor | None = None
    _listener: threading.Thread | None = None

    def submit(self, call: Callable[[], Result]) -> Future[Result]:
        """Have the process of this place make a call; it is started if there is none."""
        # making an executor starts a process, too: multiprocessing's tracker of semaphores
        with safe_path(), _interruptions_blocked():
            if self._process is not None:
                return self._process.submit(_flushed, call)
            environment = dict(os.environ) | ({} if self.is_first else {ANNOUNCES: "0"})
            reader, writer = self.context.Pipe(duplex=False) if self.on_message else (None, None)
            self._process = ProcessPoolExecutor(1, self.context, self.settle, (environment, writer))
            made = self._process.submit(_flushed, call)
        if reader and writer:
            writer.close()  # the process has its own, and nothing can be read any more once that is closed
            self._listener = threading.Thread(target=_read_messages, args=(reader, self.on_message), daemon=True)
            self._listener.start()
        return made

    def kill(self) -> None:
        """End the process in any state: what it called may have left a thread, or ignore signals."""
        for process in self._processes:
            process.kill()

    def close(self) -> int:
        """Forget the process, which has ended or does so now; returns its exit status, that of a signal negative."""
        processes = self._processes
        if self._process is not None:
            self._process.shutdown()
            self._process = None
        if self._listener is not None:
            self._listener.join(1)  # what it left may hold the other end
        return next((process.exitcode for process in processes), _UNKNOWN_STATUS)

    @property
    def _processes(self) -> list[Any]:
        return list(((self._process and self._process._processes) or {}).values())


_messages: Connection | None = None  # to the process that this one works for
_forks: tuple[int, tuple[str, ...]] | None = None  # cores of each fork, and what was imported for all; set once


def _forking(places: Sequence[Cores], imports: tuple[str, ...]) -> BaseContext | None:
    """A context whose processes start with `imports` made, forked off a process that has no threads; None if not.

    Libraries decide at their import how many threads they use. So the first call makes the process that is forked, with
    as many cores as a place has, and later calls for other places or imports get None.
    """
    global _forks
    (size, *others) = {len(cores) for cores in places}
    if not imports or others or not hasattr(os, "sched_setaffinity"):
        return None
    context = multiprocessing.get_context("forkserver")
    if _forks is None:
        context.set_forkserver_preload(list(imports))
        cores = os.sched_getaffinity(0)  # of this thread
        try:
            os.sched_setaffinity(0, places[0])
            with safe_path(), _interruptions_blocked():
                forkserver.ensure_running()
            _forks = size, imports
        except OSError:  # no socket can be made in the folder of temporary files, as where its name is too long
            _forks = 0, ()
        finally:
            os.sched_setaffinity(0, cores)
    return context if _forks[0] == size and set(imports) <= set(_forks[1]) else None


def _flushed(call: Callable[[], Result]) -> Result:
    """Make a call and show what it printed, for this process is killed in the end."""
    try:
        return call()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(AttributeError, OSError, ValueError):  # the call may have closed or replaced it
                stream.flush()


def _read_messages(reader: Connection, on_message: Callable[..., object]) -> None:
    with suppress(EOFError, OSError), reader:
        while True:
            on_message(*reader.recv())


def send_message(*arguments: Any) -> None:
    """Call the `on_message` of the process that this one works for, if it has one."""
    if _messages is not None:
        with suppress(OSError):
            _messages.send(arguments)


@contextmanager
def _interruptions_blocked() -> Iterator[None]:
    """A block in which processes are started that Ctrl-C does not reach before they are settled."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPT)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextmanager
def interrupted_afterwards() -> Iterator[None]:
    """A block that Ctrl-C does not interrupt: `KeyboardInterrupt` is raised at its end instead.

    Outside of the main thread, which alone is interrupted, it is a block like any other.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if heard:
        raise KeyboardInterrupt


def _settle(place: Cores, is_alone: bool, environment: Mapping[str, str], writer: Connection | None = None) -> None:
    """Keep this process to its cores, and let it end with its parent, even if the parent is killed."""
    global _messages
    _messages = writer
    os.environ.update(environment)  # that of a fork is as old as the process it was forked off
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the parent, which ends this process without a traceback
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPT)
    with suppress(OSError):  # on Linux, where memory runs out, it ends and not its parent, which says so
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="utf-8")
    if place:
        os.sched_setaffinity(0, place)
    elif not is_alone:  # macOS cannot keep a process to a core; one thread comes nearest to it
        os.environ.update(dict.fromkeys(_THREADS, "1"))
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent:
        parent.join()
        os._exit(1)
