from __future__ import annotations

import errno
import pickle

import numpy as np
import pytest

from xfreqbench.errors import (
    DataError,
    DivergenceError,
    OutOfMemoryError,
    UnknownNameError,
    XFreqBenchError,
    ran_out_of_memory,
)


@pytest.mark.parametrize(
    "error",
    [
        DataError("damaged"),
        OutOfMemoryError("1 MiB is left"),
        UnknownNameError("method", "nearst", ["nearest", "xfreq-gs"]),
        DivergenceError(7, "loss", "Lower it."),
    ],
)
def test_an_error_says_the_same_in_another_process(error: XFreqBenchError) -> None:
    arrived = pickle.loads(pickle.dumps(error))
    assert type(arrived) is type(error)
    assert str(arrived) == str(error)
    assert getattr(arrived, "step", None) == getattr(error, "step", None)


def _caused_by(error: BaseException) -> Exception:
    found = ValueError("no map")
    found.__cause__ = error
    return found


def _of_numpy() -> MemoryError:
    with pytest.raises(MemoryError) as found:
        np.empty(2**60, np.uint8)
    return found.value


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        _of_numpy(),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        OSError("Unable to synchronously open file (memory allocation failed for file read buffer)"),
        RuntimeError("[enforce fail at alloc_cpu.cpp:117] err == 0. DefaultCPUAllocator: can't allocate memory"),
        RuntimeError("DefaultCPUAllocator: not enough memory: you tried to allocate 8 bytes."),
        RuntimeError("can't start new thread"),
        ImportError("_flapack.so: failed to map segment from shared object"),
        ImportError("libtorch.so: cannot allocate memory in static TLS block"),
        SystemError("error return without exception set"),
        _caused_by(MemoryError()),
    ],
)
def test_libraries_say_in_many_ways_that_memory_ran_out(error: BaseException) -> None:
    assert ran_out_of_memory(error)


@pytest.mark.parametrize(
    "error", [RuntimeError("shapes differ"), OSError(errno.ENOSPC, "No space"), DataError("damaged"), ValueError(1)]
)
def test_other_errors_are_no_lack_of_memory(error: BaseException) -> None:
    assert not ran_out_of_memory(error)
