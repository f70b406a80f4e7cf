"""The rooms of a scene: closed meshes whose inside is free space, where others are objects that hold nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from xfreqbench.errors import PlacementError, SceneError, UnknownNameError
from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.model import Scene
from xfreqbench.scene.visibility import enclosing_mesh, fibonacci_sphere, is_closed, sees
from xfreqbench.types import FloatArray

OUTSIDE_M = 0.3  # by which window sills and frames may extend out of a room
NUM_RAYS = 10_000  # that look for the way out of a room


def objects_of(scene: Scene, meshes: Sequence[SurfaceMesh]) -> list[SurfaceMesh]:
    """The meshes that are not rooms, in which nothing can be.

    Rooms are the meshes that `scene.rooms` names. Without names, a closed mesh is a room if the receiver is in it, and
    nothing else of the scene extends out of its bounding box by more than `OUTSIDE_M`: a cabinet is not, because the
    walls extend out of it. Raises `UnknownNameError` and `SceneError` for names of no closed mesh.
    """
    if not meshes:
        return []
    if not scene.rooms:
        receiver_m = np.asarray(scene.receiver.position_m)
        bounds = [(mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)) for mesh in meshes]
        low_m, high_m = (np.array(corners).reshape(-1, 3) for corners in zip(*bounds, strict=True))
        spans_all = (low_m <= low_m.min(axis=0) + OUTSIDE_M) & (high_m >= high_m.max(axis=0) - OUTSIDE_M)
        found = list[SurfaceMesh]()
        for mesh, is_widest in zip(meshes, spans_all.all(axis=1).tolist(), strict=True):
            found += _without_shell(mesh, receiver_m) if is_widest and _encloses(mesh, receiver_m) else [mesh]
        return found
    names = {mesh.name for mesh in meshes}
    for name in scene.rooms:
        if name not in names:
            raise UnknownNameError("mesh for a room", name, names)
    for mesh in meshes:
        if mesh.name in scene.rooms and not is_closed(mesh):
            raise SceneError(
                f"The scene names {mesh.name!r} as a room, but some of its edges belong to only one face, so it "
                "has no inside. Close it, or leave it out of rooms."
            )
    return [mesh for mesh in meshes if mesh.name not in scene.rooms]


def _without_shell(room: SurfaceMesh, receiver_m: Float[FloatArray, "3"]) -> list[SurfaceMesh]:
    """The objects that are one mesh with the room about them: its connected parts but the widest about the receiver."""
    import trimesh

    parts = [
        replace(room, vertices_m=np.asarray(part.vertices), triangles=np.asarray(part.faces, np.int64))
        for part in trimesh.Trimesh(room.vertices_m, room.triangles).split(only_watertight=False)
    ]
    shell = max(parts, key=lambda part: float(np.ptp(part.vertices_m, axis=0).prod()) * _encloses(part, receiver_m))
    return [part for part in parts if part is not shell]


def _encloses(mesh: SurfaceMesh, point_m: Float[FloatArray, "3"]) -> bool:
    return int(enclosing_mesh([mesh], point_m[None])[0]) == 0


def check_closed(scene: Scene, meshes: Sequence[SurfaceMesh]) -> None:
    """Raise `PlacementError` if a scene promises that it is closed, but there is a way out.

    A closed mesh about the receiver has none. Otherwise `NUM_RAYS` rays from the receiver look for one, and the first
    that meets nothing is named.
    """
    receiver_m = np.asarray(scene.receiver.position_m)
    if not scene.closed or any(_encloses(mesh, receiver_m) for mesh in meshes):
        return
    directions = fibonacci_sphere(NUM_RAYS)
    farthest_m = max((float(np.abs(mesh.vertices_m - receiver_m).max()) for mesh in meshes), default=1.0)
    free = sees(meshes, receiver_m + 2 * farthest_m * directions, receiver_m)
    if free.any():
        towards = directions[free.argmax()].round(3).tolist()
        raise PlacementError(
            f"Scene {scene.name!r} promises closed = true, but {free.sum():,} of {NUM_RAYS:,} rays from its receiver "
            f"meet nothing, the first of them towards {towards}. Close the gap, or remove the promise."
        )
