"""Shapes as mesh files state them, and what the names of their materials mean."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.errors import SceneError
from xfreqbench.scene.materials import (
    DEFAULT_THICKNESS_M,
    ITU_MATERIALS,
    PRESETS,
    Layer,
    LayeredMaterial,
    Material,
    Scattering,
    SceneMaterial,
    SlabMaterial,
    material_named,
)
from xfreqbench.types import FloatArray, IntArray

MAX_TRIANGLES = 5_000_000  # and vertices, of a scene's mesh file
MAX_SHAPES = 50_000


class Triangles(NamedTuple):
    """K triangles on V vertices, in metres."""

    vertices_m: Float[FloatArray, "V 3"]
    triangles: Int[IntArray, "K 3"]

    @classmethod
    def of(cls, mesh: Any) -> Triangles:
        """Those of a mesh of trimesh."""
        return cls(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64))


@dataclass(frozen=True)
class StatedMaterial:
    """What a mesh file says about a material: its name, and its properties where they are stated."""

    name: str
    material: Material | None = None
    thickness_m: float | None = None
    scattering: Scattering | None = None


class Slab(NamedTuple):
    """What the faces of a mesh are made of."""

    material: SlabMaterial
    thickness_m: float
    scattering: Scattering | None = None  # None for a smooth surface

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The layers, from the front to the back; one of most slabs."""
        if isinstance(self.material, LayeredMaterial):
            return self.material.layers
        return (Layer(self.material, self.thickness_m),)

    @property
    def turned(self) -> Slab:
        """The same slab with its back to the front."""
        return self._replace(material=self.material.turned) if isinstance(self.material, LayeredMaterial) else self

    @property
    def homogeneous(self) -> Material:
        """What a slab of one layer is made of; raises `SceneError` for one of several."""
        if len(self.layers) > 1:
            raise SceneError(
                f"Material {str(self.material)!r} has {len(self.layers)} layers, which only solver image traces. "
                "Choose it (--solver image), or give the surfaces a material of one layer."
            )
        return self.layers[0].material


@dataclass(frozen=True, eq=False)
class ImportedShape:
    """A shape of a mesh file: its name, what it is made of, its triangles, and their origin in words."""

    name: str
    slab: Slab
    triangles: Triangles
    source: str


def bounded(shapes: Iterable[ImportedShape], path: Path) -> Iterator[ImportedShape]:
    """The shapes of a file, one after another; raises `SceneError` once they are more than any solver can trace."""
    size = 0
    for number, shape in enumerate(shapes):
        size += max(map(len, shape.triangles))
        if size > MAX_TRIANGLES or number == MAX_SHAPES:
            most = f"{MAX_TRIANGLES:,} triangles or {MAX_SHAPES:,} objects"
            raise SceneError(f"it holds more than {most}. Simplify its meshes, and join those of one material.")
        yield shape


def slab_of(stated: StatedMaterial | None, table: Mapping[str, SceneMaterial], source: str, name: str) -> Slab:
    """The slab of the material of a shape; `source` says in words which shape that is.

    A shape without a material has the one of its own `name` in the scene's table. An entry of
    that table comes first: under the material's name as the file has it, under its plain name, or under that of the
    P.2040 material that the file states. Otherwise it is what the file gives, or the P.2040 material of its plain name,
    where `Glass` is glass. Raises `SceneError` if the name means nothing, or there is none.
    """
    if stated is None and name not in table:
        raise SceneError(
            f"{source} has faces without a material. Give them one, named like 'itu_concrete', or say what they are in "
            f"the scene's TOML: [[material]] name = {name!r}, itu = 'concrete', thickness_m = 0.1."
        )
    stated = stated or StatedMaterial(name)
    plain = plain_name(stated.name)
    names = [stated.name, plain, plain.lower(), str(stated.material)]
    own = next((table[name] for name in names if name in table), None)
    material = material_named(own.name, table) if own else stated.material
    if material is None:
        plain = plain.lower()
        if plain not in ITU_MATERIALS and plain not in PRESETS:
            raise SceneError(
                f"{source}: material {stated.name!r} is not an ITU material. Name it like 'itu_concrete', or say what "
                f"it is in the scene's TOML: [[material]] name = {stated.name!r}, itu = 'concrete', thickness_m = 0.1."
            )
        material = material_named(plain, {})
    thickness_m = (own.thickness_m if own else None) or stated.thickness_m or DEFAULT_THICKNESS_M
    if isinstance(material, LayeredMaterial):
        thickness_m = material.thickness_m
    scattering = (own.scattering if own else None) or stated.scattering
    return Slab(material, thickness_m, rough(scattering))


def rough(scattering: Scattering | None) -> Scattering | None:
    """The scattering of a surface, None if its coefficient is 0."""
    return scattering if scattering and scattering.coefficient > 0 else None


def plain_name(name: str) -> str:
    """Name of a material without `mat-` and `itu_`, which exports put before it, and `.001` of Blender's copies."""
    return re.sub(r"^(mat-)?(itu_)?(itu-)?|(\.\d{3,})+$", "", name)
