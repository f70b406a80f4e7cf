"""Kernels: the process that finds none in Numba's cache computes the same digits as those after it."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path
from subprocess import DEVNULL

import pytest

from tests.support.places import ROOT
from xfreqbench.errors import XFreqBenchError
from xfreqbench.system import caches, kernels

SUMS = """
import numpy as np
from numba import prange
from xfreqbench.system.kernels import entry

@entry(parallel=True, fastmath=True, error_model="numpy")
def sums(x, y, total):
    for n in prange(len(x)):
        one = two = three = np.float32(0)
        for k in range(x.shape[1]):
            one += x[n, k] * y[k]
            two += x[n, k] * x[n, k] * y[k]
            three += x[n, k] * y[k] * y[k]
        total[n, 0], total[n, 1], total[n, 2] = one, two, three
"""
USE = """
import numpy as np
from sums import sums
x, total = np.random.default_rng(0).normal(size=(50, 997)).astype(np.float32), np.empty((50, 3), np.float32)
sums(x, x[0].copy(), total)
print(total.tobytes().hex(), sum(sums.stats.cache_misses.values()))
"""


def test_who_compiles_computes_the_digits_of_who_finds_it_compiled(tmp_path: Path) -> None:
    """With Numba's own cache the first process has others than those after it, by sums in another order.

    Who compiles does not import a file of the working folder that has a standard name.
    """
    (tmp_path / "sums.py").write_text(SUMS)
    (tmp_path / "use.py").write_text(USE)
    (folder := tmp_path / "working").mkdir()
    (folder / "pickle.py").write_text("open('imported', 'w')")
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "NUMBA_NUM_THREADS": "1"}
    environment["XFREQBENCH_ANNOUNCES"] = "1"
    processes = [
        subprocess.run(
            [sys.executable, tmp_path / "use.py"],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    ]
    answers = [process.stdout for process in processes]
    assert ["compiling kernels" in process.stderr for process in processes] == [True, False]
    assert answers[0] == answers[1]
    assert answers[0].endswith(" 0\n"), "compiled in the process that uses it"
    assert not (folder / "imported").exists()


def test_a_kernel_is_compiled_again_where_the_type_of_its_argument_has_another_name(tmp_path: Path) -> None:
    code = """
from typing import NamedTuple
from xfreqbench.system.kernels import entry

class NAME(NamedTuple):
    x: float

@entry("NAME")
def first(pair):
    return pair.x
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    for name in ("Old", "New"):
        (tmp_path / "pairs.py").write_text(code.replace("NAME", name))
        use = [sys.executable, "-c", f"import pairs; print(pairs.first(pairs.{name}(2.5)))"]
        done = subprocess.run(use, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
        assert done.stdout == "2.5\n"


def test_where_no_cache_can_be_written_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locator(_: object) -> None:
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(kernels, "_Cache", no_locator)
    with pytest.raises(XFreqBenchError, match="Set NUMBA_CACHE_DIR to a folder that can be written"):
        kernels.entry()(lambda x: x)


def test_a_folder_that_only_seems_to_be_writable_is_found_out() -> None:
    """As a home on NFS where root is squashed: for root, the system says of `/proc` too that it can be written."""
    assert not caches._is_writable(Path("/proc/home"))
    assert not caches._is_writable(Path("/proc/self/status/home"))


def test_caches_are_put_elsewhere_where_those_that_are_named_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cannot = {"XDG_CACHE_HOME": "/proc/caches", "NUMBA_CACHE_DIR": "/proc/numba", "MPLCONFIGDIR": str(tmp_path)}
    for name, folder in cannot.items():
        monkeypatch.setenv(name, folder)
    monkeypatch.setattr(caches, "_PACKAGE", Path("/proc"))
    monkeypatch.setattr(caches, "_own_folder", lambda: tmp_path / "own")
    caches.settle_caches()
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path / "own" / "numba")
    assert os.environ["MPLCONFIGDIR"] == str(tmp_path)
    assert caches.data_folder() == tmp_path / "own" / "data"


ENDLESS = """
import pathlib, threading

class kernel:
    def compile(sig):
        pathlib.Path("compiling").touch()
        threading.Event().wait()
"""


def test_the_compiler_ends_with_who_asks_even_while_it_compiles(tmp_path: Path) -> None:
    """Otherwise it goes on for a minute after Ctrl-C."""
    (tmp_path / "endless.py").write_text(ENDLESS)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])}
    command = [sys.executable, "-c", kernels._SERVE]
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stdin=subprocess.PIPE, stderr=DEVNULL) as compiler:
        assert compiler.stdin
        compiler.stdin.write(pickle.dumps(("endless", "kernel", ())))
        compiler.stdin.flush()
        while not (tmp_path / "compiling").exists():
            assert compiler.poll() is None
        compiler.stdin.close()
        assert compiler.wait() == 1


@pytest.mark.parametrize("death", ["os.abort()", "os.kill(os.getpid(), 9)"])
def test_a_compiler_that_dies_as_without_memory_is_not_followed(death: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """LLVM would end this process too."""
    monkeypatch.setattr(kernels, "_SERVE", f"import os; {death}")
    monkeypatch.setattr(kernels, "_compilers", {})
    with pytest.raises(MemoryError, match="the process that compiles kernels died"):
        kernels._compile_beside("module", "name", ())
