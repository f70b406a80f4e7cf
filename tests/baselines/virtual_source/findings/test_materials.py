"""What is told of materials: which slab of the scene a learned one belongs to, and how both reflect over angle."""

from __future__ import annotations

import numpy as np
from xfreqbench.baselines.virtual_source.findings.materials import (
    LearnedSlab,
    learned_slabs,
    material_rows,
    reflection_rows,
    shown_carriers_hz,
)

from tests.support.found_box import SCENE, compared, found_room, slab
from tests.support.reference import slab_coefficients
from xfreqbench.data.dataset import PasDataset
from xfreqbench.scene.materials import complex_permittivity

ANGLE_RAD = np.radians([0.0, 30.0, 60.0, 85.0])


def learned_where(box: PasDataset, findings: dict[str, object], title: str) -> list[LearnedSlab]:
    return [learned for learned in learned_slabs(compared(box, findings)) if learned.title == title]


def test_every_slab_of_the_scene_has_the_planes_that_show_it(box: PasDataset) -> None:
    assert [(learned.title, learned.plane) for learned in learned_slabs(compared(box, found_room()))] == [
        ("concrete 100 mm", 2),
        ("concrete 100 mm", 3),
        ("concrete 200 mm", 0),
        ("concrete 200 mm", 1),
        ("glass 10 mm", 4),
        ("glass 10 mm", 5),
        ("plasterboard 20 mm", 6),
    ]


def test_both_polarisations_reflect_as_the_recommendation_says(box: PasDataset) -> None:
    for glass in learned_where(box, found_room(), "glass 10 mm"):
        for carrier_hz in shown_carriers_hz(compared(box, found_room())):
            learned, true = glass.reflections(carrier_hz, ANGLE_RAD)
            literal = [
                slab_coefficients(complex_permittivity("glass", carrier_hz), 0.01, carrier_hz, cosine)[:2]
                for cosine in np.cos(ANGLE_RAD)
            ]
            np.testing.assert_allclose(true, np.abs(literal), atol=1e-9)
            np.testing.assert_allclose(learned, true, atol=1e-12)  # what was learned has no error


def test_a_slab_is_compared_with_what_is_where_its_faces_are(box: PasDataset) -> None:
    """Two slabs of one plane: the face of the second lies on the screen's plane, the first has none at all."""
    findings = found_room()
    screen = findings["planes"][6]
    screen["slabs"] = [{**slab("metal", 0.002), "share": 0.01}, {**slab("wood", 0.03), "share": 0.9}]
    findings["faces"][6]["slab"] = 1
    (only,) = learned_where(box, findings, "plasterboard 20 mm")  # what fills a hundredth of the plane is not told
    assert only.slab.thickness_m == 0.03
    learned, true = only.reflections(24.25e9, ANGLE_RAD)
    assert abs(learned - true).max() > 0.1
    header, rows = material_rows(compared(box, findings))
    assert rows[-1][header.index("nearest of P.2040")].startswith("wood")


def test_rows_say_what_paths_tell_of(box: PasDataset) -> None:
    header, rows = material_rows(compared(box, found_room(seen=0.25)))
    assert len(rows) == len(SCENE.surface)
    told = [dict(zip(header, row, strict=True)) for row in rows]
    (screen,) = [row for row in told if row["plane"] == "6"]
    assert screen["seen"] == "25%"
    assert screen["nearest of P.2040"] == "plasterboard 20.00 mm"
    assert screen["to that, rms |ΔR|"] == "0.000"
    _, without_faces = material_rows(compared(box, {**found_room(), "faces": []}))
    assert {row[header.index("seen")] for row in without_faces} == {"–"}


def test_reflection_is_told_over_the_angle_with_the_truth_in_brackets(box: PasDataset) -> None:
    header, rows = reflection_rows(compared(box, found_room()))
    assert len(rows) == len(SCENE.surface) * len(shown_carriers_hz(compared(box, found_room()))) * 2
    cells = [cell for row in rows for cell in row[header.index("0°") :]]
    assert all(cell == f"{cell[:4]} ({cell[:4]})" for cell in cells)  # what was learned has no error
