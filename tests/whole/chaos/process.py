"""One command line in a process of its own, which can be signalled, and whose files can be kept from growing."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from xfreqbench.runs import checkpoints

HANGS_S = 300.0  # far beyond what any of the commands takes on a busy machine
_WARM = (
    *("xfreqbench.cli.main", "xfreqbench.data.generate", "xfreqbench.runs.run", "xfreqbench.baselines.aperture_gs"),
    *("xfreqbench.report.view.write", "xfreqbench.report.leaderboard.plots", "skimage.metrics"),
)
CommandLine = Callable[[], None]


@dataclass(frozen=True)
class Ended:
    """How a command ended: its exit code, negative for a signal and None if it had to be killed, and its stderr."""

    code: int | None
    stderr: str

    @property
    def is_refusal(self) -> bool:
        """Whether it ended in words for the user, and nothing else."""
        return self.code == 2 and self.stderr.startswith("xfreqbench: ") and "Traceback" not in self.stderr


class Running:
    """A command that has been started in a folder; `command_line` runs what `sys.argv` says.

    Processes come from a server that has the package imported already, as `multiprocessing` calls it: no more than
    a fork, and yet without threads of this one. With `file_bytes`, no file may grow beyond that size.
    """

    def __init__(self, command_line: CommandLine, line: str, folder: Path, file_bytes: int | None = None) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(_WARM))
        self._log = tempfile.TemporaryDirectory(prefix="xfreqbench-chaos-")
        logged = Path(self._log.name)
        arguments = (command_line, line.split(), folder, logged, file_bytes)
        self._process = context.Process(target=_child, args=arguments)
        self._process.start()
        self._begun, self._stderr = logged / "begun", logged / "stderr"
        while not self._begun.exists() and self._process.is_alive():
            time.sleep(0.002)

    def go_on_for(self, seconds: float) -> None:
        """Wait for that time, or until the command has ended."""
        self._process.join(seconds)

    def send(self, sent: signal.Signals) -> None:
        """Send a signal, unless the command has ended."""
        if self._process.exitcode is None and self._process.pid:
            os.kill(self._process.pid, sent)

    def wait(self) -> Ended:
        """The outcome, once the command has ended."""
        self._process.join(HANGS_S)
        code = self._process.exitcode
        if code is None:
            self._process.kill()
            self._process.join()
        stderr = self._stderr.read_text(encoding="utf-8", errors="replace") if self._stderr.exists() else ""
        self._log.cleanup()
        return Ended(code, stderr)


def _child(command_line: CommandLine, words: list[str], folder: Path, logged: Path, file_bytes: int | None) -> None:
    os.chdir(folder)
    for stream, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(os.open(logged / name, os.O_WRONLY | os.O_CREAT), stream)
    if file_bytes is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = ["xfreqbench", *words]
    checkpoints.CHECKPOINT_SECONDS = 0.1
    (logged / "begun").touch()
    command_line()
