"""The command line: what it is called by, and how it ends."""

from __future__ import annotations

import io
import os
import sys

from xfreqbench.commands import app, data, exchange, learned, measure, runs
from xfreqbench.errors import StorageError, XFreqBenchError

__all__ = ["app", "data", "exchange", "learned", "main", "measure", "runs"]


def main() -> None:
    """Run the command line; exit code 2 for what a user can mend, 130 for an interrupted command."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files need be no text
    try:
        app()
        sys.stdout.flush()
    except StorageError as error:
        print(f"xfreqbench: {error}", file=sys.stderr, flush=True)
        os._exit(2)  # HDF5 would write the failed file once more on the way out, and crash
    except XFreqBenchError as error:
        print(f"xfreqbench: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # whoever read, as `head` does, has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        if error.filename is None:
            raise
        print(f"xfreqbench: {_unusable(error)}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        _leave_interrupted()
    except SystemError as error:  # what Numba makes of Ctrl-C within a kernel
        if not _was_interrupted(error):
            raise
        _leave_interrupted()


def _unusable(error: OSError) -> str:
    """Words for a path that the system refuses before anything looks into it: too long, or not to be entered."""
    return f"{error.filename} cannot be used: {error.strerror}. Mend the path or its permissions."


def _was_interrupted(error: BaseException | None) -> bool:
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _leave_interrupted() -> None:
    print("\nxfreqbench: interrupted; the same command goes on where it stopped.", file=sys.stderr)
    sys.exit(130)


if __name__ == "__main__":
    main()
