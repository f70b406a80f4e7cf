"""Runs the code of methods, which is not ours: it may raise anything, end the process, or fork it."""

from __future__ import annotations

import importlib
import json
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic_core import from_json

from xfreqbench.errors import MethodError, OutOfMemoryError, XFreqBenchError, was_interrupted
from xfreqbench.system.machine import lacks_memory, memory_left


@contextmanager
def method_code(
    failed: str, advice: str, passed: tuple[type[XFreqBenchError], ...] = (XFreqBenchError,)
) -> Iterator[None]:
    """A block that runs a method's own code, in which whatever it raises becomes a `MethodError`.

    `SystemExit` is an error too, for a method may not end the process. The message begins with `failed`, such as
    "Method 'mine' failed in fit:", and ends with `advice`. Errors of the types `passed` are raised as they are, an
    interruption as `KeyboardInterrupt`, and a lack of memory as `OutOfMemoryError`. A child that the method forked and
    that comes back out of its code ends here: the parent alone goes on, so that nothing is stored twice.
    """
    process = os.getpid()
    try:
        yield
    except passed:
        raise
    except BaseException as error:
        if was_interrupted(error):
            raise KeyboardInterrupt from error
        if lacks_memory(error):
            raise OutOfMemoryError(f"{failed} {described(error)}. Memory ran out. {memory_left()}") from error
        raise MethodError(f"{failed} {described(error)}. {advice}".rstrip()) from error
    finally:
        if os.getpid() != process:
            print(f"xfreqbench: {failed} it forked the process; the child ends here.", file=sys.stderr, flush=True)
            os._exit(1)


def described(error: BaseException) -> str:
    """Type and message of an exception and, where it is known, the place in the method's code: one line of text."""
    try:
        text = str(error)[:2000]
    except Exception:  # a message may be a method's own code as well
        text = "its message cannot be shown"
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not frame.filename.startswith("<frozen ")]
    place = f" ({own[-1].filename}, line {own[-1].lineno})" if own else ""
    if own and Path(own[-1].filename).parent == Path(importlib.__file__).parent:
        place = ""  # the module was not found, or is no Python
    return readable(f"{type(error).__name__}: {text}{place}")


def readable(text: str) -> str:
    """A text in which what UTF-8 cannot hold, half of a surrogate pair, stands as an escape such as `\\udcff`."""
    return text.encode("utf-8", "backslashreplace").decode()


def plain_json(value: Any) -> Any:
    """What JSON holds of a value, as a record stores and reads it.

    Raises `ValueError`, `TypeError` or `RecursionError` for what no record can hold: other types, text that is no
    Unicode, values nested too deep.
    """
    return from_json(json.dumps(value))
