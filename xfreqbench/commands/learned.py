"""Commands about what a run has learned."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from xfreqbench.commands import Output, Quiet, app, print_table, progress_bars, say

RunData = Annotated[Path, Parameter(name="--data", help="The data set that the run was on.")]
RecordId = Annotated[
    str | None, Parameter(name="--id", help="How the record's id begins; the newest record if absent.")
]
RecordSplit = Annotated[str | None, Parameter(help="Only runs on this split, as in lofo-24.25GHz.")]
RecordSeed = Annotated[int | None, Parameter(help="Only runs of this seed.")]


@app.command
def findings(
    results: Path,
    *,
    data: RunData,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder for tables, figures and model.")],
    id_: RecordId = None,
    split: RecordSplit = None,
    seed: RecordSeed = None,
    quiet: Quiet = False,
) -> None:
    """Compare the planes, materials and images that a run found with the scene of its data.

    Parameters
    ----------
    results
        Folder of `run`, or its file of records.
    """
    from xfreqbench.dataset import open_dataset
    from xfreqbench.findings_record import ComparedFindings, choose_record
    from xfreqbench.findings_report import missing_rows, plane_rows, small_missing, title, write_findings

    record = choose_record(results, id_, split, seed)
    compared = ComparedFindings.of(record, open_dataset(data))
    paths = write_findings(compared, output)
    if not quiet:
        print_table(title(compared), *plane_rows(compared))
        print_table("Planes of the scene that were not found", *missing_rows(compared))
    say(small_missing(compared), quiet)
    for path in paths:
        say(f"wrote {path}", quiet)


@app.command
def residual(
    results: Path,
    *,
    data: RunData,
    output: Output,
    id_: RecordId = None,
    split: RecordSplit = None,
    seed: RecordSeed = None,
    tx: Annotated[
        int, Parameter(help="Tested transmitters, drawn at random; all where there are fewer.")
    ] = 60,
    quiet: Quiet = False,
) -> None:
    """Say whether a run lacks paths off planes that it did not find, or gains of paths off those it did.

    Parameters
    ----------
    results
        Folder of `run`, or its file of records; the predictions lie beside the records.
    """
    from xfreqbench import residual as residuals
    from xfreqbench.dataset import open_dataset
    from xfreqbench.findings_record import ComparedFindings, choose_record
    from xfreqbench.findings_report import title

    record = choose_record(results, id_, split, seed)
    compared = ComparedFindings.of(record, open_dataset(data))
    plan = residuals.plan_residual(results, compared, tx)
    residuals.claim(output, record.id)
    with progress_bars("transmitters", ["tracing", "scoring"], quiet) as (tracing, scoring):
        found = residuals.take_apart(plan, tracing, scoring)
    residuals.write_residual(found, output)
    if not quiet:
        print_table(title(compared), *residuals.score_rows(found))
        print_table("Where the findings leave gaps", *residuals.group_rows(found))
    say(f"{residuals.note(found)}\nwrote {output}", quiet)
