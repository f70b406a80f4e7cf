"""Runs the command line, and turns every error that a user can fix into one line and an exit code."""

from __future__ import annotations

import io
import os
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import ExtensionFileLoader
from types import FrameType
from typing import NoReturn

from xfreqbench.cli import data, exchange, measure, runs
from xfreqbench.cli.options import app, plain
from xfreqbench.cli.plugins import add_plugin_commands
from xfreqbench.errors import OutOfMemoryError, RunsFailedError, StorageError, XFreqBenchError, was_interrupted
from xfreqbench.system.bars import announcing
from xfreqbench.system.machine import (
    lacks_memory,
    memory_left,
    now,
    require_memory,
    require_thread_count,
    require_working_folder,
)

__all__ = ["app", "data", "exchange", "main", "measure", "runs"]  # importing a file adds its commands
_LOADING = ExtensionFileLoader.create_module.__code__, ExtensionFileLoader.exec_module.__code__
_IGNORED = add_plugin_commands(app)  # after the commands of our own


def main() -> None:
    """Run the command line; ends with exit code 2 for an error that a user can fix, 130 for an interrupted command.

    The code is 1 if memory runs out, or if the program that reads the output has ended.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files may be invalid text
    _bound_console_width()
    os.environ["MPLBACKEND"] = "agg"  # opens no window; Matplotlib could not be imported with a wrong name
    for ignored in _IGNORED:
        print(f"xfreqbench: {ignored}", file=sys.stderr)
    try:
        require_working_folder()
        require_thread_count()
        now()  # a wrong clock is an error before the work
        # with less, OpenBLAS and LLVM end the process, or wait for ever, when they are loaded
        require_memory(200, "This command")
        with interruptions_kept(), announcing(not {"--quiet", "-q"} & {*sys.argv}):
            if sys.argv[1:2] in ([], ["--help"], ["-h"]):
                app.resolved_commands()  # imports plug-ins, so that help describes their commands
            app()
        sys.stdout.flush()
    except (StorageError, RunsFailedError, OutOfMemoryError) as error:  # of several runs, one may have found no space
        # at an ordinary exit HDF5 would write the failed file again, and crash
        _leave(f"xfreqbench: {_shown(error)}", 1 if isinstance(error, OutOfMemoryError) else 2)
    except XFreqBenchError as error:
        print(f"xfreqbench: {_shown(error)}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # the program that reads our output, such as `head`, has read enough
        _discard_output()
        sys.exit(1)
    except (Exception, KeyboardInterrupt) as error:
        if was_interrupted(error):  # Numba and Dr.Jit raise errors of their own if Ctrl-C interrupts a kernel
            _leave("\nxfreqbench: interrupted; the same command continues where it stopped.", 130)
        if lacks_memory(error):
            said = str(error).partition("\n")[0] or type(error).__name__
            _leave(f"xfreqbench: memory ran out: {said}. {memory_left()}", 1)
        if not isinstance(error, OSError) or (error.filename is None and not _is_output_lost()):
            raise
        fault = f"{error.filename} cannot be used: {error.strerror}. Correct the path or its permissions."
        if error.filename is None:
            fault = f"the output cannot be printed: {error.strerror}. Free some space, or print elsewhere."
        print(f"xfreqbench: {plain(fault)}", file=sys.stderr)
        sys.exit(2)


def _shown(error: XFreqBenchError) -> str:
    """The message of an error as it is printed, without the middle of a very long one."""
    text = plain(error)
    return text if len(text) < 8000 else f"{text[:4000]} … {text[-2000:]}"


@contextmanager
def interruptions_kept() -> Iterator[None]:
    """Keep Ctrl-C where Python or a library drops it: in the garbage collector, or while C looks for an attribute.

    It is raised again unless the main thread is ending because of it, and instead of the errors of libraries. It waits
    until a compiled module is imported: one that is initialised halfway crashes the interpreter at its exit.
    """
    others, main_thread = sys.unraisablehook, threading.get_ident()
    is_ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # in a shell's background it is ignored
    pressed = threading.Event()

    def press(number: int, frame: FrameType | None) -> None:
        pressed.set()
        look_after()
        while frame and frame.f_code not in _LOADING:
            frame = frame.f_back
        if not frame:
            raise KeyboardInterrupt

    def look_after() -> None:
        threading.Timer(0.01, press_again).start()  # here it would be lost again

    def press_again() -> None:
        raised = sys._current_exceptions()[main_thread]
        error = raised[1] if isinstance(raised, tuple) else raised  # with its type and place before Python 3.12
        if sys.unraisablehook is hook and not was_interrupted(error):
            signal.pthread_kill(main_thread, signal.SIGINT)  # which wakes it, too

    def hook(lost: sys.UnraisableHookArgs) -> None:
        look_after() if isinstance(lost.exc_value, KeyboardInterrupt) else others(lost)

    sys.unraisablehook = hook
    if is_ours:
        signal.signal(signal.SIGINT, press)
    try:
        yield
    except Exception as error:
        if pressed.is_set():
            raise KeyboardInterrupt from error
        raise
    finally:
        sys.unraisablehook = others
        if is_ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _is_output_lost() -> bool:
    """Whether an empty line cannot be printed; what is left to print is then discarded."""
    try:
        print(flush=True)
    except OSError:
        _discard_output()
        return True
    return False


def _discard_output() -> None:
    """Discard the rest of the output, because the interpreter's exit would fail to print it again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _bound_console_width() -> None:
    """Limit the width of tables, bars and help texts that `COLUMNS` or the terminal asks for."""
    low, high = 20, 1000  # narrower, a help text never ends; wider, it fills the memory
    width = shutil.get_terminal_size().columns
    if "COLUMNS" in os.environ or not low <= width <= high:
        os.environ["COLUMNS"] = str(min(max(width, low), high))


def _leave(words: str, status: int) -> NoReturn:
    """Print why, and end without the interpreter's exit, which frees what threads and libraries may still use."""
    try:
        print(words, file=sys.stderr, flush=True)
        sys.stdout.flush()
    finally:
        os._exit(status)
