"""How the kernels of this folder are compiled, and how Numba's cache learns that one of their sources has changed."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from numba import get_num_threads, njit

from xfreqbench.errors import XFreqBenchError
from xfreqbench.system import kernels
from xfreqbench.system.bars import report

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
Result = TypeVar("Result")

FAST = {"nnan", "ninf", "nsz", "arcp", "contract", "afn", "reassoc"}
_OPTIONS: dict[str, Any] = {"fastmath": FAST, "error_model": "numpy"}
SOURCES = hashlib.sha256(b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py")))).hexdigest()

if TYPE_CHECKING:  # Numba's types lack the option `_nrt`
    _uncounted = njit
else:  # for kernels that neither make nor return an array: they do not count references to those they are given,
    # which took an eighth of the time. Who returns an array without counting has it freed while it is in use.
    _uncounted = partial(njit, _nrt=False)

part = _uncounted(forceinline=True, **_OPTIONS)  # a few lines of the kernel that calls it
lane = njit(inline="always", **_OPTIONS)  # its very lines, for loops over lanes, which no call may interrupt
bare = _uncounted(**_OPTIONS)
whole = njit(**_OPTIONS)  # may make arrays


def entry(function: Kernel) -> Kernel:
    """Compile a kernel that Python calls, without the interpreter's lock, anew where any file of this folder changed.

    A cached kernel holds the code of those that it calls.
    """
    return kernels.entry(SOURCES, nogil=True, **_OPTIONS)(function)


def within(kernel: Any) -> Any:
    """An `entry` for other kernels: code from the cache is called, not made part of them, and then rounds otherwise."""
    return whole(getattr(kernel, "py_func", kernel))


def num_threads() -> int:
    """Number of threads that Numba uses; raises `XFreqBenchError` where it is to start them by a library it lacks."""
    try:
        return get_num_threads()
    except ValueError as error:
        asked = os.environ.get("NUMBA_THREADING_LAYER")
        raise XFreqBenchError(
            f"NUMBA_THREADING_LAYER is set to {asked!r}, with which Numba cannot start threads here: "
            f"{str(error).splitlines()[0]} Set it to omp or workqueue, or unset it."
        ) from error


def on_threads(call: Callable[[int], Result], number: int, title: str = "") -> list[Result]:
    """The results of `call` for 0 to number − 1, computed by as many threads as Numba may use.

    With a `title` it reports how many are there. After an exception, Ctrl-C included, it does not wait for those that
    compile or compute, which may take a minute.
    """
    threads, results = ThreadPoolExecutor(num_threads()), list[Result]()
    try:
        for result in threads.map(call, range(number)):
            results.append(result)
            if title:
                report(title, len(results), number)
        return results
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
