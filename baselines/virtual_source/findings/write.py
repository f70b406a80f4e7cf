"""Writes what one run learned beside the true scene: a page, tables, figures and a 3D model in one folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from xfreqbench.report.drawing.figures import is_own_drawing
from xfreqbench.report.drawing.glb import GlbModel
from xfreqbench.report.drawing.markdown import ABSENT, heading, number, table
from xfreqbench.report.drawing.materials import material_hex
from xfreqbench.report.drawing.orbit import BORESIGHT_M, by_material, millimetres, one_label, one_surface, packed
from xfreqbench.report.drawing.templates import PageTable, Picture, is_of_subject, owner_mark, render
from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.system.files import read_text, require_own, require_space, write_text

from ..room.surfaces import fan_of
from ..search.planes import Vector
from .compared import MATCH_DISTANCE_M, MATCH_TILT_RAD, ComparedFindings, share_in_sight
from .figures import plot_materials, plot_scene
from .materials import LEAST_SHARE, material_rows, shown_carriers_hz, shown_materials
from .room import ROOM_HEADER, ScoredRoom

_TRUE, _FOUND, _SOURCE = "#f5f0dc", "#d55e00", "#f0e442"  # none is that of a material
_SOURCE_PIXELS = 8
_LAYERS = {"true": "the true surfaces, pale", "learned": "what was learned", "sources": "virtual sources, yellow"}


PAGE, TABLE, NUMBERS, MODEL, PICTURE = "index.html", "findings.md", "findings.json", "scene.glb", "scene.png"
CURVES, CURVES_PNG = "reflection.svg", "reflection.png"
_TITLE = "# Findings of "
FILES = (PAGE, TABLE, NUMBERS, CURVES, CURVES_PNG, PICTURE, MODEL)
_ALT = {
    PICTURE: "Plan and elevation of the scene with the planes that were found",
    CURVES: "Reflection over the angle of incidence, material by material, learned and by ITU-R P.2040",
}
LISTED_AREA_M2 = 4.0  # planes of the scene that were not found and are smaller are only counted
_ERROR_COLUMNS = ("error (mm)", "± std", "tilt (mrad)", "± std")
_COLUMNS = ("plane", "surface", *_ERROR_COLUMNS, "held", "Δ|R| median", "Δ|R| max")
LEGEND = (
    f"A found plane shows a surface within {MATCH_DISTANCE_M * 100:g} cm and {np.degrees(MATCH_TILT_RAD):g}°. Errors "
    "of distance are along the true normal, positive beyond the surface, at its point nearest to the foot of the "
    "perpendicular from the array. “Held”: the share of the cells touched by paths that hold something; where it is "
    "0, the method itself says that nothing is there, and the surface is matched by the plane alone. Δ|R|: how far "
    "the learned |R| is from that of ITU-R P.2040 at normal incidence, at the carriers of the data."
)
_REFLECTION_LEGEND = (
    "Blue: ITU-R P.2040 for the scene's slab; orange: what was learned where the scene has it, every slab that fills "
    f"at least {LEAST_SHARE:.0%} of a plane which shows a surface directly, the fainter the less it fills. Each of "
    "these is a row of the table: how much of its plane it fills; how much of that the paths of the training tell of "
    "(where they tell of nothing, it is what learning began with); and the P.2040 slab that is nearest to it, with "
    "the root mean square of |ΔR| over carriers, angles and polarisations, phases included."
)
_MISSING_COLUMNS = ("not found", "plane", "area (m²)", "in sight of the array")


def plane_rows(compared: ComparedFindings) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and cells of a table with one row for each found plane."""
    planes = enumerate(zip(compared.findings.planes, compared.matches, compared.reflections, strict=True))
    return _COLUMNS, [
        (
            f"{index} {_place(found.unit_normal, found.distance_m)}",
            compared.surface(index),
            f"{match.distance_error_m * 1e3:+.2f}" if match else ABSENT,
            number(found.distance_std_m * 1e3, 2),
            number(match.tilt_error_rad * 1e3, 2) if match else ABSENT,
            number(found.tilt_std_rad * 1e3, 2),
            number(found.held, 2),
            number(float(np.median(shown.difference)), 3) if shown else ABSENT,
            number(float(shown.difference.max()), 3) if shown else ABSENT,
        )
        for index, (found, match, shown) in planes
    ]


def missing_rows(compared: ComparedFindings) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and cells of a table of the scene's planes, of `LISTED_AREA_M2` or more, that were not found."""
    array_m = compared.findings.array_m
    return _MISSING_COLUMNS, [
        (
            compared.names(plane.surfaces),
            _place(plane.normal, plane.distance_m),
            number(plane.area_m2, 1),
            f"{share_in_sight(plane, compared.meshes, array_m):.0%}",
        )
        for plane in compared.missing
        if plane.area_m2 >= LISTED_AREA_M2
    ]


