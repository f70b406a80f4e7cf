"""Scenes that a page shows in 3D, in the form that `orbit.js` draws."""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.types import FloatArray

BORESIGHT_M = 0.5  # drawn, in figures and models too


def packed(scene: Mapping[str, Any]) -> str:
    """A scene as JSON, compressed by gzip, in base64; equal scenes give equal text.

    `surfaces` are those of `one_surface`, `labels` a `text` and where it is shown, `at`. `groups` are points and `rays`
    lines, each a `colour` as `#rrggbb` and the `points` of `millimetres`, as are all places.
    """
    content = json.dumps(scene, separators=(",", ":")).encode()
    return b64encode(gzip.compress(content, mtime=0)).decode()


def millimetres(points_m: Float[FloatArray, "... 3"]) -> list[int]:
    """Points as x, y, z in whole millimetres in world axes, z upwards, each as the step from the one before it.

    The first is the step from the origin. Steps compress to less than half of what places take.
    """
    places = np.rint(1000 * points_m).astype(int).reshape(-1, 3)
    return np.diff(places, axis=0, prepend=0).ravel().tolist()


def one_surface(meshes: Sequence[SurfaceMesh], colour: str) -> dict[str, Any]:
    """All triangles of some meshes as one; each index of a corner is the step from the one before it."""
    first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    corners = [mesh.triangles + start for mesh, start in zip(meshes, first, strict=False)]
    return {
        "colour": colour,
        "points": millimetres(np.concatenate([mesh.vertices_m for mesh in meshes])),
        "triangles": np.diff(np.concatenate(corners).ravel(), prepend=0).tolist(),
    }


def by_material(meshes: Sequence[SurfaceMesh]) -> dict[str, list[SurfaceMesh]]:
    """Meshes by the names of their materials, which are sorted."""
    names = sorted({str(mesh.material) for mesh in meshes})
    return {name: [mesh for mesh in meshes if str(mesh.material) == name] for name in names}
