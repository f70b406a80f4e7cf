"""Commands that show what a run has learned, and what its maps lack."""

from __future__ import annotations

from pathlib import Path


def findings(
    results: Path,
    *,
    data: Path,
    output: Path,
    room: Path | None = None,
    refine: bool = True,
    id: str | None = None,
    split: str | None = None,
    seed: int | None = None,
    quiet: bool = False,
) -> None:
    """Compare the planes, materials and images that a run found with the scene of its data.

    With --room, what was found also becomes a scene, which is traced at some tested rows and scored.

    Example: xfreqbench findings results --data office.h5 -o findings

    Parameters
    ----------
    results
        Folder of `run`, or its file of records.
    data
        The data set that the run was on.
    output
        Folder for the text and the model.
    room
        Folder for the learned room as a scene, room.toml and room.glb, which generate traces.
    refine
        Show the room as the run refined it; for older records it is refined now, within minutes.
    id
        How the record's id begins; the newest record if absent.
    split
        Only runs on this split, as in lofo-24.25GHz.
    seed
        Only runs of this seed.
    """
    from xfreqbench.data.dataset import open_dataset
    from xfreqbench.system.bars import progress_bars

    from .findings.compared import ComparedFindings, choose_record
    from .findings.room import ROOM, SHAPE, claim_room, refinement_of, score_rooms, write_room
    from .findings.text import printable
    from .findings.write import MODEL, TEXT, claim_findings, write_findings

    chosen = choose_record(results, id, split, seed)
    compared = ComparedFindings.of(chosen, open_dataset(data, chosen.job.receiver, chosen.job.polarization))
    scores, paths = list[tuple[str, ...]](), [output / TEXT, output / MODEL]
    if room is not None:
        refinement = refinement_of(compared)
        claim_room(chosen.id, room)
        claim_findings(compared, output)  # before what takes minutes
        rooms = {"traced in the room, as found": refinement.found}
        if refine:
            with progress_bars("changes", ["refining the room"], quiet) as (progress,):
                while not refinement.is_over:
                    refinement.step()
                    progress(refinement.done, refinement.num_steps)
            rooms["traced in the room, refined"] = refinement.room
        scores = score_rooms(results, compared, rooms)
        write_room(compared, list(rooms.values())[-1], scores, room)
        paths += [room / ROOM, room / SHAPE]
    text = write_findings(compared, output, scores)
    if not quiet:
        print(text, *(f"wrote {printable(path)}" for path in paths), sep="\n")


def residual(
    results: Path,
    *,
    data: Path,
    output: Path,
    tx: int = 60,
    id: str | None = None,
    split: str | None = None,
    seed: int | None = None,
    quiet: bool = False,
) -> None:
    """Measure what a run's maps lack: paths at planes that it did not find, or gains of paths at those it did.

    Example: xfreqbench residual results --data office.h5 -o residual.md

    Parameters
    ----------
    results
        Folder of `run`, or its file of records; the predictions lie beside the records.
    data
        The data set that the run was on.
    output
        File to write.
    tx
        Tested transmitters, drawn at random; all where there are fewer.
    id
        How the record's id begins; the newest record if absent.
    split
        Only runs on this split, as in lofo-24.25GHz.
    seed
        Only runs of this seed.
    """
    from xfreqbench.data.dataset import open_dataset
    from xfreqbench.system.bars import progress_bars

    from .findings.compared import ComparedFindings, choose_record
    from .findings.residual import claim_residual, compute_residual, plan_residual, write_residual
    from .findings.text import printable

    chosen = choose_record(results, id, split, seed)
    compared = ComparedFindings.of(chosen, open_dataset(data, chosen.job.receiver, chosen.job.polarization))
    plan = plan_residual(results, compared, tx)
    claim_residual(compared, output)
    with progress_bars("transmitters", ["tracing", "scoring"], quiet) as (tracing, scoring):
        found = compute_residual(plan, tracing, scoring)
    text = write_residual(found, output)
    if not quiet:
        print(text, f"wrote {printable(output)}", sep="\n")
