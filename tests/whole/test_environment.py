"""Environments that once ended a command in a traceback: locales, full devices, variables of libraries."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.support.fuzzing.common import check_clean, check_refusal, xfreqbench
from tests.support.stored_records import make_record
from tests.support.synthetic import paper_dataset
from xfreqbench.runs.records import append

pytestmark = pytest.mark.slow

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def run(
    *words: str | Path,
    stdout: Path | None = None,
    cwd: Path | None = None,
    before: Sequence[str] = (),
    python: Sequence[str] = ("-m", "xfreqbench.cli"),
    **environment: str,
) -> subprocess.CompletedProcess[bytes]:
    """The command line in a process of its own, or other Python; `before` is a command that starts it."""
    command = [*before, sys.executable, *python, *map(str, words)]
    with Path(stdout or os.devnull).open("wb") as file:
        return subprocess.run(
            command,
            stdout=file if stdout else subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=os.environ | environment,
            cwd=cwd,
            timeout=120,
        )


def check_line(ended: subprocess.CompletedProcess[bytes], *words: str) -> None:
    said = ended.stderr.decode()
    assert ended.returncode == 2, said
    assert said.startswith("xfreqbench: ")
    assert said.count("\n") == 1, said
    for word in words:
        check_refusal(said, word)


EVERY = """
import sys
from xfreqbench.cli.main import main
for line in sys.argv[1:]:
    sys.argv[1:] = line.split()
    try:
        main()
    except SystemExit as end:
        assert not end.code
