"""Commands that show what a run has learned, and what its maps lack."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from xfreqbench.cli.options import Output, Quiet, example, print_table, say

findings = App(name="findings", group="Results", help_epilogue=example("findings results --data office.h5 -o findings"))
residual = App(
    name="residual", group="Results", help_epilogue=example("residual results --data office.h5 -o residual.md")
)
RunData = Annotated[Path, Parameter(name="--data", help="The data set that the run was on.")]


@Parameter(name="*")
@dataclass(frozen=True)
class RecordChoice:
    """Which of a folder's records is meant: the newest one that fits."""

    id: Annotated[
        str | None, Parameter(name="--id", help="How the record's id begins; the newest record if absent.")
    ] = None
    split: Annotated[str | None, Parameter(name="--split", help="Only runs on this split, as in lofo-24.25GHz.")] = None
    seed: Annotated[int | None, Parameter(name="--seed", help="Only runs of this seed.")] = None


NEWEST = RecordChoice()


@findings.default
def compare_findings(
    results: Path,
    *,
    data: RunData,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder for the page, its figures and the model.")],
    room: Annotated[
        Path | None,
        Parameter(help="Folder for the learned room as a scene, room.toml and room.glb, which generate traces."),
    ] = None,
    refine: Annotated[
        bool,
        Parameter(help="Show the room as the run refined it; for older records it is refined now, within minutes."),
    ] = True,
    record: RecordChoice = NEWEST,
    quiet: Quiet = False,
) -> None:
    """Compare the planes, materials and images that a run found with the scene of its data.

    With --room, what was found also becomes a scene, which is traced at some tested rows and scored.

    Parameters
    ----------
    results
        Folder of `run`, or its file of records.
    """
    from xfreqbench.data.dataset import open_dataset
    from xfreqbench.system.bars import progress_bars

    from .findings.compared import ComparedFindings, choose_record
    from .findings.room import ROOM_HEADER, claim_room, refinement_of, score_rooms, write_room
    from .findings.write import missing_rows, plane_rows, small_missing, write_findings, write_page

    chosen = choose_record(results, record.id, record.split, record.seed)
    compared = ComparedFindings.of(chosen, open_dataset(data, chosen.job.receiver, chosen.job.polarization))
    tables = [
        (compared.title, *plane_rows(compared)),
        ("Planes of the scene that were not found", *missing_rows(compared)),
    ]
    if room is None:
        paths = write_findings(compared, output)
    else:
        refinement = refinement_of(compared)
        claim_room(chosen.id, room)
        paths = write_findings(compared, output)  # before what takes minutes
        rooms = {"traced in the room, as found": refinement.found}
        if refine:
            with progress_bars("changes", ["refining the room"], quiet) as (progress,):
                while not refinement.is_over:
                    refinement.step()
                    progress(refinement.done, refinement.num_steps)
            rooms["traced in the room, refined"] = refinement.room
        learned = score_rooms(results, compared, rooms)
        paths += write_room(compared, learned, room)
        write_page(compared, output, learned)
        tables.append(("The room at tested rows", ROOM_HEADER, list(learned.scores)))
    for table in () if quiet else tables:
        print_table(*table)
    say(small_missing(compared), quiet)
    for path in paths:
        say(f"wrote {path}", quiet)


@residual.default
def measure_residual(
    results: Path,
    *,
    data: RunData,
    output: Output,
    record: RecordChoice = NEWEST,
    tx: Annotated[int, Parameter(help="Tested transmitters, drawn at random; all where there are fewer.")] = 60,
    quiet: Quiet = False,
) -> None:
    """Measure what a run's maps lack: paths at planes that it did not find, or gains of paths at those it did.

    Parameters
    ----------
    results
        Folder of `run`, or its file of records; the predictions lie beside the records.
    """
    from xfreqbench.data.dataset import open_dataset
    from xfreqbench.system.bars import progress_bars

    from .findings import residual as tables
    from .findings.compared import ComparedFindings, choose_record

    chosen = choose_record(results, record.id, record.split, record.seed)
    compared = ComparedFindings.of(chosen, open_dataset(data, chosen.job.receiver, chosen.job.polarization))
    plan = tables.plan_residual(results, compared, tx)
    tables.claim(output, chosen.id)
    with progress_bars("transmitters", ["tracing", "scoring"], quiet) as (tracing, scoring):
        found = tables.compute_residual(plan, tracing, scoring)
    tables.write_residual(found, output)
    if not quiet:
        print_table(compared.title, *tables.score_rows(found))
        print_table("Where the findings leave gaps", *tables.group_rows(found))
    say(f"{tables.note(found)}\nwrote {output}", quiet)
