from __future__ import annotations

from dataclasses import replace

import numpy as np

from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.solvers import resolve_solver
from xfreqbench.tracing.tracer import TraceSettings


def test_auto_takes_the_image_method_where_scene_and_interactions_allow_it() -> None:
    meshes = surface_meshes(load_scene("office"))
    office = Geometry(meshes)
    assert resolve_solver(office, TraceSettings(interactions=("specular", "refraction"))).solver == "image"
    assert resolve_solver(office, TraceSettings(interactions=("specular", "diffraction"))).solver == "image"
    many_facets = Geometry([replace(meshes[0], triangles=np.tile(meshes[0].triangles, (450, 1)))])
    assert resolve_solver(many_facets, TraceSettings(interactions=("specular", "refraction"))).solver == "image"
    diffracting = TraceSettings(interactions=("specular", "diffraction"))
    assert resolve_solver(many_facets, diffracting).solver == "image"
    round_table = replace(meshes[0], triangles=np.tile(meshes[0].triangles, (1000, 1)))
    assert (
        resolve_solver(Geometry([round_table]), TraceSettings(interactions=("specular", "refraction"))).solver
        == "sionna"
    )
