"""What happens to a command in a round. Each disturbance leaves the folder as an accident or an enemy would."""

from __future__ import annotations

import random
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests.whole.chaos.commands import Command
from tests.whole.chaos.process import CommandLine, Ended, Running

_LEAST_FILE_BYTES = 1 << 13  # what the messages of a command need
Disturbance = Callable[["Round"], None]


@dataclass
class Round:
    """One command in a folder of its own: `folder/work`, where it is given, beside `folder/outside`.

    `seconds` is how long it takes undisturbed, and `written` are the paths that it then writes, relative to the
    folder. A disturbance puts what it changes into `planted` (somebody's files, which must stay as they are)
    or `damaged` (ours, which must not be believed). With `may_refuse`, the command need not go on afterwards.
    """

    command: Command
    command_line: CommandLine
    folder: Path
    chance: random.Random
    seconds: float
    written: Sequence[str]
    outcomes: list[Ended] = field(default_factory=list)
    planted: list[Path] = field(default_factory=list)
    damaged: list[Path] = field(default_factory=list)
    may_refuse: bool = False
    has_rival: bool = False

    @property
    def work(self) -> Path:
        """Where the command is given."""
        return self.folder / "work"

    def start(self, line: str | None = None, file_bytes: int | None = None) -> Running:
        """Start the command, or another command line."""
        return Running(self.command_line, line or self.command.line, self.work, file_bytes)

    def moment(self) -> float:
        """A random time within the undisturbed run, in seconds."""
        return self.chance.uniform(0, 1.05 * self.seconds)

    def end(self, *running: Running) -> None:
        """Wait for commands, and keep their outcomes."""
        self.outcomes += [process.wait() for process in running]

    def site(self) -> Path:
        """A random place at which the command writes, or keeps what is unfinished."""
        outputs = [self.command.output, *self.command.others]
        return self.work / self.chance.choice([*self.written, *outputs, *(f"{path}.parts" for path in outputs)])

    def kill(self, running: Running, sent: signal.Signals = signal.SIGKILL) -> None:
        """Signal a command at a random moment, and wait for its end."""
        running.go_on_for(self.moment())
        running.send(sent)
        self.end(running)


def killed(round_: Round) -> None:
    """Kill the command, up to three times, each time at another moment."""
    for _ in range(round_.chance.randint(1, 3)):
        round_.kill(round_.start())


def interrupted(round_: Round) -> None:
    """Press Ctrl-C."""
    round_.kill(round_.start(), signal.SIGINT)


def doubled(round_: Round) -> None:
    """Give the command twice, the second time before the first has ended."""
    first = round_.start()
    first.go_on_for(round_.moment() / 2)
    round_.end(first, round_.start())


def rivalled(round_: Round) -> None:
    """Give a command that writes something else to the same place, at the same time or killed before."""
    round_.may_refuse = round_.has_rival = True
    rival = round_.start(round_.command.rival)
    if round_.chance.random() < 0.5:
        round_.kill(rival)
    else:
        rival.go_on_for(round_.moment() / 2)
        round_.end(rival, round_.start())


def filled(round_: Round) -> None:
    """Let no file grow beyond a random size, as on a disk that is full."""
    sizes = [0, *(path.stat().st_size for path in round_.folder.rglob("inputs/*") if path.is_file())]
    round_.end(round_.start(file_bytes=_LEAST_FILE_BYTES + round_.chance.randint(0, max(sizes))))


def damaged(round_: Round) -> None:
    """Kill the command, then change a byte of something that it left or that it reads, or cut it short."""
    killed(round_)
    round_.may_refuse = True
    names = [path for path in round_.work.rglob("*") if path.is_file() and path.stat().st_size]
    path = round_.chance.choice(sorted(names))
    content = bytearray(path.read_bytes())
    place = round_.chance.randrange(len(content))
    if round_.chance.random() < 0.7:
        content[place] ^= 1 << round_.chance.randrange(8)
    else:
        del content[place:]
    path.write_bytes(content)
    round_.damaged.append(path)


def linked(round_: Round) -> None:
    """Put a symbolic link to somebody else's file or folder where the command writes, before it or after a kill."""
    site = _cleared_site(round_)
    output = round_.command.output
    is_output_folder = site == round_.work / output and any(path.startswith(f"{output}/") for path in round_.written)
    if site is not None and not is_output_folder:  # whoever links that one wants its target filled
        site.symlink_to(round_.folder / "outside" / round_.chance.choice(("thesis.tex", "folder", "nothing")))


def foreign(round_: Round) -> None:
    """Put somebody else's file where the command writes, or into a folder in its place."""
    site = _cleared_site(round_)
    if site is None:
        return
    if round_.chance.random() < 0.5:
        site.mkdir()
        site /= "thesis.tex"
    site.write_text("years of work", encoding="utf-8")
    round_.planted.append(site)


def _cleared_site(round_: Round) -> Path | None:
    """A place at which nothing is; half of the time the command was killed before."""
    round_.may_refuse = True
    if round_.chance.random() < 0.5:
        killed(round_)
    site = round_.site()
    if site.exists() or site.is_symlink():
        return None
    try:
        site.parent.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return site


DISTURBANCES: dict[str, Disturbance] = {
    disturb.__name__: disturb for disturb in (killed, interrupted, doubled, rivalled, filled, damaged, linked, foreign)
}
