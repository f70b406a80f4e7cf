"""3D models of scenes as GLB files, which any viewer of 3D models opens, and the colours of materials."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float
from trimesh.exchange.gltf import export_glb
from trimesh.visual.material import PBRMaterial

from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.system.files import atomic_path, storage_errors
from xfreqbench.types import FloatArray

Colour = tuple[int, int, int, int]  # red, green, blue and opacity, from 0 to 255

_SOFTWARE = "xfreqbench"  # the mark by which a model is known as ours when it is replaced


def material_hex(material: str) -> str:
    """Colour of a material as `#rrggbb`; one for all that have no name of ours."""
    return {
        "concrete": "#7f7f7f",
        "plasterboard": "#b8a37a",
        "stud-wall": "#b8a37a",
        "glass": "#56b4e9",
        "double-glazing": "#56b4e9",
        "wood": "#a0522d",
        "solid-door": "#a0522d",
        "hollow-door": "#a0522d",
        "chipboard": "#cd853f",
        "plywood": "#d2a679",
        "metal": "#3b5b92",
        "brick": "#b5482f",
        "brick-wall": "#b5482f",
        "marble": "#9d8fa8",
        "ceiling_board": "#a9b39b",
        "floorboard": "#8b6b3d",
    }.get(material, "#6b8e6b")


def material_colour(material: str, opacity: int) -> tuple[int, int, int, int]:
    """Colour of a material as red, green, blue and opacity, each from 0 to 255."""
    red, green, blue = bytes.fromhex(material_hex(material)[1:])
    return red, green, blue, opacity


class GlbModel:
    """A 3D model to which shapes are added: each is a node with a name and one colour, visible from both sides.

    Positions are in metres in world axes, z upwards. The file has y upwards, as glTF demands.
    """

    def __init__(self) -> None:
        self._scene = trimesh.Scene()

    def add_surface(self, mesh: SurfaceMesh, colour: Colour = (150, 160, 175, 60), material: str | None = None) -> None:
        """Add a surface of a scene, as the node `surface NAME`, under the name of a material where one is given."""
        shape = trimesh.Trimesh(mesh.vertices_m, mesh.triangles)
        self._add(f"surface {mesh.name}", shape, colour, material)

    def add_rectangle(self, name: str, corners_m: Float[FloatArray, "4 3"], colour: Colour) -> None:
        """Add a rectangle; its corners are given in order around it."""
        self._add(name, trimesh.Trimesh(corners_m, [[0, 1, 2], [0, 2, 3]], process=False), colour)

    def add_ball(self, name: str, centre_m: Float[FloatArray, "3"], radius_m: float, colour: Colour) -> None:
        """Add a sphere."""
        ball = trimesh.creation.icosphere(subdivisions=1, radius=radius_m)
        self._add(name, ball.apply_translation(centre_m), colour)

    def add_markers(self, name: str, position_m: Float[FloatArray, "N 3"], radius_m: float, colour: Colour) -> None:
        """Add small octahedra at N positions as one mesh of 168 bytes each; without positions, add nothing."""
        if not len(position_m):
            return
        faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
        vertices_m = position_m[:, None] + radius_m * np.vstack([np.eye(3), -np.eye(3)])
        triangles = 6 * np.arange(len(position_m))[:, None, None] + faces
        vertices_m, triangles = vertices_m.reshape(-1, 3), triangles.reshape(-1, 3)
        self._add(name, trimesh.Trimesh(vertices_m, triangles, process=False), colour)

    def add_tube(self, name: str, points_m: Float[FloatArray, "n 3"], radius_m: float, colour: Colour) -> None:
        """Add a line through points as a tube, which all viewers draw alike. Neighbouring points must differ."""
        parts = [
            trimesh.creation.cylinder(radius=radius_m, segment=segment, sections=6) for segment in pairwise(points_m)
        ]
        tube = trimesh.util.concatenate(parts)
        assert isinstance(tube, trimesh.Trimesh), "cylinders are meshes"
        self._add(name, tube, colour)

    def write(self, path: Path) -> None:
        """Write the model to a file; equal models give equal bytes. Raises `StorageError`."""
        content: bytes = export_glb(self._scene, tree_postprocessor=_sign)  # type: ignore[no-untyped-call]
        with atomic_path(path, len(content)) as temporary, storage_errors(path, len(content)):
            temporary.write_bytes(content)

    def _add(self, name: str, shape: trimesh.Trimesh, colour: Colour, material: str | None = None) -> None:
        mode = "OPAQUE" if colour[3] == 255 else "BLEND"
        look = PBRMaterial(name=material, baseColorFactor=colour, alphaMode=mode, doubleSided=True)  # type: ignore[no-untyped-call]
        shape.visual = trimesh.visual.TextureVisuals(material=look)  # type: ignore[no-untyped-call]
        y_up = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # from z upwards
        self._scene.add_geometry(shape, node_name=name, geom_name=name, transform=y_up)


def is_own_model(path: Path) -> bool:
    """Whether a model that `GlbModel` wrote is at `path`, by the mark in it."""
    with path.open("rb") as file:
        head = file.read(1024)
    return head.startswith(b"glTF") and f'"generator":"{_SOFTWARE}"'.encode() in head


def _sign(tree: dict[str, Any]) -> None:
    """Say first who made the model."""
    content = {"asset": {**tree.pop("asset"), "generator": _SOFTWARE}, **tree}
    tree.clear()
    tree.update(content)