def small_missing(compared: ComparedFindings) -> str:
    """A sentence on the planes that `missing_rows` leaves out as too small."""
    count = sum(plane.area_m2 < LISTED_AREA_M2 for plane in compared.missing)
    return f"{count} planes of less than {LISTED_AREA_M2:g} m² were not found either."


def write_findings(compared: ComparedFindings, folder: Path) -> list[Path]:
    """Write `FILES` into a folder and return their paths; those of the same record are replaced.

    Raises `OutputExistsError`, before anything is written, where a file is something else, and `StorageError`.
    """
    _claim(folder, compared.record.id)
    paths = [folder / name for name in FILES]
    write_text(folder / NUMBERS, json.dumps(_as_json(compared), indent=1) + "\n")
    write_text(folder / TABLE, _markdown(compared))
    drawn = shown_materials(compared), shown_carriers_hz(compared)
    plot_materials(*drawn, folder / CURVES)
    plot_materials(*drawn, folder / CURVES_PNG, "png")
    plot_scene(compared, folder / PICTURE)
    model = GlbModel()
    for mesh in compared.meshes:
        model.add_surface(mesh)
    for index, found in enumerate(compared.findings.planes):
        if found.corners_m:
            corners_m = np.array(found.corners_m)
            model.add_rectangle(f"found plane {index}: {compared.surface(index)}", corners_m, (213, 94, 0, 150))
    points = {"receiver": compared.findings.array_m, f"transmitter {compared.tx}": compared.tx_m}
    points |= {f"virtual source {' '.join(map(str, source.planes))}": source.position_m for source in compared.sources}
    for name, point_m in points.items():
        model.add_ball(name, point_m, 0.06, (0, 114, 178, 255))
    model.write(folder / MODEL)
    write_page(compared, folder)
    return paths


def write_page(compared: ComparedFindings, folder: Path, room: ScoredRoom | None = None) -> None:
    """Write the page of findings whose figures lie in the folder, with a learned room if any. Raises `StorageError`."""
    record, right = compared.record, [match for match in compared.matches if match]
    lead = f"{len(right)} of {len(compared.matches)} planes that were found are the scene's"
    if right:
        error_mm = 1e3 * np.median([abs(match.distance_error_m) for match in right])
        lead += f"; half of those are within {error_mm:.2g} mm of it"
    key = {"what was found": _FOUND}
    if room:
        materials = sorted({surface.slab.material for surface in room.surfaces})
        key = {material.replace("_", " "): material_hex(material) for material in materials}
    page = render(
        "page.html",
        __package__,
        title=f"Findings of {compared.title}",
        lead=f"{lead}.",
        owner=owner_mark(_subject_of(record.id)),
        facts={
            "Method": record.job.method,
            "Scene": record.scene,
            "Split": f"{record.job.split}, seed {record.job.seed}",
            "Record": record.id,
        },
        tx=compared.tx,
        orbit=packed(_scene(compared, room)),
        layers=_LAYERS.items(),
        colours=key,
        pictures={name: Picture(name, alt, (folder / name).read_bytes()) for name, alt in _ALT.items()},
        tables={
            "planes": PageTable(*plane_rows(compared)),
            "missing": PageTable(*missing_rows(compared)),
            "materials": PageTable(*_material_table(compared)),
        },
        notes={"planes": LEGEND, "missing": small_missing(compared), "materials": _REFLECTION_LEGEND},
        room=PageTable(ROOM_HEADER, list(room.scores)) if room else None,
    )
    write_text(folder / PAGE, page)


def _subject_of(record_id: str) -> str:
    """What a page of a record's findings says in its mark that it is about."""
    return f"findings of record {record_id}"


def _scene(compared: ComparedFindings, room: ScoredRoom | None) -> dict[str, Any]:
    """What `orbit.js` draws."""
    receiver_m = compared.findings.array_m
    ahead_m = receiver_m + BORESIGHT_M * compared.dataset.header.receiver.rotation[:, 2]
    sources_m = np.array([source.position_m for source in compared.sources]).reshape(-1, 3)
    true = [one_surface(compared.meshes, _TRUE, layer="true", opacity=0.1)] if compared.meshes else []
    sources = {"colour": _SOURCE, "points": millimetres(sources_m), "layer": "sources"}
    return {
        "surfaces": [*true, *_learned(compared, room)],
        "groups": [{**sources, "size": _SOURCE_PIXELS, "far": True}],
        "rays": [],
        "transmitter": millimetres(compared.tx_m),
        "receiver": millimetres(receiver_m),
        "boresight": millimetres(np.stack([receiver_m, ahead_m])),
        "labels": [one_label("receiver", receiver_m), one_label(f"transmitter {compared.tx}", compared.tx_m)],
    }


