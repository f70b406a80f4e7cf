"""A scene with what is computed of it once, for those that plan, trace or draw it."""

from __future__ import annotations

from dataclasses import dataclass

from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Scene


@dataclass(frozen=True, eq=False)
class PreparedScene:
    """A scene and its geometry: meshes, facets and patches, each computed when it is first asked for, and kept."""

    scene: Scene
    geometry: Geometry

    @classmethod
    def of(cls, scene: Scene | PreparedScene) -> PreparedScene:
        """The scene with its meshes read, or what is prepared as it is; raises `SceneError` for what cannot be read."""
        if isinstance(scene, PreparedScene):
            return scene
        return cls(scene, Geometry(surface_meshes(scene)))
