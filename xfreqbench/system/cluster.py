"""Workers of a Dask cluster, which may join, leave and die. Only this module imports `distributed`."""

from __future__ import annotations

import asyncio
import logging
import platform
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from importlib.util import find_spec
from typing import Any, TypeVar

from xfreqbench.errors import ClusterError
from xfreqbench.system.machine import installed_version, safe_path
from xfreqbench.system.source import package_sha256
from xfreqbench.system.workers import Workers, lost_workers

Result = TypeVar("Result")
SCHEME = "dask://"
CONNECT_S = 6.0  # how long to wait for a scheduler
FIRST_WORKER_S = 30.0  # and then for its first worker, which has to import libraries
_LIBRARIES = ("numpy", "scipy", "h5py", "torch", "numba", "dask", "distributed")


class _DaskWorkers(Workers):
    """The workers of one scheduler, each making one call at a time.

    A call whose worker dies is made again on another worker. It ends with `ClusterError` once more workers have
    died of it than the scheduler's `distributed.scheduler.allowed-failures`, or if the scheduler itself ends, and where
    its worker has other software than this process.
    """

    def __init__(self, client: Any, address: str) -> None:
        self._client = client
        self._address = address
        self._executor = client.get_executor(pure=False)

    @property
    def num_places(self) -> int:  # type: ignore[override]
        """Number of workers at this moment."""
        with _losses_in_words(self._address):
            return len(self._client.nthreads())

    def submit(self, call: Callable[..., Result], /, *arguments: Any, **options: Any) -> Future[Result]:
        """Have a worker make a call."""
        import cloudpickle

        sent = cloudpickle.dumps(partial(call, *arguments, **options))
        with _losses_in_words(self._address):
            found = self._executor.submit(_call_alike, sent, fingerprint())
        # a future with the same outcome, except that the death of workers or scheduler is a `ClusterError`
        worded: Future[Result] = Future()
        worded.add_done_callback(lambda ended: found.cancel() if ended.cancelled() else None)
        found.add_done_callback(partial(self._end, worded))
        return worded

    def _end(self, worded: Future[Any], found: Future[Any]) -> None:
        """Give a future the outcome of a call."""
        if not worded.set_running_or_notify_cancel():
            return
        error = _gone(self._address) if found.cancelled() else found.exception()
        if error is None:
            worded.set_result(found.result())
        else:
            worded.set_exception(_killed(error) or error)

    def ask(self, question: Callable[..., Result], *arguments: Any) -> dict[str, Result]:
        """The answer of every worker to a question, by its address; raises `ClusterError` if one cannot answer."""
        with _losses_in_words(self._address):
            answers = self._client.run(question, *arguments, on_error="return")
        for worker, answer in answers.items():
            if isinstance(answer, Exception):
                raise ClusterError(
                    f"Worker {worker} of {self._address} cannot work: {type(answer).__name__}: {answer}. Start "
                    "it in an environment like this one."
                )
        return answers


@contextmanager
def dask_workers(address: str) -> Iterator[_DaskWorkers]:
    """Yield the workers of the scheduler at `dask://host:port`, after checking that they match this process.

    Raises `ClusterError` if `distributed` is not installed, if there is no scheduler or no worker, if a worker has
    several threads, and if one has other versions of Python, of a library or of xfreqbench.
    """
    distributed = _imported()
    scheduler = "tcp://" + address.removeprefix(SCHEME)
    # the last prints a traceback where Ctrl-C meets a call that has not quite begun
    with _quiet("distributed", "distributed.client", "tornado.application"):  # the errors below say it in words of ours
        try:
            with ThreadPoolExecutor(1) as thread:  # a notebook has an event loop of its own
                question = asyncio.wait_for(_require_scheduler(distributed, scheduler), CONNECT_S)
                thread.submit(asyncio.run, question).result()
            client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:  # what listens there may say anything
            heard = " ".join(str(error).split()) or "nothing is said"
            fault = heard if isinstance(error, OSError) else "what listens there is something else"
            raise ClusterError(
                f"No Dask scheduler answers at {address}: {fault}. Start one with `dask scheduler`, or fix --executor."
            ) from error
        with client:
            workers = _DaskWorkers(client, address)
            _require_workers(client, address)
            for worker, found in workers.ask(fingerprint).items():
                _require_alike(worker, fingerprint(), found)
            yield workers


