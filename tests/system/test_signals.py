"""Ctrl-C waits for a block that must not be cut in two."""

from __future__ import annotations

import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from xfreqbench.system.processes import interrupted_afterwards


def test_an_interruption_within_the_block_is_raised_at_its_end() -> None:
    before, done = signal.getsignal(signal.SIGINT), []
    with pytest.raises(KeyboardInterrupt), interrupted_afterwards():
        signal.raise_signal(signal.SIGINT)
        done.append("the rest")
    assert done == ["the rest"]
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(ValueError, match="ours"), interrupted_afterwards():
        raise ValueError("ours")
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_runs_the_block_too() -> None:
    with ThreadPoolExecutor(1) as thread:
        thread.submit(interrupted_afterwards().__enter__).result()


IMPORT_SIONNA = """
import signal, sys
from importlib.abc import MetaPathFinder

class Interrupting(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "sionna":
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Interrupting())
sys.argv = ["xfreqbench", *"generate empty --tx 1 --solver sionna -q -o out.h5".split()]
from xfreqbench.cli.main import main
main()
"""


@pytest.mark.slow
@pytest.mark.sionna
def test_ctrl_c_while_sionna_rt_is_imported_ends_in_one_line(tmp_path: Path) -> None:
    command = [sys.executable, "-c", IMPORT_SIONNA]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert ended.returncode == 130
    assert ended.stderr.strip() == "xfreqbench: interrupted; the same command continues where it stopped."
