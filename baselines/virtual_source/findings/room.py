"""The learned room of a record: refined on its training rows, scored at tested rows, and written as a scene."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from xfreqbench import load_predictions
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import find_split
from xfreqbench.errors import DataError, StorageError
from xfreqbench.maps.metrics import ssim
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.glb_writer import GlbModel, material_colour
from xfreqbench.scene.model import ReceiverArray, TransmitterGrid
from xfreqbench.system.files import write_text
from xfreqbench.tracing.image.tracer import can_solve
from xfreqbench.tracing.tracer import TraceSettings

from ..room.refine import Refinement
from ..room.surfaces import MIN_SEEN, NO_PLANE, RoomSurface, surface_from_json
from ..room.traced import channels_in
from .compared import ComparedFindings
from .residual import drawn_rows
from .text import claim

NUM_TESTED_TX = 60
ROOM_HEADER = ("maps", "median SSIM", "mean SSIM", "tested rows")
ROOM, SHAPE = "room.toml", "room.glb"


def settings_in_room(dataset: PasDataset) -> TraceSettings:
    """How learned rooms are traced: as the data were, by solver `image`."""
    return replace(dataset.trace_settings, solver="image", materials="extrapolate")


def refinement_of(compared: ComparedFindings) -> Refinement:
    """The refinement of a record's room; `found` is the room before it, `room` the room after its steps.

    No step remains where the record holds the room that the run itself refined. Raises `DataError` for findings without
    faces, or data whose interactions the image method does not trace in a room.
    """
    dataset, job = compared.dataset, compared.record.job
    train = dataset[find_split(dataset, job.protocol, job.split).train]
    refinement = Refinement.of(compared.findings, train)
    if refinement is None:
        raise DataError(
            f"Record {compared.record.id} has no faces from which a room could be made: the run found no plane that "
            "holds anything, or the record was written before faces were stored. Run virtual-source again."
        )
    if compared.findings.room:
        refinement.take([surface_from_json(surface.model_dump()) for surface in compared.findings.room])
    geometry = Geometry([surface.mesh for surface in refinement.room])
    if not can_solve(geometry, settings_in_room(dataset)):
        raise DataError(
            f"{dataset.path} was traced with {', '.join(dataset.trace_settings.named_interactions)}, which the image "
            f"method does not trace among the {len(refinement.room)} surfaces that were learned. Leave out --room."
        )
    return refinement


def score_rooms(
    results: Path, compared: ComparedFindings, rooms: Mapping[str, Sequence[RoomSurface]]
) -> list[tuple[str, ...]]:
    """Cells under `ROOM_HEADER`: the SSIM of tested rows, of the predictions if they are stored, and of each room.

    Rooms are traced as the data were. The rows are those of `NUM_TESTED_TX` transmitters, drawn at random, all where
    there are fewer.
    """
    dataset, record = compared.dataset, compared.record
    tested = find_split(dataset, record.job.protocol, record.job.split).test
    rows = drawn_rows(dataset, tested, NUM_TESTED_TX)
    samples = dataset[rows]
    truth, scores = samples.pas(), {}
    with suppress(DataError, StorageError):  # not kept, in use, or of other rows
        predicted = load_predictions(results, record, rows.tolist())
        scores[f"{record.job.method}, as predicted"] = ssim(predicted, truth, samples.grid)
    for label, room in rooms.items():
        cfr = channels_in(room, samples, settings_in_room(samples))
        maps = samples.beam.maps(cfr, samples.header.pas_kind)[0]
        scores[label] = ssim(maps, truth, samples.grid)
    return [
        (label, f"{np.median(similarity):.4f}", f"{similarity.mean():.4f}", str(len(similarity)))
        for label, similarity in scores.items()
    ]


def claim_room(record_id: str, folder: Path) -> None:
    """Raise `OutputExistsError` where a folder holds other files of these names, and `StorageError`."""
    claim(record_id, _first_line(record_id), folder / ROOM, folder / SHAPE)


def write_room(
    compared: ComparedFindings, room: Sequence[RoomSurface], scores: Sequence[tuple[str, ...]], folder: Path
) -> None:
    """Write a room with the data's array and transmitters into a folder, which `claim_room` has looked at.

    The scene's file tells the scores in comments. Raises `StorageError`.
    """
    model = GlbModel()
    for surface in room:
        model.add_surface(surface.mesh, material_colour(surface.slab.material, 140), surface.slab_name)
    write_text(folder / ROOM, _toml(compared, room, scores))
    model.write(folder / SHAPE)


def _first_line(record_id: str) -> str:
    return f"# The room that record {record_id} has learned."


def _toml(compared: ComparedFindings, room: Sequence[RoomSurface], scores: Sequence[tuple[str, ...]]) -> str:
    """The scene: its array and transmitters are those of the data, its materials those of the room."""
    scene, job = compared.dataset.scene, compared.record.job
    receiver = TypeAdapter(ReceiverArray).dump_python(compared.dataset.header.receiver, mode="json")
    head = {
        "name": f"{scene.name}-learned",
        "description": f"What {job.method} has learned of {scene.name} on {job.split}, seed {job.seed}.",
        "scene": SHAPE,
        "mirrors": "facets",
    }
    told = [f"# {what}: SSIM {median} (mean {mean}) of {number} tested rows\n" for what, median, mean, number in scores]
    parts = [_first_line(compared.record.id), "".join(told) + _table(head), f"[receiver]\n{_table(receiver)}"]
    if scene.transmitters:
        grid = TypeAdapter(TransmitterGrid).dump_python(scene.transmitters, mode="json")
        parts.append(f"[transmitters]\n{_table(grid)}")
    by_slab = defaultdict[str, list[RoomSurface]](list)
    for surface in room:
        by_slab[surface.slab_name].append(surface)
    for name, own in sorted(by_slab.items()):
        unseen = [surface.name for surface in own if surface.seen < MIN_SEEN]
        learned = [surface.slab.distance for surface in own if surface.plane != NO_PLANE]
        note = f"|ΔR| {max(learned):.3f} from what was learned" if learned else "of those tried, nearest to the maps"
        note += f"; unseen: {', '.join(unseen)}" if unseen else ""
        entry = {"name": name, "itu": own[0].slab.material, "thickness_m": own[0].slab.thickness_m}
        parts.append(f"[[material]]  # {note}\n{_table(entry)}")
    return "\n".join(parts)


def _table(content: Mapping[str, Any]) -> str:
    """Lines of TOML, which writes numbers, texts and lists of them as JSON does."""
    return "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in content.items())
