"""How long waiting threads of OpenMP keep their core busy, which has to be said before OpenMP starts.

A thread that spins while it waits goes on at once, but keeps its core from other programs, whose work the others may
be waiting for. Libgomp lets threads spin for milliseconds. `xfreqbench bench load` measures what that costs.
"""

from __future__ import annotations

import os
from pathlib import Path

_LOAD = Path("/proc/loadavg")
_SPINS = "GOMP_SPINCOUNT"
_BUSY, _IDLE = "1", "1001"  # the package sets the second where the user set none, and no user writes 1001


def choose_spinning() -> None:
    """Let threads of this process spin by how busy the machine is, unless the user has said how long they may."""
    if os.environ.get(_SPINS) in (_BUSY, _IDLE):
        os.environ[_SPINS] = _BUSY if _is_busy() else _IDLE


def _is_busy() -> bool:
    """Whether at least as many threads of others want to run as the machine has cores; False where nothing tells."""
    try:
        num_running = int(_LOAD.read_text(encoding="utf-8").split()[3].partition("/")[0])
    except (OSError, ValueError, LookupError):
        return False
    return num_running > (os.cpu_count() or 1)  # this thread is one of them
