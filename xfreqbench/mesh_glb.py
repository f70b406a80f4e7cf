"""A scene, planes and points in it as one GLB file, for any viewer of 3D models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float
from trimesh.exchange.gltf import export_glb
from trimesh.visual.material import PBRMaterial

from xfreqbench.angles import FloatArray
from xfreqbench.mesh import SurfaceMesh
from xfreqbench.storage import atomic_path, storage_errors

_SURFACE, _PLANE, _POINT = (150, 160, 175, 60), (213, 94, 0, 150), (0, 114, 178, 255)  # RGBA
_RADIUS_M = 0.06
_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # as glTF has it; ours is z


def write_glb(
    meshes: Sequence[SurfaceMesh],
    rectangles_m: Mapping[str, Float[FloatArray, "4 3"]],
    points_m: Mapping[str, Float[FloatArray, "3"]],
    path: Path,
) -> None:
    """Translucent surfaces, rectangles (corners in turn) in a colour of their own, points as small spheres.

    Every one is a node of its name; surfaces are `surface NAME`. Raises `StorageError`.
    """
    scene = trimesh.Scene()
    for mesh in meshes:
        _add(scene, f"surface {mesh.name}", trimesh.Trimesh(mesh.vertices_m, mesh.triangles), _SURFACE)
    for name, corners_m in rectangles_m.items():
        _add(scene, name, trimesh.Trimesh(corners_m, [[0, 1, 2], [0, 2, 3]], process=False), _PLANE)
    for name, point_m in points_m.items():
        ball = trimesh.creation.icosphere(subdivisions=1, radius=_RADIUS_M)
        _add(scene, name, ball.apply_translation(point_m), _POINT)
    content: bytes = export_glb(scene)  # type: ignore[no-untyped-call]
    with atomic_path(path, len(content)) as temporary, storage_errors(path, len(content)):
        temporary.write_bytes(content)


def _add(scene: trimesh.Scene, name: str, shape: trimesh.Trimesh, colour: tuple[int, int, int, int]) -> None:
    mode = "OPAQUE" if colour[3] == 255 else "BLEND"
    material = PBRMaterial(baseColorFactor=colour, alphaMode=mode, doubleSided=True)  # type: ignore[no-untyped-call]
    shape.visual = trimesh.visual.TextureVisuals(material=material)  # type: ignore[no-untyped-call]
    scene.add_geometry(shape, node_name=name, geom_name=name, transform=_Y_UP)
