"""Writes what one run learned beside the true scene: a text with tables, and a 3D model, in one folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xfreqbench.scene.glb_writer import GlbModel
from xfreqbench.system.files import write_text

from ..search.planes import Vector
from .compared import (
    MATCH_DISTANCE_M,
    MATCH_TILT_RAD,
    ComparedFindings,
    reflection_difference,
    share_in_sight,
    virtual_sources,
)
from .materials import LEAST_SHARE, material_rows, reflection_rows
from .room import ROOM_HEADER
from .text import ABSENT, Table, claim, literal, number, table

TEXT, MODEL = "findings.md", "scene.glb"
LISTED_AREA_M2 = 4.0  # planes of the scene that were not found and are smaller are only counted


def plane_rows(compared: ComparedFindings) -> Table:
    """One row for each found plane."""
    rows: list[tuple[str, ...]] = []
    for index, (found, match) in enumerate(zip(compared.findings.planes, compared.matches, strict=True)):
        reflects = match and match.mirror is None and any(slab.share for slab in found.slabs)
        carrier_hz, away = compared.dataset.header.carrier_hz, np.array([np.nan])
        if match and reflects:
            away = reflection_difference(found.slabs, match.slabs(compared.meshes), carrier_hz)
        rows.append(
            (
                f"{index} {_place(found.unit_normal, found.distance_m)}",
                compared.surface(index),
                f"{match.distance_error_m * 1e3:+.2f}" if match else ABSENT,
                number(found.distance_std_m * 1e3, 2),
                number(match.tilt_error_rad * 1e3, 2) if match else ABSENT,
                number(found.tilt_std_rad * 1e3, 2),
                number(found.held, 2),
                number(float(np.median(away)), 3),
                number(float(away.max()), 3),
            )
        )
    errors = "error (mm)", "± std", "tilt (mrad)", "± std"
    return ("plane", "surface", *errors, "held", "Δ|R| median", "Δ|R| max"), rows


def missing_rows(compared: ComparedFindings) -> Table:
    """One row for each plane of the scene, of `LISTED_AREA_M2` or more, that was not found."""
    return ("not found", "plane", "area (m²)", "in sight of the array"), [
        (
            compared.names(plane.surfaces),
            _place(plane.normal, plane.distance_m),
            number(plane.area_m2, 1),
            f"{share_in_sight(plane, compared.meshes, compared.findings.array_m):.0%}",
        )
        for plane in compared.missing
        if plane.area_m2 >= LISTED_AREA_M2
    ]


def claim_findings(compared: ComparedFindings, folder: Path) -> None:
    """Raise `OutputExistsError` where a folder holds other files of the names written, and `StorageError`."""
    claim(compared.record.id, _title(compared), folder / TEXT, folder / MODEL)


def write_findings(compared: ComparedFindings, folder: Path, scores: Sequence[tuple[str, ...]] = ()) -> str:
    """Write the text and the model into a folder; those of the same record are replaced. Returns the text.

    `scores` are those of the room that was learned, if one was traced. Raises what `claim_findings` raises.
    """
    claim_findings(compared, folder)
    text = _text(compared, scores)
    write_text(folder / TEXT, text)
    model = GlbModel()
    for mesh in compared.meshes:
        model.add_surface(mesh)
    for index, found in enumerate(compared.findings.planes):
        if found.corners_m:
            corners_m = np.array(found.corners_m)
            model.add_rectangle(f"found plane {index}: {compared.surface(index)}", corners_m, (213, 94, 0, 150))
    points = {"receiver": compared.findings.array_m, f"transmitter {compared.tx}": compared.tx_m}
    for planes, position_m in virtual_sources(compared.findings, compared.tx_m).items():
        points[f"virtual source {' '.join(map(str, planes))}"] = position_m
    for name, point_m in points.items():
        model.add_ball(name, point_m, 0.06, (0, 114, 178, 255))
    model.write(folder / MODEL)
    return text


def _title(compared: ComparedFindings) -> str:
    return f"# Findings of {literal(compared.title)}"


def _text(compared: ComparedFindings, scores: Sequence[tuple[str, ...]]) -> str:
    right = [abs(match.distance_error_m) for match in compared.matches if match]
    lead = f"{len(right)} of {len(compared.matches)} planes that were found are the scene's"
    lead += f"; half of those are within {1e3 * np.median(right):.2g} mm of it." if right else "."
    small = sum(plane.area_m2 < LISTED_AREA_M2 for plane in compared.missing)
    parts = [
        _title(compared),
        f"{lead} [{MODEL}]({MODEL}) shows them in the scene, with the places where transmitter {compared.tx} seems to "
        "be after one or two reflections.",
        f"A found plane shows a surface within {MATCH_DISTANCE_M * 100:g} cm and {np.degrees(MATCH_TILT_RAD):g}°. "
        "Errors of distance are along the true normal, positive beyond the surface, at its point nearest to the foot "
        "of the perpendicular from the array. “Held”: the share of the cells touched by paths that hold something; "
        "where it is 0, the method itself says that nothing is there, and the surface is matched by the plane alone. "
        "Δ|R|: how far the learned |R| is from that of ITU-R P.2040 at normal incidence, at the carriers of the data.",
        table(*plane_rows(compared)),
        table(*missing_rows(compared)),
        f"{small} planes of less than {LISTED_AREA_M2:g} m² were not found either.",
    ]
    if scores:
        parts += ["## The learned room, traced at tested rows", table(ROOM_HEADER, scores)]
    parts += [
        "## Materials",
        "What was learned where the scene has a slab: every slab that fills at least "
        f"{LEAST_SHARE:.0%} of a plane which shows a surface directly, how much of its plane it fills, how much of "
        "that the paths of the training tell of (where they tell of nothing, it is what learning began with), and the "
        "P.2040 slab that is nearest to it, with the root mean square of |ΔR| over carriers, angles and "
        "polarisations, phases included.",
        table(*material_rows(compared)),
        "How each reflects over the angle of incidence: |R| as learned, and in brackets by ITU-R P.2040 for the "
        "scene's slab.",
        table(*reflection_rows(compared)),
    ]
    return "\n\n".join(parts) + "\n"


def _place(normal: Vector, distance_m: float) -> str:
    """In which direction a plane lies from the array centre, and how far, as in `+x 4.870 m`."""
    axis = int(np.abs(normal).argmax())
    is_along = np.abs(normal[axis]) > np.cos(MATCH_TILT_RAD)
    named = f"{'+' if normal[axis] > 0 else '-'}{'xyz'[axis]}"
    towards = named if is_along else f"({', '.join(f'{part:.2f}' for part in normal)})"
    return f"{towards} {distance_m:.3f} m"
