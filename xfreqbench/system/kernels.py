"""Kernels that Numba compiles, in a separate process from those that use them: all of these run what its cache holds.

Numba optimises a kernel for the process that compiles it, and once more, with all that it calls, for the cache. Sums
in the two may be in another order, so a process that ran what it compiled itself would compute other last digits than
those after it.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

import numba
from numba.core import config
from numba.core.caching import FunctionCache

from xfreqbench.errors import XFreqBenchError
from xfreqbench.system.bars import announce_compilation
from xfreqbench.system.machine import safe_path

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

_IS_COMPILER = "XFREQBENCH_IS_COMPILER"  # a variable of its environment
_SERVE = "from xfreqbench.system.kernels import serve; serve()"
_compilers: dict[int, Any] = {}  # by the process that they compile for


def entry(sources: str | None = None, **options: Any) -> Callable[[Kernel], Kernel]:
    """Compile a kernel that Python calls, by `options` of `numba.njit`, and keep it in Numba's cache.

    Kernels that it calls are `numba.njit` without a cache: code from the cache is called, not made part of the
    kernel, and then rounds otherwise. It is compiled again if its file has changed, or, if `sources` is
    given, if that has. Raises `XFreqBenchError` if no folder of a cache can be written.
    """

    def compiled(function: Kernel) -> Kernel:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]  # NUMBA_DISABLE_JIT=1, to debug
            return function
        kernel: Any = numba.njit(**options)(function)
        try:
            kernel._cache = _Cache(kernel.py_func)  # type: ignore[no-untyped-call]
        except RuntimeError as error:
            advice = "Set NUMBA_CACHE_DIR to a folder that can be written."
            raise XFreqBenchError(f"There is no folder for compiled kernels. {advice}") from error
        if sources is not None:
            file = kernel._cache._cache_file
            # of another version Numba does not read the types of arguments, which these sources may lack
            file._source_stamp, file._version = sources, f"{file._version} {sources}"
        return kernel

    return compiled


class _Cache(FunctionCache):
    """Numba's cache, which has another process compile what it lacks."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled kernel for types of arguments; None if this process has to compile it."""
        found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if found is None and _compile_beside(self._py_func.__module__, self._py_func.__name__, sig):
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        return found


def _compile_beside(module: str, name: str, sig: Any) -> bool:
    """Have this process's compiler compile a kernel for types of arguments; return whether it did.

    Raises `MemoryError` if the compiler is killed, or aborts as LLVM does without memory: so would this process.
    """
    if _IS_COMPILER in os.environ:
        return False
    announce_compilation()
    asked = pickle.dumps((module, name, sig))
    for _ in range(2):  # one that was idle may end at this moment
        with suppress(OSError):
            compiler = _compilers.pop(os.getpid(), None)  # and forgotten, unless its answer has come
            if compiler is None or compiler.poll() is not None:
                compiler = _started()
            compiler.stdin.write(asked)
            compiler.stdin.flush()
            if compiler.stdout.read(1):
                _compilers[os.getpid()] = compiler
                return True
            if compiler.wait() in (-6, -9):  # by SIGABRT, SIGKILL
                raise MemoryError("the process that compiles kernels died")
    return False


def _started() -> Any:
    """A compiler for this process, which goes with it."""
    path = os.pathsep.join(folder or str(Path.cwd()) for folder in sys.path)
    with safe_path():
        compiler = subprocess.Popen(
            [sys.executable, "-c", _SERVE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # what fails there is compiled here, where errors show
            env=os.environ | {"PYTHONPATH": path, _IS_COMPILER: "1"},
        )
    atexit.register(_end, compiler)
    return compiler


def _end(compiler: Any) -> None:
    compiler.kill()
    compiler.communicate()


def serve() -> None:
    """Compile into the cache what is asked for on standard input, until nothing is for a while.

    What fails to compile ends this process, and so does the end of the process that asks, even while it compiles.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends who asks
    asked: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_listen, args=(asked,), daemon=True).start()
    while True:
        signal.alarm(20)  # ends this process; compilers hold a gigabyte
        module, name, sig = asked.get()
        signal.alarm(0)
        getattr(import_module(module), name).compile(sig)
        sys.stdout.buffer.write(b".")
        sys.stdout.buffer.flush()


def _listen(asked: SimpleQueue[Any]) -> None:
    try:
        while True:
            asked.put(pickle.load(sys.stdin.buffer))
    finally:
        os._exit(1)
