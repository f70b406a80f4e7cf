"""What is told of materials: which slab of the scene a learned one belongs to, and how both reflect over angle."""

from __future__ import annotations

import numpy as np
from xfreqbench.baselines.virtual_source.findings.compared import ComparedFindings
from xfreqbench.baselines.virtual_source.findings.materials import (
    ShownMaterial,
    material_rows,
    shown_carriers_hz,
    shown_materials,
)

from tests.support.found_box import SCENE, found_room, slab
from tests.support.reference import slab_coefficients
from tests.support.stored_records import make_record
from xfreqbench.data.dataset import PasDataset
from xfreqbench.scene.materials import complex_permittivity

ANGLE_RAD = np.radians([0.0, 30.0, 60.0, 85.0])


def compared(box: PasDataset, findings: dict[str, object]) -> ComparedFindings:
    return ComparedFindings.of(make_record("virtual-source", dataset_sha256=box.sha256, findings=findings), box)


def materials_of(box: PasDataset, findings: dict[str, object]) -> dict[str, ShownMaterial]:
    return {material.title: material for material in shown_materials(compared(box, findings))}


def test_every_slab_of_the_scene_has_the_planes_that_show_it(box: PasDataset) -> None:
    shown = materials_of(box, found_room())
    planes = {title: [learned.plane for learned in material.learned] for title, material in shown.items()}
    assert planes == {
        "concrete 100 mm": [2, 3],
        "concrete 200 mm": [0, 1],
        "glass 10 mm": [4, 5],
        "plasterboard 20 mm": [6],
    }


def test_both_polarisations_reflect_as_the_recommendation_says(box: PasDataset) -> None:
    glass = materials_of(box, found_room())["glass 10 mm"]
    for carrier_hz in shown_carriers_hz(compared(box, found_room())):
        true = glass.true_over_angle(carrier_hz, ANGLE_RAD)
        literal = [
            slab_coefficients(complex_permittivity("glass", carrier_hz), 0.01, carrier_hz, cosine)[:2]
            for cosine in np.cos(ANGLE_RAD)
        ]
        np.testing.assert_allclose(true.T, np.abs(literal), atol=1e-9)
        for learned in glass.learned_over_angle(carrier_hz, ANGLE_RAD):
            np.testing.assert_allclose(learned, true, atol=1e-12)  # what was learned has no error


def test_a_slab_is_compared_with_what_is_where_its_faces_are(box: PasDataset) -> None:
    """Two slabs of one plane: the face of the second lies on the screen's plane, the first has none at all."""
    findings = found_room()
    screen = findings["planes"][6]
    screen["slabs"] = [{**slab("metal", 0.002), "share": 0.01}, {**slab("wood", 0.03), "share": 0.9}]
    findings["faces"][6]["slab"] = 1
    shown = materials_of(box, findings)["plasterboard 20 mm"]
    (only,) = shown.learned  # what fills a hundredth of the plane is not told
    assert only.slab.thickness_m == 0.03
    assert only.named is not None and only.named.material == "wood"
    away = shown.true_over_angle(24.25e9, ANGLE_RAD) - shown.learned_over_angle(24.25e9, ANGLE_RAD)[0]
    assert abs(away).max() > 0.1


def test_rows_say_what_paths_tell_of(box: PasDataset) -> None:
    header, rows = material_rows(shown_materials(compared(box, found_room(seen=0.25))), 24.25e9)
    assert len(rows) == len(SCENE.surface)
    told = [dict(zip(header, row, strict=True)) for row in rows]
    (screen,) = [row for row in told if row["plane"] == "6"]
    assert screen["seen"] == "25%"
    assert screen["nearest of P.2040"] == "plasterboard 20.00 mm"
    assert screen["to that, rms |ΔR|"] == "0.000"
    without_faces = {**found_room(), "faces": []}
    assert {
        row[header.index("seen")] for row in material_rows(shown_materials(compared(box, without_faces)), 1e9)[1]
    } == {"–"}
