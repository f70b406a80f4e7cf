"""What makes many calls of one function: this process, processes with cores of their own, or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from itertools import islice
from typing import Any, TypeVar

Argument = TypeVar("Argument")
Result = TypeVar("Result")


class Workers(Executor):
    """What makes calls. Functions and arguments are pickled, unless the calls are made in this process.

    A call whose worker dies is made again a few times, and then ends with `ClusterError`.
    """

    num_places = 1
    """Number of calls that are made at a time."""

    def ask(self, question: Callable[..., Result], *arguments: Any) -> dict[str, Result]:
        """Have a function called by every worker that may be on another machine; its answers by workers' names."""
        return {}


class InThisProcess(Workers):
    """Makes each call immediately, in this process, with as many threads as the call uses."""

    def submit(self, call: Callable[..., Result], /, *arguments: Any, **options: Any) -> Future[Result]:
        """Make a call; the future is finished."""
        future: Future[Result] = Future()
        try:
            future.set_result(call(*arguments, **options))
        except Exception as error:
            future.set_exception(error)
        return future


HERE = InThisProcess()


def side_by_side(
    workers: Workers, call: Callable[[Argument], Result], arguments: Iterable[Argument], *, ahead: int = 0
) -> Iterator[tuple[Argument, Future[Result]]]:
    """Call a function with every argument, in their order, as many calls at a time as `workers` has places.

    Yields each argument with its finished future, in the order in which calls end. For each place, at most `ahead`
    calls wait in addition to the current one, so that neither arguments nor results pile up. Calls that still wait when
    the caller stops iterating are cancelled.
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


def lost_workers(number: int, where: str = "") -> str:
    """Words for a call that ended because `number` workers died of it."""
    return (
        f"{number} workers died of it{where}. Most often memory ran out: have fewer workers, or allow each of them "
        "more. A cluster's workers have a log that says why."
    )
