"""What a run is made with: threads, processor, memory, versions of libraries, and commit of the source code."""

from __future__ import annotations

import os
import platform
import subprocess
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from threadpoolctl import ThreadpoolController

from xfreqbench.errors import OutOfMemoryError, XFreqBenchError, ran_out_of_memory

_STATUS = Path("/proc/self/status")
_MEMORY = Path("/proc/meminfo")
_GROUPS, _LIMITS_OF_GROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
_THREADS, _MOST_THREADS = "NUMBA_NUM_THREADS", 1024  # with many more the system refuses to start them
_SAFE_PATH = "PYTHONSAFEPATH"
_STARTING, _num_starting = threading.Lock(), 0
_safe_path_before: str | None = None
_LIBRARIES = ("xfreqbench", "numpy", "scipy", "scikit-image", "h5py", "torch", "safetensors", "numba")


def require_working_folder() -> None:
    """Raise `XFreqBenchError` if the working folder has been removed, which libraries end the process for."""
    try:
        Path.cwd()
    except FileNotFoundError as error:
        raise XFreqBenchError("The working folder has been removed. Change into another one.") from error


def now() -> datetime:
    """This moment, in the time zone of the machine; raises `XFreqBenchError` if its clock is past the year 9999."""
    try:
        return datetime.now().astimezone()
    except (ValueError, OverflowError) as error:
        raise XFreqBenchError("The clock of this machine is past the year 9999. Set it right.") from error


def require_thread_count() -> None:
    """Raise `XFreqBenchError` if the environment asks Numba for a number of threads that cannot be."""
    asked = os.environ.get(_THREADS, "1")
    if not (asked.isdecimal() and len(asked) < 9 and 1 <= int(asked) <= _MOST_THREADS):
        raise XFreqBenchError(
            f"{_THREADS} is set to {asked!r}. Set it to a number of threads from 1 to {_MOST_THREADS}, or unset it: "
            "there is then one for each core."
        )


@contextmanager
def safe_path() -> Iterator[None]:
    """While the block runs, Python interpreters that are started do not import from the working folder.

    A process of multiprocessing gets the path of its parent, and imports what its parent can import. Interpreters that
    these start themselves do the same. Several threads may be in such a block.
    """
    global _num_starting, _safe_path_before
    with _STARTING:
        if _num_starting == 0:
            _safe_path_before = os.environ.get(_SAFE_PATH)
            os.environ[_SAFE_PATH] = "1"
        _num_starting += 1
    try:
        yield
    finally:
        with _STARTING:
            _num_starting -= 1
            if _num_starting == 0:
                del os.environ[_SAFE_PATH]
                if _safe_path_before is not None:
                    os.environ[_SAFE_PATH] = _safe_path_before


def one_blas_thread() -> AbstractContextManager[Any]:
    """A context in which BLAS computes products in one thread.

    On some processors products are rounded in other ways by two threads than by one. Where they are small, others
    only wait.
    """
    return _numeric_libraries().limit(limits=1, user_api="blas")


@cache
def _numeric_libraries() -> ThreadpoolController:
    return ThreadpoolController()