async def _require_scheduler(distributed: Any, address: str) -> None:
    """Raise an exception unless a Dask scheduler listens at an address; it is given as long as the caller waits."""
    comm = await distributed.comm.connect(address, timeout=CONNECT_S)
    try:
        await comm.write({"op": "identity", "reply": True, "close": True})
        answer = await comm.read()
    finally:
        comm.abort()
    if answer["type"] != "Scheduler":
        raise ConnectionError(f"a Dask {answer['type'].lower()} listens there")


@contextmanager
def _quiet(*names: str) -> Iterator[None]:
    """A block in which loggers report critical errors only."""
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def is_installed() -> bool:
    """Whether the extra `cluster` is installed."""
    return find_spec("distributed") is not None


@contextmanager
def local_cluster(num_workers: int) -> Iterator[str]:
    """Start a cluster on this machine, with one thread a worker, for the block; yields its `dask://` address."""
    distributed = _imported()
    one_thread = {"NUMBA_NUM_THREADS": "1"}  # Dask itself limits OpenMP and BLAS to one thread
    options = {"threads_per_worker": 1, "dashboard_address": ":0", "env": one_thread}
    with safe_path(), distributed.LocalCluster(n_workers=num_workers, **options) as cluster:
        yield SCHEME + cluster.scheduler_address.removeprefix("tcp://")


@cache
def fingerprint() -> Mapping[str, str]:
    """What has to be the same wherever a call is made: versions of Python, libraries and this package, and its code."""
    versions = {name: installed_version(name) or "none" for name in _LIBRARIES}
    own = f"{installed_version('xfreqbench')} ({package_sha256()[:12]})"  # an edited checkout keeps its version
    return {"python": platform.python_version(), "xfreqbench": own} | versions


def differences(ours: Mapping[str, str], theirs: Mapping[str, str]) -> str:
    """The names whose values differ, each with both values, in words; empty if all are equal."""
    names = [name for name in {**ours, **theirs} if ours.get(name) != theirs.get(name)]
    return ", ".join(f"{name} {theirs.get(name, 'none')} (here {ours.get(name, 'none')})" for name in sorted(names))


def _require_alike(worker: str, ours: Mapping[str, str], theirs: Mapping[str, str]) -> None:
    """Raise `ClusterError` where the versions of a worker are not those of the driver."""
    if differing := differences(ours, theirs):
        raise ClusterError(
            f"Worker {worker} has other software: {differing}. Its results could differ; install the same "
            "versions on both, as with `pip install -c constraints.txt`."
        )


def _imported() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise ClusterError(
            'A Dask cluster needs the extra "cluster". Run: pip install "xfreqbench[cluster]"'
        ) from error
    return distributed


def _require_workers(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)
    except TimeoutError as error:
        host = address.removeprefix(SCHEME)
        raise ClusterError(
            f"The scheduler at {address} has no worker. Start some: dask worker {host} --nthreads 1 --nworkers N"
        ) from error
    several = sorted(worker for worker, number in client.nthreads().items() if number > 1)
    if several:
        raise ClusterError(
            f"{len(several)} workers of {address} make several calls at a time ({several[0]}), which the solvers "
            "do not support. Start them with --nthreads 1, and --nworkers for as many as there are cores."
        )


def _call_alike(sent: bytes, drivers: Mapping[str, str]) -> Any:
    """On the worker: make a call, unless this worker differs from the driver, as one that joined later may."""
    import cloudpickle
    from distributed import get_worker

    _require_alike(get_worker().address, drivers, fingerprint())
    return cloudpickle.loads(sent)()


@contextmanager
def _losses_in_words(address: str) -> Iterator[None]:
    """Turn any error of a client whose scheduler has ended into a `ClusterError`."""
    from distributed.client import ClosedClientError

    try:
        yield
    except (OSError, ClosedClientError) as error:
        raise _gone(address) from error


def _gone(address: str) -> ClusterError:
    return ClusterError(
        f"The scheduler at {address} has gone, and so has the work of its workers. Start it again; the same "
        "command continues where it stopped."
    )


def _killed(error: Any) -> ClusterError | None:
    from distributed.scheduler import KilledWorker

    if not isinstance(error, KilledWorker):
        return None
    return ClusterError(lost_workers(error.allowed_failures + 1, f", the last at {error.last_worker.address}"))
