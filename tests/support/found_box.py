"""A box of six walls and a screen, and findings that hold all or some of its planes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from xfreqbench.baselines.virtual_source.findings.compared import ComparedFindings

from tests.support.plans import plan_generation
from tests.support.stored_records import make_record
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.runs.records import RunRecord
from xfreqbench.scene.materials import ITU_MATERIALS
from xfreqbench.scene.model import ReceiverArray, Scene, Surface, TransmitterGrid
from xfreqbench.tracing.tracer import TraceSettings

ARRAY_M = np.array([2.1, 1.6, 2.3])
SIZE_M = np.array([5.0, 4.0, 2.6])
SETTINGS = TraceSettings(interactions=("specular", "refraction"), solver="image", rays=20_000, max_depth=3)
SCENE = Scene(
    name="box",
    receiver=ReceiverArray(position_m=(2.1, 1.6, 2.3)),
    transmitters=TransmitterGrid(min_m=(0.5, 0.5, 0.8), max_m=(4.6, 3.5, 1.4), step_m=(0.5, 0.6, 0.5)),
    surface=(
        Surface("floor", "concrete", 0.2, (0.0, 0.0, 0.0), (5.0, 4.0, 0.0)),
        Surface("ceiling", "concrete", 0.2, (0.0, 0.0, 2.6), (5.0, 4.0, 2.6)),
        Surface("west", "concrete", 0.1, (0.0, 0.0, 0.0), (0.0, 4.0, 2.6)),
        Surface("east", "concrete", 0.1, (5.0, 0.0, 0.0), (5.0, 4.0, 2.6)),
        Surface("south", "glass", 0.01, (0.0, 0.0, 0.0), (5.0, 0.0, 2.6)),
        Surface("north", "glass", 0.01, (0.0, 4.0, 0.0), (5.0, 4.0, 2.6)),
        Surface("screen", "plasterboard", 0.02, (3.4, 0.0, 0.0), (3.4, 2.5, 2.6)),
    ),
)
CARRIERS_HZ = [2.4e9, 24.25e9, 60e9]
WALLS = (("z", 0.0), ("z", 2.6), ("x", 0.0), ("x", 5.0), ("y", 0.0), ("y", 4.0), ("x", 3.4))


def generated(folder: Path, scene: Scene = SCENE, settings: TraceSettings = SETTINGS, **options: Any) -> PasDataset:
    """A data set of the box, or of a scene like it, at three carriers."""
    plan = plan_generation(scene, CARRIERS_HZ, settings, **options)
    return open_dataset(generate_planned(plan, folder / "box.h5"))


def plane(axis: str, at_m: float, error_m: float = 0.0, tilt_rad: float = 0.0, **changes: object) -> dict[str, object]:
    """A plane that was found all over the box, `error_m` too far from the array and turned about the next axis."""
    index = "xyz".index(axis)
    normal, corners_m = np.zeros(3), np.zeros((4, 3))
    normal[index], normal[(index + 1) % 3] = (np.sign(at_m - ARRAY_M[index]) * np.cos(tilt_rad), np.sin(tilt_rad))
    corners_m[[1, 2], (index + 1) % 3] = SIZE_M[(index + 1) % 3]
    corners_m[[2, 3], (index + 2) % 3] = SIZE_M[(index + 2) % 3]
    corners_m[:, index] = at_m
    return {
        "normal": normal.tolist(),
        "distance_m": float(abs(at_m - ARRAY_M[index]) + error_m),
        "distance_std_m": 0.0,
        "tilt_std_rad": 0.0,
        "held": 1.0,
        "corners_m": corners_m.tolist(),
        "slabs": [],
        **changes,
    }


def findings_of(*planes: dict[str, object]) -> dict[str, object]:
    return {"planes": list(planes), "receiver_m": ARRAY_M.tolist(), "images": []}


ALL_PLANES = findings_of(*(plane(*wall) for wall in WALLS))
WITHOUT_FLOOR = findings_of(*(plane(*wall) for wall in WALLS[1:]))


def slab(material: str, thickness_m: float) -> dict[str, float]:
    """What a run would have learned of a slab if it had made no error."""
    band = ITU_MATERIALS[material][0]
    return {
        "share": 1.0,
        "permittivity": band.a,
        "conductivity_s_m": band.c,
        "conductivity_power": band.d,
        "thickness_m": thickness_m,
    }


def found_room(error_m: float = 0.0, seen: float = 1.0) -> dict[str, object]:
    """Every surface of the box as a plane with one face, `error_m` too far from the array."""
    planes, faces = [], []
    for index, surface in enumerate(SCENE.surface):
        low_m, high_m = np.array(surface.min_m), np.array(surface.max_m)
        axis = int(np.flatnonzero(low_m == high_m)[0])
        one, other = (other_axis for other_axis in range(3) if other_axis != axis)
        corners_m = np.array([low_m] * 4)
        corners_m[1:3, one], corners_m[2:, other] = high_m[one], high_m[other]
        corners_m[:, axis] += error_m * np.sign(low_m[axis] - ARRAY_M[axis])
        slabs = [slab(surface.material, surface.thickness_m)]
        planes.append(plane("xyz"[axis], float(low_m[axis]), error_m, slabs=slabs))
        told = {"plane": index, "slab": 0, "corners_m": corners_m.tolist(), "seen": seen}
        faces.append({**told, "is_wall": surface.name != "screen"})
    return {**ALL_PLANES, "planes": planes, "faces": faces}


def record_of(dataset: PasDataset, findings: dict[str, object], **changes: object) -> RunRecord:
    """A record of virtual-source on a data set."""
    return make_record("virtual-source", dataset_sha256=dataset.sha256, findings=findings, **changes)


def compared(dataset: PasDataset, findings: dict[str, object], **changes: object) -> ComparedFindings:
    """The findings of such a record beside the scene."""
    return ComparedFindings.of(record_of(dataset, findings, **changes), dataset)
