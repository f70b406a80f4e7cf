from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from xfreqbench.errors import SceneError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.solvers import make_tracer, resolve_solver
from xfreqbench.tracing.tracer import TraceSettings


def test_auto_takes_the_image_method_where_scene_and_interactions_allow_it() -> None:
    meshes = surface_meshes(load_scene("office"))
    many, too_many = (replace(meshes[0], triangles=np.tile(meshes[0].triangles, (n, 1))) for n in (450, 1000))
    for second in ("refraction", "diffraction"):
        settings = TraceSettings(interactions=("specular", second))
        solvers = [resolve_solver(Geometry(scene), settings).solver for scene in (meshes, [many], [too_many])]
        assert solvers == ["image", "image", "sionna"]


@pytest.mark.parametrize("solver", ["image", "sionna"])
def test_no_solver_takes_surfaces_that_lie_on_one_another(solver: Literal["image", "sionna"]) -> None:
    scene = load_scene("office")
    floor = next(surface for surface in scene.surface if surface.name == "floor")
    rug = replace(
        floor, name="rug", material="wood", min_m=(1.0, 1.0, floor.max_m[2]), max_m=(2.0, 2.0, floor.max_m[2])
    )
    for surfaces in ((*scene.surface, rug), (rug, *scene.surface)):
        with pytest.raises(SceneError, match=r"'(floor|rug)' .* and '(floor|rug)' .* overlap in one plane"):
            make_tracer(replace(scene, surface=surfaces), [24.25], TraceSettings(solver=solver))