def reset_peak_memory() -> None:
    """Start a new measurement of peak memory, on Linux; elsewhere the peak stays that since the process began."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")


def peak_memory_mib() -> float:
    """Largest resident memory of this process since `reset_peak_memory`, in MiB, with interpreter and libraries.

    Of a process that was forked off another one it holds, too, what that one had imported.
    """
    try:
        return _stated_bytes(_STATUS, "VmHWM") / 2**20
    except (OSError, IndexError):
        import resource  # which Windows lacks

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (1 << 20 if platform.system() == "Darwin" else 1 << 10)  # macOS counts bytes


def available_memory_mib(processes: int = 1) -> float:
    """Memory in MiB that this process can still take without the system swapping; infinite if it is not known.

    On Linux it is the least that the system, control groups (of a container or a batch job) and `ulimit` leave. For
    several processes that will be started, it is what the first two leave for each.
    """
    try:
        shared, own = [float("inf"), *_left_in_groups()], [float("inf")]
    except MemoryError:  # to read a small file
        return 0.0
    with suppress(OSError, IndexError):
        shared.append(_stated_bytes(_MEMORY, "MemAvailable"))
    with suppress(OSError, IndexError, ImportError):
        import resource  # which Windows lacks

        for limit, used in ((resource.RLIMIT_AS, "VmSize"), (resource.RLIMIT_DATA, "VmData")):
            if (most := resource.getrlimit(limit)[0]) != resource.RLIM_INFINITY:
                own.append(most - _stated_bytes(_STATUS, used))
    return max(0.0, (min(shared) / processes if processes > 1 else min(*shared, *own)) / 2**20)


def _left_in_groups() -> Iterator[float]:
    """Bytes that are left in each control group of this process, of either version, which limits memory."""
    with suppress(OSError):
        for line in _GROUPS.read_text(encoding="utf-8").splitlines():
            _, controllers, path = line.split(":", 2)
            is_first = "memory" in controllers.split(",")  # version of them
            limit, used = ("memory.limit_in_bytes", "total_rss") if is_first else ("memory.max", "anon")
            innermost = _LIMITS_OF_GROUPS / ("memory" if is_first else "") / path.strip("/")
            for group in (innermost, *innermost.parents):
                with suppress(OSError, ValueError, IndexError):  # in a container, it is elsewhere than its name says
                    most = int((group / limit).read_text(encoding="utf-8"))
                    yield most - int(_stated(group / "memory.stat", used, " ")[0])


def lacks_memory(error: BaseException) -> bool:
    """Whether memory ran out: an error says so, or so little is left that libraries say anything."""
    return ran_out_of_memory(error) or available_memory_mib() < 16


def require_memory(least_mib: float, who: str, processes: int = 1) -> None:
    """Raise `OutOfMemoryError` if `who`, one or each of some processes, takes more memory than is left for it."""
    if least_mib > available_memory_mib(processes):
        raise OutOfMemoryError(f"{who} needs at least {least_mib:,.0f} MiB of memory. {memory_left(processes)}")


def memory_left(processes: int = 1) -> str:
    """How much memory is left, and what helps where it is not enough, in words."""
    return (
        f"{available_memory_mib(processes):,.0f} MiB are left{' for each' if processes > 1 else ''}. Close other "
        "programs, raise the limit on memory, or ask for less: fewer workers (--executor); generate: fewer --freqs or "
        "--rays, simpler meshes; run: --set batch_size=…; report: fewer results."
    )


@cache
def hardware() -> dict[str, str]:
    """Processor, number of cores that this process may use, operating system, and NVIDIA GPUs if there are any.

    Where the environment asks libraries for fewer threads than there are cores, there is their number too.
    """
    # on Linux; `taskset` keeps a process from some of the cores
    has_affinity = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count()
    system = f"{platform.system()} {platform.machine()}"
    gpus = [
        name
        for path in sorted(Path("/proc/driver/nvidia/gpus").glob("*/information"))
        for name in _stated(path, "Model:")
    ]
    known = {"processor": _processor(), "cores": str(cores), "system": system}
    asked = [int(text) for name in ("OMP_NUM_THREADS", _THREADS) if (text := os.environ.get(name, "")).isdecimal()]
    limited = {"threads": str(min(asked))} if asked and 0 < min(asked) < (cores or 1) else {}
    return known | limited | ({"gpu": " + ".join(gpus)} if gpus else {})


def _stated(path: Path, name: str, separator: str = ":") -> list[str]:
    """What the lines of a file say that begin with a name, after the separator."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [line.partition(separator)[2].strip() for line in lines if line.startswith(name)]


def _stated_bytes(path: Path, name: str) -> float:
    """What such a file says in kilobytes."""
    return int(_stated(path, name)[0].split()[0]) * 1024


@cache
def software() -> dict[str, str]:
    """Versions of Python and of the installed libraries that scores and times depend on, by name."""
    versions = {name: installed_version(name) for name in _LIBRARIES}
    return {"python": platform.python_version()} | {name: text for name, text in versions.items() if text}


@cache
def git_commit() -> str | None:
    """Commit of the source tree that runs, with `+changes` if files differ from it; None for an installed wheel."""
    folder = Path(__file__).parent
    commit = _git(folder, "rev-parse", "HEAD")
    if commit is None or _git(folder, "ls-files", "--error-unmatch", __file__) is None:
        return None
    return f"{commit}+changes" if _git(folder, "status", "--porcelain") else commit


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        answer = subprocess.run(["git", "-C", folder, *arguments], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return answer.stdout.strip()


def installed_version(name: str) -> str | None:
    """The version of an installed package, or None."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    try:
        return _stated(Path("/proc/cpuinfo"), "model name")[0]
    except (OSError, IndexError):
        return platform.processor()
