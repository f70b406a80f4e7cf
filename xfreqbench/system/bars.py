"""Progress bars on stderr. They appear with the first report, so that no bar precedes an error about arguments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from xfreqbench.types import ProgressCallback, ignore_progress


class Bars:
    """Bars of several stages, each with its elapsed and remaining time; `open_bars` makes and closes them."""

    def __init__(self, progress: Any, stages: Sequence[str]) -> None:
        self._progress = progress
        self._tasks = [progress.add_task(stage, total=None, state="") for stage in stages]

    @property
    def is_drawn(self) -> bool:
        """Whether bars can be drawn over and over: on a terminal or in a notebook, but not in a file."""
        console = self._progress.console
        return console.is_interactive or console.is_jupyter

    def show(self, stage: int, done: float, total: float | None, state: str, title: str | None = None) -> None:
        """Draw the bar of a stage at `done` of `total`, None where nobody knows; `state` stands beside it."""
        self._progress.start()
        changed = {} if title is None else {"description": title}
        self._progress.update(self._tasks[stage], completed=done, total=total, state=state, **changed)

    def rate(self, stage: int) -> str:
        """How much of a stage is done in a second, as text; empty at its beginning."""
        speed = self._progress.tasks[stage].speed
        return f"{speed:.3g}/s" if speed else ""


@contextmanager
def open_bars(stages: Sequence[str]) -> Iterator[Bars]:
    """Bars for some stages, by name, until the block ends."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    texts = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[state]}")
    progress = Progress(*texts, TimeElapsedColumn(), TimeRemainingColumn(), console=Console(stderr=True))
    try:
        yield Bars(progress, stages)
    finally:
        if progress.live.is_started:
            progress.stop()


@contextmanager
def progress_bars(unit: str, stages: Sequence[str], quiet: bool) -> Iterator[list[ProgressCallback]]:
    """A callback(done, total) for each stage, which draws its bar with the rate; with `quiet` nothing is drawn."""
    if quiet:
        yield [ignore_progress] * len(stages)
        return
    with open_bars(stages) as bars:

        def update(stage: int, done: int, total: int) -> None:
            bars.show(stage, done, total, f"{done}/{total} {unit} {bars.rate(stage)}")

        yield [partial(update, stage) for stage in range(len(stages))]
