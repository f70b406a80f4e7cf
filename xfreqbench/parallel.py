"""Many calls of one function: in this process, in others on cores of their own, or by a cluster's workers."""

from __future__ import annotations

import multiprocessing
import os
import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from queue import SimpleQueue
from types import TracebackType
from typing import Any, Protocol, TypeVar, runtime_checkable

from xfreqbench.cluster import SCHEME, dask_workers, lost_workers
from xfreqbench.errors import ClusterError, XFreqBenchError

Argument = TypeVar("Argument")
Result = TypeVar("Result")
Cores = frozenset[int]
SERIAL = "serial"
MAX_DEATHS = 4  # of processes that one call is tried in, as many as Dask's workers by default
_THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


@runtime_checkable
class Workers(Protocol):
    """Whoever makes calls. Calls and arguments are pickled unless they are made in this process."""

    @property
    def num_places(self) -> int:
        """How many calls are made at a time."""
        ...

    def submit(self, call: Callable[[Argument], Result], argument: Argument) -> Future[Result]:
        """Have a call made; a worker that dies of it is replaced a few times, then it is a `ClusterError`."""
        ...

    def ask(self, question: Callable[..., Result], *arguments: Any) -> dict[str, Result]:
        """Answers by the names of workers that share neither this machine nor its files; none where all do."""
        ...


def open_workers(executor: str, *, is_fresh: bool = False) -> AbstractContextManager[Workers]:
    """Workers as `--executor` names them: `serial`, a number of processes, or `dask://host:port`.

    With `is_fresh`, processes of this machine start anew for each call. Raises `XFreqBenchError` for any
    other text, and what `xfreqbench.cluster.dask_workers` raises.
    """
    if executor == SERIAL:
        return nullcontext(HERE)
    if executor.isdecimal() and len(executor) < 5 and int(executor) > 0:
        return LocalProcesses(split_cores(int(executor)), is_fresh=is_fresh)
    if re.fullmatch(rf"{SCHEME}[^\s/]+:\d{{1,5}}", executor):
        return dask_workers(executor)
    raise XFreqBenchError(
        f"--executor takes serial, a number of processes, or {SCHEME}host:port of a scheduler, but got {executor!r}."
    )


def side_by_side(
    workers: Workers,
    call: Callable[[Argument], Result],
    arguments: Iterable[Argument],
    *,
    ahead: int = 0,
) -> Iterator[tuple[Argument, Future[Result]]]:
    """Call a function for every argument, in their order, as many at a time as there are places.

    Yields arguments with their finished futures as they come. No more than `ahead` calls a place wait
    with those that are made, so that neither arguments nor results pile up; what still waits when the
    caller leaves is cancelled.
    """
    left, running = iter(arguments), dict[Future[Result], Argument]()
    try:
        while True:
            limit = max(1, workers.num_places) * (1 + ahead)
            for argument in islice(left, max(0, limit - len(running))):
                running[workers.submit(call, argument)] = argument
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future
    finally:
        for future in running:
            future.cancel()


def own_cores() -> list[Cores]:
    """Every core that this process may use, by itself; where processes cannot be kept to cores, empty sets."""
    if hasattr(os, "sched_getaffinity"):
        return [frozenset({core}) for core in sorted(os.sched_getaffinity(0))]
    return [frozenset()] * (os.cpu_count() or 1)


def all_cores() -> list[Cores]:
    """One place with every core that this process may use."""
    return [frozenset().union(*own_cores())]


def split_cores(num_places: int) -> list[Cores]:
    """This process's cores dealt out to places; where places are more than cores, several share one."""
    cores = own_cores()
    return [frozenset().union(*cores[place % len(cores) :: num_places]) for place in range(num_places)]


class InThisProcess:
    """Makes each call at once, here, with all threads that it takes."""

    num_places = 1

    def submit(self, call: Callable[[Argument], Result], argument: Argument) -> Future[Result]:
        """A call that has been made."""
        future: Future[Result] = Future()
        try:
            future.set_result(call(argument))
        except Exception as error:
            future.set_exception(error)
        return future

    def ask(self, question: Callable[..., Result], *arguments: Any) -> dict[str, Result]:
        """Nobody."""
        return {}


HERE = InThisProcess()


class LocalProcesses:
    """Processes of this machine, each kept to its place's cores; a context manager.

    They end with this process, however it ends. With `is_fresh` every call starts in a new one: equal
    conditions for whatever is timed.
    """

    def __init__(self, places: Sequence[Cores], *, is_fresh: bool = False) -> None:
        self.num_places = len(places)
        self._is_fresh = is_fresh
        self._is_ending = threading.Event()
        self._threads = ThreadPoolExecutor(len(places))
        self._free: SimpleQueue[_Place] = SimpleQueue()
        self._places = [_Place(partial(_settle, cores, is_alone=len(places) == 1)) for cores in places]
        for place in self._places:
            self._free.put(place)

    def __enter__(self) -> LocalProcesses:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let calls that are being made end, or after an exception, Ctrl-C included, end them."""
        self._is_ending.set()
        self._threads.shutdown(wait=error is None, cancel_futures=True)
        while self._free.qsize() < self.num_places:  # a thread may be at starting one more
            for process in multiprocessing.active_children():
                process.terminate()
            time.sleep(0.05)
        for place in self._places:
            place.close()

    def submit(self, call: Callable[[Argument], Result], argument: Argument) -> Future[Result]:
        """Have a process make a call."""
        return self._threads.submit(self._call, call, argument)

    def ask(self, question: Callable[..., Result], *arguments: Any) -> dict[str, Result]:
        """Nobody: all see what this process sees."""
        return {}

    def _call(self, call: Callable[[Argument], Result], argument: Argument) -> Result:
        place = self._free.get()
        try:
            return self._tried(place, call, argument)
        finally:
            if self._is_fresh:
                place.close()
            self._free.put(place)

    def _tried(self, place: _Place, call: Callable[[Argument], Result], argument: Argument) -> Result:
        for _ in range(MAX_DEATHS):
            if self._is_ending.is_set():
                raise ClusterError("The call was ended with those beside it.")
            with suppress(BrokenProcessPool):
                return place.process().submit(call, argument).result()
            place.close()
        raise ClusterError(lost_workers(MAX_DEATHS))


@dataclass
class _Place:
    """Where one process runs at a time; `settle` is what it begins with."""

    settle: Callable[[], None]
    _process: ProcessPoolExecutor | None = None

    def process(self) -> ProcessPoolExecutor:
        """The process, started where there is none; a library that was imported here counts its own cores."""
        if self._process is None:
            context = multiprocessing.get_context("spawn")
            self._process = ProcessPoolExecutor(1, context, self.settle)
        return self._process

    def close(self) -> None:
        """Let the process end."""
        if self._process is not None:
            self._process.shutdown()
            self._process = None


def _settle(place: Cores, is_alone: bool) -> None:
    """Keep this process to its cores, and end it with its parent, even one that is killed."""
    if place:
        os.sched_setaffinity(0, place)
    elif not is_alone:  # macOS keeps no process to a core; one thread is what comes nearest
        os.environ.update(dict.fromkeys(_THREADS, "1"))
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent:
        parent.join()
        os._exit(1)