def _learned(compared: ComparedFindings, room: ScoredRoom | None) -> list[dict[str, Any]]:
    """The surfaces of a learned room, by material; without one the faces that were found, or the planes' rectangles."""
    if room:
        meshes = by_material([surface.mesh for surface in room.surfaces])
        return [
            one_surface(own, material_hex(material), layer="learned", opacity=0.45) for material, own in meshes.items()
        ]
    findings = compared.findings
    planes = [plane.corners_m for plane in findings.planes if plane.corners_m]
    shapes = [
        SurfaceMesh("found", "vacuum", 0.0, np.array(corners_m), fan_of(len(corners_m)))
        for corners_m in [face.corners_m for face in findings.faces] or planes
    ]
    return [one_surface(shapes, _FOUND, layer="learned", opacity=0.3)] if shapes else []


def _material_table(compared: ComparedFindings) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    carriers_hz = shown_carriers_hz(compared)
    return material_rows(shown_materials(compared), carriers_hz[len(carriers_hz) // 2])


def _claim(folder: Path, record_id: str) -> None:
    """Make the folder, or see that what is there was written for the same record."""
    try:
        is_same = str(json.loads((folder / NUMBERS).read_text("utf-8"))["record"]) == record_id
    except (OSError, ValueError, KeyError, TypeError):
        is_same = False

    def fault_of(path: Path) -> str | None:
        if path.name == TABLE:
            is_ours = path.read_bytes().startswith(_TITLE.encode())
        elif path.name == PAGE:
            is_ours = is_of_subject(read_text(path), _subject_of(record_id))
        else:
            is_ours = path.name == NUMBERS or is_own_drawing(path)
        return None if is_same and is_ours else f"was not written for record {record_id}"

    for name in FILES:
        require_own(folder / name, fault_of)
    require_space(folder / TABLE, 1)


def _markdown(compared: ComparedFindings) -> str:
    missing, materials = missing_rows(compared), _material_table(compared)
    parts = [
        f"{_TITLE}{heading(compared.title)}",
        f"[The same as a page, with the scene in 3D]({PAGE}); [the model alone]({MODEL})",
        LEGEND,
        table(*plane_rows(compared)),
        *([table(*missing)] if missing[1] else []),
        small_missing(compared),
        f"![{_ALT[PICTURE]}]({PICTURE})",
        "## Materials",
        _REFLECTION_LEGEND,
        *([table(*materials)] if materials[1] else []),
        f"![{_ALT[CURVES]}]({CURVES})",
    ]
    return "\n\n".join(parts) + "\n"


def _as_json(compared: ComparedFindings) -> dict[str, Any]:
    record = compared.record
    return {
        "record": record.id,
        "method": record.job.method,
        "split": record.job.split,
        "seed": record.job.seed,
        "dataset_sha256": record.dataset_sha256,
        "planes": [_plane_json(compared, index) for index in range(len(compared.matches))],
        "not_found": [
            {
                "surfaces": [compared.meshes[surface].name for surface in plane.surfaces],
                "normal": plane.normal.tolist(),
                "distance_m": plane.distance_m,
                "area_m2": plane.area_m2,
                "share_in_sight": share_in_sight(plane, compared.meshes, compared.findings.array_m),
            }
            for plane in compared.missing
        ],
        "transmitter": {"index": compared.tx, "position_m": compared.tx_m.tolist()},
        "virtual_sources": [
            {"planes": source.planes, "power": source.power, "position_m": source.position_m.tolist()}
            for source in compared.sources
        ],
    }


def _plane_json(compared: ComparedFindings, index: int) -> dict[str, Any]:
    match, shown = compared.matches[index], compared.reflections[index]
    return {
        **compared.findings.planes[index].model_dump(),
        "surface": compared.surface(index),
        "surfaces": [compared.meshes[surface].name for surface in match.surfaces] if match else [],
        "image_in_plane": match.mirror if match else None,
        "distance_error_m": match.distance_error_m if match else None,
        "tilt_error_rad": match.tilt_error_rad if match else None,
        "reflection": {
            "carrier_hz": shown.carrier_hz.tolist(),
            "learned": shown.learned.tolist(),
            "itu_r_p2040": shown.truth.tolist(),
            "median_difference": float(np.median(shown.difference)),
            "max_difference": float(shown.difference.max()),
        }
        if shown
        else None,
    }


def _place(normal: Vector, distance_m: float) -> str:
    """In which direction a plane lies from the array centre, and how far, as in `+x 4.870 m`."""
    axis = int(np.abs(normal).argmax())
    is_along = np.abs(normal[axis]) > np.cos(MATCH_TILT_RAD)
    named = f"{'+' if normal[axis] > 0 else '-'}{'xyz'[axis]}"
    towards = named if is_along else f"({', '.join(f'{part:.2f}' for part in normal)})"
    return f"{towards} {distance_m:.3f} m"
