"""Tables of measurements: printed row by row as they are taken, and kept as records for a report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from xfreqbench.machine import git_commit, hardware, software
from xfreqbench.records import BenchFigure, BenchRecord, append, read
from xfreqbench.storage import storage_errors


@dataclass
class Table:
    """A table that grows: every row is printed when it is added."""

    columns: tuple[str, ...]
    say: Callable[[str], None]
    rows: list[tuple[str, ...]] = field(default_factory=list)
    figure: BenchFigure | None = None

    def add(self, *cells: str) -> None:
        """Add a row: one cell a column."""
        assert len(cells) == len(self.columns), f"{len(cells)} cells in {len(self.columns)} columns"
        self.rows.append(cells)
        self.say(_line(cells))


@dataclass(frozen=True)
class Bench:
    """One command that measures; its tables are printed, and appended to `output` where that is given.

    `command` is the command line that prints the tables again.
    """

    name: str
    command: str
    say: Callable[[str], None]
    output: Path | None = None

    def introduce(self) -> None:
        """Name the machine; raises `StorageError` or `DataError` where no record could be kept later."""
        if self.output is not None:
            with storage_errors(self.output):
                self.output.parent.mkdir(parents=True, exist_ok=True)
                self.output.open("ab").close()
            read(self.output)
        machine = hardware()
        gpus = f", {machine['gpu']}" if "gpu" in machine else ""
        self.say(f"{machine['processor']}, {machine['cores']} cores, {machine['system']}{gpus}.\n")

    @contextmanager
    def table(
        self, title: str, note: str, columns: tuple[str, ...], versions: Mapping[str, str] | None = None
    ) -> Iterator[Table]:
        """A table under its title and note, recorded after its last row; an unfinished one is not.

        `versions` are those of libraries that no run names, such as solvers.
        """
        table = Table(columns, self.say)
        self.say(f"{title}\n\n{note}\n\n{_line(columns)}\n{'|---' * len(columns)}|")
        yield table
        self.say("")
        if self.output is not None:
            about = {"bench": self.name, "title": title, "command": self.command, "note": note}
            rows, figure = tuple(table.rows), table.figure
            record = recorded(**about, columns=table.columns, rows=rows, figure=figure, versions=versions)
            append(self.output, record)


def recorded(
    bench: str,
    title: str,
    command: str,
    note: str,
    columns: tuple[str, ...],
    rows: tuple[tuple[str, ...], ...],
    figure: BenchFigure | None = None,
    versions: Mapping[str, str] | None = None,
) -> BenchRecord:
    """A table as a record of this machine, commit and moment; `versions` are of libraries that no run names."""
    return BenchRecord(
        bench=bench,
        title=title,
        command=command,
        note=note,
        columns=columns,
        rows=rows,
        figure=figure,
        hardware=hardware(),
        software=software() | dict(versions or {}),
        git_commit=git_commit(),
        time_utc=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _line(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"
