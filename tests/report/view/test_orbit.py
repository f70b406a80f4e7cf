"""What the orbit viewer is told to draw, compared with the room."""

from __future__ import annotations

import gzip
import json
import re
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.support.screened_room import SCENE
from xfreqbench.report.view.figures import ray_colour
from xfreqbench.report.view.page import orbit_scene
from xfreqbench.report.view.plan import ViewPlan

ROUNDING_M = 0.0005  # half a millimetre


def metres(points: list[int]) -> np.ndarray:
    return np.cumsum(np.reshape(points, (-1, 3)), axis=0) / 1000


def test_the_page_holds_the_room_that_is_drawn(folder: Path, view: ViewPlan) -> None:
    html = (folder / "index.html").read_text("utf-8")
    found = re.search('<script type="application/gzip" id="orbit-scene">(.*?)</script>', html, re.DOTALL)
    assert found and json.loads(gzip.decompress(b64decode(found.group(1)))) == orbit_scene(view.room)
    assert html.index("Permission is hereby granted") < html.index(
        "THREE={}"
    )  # the licence, above the library


def test_surfaces_of_a_material_are_one_mesh_and_fill_their_surfaces(view: ViewPlan) -> None:
    surfaces = orbit_scene(view.room)["surfaces"]
    assert len(surfaces) == len({surface.material for surface in SCENE.surface}) == 3
    area_m2 = 0.0
    for surface in surfaces:
        corners = metres(surface["points"])[np.cumsum(surface["triangles"]).reshape(-1, 3)]
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area_m2 += float(np.linalg.norm(sides, axis=1).sum() / 2)
    np.testing.assert_allclose(area_m2, 2 * 8 * 6 + 6 * 2.8 + 3 * 2.3)


def test_rays_run_from_the_transmitter_to_the_receiver_the_weakest_first(view: ViewPlan) -> None:
    backwards = replace(view.room, rays=view.room.rays[::-1])
    drawn = orbit_scene(backwards)
    assert drawn == orbit_scene(view.room)
    assert len(drawn["rays"]) == len(view.room.rays)
    for shown, ray in zip(drawn["rays"], sorted(view.room.rays, key=lambda ray: ray.level_db), strict=True):
        assert shown["colour"] == "#{:02x}{:02x}{:02x}".format(*ray_colour(ray.level_db))
        np.testing.assert_allclose(metres(shown["points"]), ray.points_m, atol=ROUNDING_M)
        assert shown["points"][:3] == drawn["transmitter"]
        np.testing.assert_array_equal(metres(shown["points"])[-1:], metres(drawn["receiver"]))


def test_a_room_of_which_nothing_but_places_is_known_is_drawn(view: ViewPlan) -> None:
    drawn = orbit_scene(replace(view.room, meshes=[], rays=[], in_sight=None))
    assert drawn["surfaces"] == drawn["rays"] == []
    np.testing.assert_allclose(metres(drawn["groups"][0]["points"]), view.room.tx_position_m, atol=ROUNDING_M)
