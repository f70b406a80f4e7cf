"""What is shown on stderr while something takes time: bars on a terminal, a line every ten seconds elsewhere.

Nothing appears before the first report, so that no bar precedes an error about arguments. NumPy is not imported here:
workers import this before they are kept to their cores, which NumPy counts.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, Literal

Shown = bool | Literal["auto"]  # auto: where a person looks, on a terminal or in a notebook
_EVERY_S = 10.0  # between two lines
_listeners: list[Callable[[str, int, int], None]] = []
ANNOUNCES = "XFREQBENCH_ANNOUNCES"  # a variable, so that workers have it: 1 to announce compilation, 0 for silence


class _Bars:
    """Stages of some work, each with its elapsed and remaining time; `open_bars` makes and closes them."""

    def __init__(self, progress: Any, stages: Sequence[str]) -> None:
        self._progress = progress
        self._titles = list(stages)
        self._tasks = [progress.add_task(stage, total=None, state="", start=False) for stage in stages]
        self._begun = dict[int, tuple[str, float, float]]()  # of a stage: title, time and what was done at its start
        self._line: Callable[[], str] = str
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._print_lines, daemon=True)

    @property
    def is_drawn(self) -> bool:
        """Whether bars can be drawn over and over: on a terminal, but not in a file or a notebook."""
        return bool(self._progress.console.is_interactive)

    def show(self, stage: int, done: float, total: float | None, state: str, title: str | None = None) -> None:
        """Show a stage at `done` of `total`, None if nobody knows; `state` says the same in words.

        A new `title` starts its time again.
        """
        title = title or self._titles[stage]
        if self._begun.get(stage, ("",))[0] != title:
            self._begun[stage] = title, time.perf_counter(), done
            self._progress.reset(self._tasks[stage], description=title)
        if self.is_drawn:
            self._progress.start()
            self._progress.update(self._tasks[stage], completed=done, total=total, state=state)
            return
        self._line = partial(self._text, *self._begun[stage], done, total, state)
        if self._thread.ident is None:
            self._thread.start()

    def print_line(self) -> None:
        """Print a line on the stage that was shown last."""
        print(self._line(), file=sys.stderr, flush=True)

    def rate(self, stage: int) -> str:
        """How much of a stage is done in a second, as text; empty at its beginning."""
        speed = self._progress.tasks[stage].speed
        return f" {speed:.3g}/s" if speed else ""

    def close(self) -> None:
        """Show nothing more."""
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join()
        if self._progress.live.is_started:
            self._progress.stop()

    def _text(self, title: str, start_s: float, before: float, done: float, total: float | None, state: str) -> str:
        elapsed_s = time.perf_counter() - start_s
        left = ""
        if total is not None and before < done < total:
            left = f", about {elapsed_s * (total - done) / (done - before):.0f} s left"
        return f"{title}: {state}, {elapsed_s:.0f} s{left}"

    def _print_lines(self) -> None:
        while not self._ended.wait(_EVERY_S):
            self.print_line()


@contextmanager
def open_bars(stages: Sequence[str]) -> Iterator[_Bars]:
    """Bars for some stages, by name, until the block ends."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    texts = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[state]}")
    bars = _Bars(Progress(*texts, TimeElapsedColumn(), TimeRemainingColumn(), console=_console()), stages)
    try:
        yield bars
    finally:
        bars.close()


@contextmanager
def progress_bars(unit: str, stages: Sequence[str], quiet: bool) -> Iterator[list[Callable[[int, int], None]]]:
    """A callback(done, total) for each stage, which shows it, with the rate on a bar; with `quiet` nothing is shown."""
    if quiet:
        yield [lambda done, total: None] * len(stages)
        return
    with open_bars(stages) as bars:
        before = 0, 0

        def update(stage: int, done: int, total: int) -> None:
            nonlocal before
            before = (done, total) if stage == 0 else before
            bars.show(stage, done, total, f"{done} of {total} {unit}{bars.rate(stage)}")

        def hear(title: str, done: int, total: int) -> None:
            if title != unit:
                bars.show(0, done, total, f"{done} of {total}", title)
            elif before[0] + done < before[1]:
                bars.show(0, before[0] + done, before[1], f"{before[0] + done} of {before[1]} {unit}{bars.rate(0)}")

        _listeners.append(hear)
        try:
            yield [partial(update, stage) for stage in range(len(stages))]
        finally:
            _listeners.remove(hear)


def report(title: str, done: int, total: int) -> None:
    """Say how far long work in this process is; `progress_bars` show it in place of their first stage.

    What is reported under the name of their unit is part of what is counted next.
    """
    for hear in _listeners:
        hear(title, done, total)


def is_watched() -> bool:
    """Whether stderr is where a person looks: a terminal or a notebook."""
    from rich.console import Console

    return _console().is_interactive or Console(stderr=True).is_jupyter


def _console() -> Any:
    """The console of bars; in a notebook, where bars would need another library, lines are printed."""
    from rich.console import Console

    return Console(stderr=True, force_jupyter=False)


@contextmanager
def announcing(progress: Shown) -> Iterator[bool]:
    """Announce compilation while the block runs, or do not, as `progress` says; yields whether progress is shown.

    What was announced, or silenced by a block around this one, is not announced again.
    """
    before = os.environ.get(ANNOUNCES)
    if progress != "auto" and before != "0":
        os.environ[ANNOUNCES] = str(int(progress))
    try:
        yield is_watched() if progress == "auto" else progress
    finally:
        if progress is False or os.environ.get(ANNOUNCES) != "0":  # else it was announced
            os.environ.pop(ANNOUNCES, None)
            os.environ.update({} if before is None else {ANNOUNCES: before})


def announce_compilation() -> None:
    """Say that kernels are compiled and how long that may take, once in this process and those it starts later."""
    said = os.environ.get(ANNOUNCES)
    if said == "0" or (said is None and not is_watched()):
        return
    os.environ[ANNOUNCES] = "0"
    print(
        "xfreqbench: compiling kernels for this machine, once per installation: about three minutes for those that "
        "trace rays, one for those that render maps",
        file=sys.stderr,
        flush=True,
    )
