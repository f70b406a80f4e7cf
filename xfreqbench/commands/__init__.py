"""What all commands share. Every command imports what it needs when it runs, so that --help is quick."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, Parameter

from xfreqbench.errors import XFreqBenchError
from xfreqbench.units import PAPER_CARRIERS_GHZ, ghz_to_hz

app = App(
    name="xfreqbench",
    help="How well does a radiance-field method predict channels at carriers it was never trained on?",
    suppress_keyboard_interrupt=False,
)
bench = App(name="bench", help="Measure accuracy against time; every table names its machine.")
app.command(bench)

Freqs = Annotated[
    str, Parameter(help="Carriers in GHz, comma-separated, as in 1,2.4,24.25; or `paper`, its ten.")
]
Quiet = Annotated[bool, Parameter(name=["--quiet", "-q"], negative="", help="Print errors only.")]
Output = Annotated[Path, Parameter(name=["--output", "-o"], help="File to write.")]
Executor = Annotated[
    str,
    Parameter(
        help="serial: in this process; 4: as many processes here; dask://host:8786: workers of a cluster."
    ),
]
_PIPED_WIDTH = 160  # of a table that no terminal bounds


def parse_carriers_hz(freqs: str) -> list[float]:
    """Carriers in hertz from `1,2.4` (GHz) or `paper`; raises `XFreqBenchError`."""
    if freqs.strip() == "paper":
        return [ghz_to_hz(carrier) for carrier in PAPER_CARRIERS_GHZ]
    try:
        return [ghz_to_hz(float(part)) for part in freqs.split(",")]
    except (ValueError, OverflowError) as error:
        raise XFreqBenchError(
            f"--freqs takes carriers in GHz, comma-separated, as in 1,2.4,24.25, but got {freqs!r}."
        ) from error


def target_carriers_hz(targets: str | None) -> list[float] | Literal["all"] | None:
    """Held-out carriers in hertz from `2.4,77` (GHz), `all` or nothing; raises `XFreqBenchError`."""
    return "all" if targets == "all" else None if targets is None else parse_carriers_hz(targets)


@contextmanager
def progress_bars(unit: str, stages: list[str], quiet: bool) -> Iterator[list[Callable[[int, int], None]]]:
    """One bar a stage on stderr, with rate and remaining time, each driven by its callback(done, total)."""
    if quiet:
        yield [lambda done, total: None for _ in stages]
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as Remaining

    counts = (
        MofNCompleteColumn(),
        TextColumn(unit + " {task.fields[rate]}"),
        TimeElapsedColumn(),
        Remaining(),
    )
    columns = (TextColumn("{task.description}"), BarColumn(), *counts)
    with Progress(*columns, console=Console(stderr=True)) as progress:
        yield [_driver(progress, progress.add_task(stage, total=None, rate="")) for stage in stages]


def _driver(progress: Any, task: Any) -> Callable[[int, int], None]:
    def update(done: int, total: int) -> None:
        speed = progress.tasks[task].speed
        progress.update(task, completed=done, total=total, rate=f"{speed:.3g}/s" if speed else "")

    return update


def say(text: str, quiet: bool = False) -> None:
    """Print at once, unless errors only are asked for."""
    if not quiet:
        print(text, flush=True)


def say_written(output: Path, is_new: bool, quiet: bool) -> None:
    """Name a data set that was written, with its size, or that was there already."""
    size = f"{output.stat().st_size / 1e6:.1f} MB"
    say(f"wrote {output} ({size})" if is_new else f"{output} already holds this data set", quiet)


def print_table(title: str, header: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print rows under their header, as wide as the terminal."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left")
    for name in header:
        table.add_column(Text(name))
    for row in rows:
        table.add_row(*map(Text, row))
    Console(width=None if sys.stdout.isatty() else _PIPED_WIDTH).print(table)
