"""Numerical stability as a list of cases, each compared with a reference that shares no code with it.

References take from the code under test what is data: the speed of light, the constants of P.2040's table,
the positions of array elements and the directions of the grid. In slabs they take the permittivity too, which
has cases of its own. Visibility by corners, threads and seeds compare two ways of the same code.

Closed forms of phase are in long double: 80 bits on x86. Where NumPy's long double is a double (Windows, Macs
with ARM), references round as what they check does, and a case may err by twice as much.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from xfreqbench.errors import UnknownNameError
from xfreqbench.records import BenchRecord, append
from xfreqbench.stress.case import Case, Verdict
from xfreqbench.tables import recorded

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
    num_skipped = sum(verdict.is_skipped for verdict in verdicts)
    failed = [verdict.case.name for verdict in verdicts if not (verdict.is_within or verdict.is_skipped)]
    skipped, others = (f"{num_skipped} skipped, ", "all others") if num_skipped else ("", "all")
    outcome = f"{len(failed)} FAILED: {'; '.join(failed)}" if failed else f"{others} within limits"
    noun = "case" if len(verdicts) == 1 else "cases"
    say(f"{len(verdicts)} {noun}, {skipped}{outcome}")
    return not failed


def record_of(verdicts: Sequence[Verdict], only: str | None = None) -> BenchRecord:
    """The verdicts as a table of the report."""
    return recorded(
        bench="stress",
        title="Numerical stability",
        command="xfreqbench stress" + (f" --only {only!r}" if only else ""),
        note=(
            "Errors against references that share constants, and no code, with what they check, and the limits they "
            "keep; cases of seeds, threads and shared visibility compare two ways of the same code."
        ),
        columns=COLUMNS,
        rows=tuple(verdict.cells for verdict in verdicts),
    )


def _line(cells: Sequence[str]) -> str:
    return " ".join(f"{cell:{width}}" for cell, width in zip(cells, _WIDTHS, strict=True)).rstrip()
