"""Triangle meshes of a scene, built from boxes or read from PLY files, and written for Sionna RT."""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from xfreqbench.errors import SceneError
from xfreqbench.scene.materials import material_bands
from xfreqbench.scene.model import FAR_M, Scene, Surface
from xfreqbench.system.files import require_regular
from xfreqbench.types import FloatArray, IntArray

DEFAULT_THICKNESS_M = 0.1  # of a material that states none, as in Sionna RT
SLIVER = (
    1e-9  # a triangle has no plane where twice its area is at most this share of its longest edge squared
)


@dataclass(frozen=True)
class SurfaceMesh:
    """K triangles on V vertices, of one material, each a slab of `thickness_m`."""

    name: str
    material: str
    thickness_m: float
    vertices_m: Float[FloatArray, "V 3"]
    triangles: Int[IntArray, "K 3"]

    @property
    def corners_m(self) -> Float[FloatArray, "K 3 3"]:
        """The three corners of every triangle."""
        return self.vertices_m[self.triangles]


def triangle_corners_m(meshes: Sequence[SurfaceMesh]) -> Float[FloatArray, "K 3 3"]:
    """The three corners of every triangle of all meshes, in their order."""
    return np.concatenate([np.zeros((0, 3, 3)), *(mesh.corners_m for mesh in meshes)])


def surface_meshes(scene: Scene) -> list[SurfaceMesh]:
    """One mesh for every surface of a scene, then those of its Mitsuba XML.

    Raises `SceneError` for meshes that cannot be read.
    """
    meshes = [_box_mesh(surface) for surface in scene.surface]
    return meshes + _imported_meshes(scene.mitsuba_xml) if scene.mitsuba_xml else meshes


def _box_mesh(surface: Surface) -> SurfaceMesh:
    bounds = np.array([surface.min_m, surface.max_m])
    flat = np.flatnonzero(bounds[0] == bounds[1])
    shape = _rectangle(bounds, int(flat[0])) if len(flat) else trimesh.creation.box(bounds=bounds)
    return _surface_mesh(surface.name, surface.material, surface.thickness_m, shape)


def _rectangle(bounds: Float[FloatArray, "2 3"], normal_axis: int) -> trimesh.Trimesh:
    u, v = [axis for axis in range(3) if axis != normal_axis]
    corners = np.repeat(bounds[:1], 4, axis=0)
    corners[1:3, u] = bounds[1, u]
    corners[2:4, v] = bounds[1, v]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def _surface_mesh(name: str, material: str, thickness_m: float, shape: trimesh.Trimesh) -> SurfaceMesh:
    """Mesh from a shape's vertices and faces, without triangles of no area, which have no normal."""
    vertices_m = np.asarray(shape.vertices, dtype=np.float64)
    triangles = np.asarray(shape.faces, dtype=np.int64)
    has_area = _have_area(vertices_m[triangles])
    return SurfaceMesh(name, material, thickness_m, vertices_m, triangles[has_area])


def _have_area(corners_m: Float[FloatArray, "K 3 3"]) -> Bool[NDArray[np.bool_], "K"]:
    edges_m = np.roll(corners_m, -1, axis=1) - corners_m
    doubled_area_m2 = np.linalg.norm(np.cross(edges_m[:, 0], edges_m[:, 1]), axis=1)
    longest_m2 = np.max(np.sum(edges_m**2, axis=2), axis=1)
    return np.asarray(doubled_area_m2 > SLIVER * longest_m2)


def _imported_meshes(xml: Path) -> list[SurfaceMesh]:
    """Meshes of a Mitsuba XML with `itu-radio-material` materials and PLY shapes, as Sionna reads them."""
    try:
        root = ElementTree.parse(require_regular(xml)).getroot()
    except OSError as error:
        raise SceneError(f"The Mitsuba scene {xml} cannot be read: {error.strerror}.") from error
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # of XML, its encoding, its path
        raise SceneError(f"The Mitsuba scene {str(xml)!r} cannot be read: {error}.") from error
    bsdfs = {bsdf.get("id", ""): bsdf for bsdf in root.iter("bsdf") if bsdf.get("id")}
    return [_imported_mesh(shape, bsdfs, xml) for shape in root.iter("shape")]


def _radio_material(bsdf: ElementTree.Element, xml: Path) -> tuple[str, float]:
    """P.2040 name and thickness, either of an `itu-radio-material` or of an id like `mat-itu_concrete`."""
    named = bsdf.find("./string[@name='type']")
    identifier = bsdf.get("id", "")
    material = (named.get("value") if named is not None else None) or identifier.removeprefix("mat-itu_")
    if named is None and not identifier.startswith("mat-itu_"):
        raise SceneError(
            f"{xml}: material {identifier!r} is no ITU material. Use <bsdf type='itu-radio-material'> with "
            "<string name='type' value='concrete'/>, or an id like 'mat-itu_concrete'."
        )
    material_bands(material)
    return material, _thickness_m(bsdf, xml)


