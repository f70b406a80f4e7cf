"""A small room furnished with meshes: a cushion of many small facets, a table of one board, and a metal screen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from xfreqbench.scene.model import ReceiverArray, Scene, Surface, TransmitterGrid

SLABS = {"wood": 0.02, "metal": 0.002}  # metres
GRID = TransmitterGrid(min_m=(0.5, 0.5, 1.0), max_m=(3.5, 2.5, 1.0), step_m=(1.0, 1.0, 1.0))
RECEIVER = ReceiverArray(position_m=(1.9, 1.4, 2.3))
SHELL = (
    Surface("floor", "concrete", 0.2, (0.0, 0.0, 0.0), (4.0, 3.0, 0.0)),
    Surface("ceiling", "concrete", 0.2, (0.0, 0.0, 2.5), (4.0, 3.0, 2.5)),
    Surface("west", "plasterboard", 0.1, (0.0, 0.0, 0.0), (0.0, 3.0, 2.5)),
    Surface("east", "concrete", 0.1, (4.0, 0.0, 0.0), (4.0, 3.0, 2.5)),
)
IN_PLACE = np.eye(4)
TX_M = np.array([[0.5, 0.6, 1.1], [3.3, 2.4, 0.9], [2.9, 0.4, 0.6], [1.4, 2.6, 1.3]])


def write_meshes(folder: Path, meshes: dict[str, tuple[str, trimesh.Trimesh]]) -> str:
    """Write meshes by name, each with its material, and the Mitsuba XML that names them; returns its name."""
    lines = [
        f'<bsdf type="itu-radio-material" id="mat-{name}"><string name="type" value="{name}"/>'
        f'<float name="thickness" value="{thickness_m}"/></bsdf>'
        for name, thickness_m in SLABS.items()
    ]
    for name, (material, mesh) in meshes.items():
        mesh.export(folder / f"{name}.ply")
        lines.append(
            f'<shape type="ply" id="mesh-{name}"><string name="filename" value="{name}.ply"/>'
            f'<ref id="mat-{material}" name="bsdf"/></shape>'
        )
    (folder / "room.xml").write_text(f'<scene version="2.1.0">{"".join(lines)}</scene>', encoding="utf-8")
    return "room.xml"


def cushion(subdivisions: int) -> trimesh.Trimesh:
    """A box with round edges, of 20·4ⁿ triangles."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    round_m = ball.vertices / np.linalg.norm(ball.vertices, ord=6, axis=1, keepdims=True)
    return trimesh.Trimesh([2.4, 1.0, 0.6] + round_m * [0.6, 0.35, 0.15], ball.faces, process=False)


def plate(edge_m: float, height_m: float, pieces: int = 1) -> trimesh.Trimesh:
    """A square of 2·pieces² triangles, level, with a corner at the origin."""
    steps = np.linspace(0, edge_m, pieces + 1)
    x, y = np.meshgrid(steps, steps, indexing="ij")
    vertices = np.stack([x, y, np.full_like(x, height_m)], axis=-1).reshape(-1, 3)
    corner = (np.arange(pieces)[:, None] * (pieces + 1) + np.arange(pieces)).reshape(-1)
    quads = np.stack([corner, corner + pieces + 1, corner + pieces + 2, corner + 1], axis=1)
    return trimesh.Trimesh(vertices, np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), process=False)


def furnished_room(folder: Path, subdivisions: int = 3, move: np.ndarray = IN_PLACE) -> Scene:
    """The room; its meshes are written to the folder, the cushion in 20·4ⁿ triangles.

    `move` (4, 4) shifts it all, or turns it by quarters about the z axis; the array stays as it is oriented.
    """
    meshes = {
        "cushion": ("wood", cushion(subdivisions)),
        "table": ("wood", trimesh.creation.box(bounds=[[0.8, 1.2, 0.7], [1.9, 2.1, 0.73]])),
        "screen": ("metal", trimesh.creation.box(bounds=[[3.0, 1.2, 0.8], [3.02, 2.0, 1.4]])),
        "foot": ("metal", trimesh.creation.cylinder(0.03, segment=[[1.3, 1.6, 0.02], [1.3, 1.6, 0.68]])),
    }
    xml = write_meshes(folder, {name: (slab, mesh.apply_transform(move)) for name, (slab, mesh) in meshes.items()})
    shell = []
    for surface in SHELL:
        ends_m = trimesh.transform_points([surface.min_m, surface.max_m], move)
        low_m, high_m = ends_m.min(axis=0).tolist(), ends_m.max(axis=0).tolist()
        shell.append(replace(surface, min_m=tuple(low_m), max_m=tuple(high_m)))
    receiver_m = trimesh.transform_points([RECEIVER.position_m], move)[0].tolist()
    receiver = replace(RECEIVER, position_m=tuple(receiver_m))
    return Scene("furnished", receiver, GRID, surface=tuple(shell), scene=xml, folder=folder)