"""


def test_a_locale_of_ascii_reads_prints_and_writes_all_the_same(tmp_path: Path) -> None:
    append(tmp_path / "records.jsonl", make_record())
    planned = f"generate office --freqs 2.4 --tx 2 -o {tmp_path / 'x.h5'} --dry-run"
    report = f"report {tmp_path} -q -o {tmp_path}/"
    lines = ["scenes", "--help", "methods", "import --conventions", planned, f"{report}ascii/r.md"]
    ended = run(*lines, python=("-c", EVERY), **ASCII)
    assert (ended.returncode, ended.stderr) == (0, b"")
    assert "nothing was written" in ended.stdout.decode("ascii")
    assert xfreqbench(*f"{report}utf8/r.md".split()).code == 0
    assert (tmp_path / "ascii" / "r.md").read_bytes() == (tmp_path / "utf8" / "r.md").read_bytes()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no device that is always full")
@pytest.mark.parametrize("command", ["scenes", "--help", "import --conventions"])
def test_a_full_device_as_output_is_said_in_one_line(command: str) -> None:
    check_line(run(*command.split(), stdout=Path("/dev/full")), "the output cannot be printed: No space left")


@pytest.mark.parametrize("number", ["0", "-1", "9999", "many", ""])
def test_a_number_of_threads_that_cannot_be_is_refused(number: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", number)
    outcome = xfreqbench("scenes")
    assert (outcome.code, outcome.stdout) == (2, "")
    assert all(word in outcome.stderr for word in ("NUMBA_NUM_THREADS", repr(number), "1 to 1024"))


def test_a_library_that_is_not_llvm_is_refused(tmp_path: Path) -> None:
    (tmp_path / "tx.csv").write_bytes(b"1,1,1\n")
    options = ["--solver", "sionna", "--tx-positions", tmp_path / "tx.csv", "-o", tmp_path / "x.h5"]
    check_line(run("generate", "empty", *options, DRJIT_LIBLLVM_PATH=__file__), "DRJIT_LIBLLVM_PATH", __file__)


@pytest.mark.parametrize("layer", ["tbb", "none such"])
def test_threads_by_a_library_that_is_not_there_are_refused(tmp_path: Path, layer: str) -> None:
    if layer == "tbb" and find_spec("tbb"):
        pytest.skip("it is there")
    command = f"generate empty --freqs 5 --tx 1 --solver image --max-depth 1 --quiet -o {tmp_path / 'x.h5'}"
    check_line(run(*command.split(), NUMBA_THREADING_LAYER=layer), "NUMBA_THREADING_LAYER", repr(layer), "unset it")


def test_a_working_folder_that_was_removed_is_said(tmp_path: Path) -> None:
    removed = ["sh", "-c", 'rmdir "$PWD" && exec "$@"', "sh"]
    (tmp_path / "gone").mkdir()
    ended = run("scenes", cwd=tmp_path / "gone", before=removed, python=("-P", "-m", "xfreqbench.cli"))
    check_line(ended, "The working folder has been removed")


def test_a_report_beside_a_ring_of_links_is_refused(tmp_path: Path) -> None:
    append(tmp_path / "records.jsonl", make_record())
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    outcome = xfreqbench("report", tmp_path, "-o", tmp_path / "r.md", "--details", tmp_path / "a", "-q")
    assert outcome.code == 2
    check_clean(outcome, str(tmp_path / "a"))


def test_figures_are_the_same_whatever_the_user_has_set_in_matplotlib(tmp_path: Path) -> None:
    """With `text.usetex` each text would be set by LaTeX."""
    data = paper_dataset(tmp_path / "data.h5", num_tx=2).path
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nfont.size: 30\naxes.facecolor: red\nsavefig.dpi: 10\n")
    words = ["plot", data, "--tx", "0", "--carriers", "5", "-o"]
    assert xfreqbench(*words, tmp_path / "plain.png").code == 0
    ended = run(*words, tmp_path / "own.png", cwd=tmp_path, MPLBACKEND="none such")
    assert (ended.returncode, ended.stderr) == (0, b"")
    assert (tmp_path / "own.png").read_bytes() == (tmp_path / "plain.png").read_bytes()


ANOTHER = 12_345  # the id of a user without a name, as in many containers, who may read everything
CAPABILITIES = ["--inh-caps", "+dac_read_search", "--ambient-caps", "+dac_read_search"]
AS_ANOTHER = ["setpriv", "--reuid", str(ANOTHER), "--regid", str(ANOTHER), "--clear-groups", *CAPABILITIES]
can_be_another = pytest.mark.skipif(
    not shutil.which("setpriv") or subprocess.run([*AS_ANOTHER, "true"], capture_output=True).returncode != 0,
    reason="needs the right to be another user",
)
KERNELS = ("-c", "import os, xfreqbench.methods.learning.loss_kernels; print(os.environ['NUMBA_CACHE_DIR'])")


@can_be_another
@pytest.mark.parametrize(
    "home",
    [["env", "-u", "HOME"], ["env", "HOME=/"], ["env", "HOME=/", "NUMBA_CACHE_DIR=/proc/numba"]],
    ids=["none", "of another user", "a cache that cannot be written"],
)
def test_without_a_home_to_write_to_kernels_are_kept_in_a_folder_of_our_own(tmp_path: Path, home: list[str]) -> None:
    (folder := tmp_path / "temporary").mkdir()
    os.chown(folder, ANOTHER, ANOTHER)
    (work := tmp_path / "work").mkdir()
    os.chown(work, ANOTHER, ANOTHER)
    ended = run(before=[*AS_ANOTHER, *home], python=KERNELS, cwd=work, TMPDIR=str(folder))
    assert (ended.returncode, ended.stderr) == (0, b"")
    own = folder / f"xfreqbench-{ANOTHER}"
    assert ended.stdout.decode().strip() == str(own / "numba")
    assert (own.stat().st_uid, own.stat().st_mode & 0o777) == (ANOTHER, 0o700)
    assert not list(work.iterdir())
    own.chmod(0o777)  # somebody else may have put code there
    ended = run(before=[*AS_ANOTHER, *home], python=KERNELS, cwd=work, TMPDIR=str(folder))
    assert ended.returncode == 0
    assert b"compiled code cannot be kept; it is compiled each time. Set NUMBA_CACHE_DIR" in ended.stderr
    assert list(folder.iterdir()) == [own]
