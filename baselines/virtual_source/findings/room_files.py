"""Writes a learned room as a scene that can be traced: a TOML file, and the GLB that it names."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from xfreqbench.report.drawing.figures import is_own_drawing
from xfreqbench.report.drawing.glb import GlbModel
from xfreqbench.report.drawing.materials import material_colour
from xfreqbench.scene.model import ReceiverArray, TransmitterGrid
from xfreqbench.system.files import require_own, require_space, write_text

from ..room.surfaces import NO_PLANE, RoomSurface
from .compared import ComparedFindings
from .page import ScoredRoom

ROOM, SHAPE = "room.toml", "room.glb"
_OPACITY = 140


def claim_room(record_id: str, folder: Path) -> None:
    """See that a room can be written into a folder: nothing is there, or a room of the same record.

    Raises `OutputExistsError` where something else is there, and `StorageError`.
    """
    fault = f"was not written for record {record_id}"

    def fault_of(path: Path) -> str | None:
        first = (
            (folder / ROOM).read_text("utf-8", "replace").partition("\n")[0]
            if (folder / ROOM).is_file()
            else ""
        )
        is_ours = path.name == ROOM or is_own_drawing(path)
        return None if is_ours and first == _first_line(record_id) else fault

    for name in (SHAPE, ROOM):
        require_own(folder / name, fault_of)
    require_space(folder / ROOM, 1)


def write_room(compared: ComparedFindings, room: ScoredRoom, folder: Path) -> list[Path]:
    """Write a room with the data's array and transmitters into a folder, which `claim_room` has looked at.

    The scene's file tells the scores in comments. Returns the paths of the scene and of its shape. Raises
    `StorageError`.
    """
    model = GlbModel()
    for surface in room.surfaces:
        colour = material_colour(surface.slab.material, _OPACITY)
        model.add_surface(surface.mesh, colour, surface.slab_name)
    write_text(folder / ROOM, _toml(compared, room))
    model.write(folder / SHAPE)
    return [folder / ROOM, folder / SHAPE]


def _first_line(record_id: str) -> str:
    return f"# The room that record {record_id} has learned."


def _toml(compared: ComparedFindings, room: ScoredRoom) -> str:
    scene, job = compared.dataset.scene, compared.record.job
    parts = [
        _first_line(compared.record.id),
        "".join(
            f"# {what}: SSIM {median} (mean {mean}) of {number} tested rows\n"
            for what, median, mean, number in room.scores
        )
        + _table(
            {
                "name": f"{scene.name}-learned",
                "description": f"What {job.method} has learned of {scene.name} on {job.split}, seed {job.seed}.",
                "scene": SHAPE,
                "mirrors": "facets",
            }
        ),
        "[receiver]\n"
        + _table(TypeAdapter(ReceiverArray).dump_python(compared.dataset.header.receiver, mode="json")),
        "[transmitters]\n"
        + _table(TypeAdapter(TransmitterGrid).dump_python(scene.transmitters, mode="json")),
    ]
    for name, own in sorted(_by_slab(room.surfaces).items()):
        unseen = [surface.name for surface in own if surface.is_unseen]
        learned = [surface.slab.distance for surface in own if surface.plane != NO_PLANE]
        near = (
            f"|ΔR| {max(learned):.3f} from what was learned"
            if learned
            else "of those tried, nearest to the maps"
        )
        note = f"# {near}" + (f"; unseen: {', '.join(unseen)}" if unseen else "")
        entry = {"name": name, "itu": own[0].slab.material, "thickness_m": own[0].slab.thickness_m}
        parts.append(f"[[material]]  {note}\n{_table(entry)}")
    return "\n".join(parts)


def _by_slab(surfaces: Sequence[RoomSurface]) -> dict[str, list[RoomSurface]]:
    slabs: dict[str, list[RoomSurface]] = {}
    for surface in surfaces:
        slabs.setdefault(surface.slab_name, []).append(surface)
    return slabs


def _table(content: Mapping[str, Any]) -> str:
    """Lines of TOML, which writes numbers, texts and lists of them as JSON does."""
    return "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in content.items())
