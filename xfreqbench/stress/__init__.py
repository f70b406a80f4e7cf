"""Numerical stability as a list of cases, each compared with a reference that shares no code with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

from xfreqbench.errors import UnknownNameError
from xfreqbench.machine import git_commit, hardware, software
from xfreqbench.records import BenchRecord, append
from xfreqbench.stress.case import Case, Verdict

COLUMNS = ("area", "case", "error", "limit", "unit", "")
_WIDTHS = (13, 68, 8, 8, 10, 0)


def cases() -> tuple[Case, ...]:
    """Every case, area by area."""
    from xfreqbench.stress import channels, geometry, maps, scores, seeds, splatting, training

    areas = (channels, geometry, maps, scores, splatting, training, seeds)
    return tuple(case for area in areas for case in area.CASES)


def selected(only: str | None) -> tuple[Case, ...]:
    """Cases whose area or name holds `only`; raises `UnknownNameError`, which names the areas, for none."""
    chosen = tuple(
        case for case in cases() if only is None or only.lower() in f"{case.area} {case.name}".lower()
    )
    if not chosen:
        raise UnknownNameError("case or area", str(only), {case.area for case in cases()})
    return chosen


def run_cases(only: str | None = None) -> Iterator[Verdict]:
    """Verdicts one by one, as `selected` says which."""
    return (case.judge() for case in selected(only))


def stress(only: str | None, output: Path | None, say: Callable[[str], None]) -> bool:
    """Print a row for each case as it is done, and whether all keep their limits, which is returned.

    The table is appended to the records in `output`. Raises `UnknownNameError` where no case is selected.
    """
    verdicts: list[Verdict] = []
    for verdict in run_cases(only):
        if not verdicts:
            say(_line(COLUMNS))
        verdicts.append(verdict)
        say(_line(verdict.cells))
    if output is not None:
        append(output, record_of(verdicts, only))
    failed = [verdict.case.name for verdict in verdicts if not verdict.is_within]
    say(
        f"{len(verdicts)} cases, "
        + (f"{len(failed)} FAILED: {'; '.join(failed)}" if failed else "all within limits")
    )
    return not failed


def record_of(verdicts: Sequence[Verdict], only: str | None = None) -> BenchRecord:
    """The verdicts as a table of the report."""
    return BenchRecord(
        bench="stress",
        title="Numerical stability",
        command="xfreqbench stress" + (f" --only {only!r}" if only else ""),
        note="Errors against references that share no code with what they check, and the limits they keep.",
        columns=COLUMNS,
        rows=tuple(verdict.cells for verdict in verdicts),
        hardware=hardware(),
        software=software(),
        git_commit=git_commit(),
        time_utc=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _line(cells: Sequence[str]) -> str:
    return " ".join(f"{cell:{width}}" for cell, width in zip(cells, _WIDTHS, strict=True)).rstrip()
