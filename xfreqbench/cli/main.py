"""Runs the command line, and turns every error that a user can fix into one line and an exit code."""

from __future__ import annotations

import _thread
import io
import os
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from xfreqbench.cli import data, exchange, measure, runs
from xfreqbench.cli.options import app, plain
from xfreqbench.cli.plugins import add_plugin_commands
from xfreqbench.errors import RunsFailedError, StorageError, XFreqBenchError, was_interrupted
from xfreqbench.system.bars import announcing
from xfreqbench.system.machine import require_thread_count, require_working_folder

__all__ = ["app", "data", "exchange", "main", "measure", "runs"]  # importing a file adds its commands
_WIDTHS = 20, 1000  # columns of text: narrower, a help text never ends; wider, it fills the memory
_MOMENT_S = 0.01
_IGNORED = add_plugin_commands(app)  # after the commands of our own


def main() -> None:
    """Run the command line; ends with exit code 2 for an error that a user can fix, 130 for an interrupted command."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # the name of a file need not be valid text
    _bound_console_width()
    os.environ["MPLBACKEND"] = "agg"  # no window is opened, and Matplotlib cannot be imported with a wrong name
    for ignored in _IGNORED:
        print(f"xfreqbench: {ignored}", file=sys.stderr)
    try:
        require_working_folder()
        require_thread_count()
        with interruptions_kept(), announcing(not {"--quiet", "-q"} & {*sys.argv}):
            if sys.argv[1:2] in ([], ["--help"], ["-h"]):
                app.resolved_commands()  # imports plug-ins, so that help describes their commands
            app()
        sys.stdout.flush()
    except (StorageError, RunsFailedError) as error:  # of several runs, one may have found no space
        print(f"xfreqbench: {plain(error)}", file=sys.stderr, flush=True)
        os._exit(2)  # at an ordinary exit HDF5 would write the failed file again, and crash
    except XFreqBenchError as error:
        print(f"xfreqbench: {plain(error)}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # the program that reads our output, such as `head`, has read enough
        _discard_output()
        sys.exit(1)
    except OSError as error:
        fault = f"{error.filename} cannot be used: {error.strerror}. Correct the path or its permissions."
        if error.filename is None:
            if not _is_output_lost():
                raise
            fault = f"what is printed cannot be written: {error.strerror}. Free some space, or print elsewhere."
        print(f"xfreqbench: {plain(fault)}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        _leave_interrupted()
    except (SystemError, RuntimeError) as error:  # of Numba and Dr.Jit, where Ctrl-C interrupts a kernel
        if not was_interrupted(error):
            raise
        _leave_interrupted()


@contextmanager
def interruptions_kept() -> Iterator[None]:
    """Let Ctrl-C count where Python drops it: in a callback of the garbage collector, it would be printed and lost."""
    others = sys.unraisablehook

    def press_again(lost: sys.UnraisableHookArgs) -> None:
        if isinstance(lost.exc_value, KeyboardInterrupt):
            threading.Timer(_MOMENT_S, _thread.interrupt_main).start()  # here it would be lost again
        else:
            others(lost)

    sys.unraisablehook = press_again
    try:
        yield
    finally:
        sys.unraisablehook = others


def _is_output_lost() -> bool:
    """Whether an empty line cannot be printed; what is left to print is then discarded."""
    try:
        print(flush=True)
    except OSError:
        _discard_output()
        return True
    return False


def _discard_output() -> None:
    """Send what is left to print nowhere, because the interpreter's exit would fail of it once more."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _bound_console_width() -> None:
    """Have tables, bars and help texts drawn for a sensible width, whatever `COLUMNS` or the terminal say."""
    low, high = _WIDTHS
    width = shutil.get_terminal_size().columns
    if "COLUMNS" in os.environ or not low <= width <= high:
        os.environ["COLUMNS"] = str(min(max(width, low), high))


def _leave_interrupted() -> None:
    print("\nxfreqbench: interrupted; the same command goes on where it stopped.", file=sys.stderr)
    sys.exit(130)
