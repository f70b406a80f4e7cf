"""Calls side by side, each in a fresh process on a core of its own: equal conditions for whatever is timed."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from typing import TypeVar

Argument = TypeVar("Argument")
Result = TypeVar("Result")
Cores = frozenset[int]
_THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def own_cores() -> list[Cores]:
    """Every core that this process may use, by itself; where processes cannot be kept to cores, empty sets."""
    if hasattr(os, "sched_getaffinity"):
        return [frozenset({core}) for core in sorted(os.sched_getaffinity(0))]
    return [frozenset()] * (os.cpu_count() or 1)


def all_cores() -> list[Cores]:
    """One place with every core that this process may use."""
    return [frozenset().union(*own_cores())]


def side_by_side(
    call: Callable[[Argument], Result], arguments: Sequence[Argument], places: Sequence[Cores]
) -> Iterator[tuple[Argument, Future[Result]]]:
    """Call a picklable function for every argument, as many at a time as there are places, in their order.

    Yields arguments with their finished futures as they come. Every call starts in a new process that is
    kept to its place's cores, and that ends with this one, however this one ends.
    """
    free: SimpleQueue[Cores] = SimpleQueue()
    for place in places:
        free.put(place)
    with ThreadPoolExecutor(len(places)) as threads, _ending_with_us():
        settle = partial(_settle, is_alone=len(places) == 1)
        futures = {threads.submit(_call_in_place, call, each, free, settle): each for each in arguments}
        try:
            for future in as_completed(futures):
                yield futures[future], future
        finally:
            for future in futures:
                future.cancel()


@contextmanager
def _ending_with_us() -> Iterator[None]:
    """Where the block ends by an exception, Ctrl-C included, end the processes that still run."""
    try:
        yield
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()
        raise


def _call_in_place(
    call: Callable[[Argument], Result],
    argument: Argument,
    free: SimpleQueue[Cores],
    settle: Callable[[Cores], None],
) -> Result:
    place = free.get()
    try:
        context = multiprocessing.get_context(
            "spawn"
        )  # a library that was imported here counts its own cores
        with ProcessPoolExecutor(1, context, settle, (place,)) as process:
            return process.submit(call, argument).result()
    finally:
        free.put(place)


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
