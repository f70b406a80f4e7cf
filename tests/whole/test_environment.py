"""Environments that once ended a command in a traceback: locales, full devices, variables of libraries."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.fuzzing.common import NOISE
from tests.support.stored_records import make_record
from xfreqbench.runs.records import append

pytestmark = pytest.mark.slow

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def run(*words: str | Path, stdout: Path | None = None, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """The command line in a process of its own."""
    command = [sys.executable, "-m", "xfreqbench.cli", *map(str, words)]
    with Path(stdout or os.devnull).open("wb") as file:
        return subprocess.run(
            command,
            stdout=file if stdout else subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=os.environ | environment,
            timeout=120,
        )


def check_line(ended: subprocess.CompletedProcess[bytes], *words: str) -> None:
    said = ended.stderr.decode()
    assert ended.returncode == 2, said
    assert said.startswith("xfreqbench: ")
    assert said.count("\n") == 1, said
    assert not any(noise in said for noise in NOISE)
    for word in words:
        assert word in said


@pytest.mark.parametrize(
    "command",
    ["scenes", "--help", "methods", "import --conventions", "generate office --freqs 2.4 --tx 2 -o x.h5 --dry-run"],
)
def test_a_locale_of_ascii_reads_and_prints_all_the_same(tmp_path: Path, command: str) -> None:
    ended = run(*command.split(), **ASCII)
    assert (ended.returncode, ended.stderr) == (0, b"")
    assert ended.stdout.decode("ascii")


def test_a_locale_of_ascii_writes_the_same_report(tmp_path: Path) -> None:
    append(tmp_path / "records.jsonl", make_record())
    written = []
    for name, environment in (("utf8", {}), ("ascii", ASCII)):
        ended = run("report", tmp_path, "-o", tmp_path / name / "r.md", "-q", **environment)
        assert (ended.returncode, ended.stderr) == (0, b"")
        written.append((tmp_path / name / "r.md").read_bytes())
    assert written[0] == written[1]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no device that is always full")
@pytest.mark.parametrize("command", ["scenes", "--help", "import --conventions"])
def test_a_full_device_as_output_is_said_in_one_line(command: str) -> None:
    check_line(run(*command.split(), stdout=Path("/dev/full")), "what is printed cannot be written: No space left")


@pytest.mark.parametrize("number", ["0", "-1", "9999", "many", ""])
def test_a_number_of_threads_that_cannot_be_is_refused(number: str) -> None:
    check_line(run("scenes", NUMBA_NUM_THREADS=number), "NUMBA_NUM_THREADS", repr(number), "1 to 1024")


def test_a_library_that_is_not_llvm_is_refused(tmp_path: Path) -> None:
    (tmp_path / "tx.csv").write_bytes(b"1,1,1\n")
    options = ["--solver", "sionna", "--tx-positions", tmp_path / "tx.csv", "-o", tmp_path / "x.h5"]
    check_line(run("generate", "empty", *options, DRJIT_LIBLLVM_PATH=__file__), "DRJIT_LIBLLVM_PATH", __file__)
