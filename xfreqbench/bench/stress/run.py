"""What `bench stress` does: it runs the cases, and prints and stores a row for each."""

from __future__ import annotations

from xfreqbench.bench.stress.case import StressCase
from xfreqbench.bench.tables import Bench
from xfreqbench.errors import UnknownNameError

COLUMNS = ("area", "case", "error", "limit", "unit", "")
_NOTE = "Errors against references that share constants, and no code, with what they check, and the limits they keep."


def cases() -> tuple[StressCase, ...]:
    """All cases, area by area."""
    from xfreqbench.bench.stress.channels import PHASE
    from xfreqbench.bench.stress.continuity import CONTINUITY
    from xfreqbench.bench.stress.diffraction import DIFFRACTION
    from xfreqbench.bench.stress.geometry import GEOMETRY
    from xfreqbench.bench.stress.maps import MAPS
    from xfreqbench.bench.stress.splatting import COMPOSITE, FOOTPRINTS, PROJECTION
    from xfreqbench.bench.stress.training import TRAINING

    physics = PHASE, GEOMETRY, DIFFRACTION, CONTINUITY, MAPS
    learning = COMPOSITE, FOOTPRINTS, PROJECTION, TRAINING
    return tuple(case for area in (*physics, *learning) for case in area.cases)


def selected(only: str | None) -> tuple[StressCase, ...]:
    """Cases whose area or name contains `only`, upper or lower case; all of them where it is None.

    Raises `UnknownNameError`, which lists the areas, where there is none.
    """
    chosen = tuple(case for case in cases() if only is None or only.lower() in f"{case.area} {case.name}".lower())
    if not chosen:
        raise UnknownNameError("case or area", str(only), {case.area for case in cases()})
    return chosen


def bench_stress(bench: Bench, only: str | None) -> bool:
    """Print a row for each case as soon as it is done; return whether all cases keep their limits.

    Raises `UnknownNameError` where no case is selected.
    """
    chosen, failed = selected(only), list[str]()
    bench.introduce()
    with bench.table("Numerical stability" + (f", {only}" if only else ""), _NOTE, COLUMNS) as table:
        for case in chosen:
            verdict = case.judge()
            table.add(*verdict.cells)
            if not verdict.is_within:
                failed.append(case.name)
    outcome = f"{len(failed)} FAILED: {'; '.join(failed)}" if failed else "all within limits"
    bench.say(f"{len(chosen)} {'case' if len(chosen) == 1 else 'cases'}, {outcome}")
    return not failed
