"""Commands that show what a run has learned, and what its maps lack."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from xfreqbench.cli.options import RESULTS, Output, Quiet, app, example, print_table, say

RunData = Annotated[Path, Parameter(name="--data", help="The data set that the run was on.")]


@Parameter(name="*")
@dataclass(frozen=True)
class RecordChoice:
    """Which of a folder's records is meant: the newest one that fits."""

    id: Annotated[
        str | None, Parameter(name="--id", help="How the record's id begins; the newest record if absent.")
    ] = None
    split: Annotated[
        str | None, Parameter(name="--split", help="Only runs on this split, as in lofo-24.25GHz.")
    ] = None
    seed: Annotated[int | None, Parameter(name="--seed", help="Only runs of this seed.")] = None


NEWEST = RecordChoice()


@app.command(group=RESULTS, help_epilogue=example("findings results --data office.h5 -o findings"))
def findings(
    results: Path,
    *,
    data: RunData,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder for tables, figures and model.")],
    room: Annotated[
        Path | None,
        Parameter(
            help="Folder for the learned room as a scene, room.toml and room.glb, which generate traces."
        ),
    ] = None,
    refine: Annotated[
        bool,
        Parameter(
            help="Change the room, within minutes, until what is traced in it is nearest to some training rows."
        ),
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
    from xfreqbench.report.findings.compared import ComparedFindings, choose_record
    from xfreqbench.report.findings.room import refinement_of
    from xfreqbench.report.findings.room_files import claim_room, write_room
    from xfreqbench.report.findings.room_score import HEADER as ROOM_COLUMNS
    from xfreqbench.report.findings.room_score import score_rooms, score_rows
    from xfreqbench.report.findings.write import (
        missing_rows,
        plane_rows,
        small_missing,
        write_findings,
    )
    from xfreqbench.system.bars import progress_bars

    chosen = choose_record(results, record.id, record.split, record.seed)
    compared = ComparedFindings.of(chosen, open_dataset(data))
    refinement = None if room is None else refinement_of(compared)
    if room is not None:
        claim_room(chosen.id, room)
    paths = write_findings(compared, output)
    if room is not None and refinement is not None:
        rooms = {"traced in the room, as found": refinement.found}
        if refine:
            with progress_bars("changes", ["refining the room"], quiet) as (progress,):
                while not refinement.is_over:
                    refinement.step()
                    progress(refinement.done, len(refinement.steps))
            rooms["traced in the room, refined"] = refinement.room
        scores = score_rows(score_rooms(results, compared, rooms))
        paths += write_room(compared, refinement.room, scores, room)
    if not quiet:
        print_table(compared.title, *plane_rows(compared))
        print_table("Planes of the scene that were not found", *missing_rows(compared))
        if room is not None:
            print_table("The room at tested rows", ROOM_COLUMNS, scores)
    say(small_missing(compared), quiet)
    for path in paths:
        say(f"wrote {path}", quiet)


@app.command(group=RESULTS, help_epilogue=example("residual results --data office.h5 -o residual.md"))
def residual(
    results: Path,
    *,
    data: RunData,
    output: Output,
    record: RecordChoice = NEWEST,
    tx: Annotated[
        int, Parameter(help="Tested transmitters, drawn at random; all where there are fewer.")
    ] = 60,
    quiet: Quiet = False,
) -> None:
    """Measure what a run's maps lack: paths at planes that it did not find, or gains of paths at those it did.

    Parameters
    ----------
    results
        Folder of `run`, or its file of records; the predictions lie beside the records.
    """
    from xfreqbench.data.dataset import open_dataset
    from xfreqbench.report.findings import residual_tables as tables
    from xfreqbench.report.findings.compared import ComparedFindings, choose_record
    from xfreqbench.report.findings.residual import compute_residual, plan_residual
    from xfreqbench.system.bars import progress_bars

    chosen = choose_record(results, record.id, record.split, record.seed)
    compared = ComparedFindings.of(chosen, open_dataset(data))
    plan = plan_residual(results, compared, tx)
    tables.claim(output, chosen.id)
    with progress_bars("transmitters", ["tracing", "scoring"], quiet) as (tracing, scoring):
        found = compute_residual(plan, tracing, scoring)
    tables.write_residual(found, output)
    if not quiet:
        print_table(compared.title, *tables.score_rows(found))
        print_table("Where the findings leave gaps", *tables.group_rows(found))
    say(f"{tables.note(found)}\nwrote {output}", quiet)
