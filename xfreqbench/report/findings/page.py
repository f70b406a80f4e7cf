"""The page of findings: the true and the learned room in 3D, planes, and materials; `page.html` puts them in place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from xfreqbench.methods.virtual_source.surfaces import RoomSurface, fan_of
from xfreqbench.report.drawing.materials import material_hex
from xfreqbench.report.drawing.orbit import BORESIGHT_M, by_material, millimetres, one_surface, packed
from xfreqbench.report.drawing.templates import PageTable, Picture, owner_mark, render
from xfreqbench.report.findings.compared import ComparedFindings
from xfreqbench.scene.meshes import SurfaceMesh

_TRUE, _FOUND, _SOURCE = "#f5f0dc", "#d55e00", "#f0e442"  # none is that of a material
_SOURCE_PIXELS = 8
_LAYERS = {
    "true": "the true surfaces, pale",
    "learned": "what was learned",
    "sources": "virtual sources, yellow",
}


@dataclass(frozen=True)
class ScoredRoom:
    """The room that was made of findings, and how maps traced in it score: header and cells of a table."""

    surfaces: Sequence[RoomSurface]
    header: tuple[str, ...]
    scores: list[tuple[str, ...]]


def subject_of(record_id: str) -> str:
    """What a page of a record's findings says in its mark that it is about."""
    return f"findings of record {record_id}"


def findings_page(
    compared: ComparedFindings,
    pictures: Mapping[str, Picture],
    tables: Mapping[str, PageTable],
    notes: Mapping[str, str],
    room: ScoredRoom | None,
) -> str:
    """HTML of the findings of a record; equal findings give equal text.

    `pictures` go by their file names, `scene.png` and `reflection.svg`; `tables` and `notes`, a paragraph on each, by
    `planes`, `missing` and `materials`.
    """
    return render(
        "findings/page.html",
        title=f"Findings of {compared.title}",
        lead=_lead(compared),
        owner=owner_mark(subject_of(compared.record.id)),
        facts=_facts(compared),
        tx=compared.tx,
        orbit=packed(_scene(compared, room)),
        layers=_LAYERS.items(),
        key=_key(room),
        pictures=pictures,
        tables=tables,
        notes=notes,
        room=PageTable(room.header, room.scores) if room else None,
    )


def _lead(compared: ComparedFindings) -> str:
    right = [match for match in compared.matches if match]
    lead = f"{len(right)} of {len(compared.matches)} planes that were found are the scene's"
    if not right:
        return f"{lead}."
    error_mm = 1e3 * np.median([abs(match.distance_error_m) for match in right])
    return f"{lead}; half of those are within {error_mm:.2g} mm of it."


def _facts(compared: ComparedFindings) -> dict[str, str]:
    job = compared.record.job
    return {
        "Method": job.method,
        "Scene": compared.record.scene,
        "Split": f"{job.split}, seed {job.seed}",
        "Record": compared.record.id,
    }


def _key(room: ScoredRoom | None) -> dict[str, str]:
    """What was learned by the colours in which it is drawn: materials of a room, or whatever was found."""
    if room is None:
        return {"what was found": _FOUND}
    materials = sorted({surface.slab.material for surface in room.surfaces})
    return {material.replace("_", " "): material_hex(material) for material in materials}


def _scene(compared: ComparedFindings, room: ScoredRoom | None) -> dict[str, Any]:
    """What `orbit.js` draws."""
    receiver_m = compared.findings.array_m
    ahead_m = receiver_m + BORESIGHT_M * compared.dataset.header.receiver.rotation[:, 2]
    sources_m = np.array([source.position_m for source in compared.sources]).reshape(-1, 3)
    return {
        "surfaces": [
            *([one_surface(compared.meshes, _TRUE, layer="true", opacity=0.1)] if compared.meshes else []),
            *_learned(compared, room),
        ],
        "groups": [
            {
                "colour": _SOURCE,
                "points": millimetres(sources_m),
                "layer": "sources",
                "size": _SOURCE_PIXELS,
                "far": True,
            }
        ],
        "rays": [],
        "transmitter": millimetres(compared.tx_m),
        "receiver": millimetres(receiver_m),
        "boresight": millimetres(np.stack([receiver_m, ahead_m])),
    }


def _learned(compared: ComparedFindings, room: ScoredRoom | None) -> list[dict[str, Any]]:
    """The surfaces of a learned room, by material; without one the faces that were found, or the planes' rectangles."""
    if room:
        meshes = by_material([surface.mesh for surface in room.surfaces])
        return [
            one_surface(own, material_hex(material), layer="learned", opacity=0.45)
            for material, own in meshes.items()
        ]
    findings = compared.findings
    outlines = [face.corners_m for face in findings.faces] or [
        plane.corners_m for plane in findings.planes if plane.corners_m
    ]
    shapes = [
        SurfaceMesh("found", "vacuum", 0.0, np.array(corners_m), fan_of(len(corners_m)))
        for corners_m in outlines
    ]
    return [one_surface(shapes, _FOUND, layer="learned", opacity=0.3)] if shapes else []
