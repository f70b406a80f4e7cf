"""What the page of a view shows in 3D: surfaces, transmitters, rays and the receiver."""

from __future__ import annotations

from typing import Any

import numpy as np

from xfreqbench.report.drawing.materials import material_hex
from xfreqbench.report.drawing.orbit import BORESIGHT_M, by_material, millimetres, one_surface
from xfreqbench.report.view.figures import Rgba, group_colour, ray_colour
from xfreqbench.report.view.room import ShownRoom


def orbit_scene(room: ShownRoom) -> dict[str, Any]:
    """What is drawn of a room, for `orbit.packed`.

    `surfaces` are one a material, `groups` the transmitters in sight and in shadow, and `rays` lines from the
    transmitter to the array centre, the weakest first, so that strong ones are drawn over them.
    """
    ahead_m = room.receiver_m + BORESIGHT_M * room.boresight
    groups = room.groups().items()
    rays = sorted(room.rays, key=lambda ray: ray.level_db)
    return {
        "surfaces": [
            one_surface(meshes, material_hex(material))
            for material, meshes in by_material(room.meshes).items()
        ],
        "groups": [
            {"colour": _hex(group_colour(name)), "points": millimetres(points)} for name, points in groups
        ],
        "rays": [
            {"colour": _hex(ray_colour(ray.level_db)), "points": millimetres(ray.points_m)} for ray in rays
        ],
        "transmitter": millimetres(room.tx_m),
        "receiver": millimetres(room.receiver_m),
        "boresight": millimetres(np.stack([room.receiver_m, ahead_m])),
    }


def _hex(colour: Rgba) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)
