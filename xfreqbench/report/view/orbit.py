"""What the orbit viewer of a page draws, for `orbit.js`: surfaces, transmitters, rays and the receiver."""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.report.view.figures import Rgba, group_colour, material_colour, ray_colour
from xfreqbench.report.view.room import ShownRoom
from xfreqbench.types import FloatArray

_BORESIGHT_M = 0.5
_OPAQUE = 255


def packed_scene(room: ShownRoom) -> str:
    """`orbit_scene` as JSON, compressed by gzip, in base64; equal rooms give equal text."""
    content = json.dumps(orbit_scene(room), separators=(",", ":")).encode()
    return b64encode(gzip.compress(content, mtime=0)).decode()


def orbit_scene(room: ShownRoom) -> dict[str, Any]:
    """What is drawn of a room: lists of x, y, z in whole millimetres in world axes, z upwards; colours as `#rrggbb`.

    Each point is given as the step from the one before it, the first from the origin, and each index of a triangle's
    corner likewise, which compresses to less than half.

    `surfaces` are triangles, one mesh a material, `groups` the transmitters in sight and in shadow, and `rays` lines
    from the transmitter to the array centre, the weakest first, so that strong ones are drawn over them.
    """
    ahead_m = room.receiver_m + _BORESIGHT_M * room.boresight
    groups = room.groups().items()
    rays = sorted(room.rays, key=lambda ray: ray.level_db)
    return {
        "surfaces": [*_surfaces(room)],
        "groups": [{"colour": _hex(group_colour(name)), "points": _mm(points)} for name, points in groups],
        "rays": [{"colour": _hex(ray_colour(ray.level_db)), "points": _mm(ray.points_m)} for ray in rays],
        "transmitter": _mm(room.tx_m),
        "receiver": _mm(room.receiver_m),
        "boresight": _mm(np.stack([room.receiver_m, ahead_m])),
    }


def _surfaces(room: ShownRoom) -> Iterable[dict[str, Any]]:
    for material in sorted({str(mesh.material) for mesh in room.meshes}):
        meshes = [mesh for mesh in room.meshes if str(mesh.material) == material]
        first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
        corners = [mesh.triangles + start for mesh, start in zip(meshes, first, strict=False)]
        yield {
            "colour": _hex(material_colour(material, _OPAQUE)),
            "points": _mm(np.concatenate([mesh.vertices_m for mesh in meshes])),
            "triangles": np.diff(np.concatenate(corners).ravel(), prepend=0).tolist(),
        }


def _mm(points_m: Float[FloatArray, "... 3"]) -> list[int]:
    places = np.rint(1000 * points_m).astype(int).reshape(-1, 3)
    return np.diff(places, axis=0, prepend=0).ravel().tolist()


def _hex(colour: Rgba) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)
