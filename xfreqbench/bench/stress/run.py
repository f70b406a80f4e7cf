"""What `bench stress` does: it runs the cases, prints a row for each, and stores the table as a record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from xfreqbench.bench.stress.case import StressCase, Verdict
from xfreqbench.bench.tables import require_records
from xfreqbench.errors import UnknownNameError
from xfreqbench.runs.records import BenchRecord, append

COLUMNS = ("area", "case", "error", "limit", "unit", "")
_WIDTHS = (13, 68, 8, 8, 10, 0)


def cases() -> tuple[StressCase, ...]:
    """All cases, area by area."""
    from xfreqbench.bench.stress.channels import MATERIALS, PHASE
    from xfreqbench.bench.stress.diffraction import DIFFRACTION
    from xfreqbench.bench.stress.geometry import FACETS, GEOMETRY
    from xfreqbench.bench.stress.maps import MAPS, SCORES
    from xfreqbench.bench.stress.splatting import COMPOSITE, FOOTPRINTS, PROJECTION
    from xfreqbench.bench.stress.training import ENCODING, SEEDS, TRAINING

    physics = (PHASE, MATERIALS, GEOMETRY, FACETS, DIFFRACTION, MAPS, SCORES)
    learning = (COMPOSITE, FOOTPRINTS, PROJECTION, ENCODING, TRAINING, SEEDS)
    return tuple(case for area in (*physics, *learning) for case in area.cases)


def selected(only: str | None) -> tuple[StressCase, ...]:
    """Cases whose area or name contains `only`, upper or lower case; all of them where it is None.

    Raises `UnknownNameError`, which lists the areas, where there is none.
    """
    chosen = tuple(case for case in cases() if only is None or only.lower() in f"{case.area} {case.name}".lower())
    if not chosen:
        raise UnknownNameError("case or area", str(only), {case.area for case in cases()})
    return chosen


def run_cases(only: str | None = None) -> Iterator[Verdict]:
    """The verdicts on the `selected` cases, one by one."""
    return (case.judge() for case in selected(only))


def stress(only: str | None, output: Path | None, say: Callable[[str], None]) -> bool:
    """Print a row for each case as soon as it is done; return whether all cases keep their limits.

    The table is appended to the records in `output`. Raises `UnknownNameError` where no case is selected, and
    `StorageError` or `DataError`, before the first case, where `output` is no file of records.
    """
    require_records(output)
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
    """The verdicts as a record with a table that a report shows."""
    return BenchRecord.here(
        bench="stress",
        title="Numerical stability" + (f", {only}" if only else ""),
        command="xfreqbench bench stress" + (f" --only {only!r}" if only else ""),
        note=(
            "Errors against references that share constants, and no code, with what they check, and the limits they "
            "keep; cases of seeds, threads and shared visibility compare two ways of the same code."
        ),
        columns=COLUMNS,
        rows=tuple(verdict.cells for verdict in verdicts),
    )


def _line(cells: Sequence[str]) -> str:
    return " ".join(f"{cell:{width}}" for cell, width in zip(cells, _WIDTHS, strict=True)).rstrip()
