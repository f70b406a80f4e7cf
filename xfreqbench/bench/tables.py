"""Tables of measurements, which are printed row by row as they grow and stored as records for a report."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from xfreqbench.runs.records import BenchFigure, BenchRecord, append, made_here, read
from xfreqbench.system.files import require_name, require_regular, storage_errors
from xfreqbench.system.machine import hardware

REPEATS = 2  # the smallest time counts, because other programs can only add to it
Answer = TypeVar("Answer")


def timed_s(work: Callable[[], Answer]) -> tuple[float, Answer]:
    """The smallest time of a few calls in seconds, after one that compiles, and the result."""
    answer, seconds = work(), []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds), answer


@dataclass
class MeasurementTable:
    """A table of measurements; each row is printed when it is added."""

    columns: tuple[str, ...]
    say: Callable[[str], None]
    rows: list[tuple[str, ...]] = field(default_factory=list)
    figure: BenchFigure | None = None

    def add(self, *cells: str) -> None:
        """Add and print a row, which has a cell for each column."""
        assert len(cells) == len(self.columns), f"{len(cells)} cells in {len(self.columns)} columns"
        self.rows.append(cells)
        self.say(_line(cells))


@dataclass(frozen=True)
class Bench:
    """One command that measures. Its tables are printed, and appended to the records in `output` if it is given.

    `command` is the command line that repeats the measurement.
    """

    name: str
    command: str
    say: Callable[[str], None]
    output: Path | None = None

    def introduce(self) -> None:
        """Print a description of the machine.

        Raises `StorageError` or `DataError` where records could not be stored later.
        """
        if self.output is not None:
            with storage_errors(self.output):
                self.output.parent.mkdir(parents=True, exist_ok=True)
                (require_regular if self.output.exists() else require_name)(self.output)
                self.output.open("ab").close()
            read(self.output)
        machine = hardware()
        gpus = f", {machine['gpu']}" if "gpu" in machine else ""
        self.say(f"{machine['processor']}, {machine['cores']} cores, {machine['system']}{gpus}.\n")

    @contextmanager
    def table(
        self, title: str, note: str, columns: tuple[str, ...], versions: Mapping[str, str] | None = None
    ) -> Iterator[MeasurementTable]:
        """Print title, note and columns; give a table for the rows, and store it as a record when the block ends.

        A table whose block raises is not stored. `versions` are those of libraries such as solvers.
        """
        table = MeasurementTable(columns, self.say)
        self.say(f"{title}\n\n{note}\n\n{_line(columns)}\n{'|---' * len(columns)}|")
        yield table
        self.say("")
        if self.output is not None:
            record = BenchRecord(
                bench=self.name,
                title=title,
                command=self.command,
                note=note,
                columns=table.columns,
                rows=tuple(table.rows),
                figure=table.figure,
                **made_here(versions),
            )
            append(self.output, record)


def _line(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"
