"""What the machine has: memory that is left, of it, of a batch job and of a process's own limits, cores, software."""

from __future__ import annotations

import os
import resource
from pathlib import Path
from unittest.mock import Mock

import pytest

from xfreqbench.errors import OutOfMemoryError
from xfreqbench.system import machine
from xfreqbench.system.machine import available_memory_mib, require_memory

MIB = 2**20
GROUPS = {
    1: ("4:memory:/job/step\n2:cpu:/\n0::/\n", "memory/job", "memory.limit_in_bytes", "cache 7\ntotal_rss {}\n"),
    2: ("0::/job/step\n", "job", "memory.max", "file 7\nanon {}\n"),
}


def _limit(folder: Path, monkeypatch: pytest.MonkeyPatch, version: int, limit: str, used: int, at: str = "") -> None:
    """Put this process into a group, whose parent, or the folder `at`, has a limit."""
    of_process, parent, limits, stat = GROUPS[version]
    (folder / "cgroup").write_text(of_process)
    (group := folder / (at or parent)).mkdir(parents=True)
    (group / limits).write_text(limit)
    (group / "memory.stat").write_text(stat.format(used))
    monkeypatch.setattr(machine, "_GROUPS", folder / "cgroup")
    monkeypatch.setattr(machine, "_LIMITS_OF_GROUPS", folder)


@pytest.mark.parametrize(
    ("version", "used", "at", "left"),
    [(1, 10, "", 20), (2, 10, "", 20), (1, 40, "memory", 0)],  # in a container it is at the root
)
def test_the_limit_of_a_control_group_counts_without_its_cached_files(
    version: int, used: int, at: str, left: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _limit(tmp_path, monkeypatch, version, f"{30 * MIB}", used * MIB, at)
    assert available_memory_mib() == left
    assert available_memory_mib(4) == left / 4


def test_a_control_group_without_a_limit_leaves_what_the_machine_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine, "_MEMORY", memory := tmp_path / "meminfo")
    memory.write_text("MemTotal: 9 kB\nMemAvailable: 5120 kB\n")
    _limit(tmp_path, monkeypatch, 2, "max", 10 * MIB)
    assert available_memory_mib() == 5
    memory.unlink()
    assert available_memory_mib() == float("inf")


@pytest.mark.parametrize(("kind", "used"), [(resource.RLIMIT_AS, "VmSize"), (resource.RLIMIT_DATA, "VmData")])
def test_what_ulimit_leaves_is_for_this_process(
    kind: int, used: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine, "_STATUS", status := tmp_path / "status")
    status.write_text(f"{used}:\t2048 kB\n")
    unlimited, known = resource.RLIM_INFINITY, {kind: 3 * MIB}
    monkeypatch.setattr(resource, "getrlimit", lambda asked: (known.get(asked, unlimited), unlimited))
    assert available_memory_mib() == 1 < available_memory_mib(2)
    with pytest.raises(OutOfMemoryError, match=r"Tracing needs at least 2 MiB of memory. 1 MiB are left. .*--executor"):
        require_memory(2, "Tracing")
    require_memory(1, "Tracing")


def test_where_not_even_a_small_file_can_be_read_nothing_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_left_in_groups", Mock(side_effect=MemoryError))
    assert available_memory_mib() == 0


def test_a_process_pinned_to_one_core_has_one() -> None:
    cores = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(cores)})
        assert machine.hardware.__wrapped__()["cores"] == "1"
    finally:
        os.sched_setaffinity(0, cores)


@pytest.mark.parametrize(("name", "asked", "told"), [("OMP_NUM_THREADS", "1", "1"), ("NUMBA_NUM_THREADS", "64", None)])
def test_fewer_threads_than_cores_are_told(
    name: str, asked: str, told: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    for each in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        monkeypatch.delenv(each, raising=False)
    monkeypatch.setenv(name, asked)
    assert machine.hardware.__wrapped__().get("threads") == told


def test_software_that_is_not_installed_has_no_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_LIBRARIES", ("numpy", "no-such-library"))
    machine.software.cache_clear()
    assert machine.software().keys() == {"python", "numpy"}
    machine.software.cache_clear()