def _thickness_m(bsdf: ElementTree.Element, xml: Path) -> float:
    stated = bsdf.find("./float[@name='thickness']")
    if stated is None:
        return DEFAULT_THICKNESS_M
    value = stated.get("value", "")
    try:
        thickness_m = float(value)
    except ValueError:
        thickness_m = np.nan
    if not (np.isfinite(thickness_m) and thickness_m > 0):
        raise SceneError(
            f"{xml}: the thickness of material {bsdf.get('id', '')!r} is {value!r}. Give a number of metres "
            f"above 0, or leave it out for {DEFAULT_THICKNESS_M:g}."
        )
    return thickness_m


def _imported_mesh(
    shape: ElementTree.Element, bsdfs: dict[str, ElementTree.Element], xml: Path
) -> SurfaceMesh:
    name = shape.get("id", "unnamed").removeprefix("mesh-")
    if shape.get("type") != "ply" or shape.find("./transform") is not None:
        raise SceneError(
            f"{xml}: shape {name!r} is a {shape.get('type')!r} or has a <transform>. Export the scene with "
            "every shape as a PLY file in world coordinates, as Sionna's Blender export does."
        )
    reference = shape.find("./ref")
    bsdf = bsdfs.get(reference.get("id", "") if reference is not None else "")
    if bsdf is None:
        raise SceneError(f"{xml}: shape {name!r} refers to no material of this file; add <ref id='mat-…'/>.")
    material, thickness_m = _radio_material(bsdf, xml)
    filename = shape.find("./string[@name='filename']")
    ply = xml.parent / (filename.get("value", "") if filename is not None else "")
    try:
        with np.errstate(all="ignore"):  # of numbers that no float holds, which are refused below
            loaded = trimesh.load_mesh(require_regular(ply), process=False)
            mesh = _surface_mesh(name, material, thickness_m, loaded)
    except Exception as error:  # trimesh raises whatever its parsers do
        fault = getattr(error, "strerror", None) or error
        raise SceneError(f"{xml}: the mesh {ply} of shape {name!r} cannot be read: {fault}.") from error
    _check_triangles(mesh, ply, xml)
    return mesh


def _check_triangles(mesh: SurfaceMesh, ply: Path, xml: Path) -> None:
    if not (np.abs(mesh.vertices_m) <= FAR_M).all():
        raise SceneError(
            f"{xml}: the mesh {ply} of shape {mesh.name!r} has vertices that are not finite, or beyond {FAR_M:g} m."
        )
    if len(mesh.triangles) == 0:
        raise SceneError(
            f"{xml}: the mesh {ply} of shape {mesh.name!r} has no face of any area. "
            "Export it with its faces, or remove the shape."
        )


def meshes_sha256(meshes: Iterable[SurfaceMesh]) -> str:
    """SHA-256 of everything that rays can meet: names, materials, thicknesses and triangles."""
    digest = hashlib.sha256()
    for mesh in meshes:
        digest.update(f"{mesh.name}|{mesh.material}|{mesh.thickness_m!r}|{mesh.vertices_m.shape}".encode())
        digest.update(mesh.vertices_m.tobytes() + mesh.triangles.tobytes())
    return digest.hexdigest()


def shape_ids(meshes: Sequence[SurfaceMesh]) -> list[str]:
    """Id of each mesh in Mitsuba: `mesh-NAME`, followed by the mesh's number where that id is taken already."""
    ids: dict[str, None] = {}
    for number, mesh in enumerate(meshes):
        identifier = f"mesh-{mesh.name}"
        while identifier in ids:
            identifier += f"-{number:05d}"
        ids[identifier] = None
    return list(ids)


def write_mitsuba(meshes: Sequence[SurfaceMesh], folder: Path) -> Path:
    """Write `scene.xml` and one PLY for each mesh, as Sionna RT loads them; returns the path of the XML."""
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    root = ElementTree.Element("scene", version="2.1.0")
    kinds = sorted({(mesh.material, mesh.thickness_m) for mesh in meshes})
    for index, (material, thickness_m) in enumerate(kinds):
        bsdf = ElementTree.SubElement(root, "bsdf", type="itu-radio-material", id=f"mat-{material}-{index}")
        ElementTree.SubElement(bsdf, "string", name="type", value=material)
        ElementTree.SubElement(bsdf, "float", name="thickness", value=repr(thickness_m))
    for number, (mesh, identifier) in enumerate(zip(meshes, shape_ids(meshes), strict=True)):
        filename = f"meshes/{number:05d}.ply"
        trimesh.Trimesh(mesh.vertices_m, mesh.triangles, process=False).export(folder / filename)
        shape = ElementTree.SubElement(root, "shape", type="ply", id=identifier)
        ElementTree.SubElement(shape, "string", name="filename", value=filename)
        ElementTree.SubElement(shape, "boolean", name="face_normals", value="true")
        index = kinds.index((mesh.material, mesh.thickness_m))
        ElementTree.SubElement(shape, "ref", id=f"mat-{mesh.material}-{index}", name="bsdf")
    xml = folder / "scene.xml"
    ElementTree.ElementTree(root).write(xml)
    return xml
