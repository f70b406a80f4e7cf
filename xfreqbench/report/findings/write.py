"""Writes what one run learned beside the true scene: a page, tables, figures and a 3D model in one folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.report.drawing.figures import is_own_drawing
from xfreqbench.report.drawing.glb import write_glb
from xfreqbench.report.drawing.markdown import ABSENT, heading, number, table
from xfreqbench.report.drawing.templates import PageTable, Picture, is_of_subject
from xfreqbench.report.findings.compared import ComparedFindings
from xfreqbench.report.findings.figures import DrawnPlane, DrawnScene, plot_materials, plot_scene
from xfreqbench.report.findings.match import MATCH_DISTANCE_M, MATCH_TILT_RAD, share_in_sight
from xfreqbench.report.findings.materials import (
    LEAST_SHARE,
    material_rows,
    shown_carriers_hz,
    shown_materials,
)
from xfreqbench.report.findings.page import ScoredRoom, findings_page, subject_of
from xfreqbench.system.files import read_text, require_own, require_space, write_text
from xfreqbench.types import FloatArray

PAGE, TABLE, NUMBERS, MODEL, PICTURE = "index.html", "findings.md", "findings.json", "scene.glb", "scene.png"
CURVES, CURVES_PNG = "reflection.svg", "reflection.png"
_TITLE = "# Findings of "
FILES = (PAGE, TABLE, NUMBERS, CURVES, CURVES_PNG, PICTURE, MODEL)
_ALT = {
    PICTURE: "Plan and elevation of the scene with the planes that were found",
    CURVES: "Reflection over the angle of incidence, material by material, learned and by ITU-R P.2040",
}
LISTED_AREA_M2 = 4.0  # planes of the scene that were not found and are smaller are only counted
_COLUMNS = (
    "plane",
    "surface",
    "error (mm)",
    "± std",
    "tilt (mrad)",
    "± std",
    "held",
    "Δ|R| median",
    "Δ|R| max",
)
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


def plane_rows(comparison: ComparedFindings) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and cells of a table with one row for each found plane."""
    planes = enumerate(
        zip(comparison.findings.planes, comparison.matches, comparison.reflections, strict=True)
    )
    return _COLUMNS, [
        (
            f"{index} {_place(found.unit_normal, found.distance_m)}",
            comparison.surface(index),
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


def missing_rows(comparison: ComparedFindings) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and cells of a table of the scene's planes, of `LISTED_AREA_M2` or more, that were not found."""
    array_m = comparison.findings.array_m
    return _MISSING_COLUMNS, [
        (
            comparison.names(plane.surfaces),
            _place(plane.normal, plane.distance_m),
            number(plane.area_m2, 1),
            f"{share_in_sight(plane, comparison.meshes, array_m):.0%}",
        )
        for plane in comparison.missing
        if plane.area_m2 >= LISTED_AREA_M2
    ]


def small_missing(comparison: ComparedFindings) -> str:
    """A sentence on the planes that `missing_rows` leaves out as too small."""
    count = sum(plane.area_m2 < LISTED_AREA_M2 for plane in comparison.missing)
    return f"{count} planes of less than {LISTED_AREA_M2:g} m² were not found either."


def write_findings(comparison: ComparedFindings, folder: Path) -> list[Path]:
    """Write `FILES` into a folder and return their paths; those of the same record are replaced.

    Raises `OutputExistsError`, before anything is written, where a file is something else, and `StorageError`.
    """
    _claim(folder, comparison.record.id)
    paths = [folder / name for name in FILES]
    write_text(folder / NUMBERS, json.dumps(_as_json(comparison), indent=1) + "\n")
    write_text(folder / TABLE, _markdown(comparison))
    drawn = shown_materials(comparison), shown_carriers_hz(comparison)
    plot_materials(*drawn, folder / CURVES)
    plot_materials(*drawn, folder / CURVES_PNG, "png")
    plot_scene(_drawn(comparison), folder / PICTURE)
    write_glb(comparison.meshes, _rectangles(comparison), _points(comparison), folder / MODEL)
    write_page(comparison, folder)
    return paths


def write_page(comparison: ComparedFindings, folder: Path, room: ScoredRoom | None = None) -> None:
    """Write the page of findings whose figures lie in the folder, with a learned room if there is one.

    Raises `StorageError`.
    """
    pictures = {name: Picture(name, alt, (folder / name).read_bytes()) for name, alt in _ALT.items()}
    tables = {
        "planes": PageTable(*plane_rows(comparison)),
        "missing": PageTable(*missing_rows(comparison)),
        "materials": PageTable(*_material_table(comparison)),
    }
    notes = {"planes": LEGEND, "missing": small_missing(comparison), "materials": _REFLECTION_LEGEND}
    write_text(folder / PAGE, findings_page(comparison, pictures, tables, notes, room))


def _material_table(comparison: ComparedFindings) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    carriers_hz = shown_carriers_hz(comparison)
    return material_rows(shown_materials(comparison), carriers_hz[len(carriers_hz) // 2])


def _claim(folder: Path, record_id: str) -> None:
    """Make the folder, or see that what is there was written for the same record."""
    is_same, fault = _owner(folder / NUMBERS) == record_id, f"was not written for record {record_id}"
    for name in FILES:
        require_own(folder / name, lambda path: None if is_same and _is_ours(path, record_id) else fault)
    require_space(folder / TABLE, 1)


def _is_ours(path: Path, record_id: str) -> bool:
    if path.name == TABLE:
        return path.read_bytes().startswith(_TITLE.encode())
    if path.name == PAGE:
        return is_of_subject(read_text(path), subject_of(record_id))
    return path.name == NUMBERS or is_own_drawing(path)


def _owner(path: Path) -> str | None:
    try:
        return str(json.loads(path.read_text("utf-8"))["record"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _markdown(comparison: ComparedFindings) -> str:
    header, rows = missing_rows(comparison)
    materials = _material_table(comparison)
    parts = [
        f"{_TITLE}{heading(comparison.title)}",
        f"[The same as a page, with the scene in 3D]({PAGE}); [the model alone]({MODEL})",
        LEGEND,
        table(*plane_rows(comparison)),
        *([table(header, rows)] if rows else []),
        small_missing(comparison),
        f"![{_ALT[PICTURE]}]({PICTURE})",
        "## Materials",
        _REFLECTION_LEGEND,
        *([table(*materials)] if materials[1] else []),
        f"![{_ALT[CURVES]}]({CURVES})",
    ]
    return "\n\n".join(parts) + "\n"


def _as_json(comparison: ComparedFindings) -> dict[str, Any]:
    record = comparison.record
    return {
        "record": record.id,
        "method": record.job.method,
        "split": record.job.split,
        "seed": record.job.seed,
        "dataset_sha256": record.dataset_sha256,
        "planes": [_plane_json(comparison, index) for index in range(len(comparison.matches))],
        "not_found": [
            {
                "surfaces": [comparison.meshes[surface].name for surface in plane.surfaces],
                "normal": plane.normal.tolist(),
                "distance_m": plane.distance_m,
                "area_m2": plane.area_m2,
                "share_in_sight": share_in_sight(plane, comparison.meshes, comparison.findings.array_m),
            }
            for plane in comparison.missing
        ],
        "transmitter": {"index": comparison.tx, "position_m": comparison.tx_m.tolist()},
        "virtual_sources": [
            {"planes": source.planes, "power": source.power, "position_m": source.position_m.tolist()}
            for source in comparison.sources
        ],
    }


def _plane_json(comparison: ComparedFindings, index: int) -> dict[str, Any]:
    match, shown = comparison.matches[index], comparison.reflections[index]
    return {
        **comparison.findings.planes[index].model_dump(),
        "surface": comparison.surface(index),
        "surfaces": [comparison.meshes[each].name for each in match.surfaces] if match else [],
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


def _drawn(comparison: ComparedFindings) -> DrawnScene:
    return DrawnScene(
        facets_m=[facet.corners_m for plane in comparison.planes for facet in plane.facets],
        planes=[
            DrawnPlane(str(index), np.array(found.corners_m), match.distance_error_m * 1e3 if match else None)
            for index, (found, match) in enumerate(
                zip(comparison.findings.planes, comparison.matches, strict=True)
            )
            if found.corners_m
        ],
        receiver_m=comparison.findings.array_m,
        tx_m=comparison.tx_m,
    )


def _rectangles(comparison: ComparedFindings) -> dict[str, Float[FloatArray, "4 3"]]:
    return {
        f"found plane {index}: {comparison.surface(index)}": np.array(found.corners_m)
        for index, found in enumerate(comparison.findings.planes)
        if found.corners_m
    }


def _points(comparison: ComparedFindings) -> dict[str, Float[FloatArray, "3"]]:
    sources = {
        f"virtual source {' '.join(map(str, source.planes))}": source.position_m
        for source in comparison.sources
    }
    return {
        "receiver": comparison.findings.array_m,
        f"transmitter {comparison.tx}": comparison.tx_m,
        **sources,
    }


def _place(normal: Float[FloatArray, "3"], distance_m: float) -> str:
    """In which direction a plane lies from the array centre, and how far, as in `+x 4.870 m`."""
    axis = int(np.abs(normal).argmax())
    is_along = np.abs(normal[axis]) > np.cos(MATCH_TILT_RAD)
    named = f"{'+' if normal[axis] > 0 else '-'}{'xyz'[axis]}"
    towards = named if is_along else f"({', '.join(f'{part:.2f}' for part in normal)})"
    return f"{towards} {distance_m:.3f} m"
