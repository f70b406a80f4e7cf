"""Runs the command line, and turns every error that a user can mend into one line and an exit code."""

from __future__ import annotations

import io
import os
import shutil
import sys

from xfreqbench.cli import data, exchange, findings, measure, runs
from xfreqbench.cli.options import app
from xfreqbench.errors import StorageError, XFreqBenchError, was_interrupted

__all__ = [
    "app",
    "data",
    "exchange",
    "findings",
    "main",
    "measure",
    "runs",
]  # importing a file adds its commands
_WIDTHS = 20, 1000  # columns of text: narrower, a help text never ends; wider, it fills the memory


def main() -> None:
    """Run the command line; ends with exit code 2 for an error that a user can mend, 130 for an interrupted command."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # the name of a file need not be valid text
    _bound_console_width()
    try:
        app()
        sys.stdout.flush()
    except StorageError as error:
        print(f"xfreqbench: {error}", file=sys.stderr, flush=True)
        os._exit(2)  # at an ordinary exit HDF5 would write the failed file again, and crash
    except XFreqBenchError as error:
        print(f"xfreqbench: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # the program that reads our output, such as `head`, has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        if error.filename is None:
            raise
        fault = f"{error.filename} cannot be used: {error.strerror}. Mend the path or its permissions."
        print(f"xfreqbench: {fault}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        _leave_interrupted()
    except SystemError as error:  # which Numba raises where Ctrl-C interrupts a kernel
        if not was_interrupted(error):
            raise
        _leave_interrupted()


def _bound_console_width() -> None:
    """Have tables, bars and help texts drawn for a sensible width, whatever `COLUMNS` or the terminal say."""
    low, high = _WIDTHS
    width = shutil.get_terminal_size().columns
    if "COLUMNS" in os.environ or not low <= width <= high:
        os.environ["COLUMNS"] = str(min(max(width, low), high))


def _leave_interrupted() -> None:
    print("\nxfreqbench: interrupted; the same command goes on where it stopped.", file=sys.stderr)
    sys.exit(130)
