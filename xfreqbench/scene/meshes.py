"""Triangle meshes of a scene, built from boxes and polygons or read from mesh files, and written for Sionna RT."""

from __future__ import annotations

import hashlib
import math
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import metadata
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from xfreqbench.errors import SceneError, UnknownNameError
from xfreqbench.scene.imported import ImportedShape, Slab, Triangles, bounded
from xfreqbench.scene.materials import ConstantMaterial, Scattering, SlabMaterial
from xfreqbench.scene.mesh_files import read_scene
from xfreqbench.scene.mitsuba_xml import read_xml
from xfreqbench.scene.model import FAR_M, UNIT_M, PatchSize, Scene, Surface
from xfreqbench.scene.polygons import flat_polygon, is_flat
from xfreqbench.types import FloatArray, IntArray, NDArray

SIONNA = "sionna:"  # begins the name of a scene that Sionna RT brings


@dataclass(frozen=True)
class SurfaceMesh:
    """K triangles on V vertices, of one material, each a slab of `thickness_m`.

    With `least_patch`, only those in a coplanar patch of at least that size reflect; otherwise all do.
    """

    name: str
    material: SlabMaterial
    thickness_m: float
    vertices_m: Float[FloatArray, "V 3"]
    triangles: Int[IntArray, "K 3"]
    scattering: Scattering | None = None
    least_patch: PatchSize | None = None

    @property
    def corners_m(self) -> Float[FloatArray, "K 3 3"]:
        """The three corners of every triangle."""
        return self.vertices_m[self.triangles]

    @cached_property
    def outlines_m(self) -> list[tuple[FloatArray, FloatArray]]:
        """Corners (3 or 4, 3) of each facet in turn, and a vector (3,) out of its front.

        Two triangles that form a parallelogram are one facet; seen from the front they turn counter-clockwise.
        """
        corners_m = self.corners_m
        front = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
        by_edge: dict[tuple[int, ...], list[int]] = defaultdict(list)
        for index, triangle in enumerate(self.triangles):
            for a, b in ((0, 1), (1, 2), (2, 0)):
                by_edge[tuple(sorted((int(triangle[a]), int(triangle[b]))))].append(index)
        merged: list[tuple[FloatArray, FloatArray]] = []
        used: set[int] = set()
        for edge, pair in by_edge.items():  # paired greedily over shared edges
            if len(pair) == 2 and not used & set(pair):
                corners = _parallelogram(self.vertices_m, edge, *self.triangles[pair])
                if corners is not None:
                    merged.append((corners, front[pair[0]]))
                    used |= set(pair)
        has_area = _have_area(corners_m)
        return merged + [(corners_m[i], front[i]) for i in range(len(corners_m)) if i not in used and has_area[i]]

    @property
    def slab(self) -> Slab:
        """What every face is made of."""
        return Slab(self.material, self.thickness_m, self.scattering)


def _parallelogram(
    vertices_m: Float[FloatArray, "V 3"],
    diagonal: tuple[int, ...],
    first: Int[IntArray, "3"],
    second: Int[IntArray, "3"],
) -> FloatArray | None:
    """Corners (4, 3) in turn, if two triangles about a diagonal make a parallelogram, otherwise None."""
    (apex,) = set(first.tolist()) - set(diagonal) or {diagonal[0]}
    (opposite,) = set(second.tolist()) - set(diagonal) or {diagonal[0]}
    a, b, c, d = vertices_m[[apex, diagonal[0], opposite, diagonal[1]]]
    size = np.linalg.norm(c - a)
    is_parallelogram = np.allclose(a + c, b + d, rtol=0, atol=1e-6 * size)
    return np.stack([a, b, c, d]) if is_parallelogram and _have_area(np.stack([a, b, c])[None])[0] else None


def slabs_of(meshes: Iterable[SurfaceMesh]) -> list[Slab]:
    """The distinct slabs of some meshes, in alphabetical order."""
    return sorted({mesh.slab for mesh in meshes}, key=lambda slab: (str(slab.material), slab.thickness_m, repr(slab)))


def triangle_corners_m(meshes: Sequence[SurfaceMesh]) -> Float[FloatArray, "K 3 3"]:
    """The three corners of every triangle of all meshes, in their order."""
    return np.concatenate([np.zeros((0, 3, 3)), *(mesh.corners_m for mesh in meshes)])


def bounds_m(meshes: Sequence[SurfaceMesh]) -> Float[FloatArray, "2 3"]:
    """The lowest and the highest corner of the box about some meshes, one at least."""
    ends_m = np.array([[mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)] for mesh in meshes])
    return np.array([ends_m[:, 0].min(axis=0), ends_m[:, 1].max(axis=0)])


def surface_meshes(scene: Scene) -> list[SurfaceMesh]:
    """One mesh for every surface of a scene, then those of its mesh file.

    Raises `SceneError` for meshes that cannot be read.
    """
    meshes = []
    for surface in scene.surface:
        least_patch = None if surface.mirrors is None else PatchSize(math.inf, math.inf)
        meshes.append(_surface_mesh(surface.name, scene.slab_of(surface), _triangles(surface), least_patch))
    return meshes + [_imported_mesh(shape, scene.least_patch) for shape in _imported_shapes(scene)]


def _triangles(surface: Surface) -> Triangles:
    import trimesh

    if surface.vertices_m is not None:
        return Triangles(*flat_polygon(surface.corners_m))
    bounds = surface.corners_m
    flat = np.flatnonzero(bounds[0] == bounds[1])
    if not len(flat):
        return Triangles.of(trimesh.creation.box(bounds=bounds))
    u, v = np.delete(np.arange(3), flat[0])
    corners_m = np.repeat(bounds[:1], 4, axis=0)
    corners_m[1:3, u] = bounds[1, u]
    corners_m[2:4, v] = bounds[1, v]
    return Triangles(corners_m, np.array([[0, 1, 2], [0, 2, 3]]))


def _surface_mesh(name: str, slab: Slab, shape: Triangles, least_patch: PatchSize | None) -> SurfaceMesh:
    """Mesh of a shape, without triangles of no area, which have no normal."""
    triangles = shape.triangles[_have_area(shape.vertices_m[shape.triangles])]
    return SurfaceMesh(name, *slab[:2], shape.vertices_m, triangles, slab.scattering, least_patch)


def _have_area(corners_m: Float[FloatArray, "K 3 3"]) -> Bool[NDArray[np.bool_], "K"]:
    edges_m = np.roll(corners_m, -1, axis=1) - corners_m
    doubled_area_m2 = np.linalg.norm(np.cross(edges_m[:, 0], edges_m[:, 1]), axis=1)
    longest_m2 = np.max(np.sum(edges_m**2, axis=2), axis=1)
    # of a longer and thinner triangle no plane is known
    return np.asarray(doubled_area_m2 > 1e-9 * longest_m2)


def _imported_shapes(scene: Scene) -> list[ImportedShape]:
    """Shapes of the scene's mesh file, if it names one, in metres and with z upwards; raises `SceneError`."""
    if scene.scene is None:
        return []
    path = _mesh_file(scene.scene, scene.folder)
    if path.suffix.lower() in (".glb", ".obj"):
        shapes = read_scene(path, scene.materials)
    else:
        shapes = list(bounded(read_xml(path, scene.materials), path))
    up = scene.up or ("y" if path.suffix.lower() == ".glb" else "z")  # glTF says y; OBJ says nothing, Mitsuba takes z
    # the first takes y upwards to z upwards
    turns = {"y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), "z": np.eye(3)}
    if scene.up is None and not scene.scene.startswith(SIONNA):
        _require_upright(scene, path, shapes, turns, up)
    matrix = UNIT_M[scene.unit or "m"] * turns[up]
    if (matrix == np.eye(3)).all():
        return shapes
    with np.errstate(all="ignore"):  # of numbers that no float holds, which are refused later
        turned = [Triangles(shape.triangles.vertices_m @ matrix.T, shape.triangles.triangles) for shape in shapes]
    return [replace(shape, triangles=triangles) for shape, triangles in zip(shapes, turned, strict=True)]


def _require_upright(
    scene: Scene, path: Path, shapes: Sequence[ImportedShape], turns: dict[str, Float[FloatArray, "3 3"]], up: str
) -> None:
    """Raise `SceneError` if the content of a file seems to lie on its side when it is read with `up` upwards.

    So it does if the receiver, or receiver and grid, are outside of the box about everything, and would be inside if
    the other axis were up; and if its middle is at height 0, and its bottom would be if the other axis were up. A
    single wall or ground has no inside.
    """
    vertices_m = np.concatenate([shape.triangles.vertices_m for shape in shapes])
    if 0 < np.abs(vertices_m).max(initial=0) <= FAR_M and is_flat(vertices_m, 0.01):  # others are refused later
        return
    bounds_m = np.array([vertices_m.min(axis=0, initial=np.inf), vertices_m.max(axis=0, initial=-np.inf)])
    with np.errstate(all="ignore"):  # of numbers that no float holds, which are refused later
        boxes_m = {axis: np.sort(UNIT_M[scene.unit or "m"] * bounds_m @ turn.T, axis=0) for axis, turn in turns.items()}
    other = "z" if up == "y" else "y"
    (low_m, high_m), (turned_low_m, _) = boxes_m[up][:, 2], boxes_m[other][:, 2]
    grid = scene.transmitters
    points_m = np.array([scene.receiver.position_m, *([grid.min_m, grid.max_m] if grid else [])])

    def holds(axis: str, points_m: FloatArray) -> bool:
        places = [boxes_m[axis], *(surface.corners_m for surface in scene.surface)]
        all_m = np.concatenate(places)
        return bool(((all_m.min(axis=0) <= points_m) & (points_m <= all_m.max(axis=0))).all())

    if any(holds(other, some) and not holds(up, some) for some in (points_m[:1], points_m)):
        fault = (
            f"the receiver at {points_m[0].tolist()}, or the grid, is outside of all that it holds, and would be inside"
        )
    # 0.3 m: the most that a floor is thick, or a room off the middle where it is centred
    elif abs(turned_low_m) < 0.3 < -low_m and abs(low_m + high_m) < 0.3 and holds(other, points_m):
        fault = f"its height goes from {low_m:.4g} to {high_m:.4g} m, and would begin at height 0"
    else:
        return
    raise SceneError(
        f"{path} is read with {up} upwards: {fault} if {other} were up. Choose with up = 'y' or up = 'z' "
        "in the scene's TOML."
    )


def _mesh_file(name: str, folder: Path) -> Path:
    """Path of the mesh file that a scene names, or of a scene that Sionna RT brings."""
    if not name.startswith(SIONNA):
        return folder / name
    scenes = Path(str(metadata.distribution("sionna-rt").locate_file("sionna/rt/scenes")))
    shipped = {path.stem: path for path in scenes.glob("*/*.xml") if path.stem == path.parent.name}
    if name.removeprefix(SIONNA) not in shipped:
        raise UnknownNameError("scene of Sionna RT", name.removeprefix(SIONNA), shipped)
    return shipped[name.removeprefix(SIONNA)]


def _imported_mesh(shape: ImportedShape, least_patch: PatchSize | None) -> SurfaceMesh:
    vertices_m, triangles = shape.triangles
    if not ((triangles >= 0) & (triangles < len(vertices_m))).all():
        raise SceneError(f"{shape.source} cannot be read: a face has a vertex that does not exist.")
    with np.errstate(all="ignore"):  # of numbers that no float holds, which are refused below
        mesh = _surface_mesh(shape.name, shape.slab, shape.triangles, least_patch)
    if not (np.abs(mesh.vertices_m) <= FAR_M).all():
        raise SceneError(f"{shape.source} has vertices that are not finite, or beyond {FAR_M:g} m.")
    if len(mesh.triangles) == 0:
        raise SceneError(f"{shape.source} has no face of any area. Export it with its faces, or remove the shape.")
    return mesh


def meshes_sha256(meshes: Iterable[SurfaceMesh]) -> str:
    """SHA-256 of all that rays can meet: names, materials, thicknesses, triangles, scattering where it is stated."""
    digest = hashlib.sha256()
    for mesh in meshes:
        material = mesh.material if isinstance(mesh.material, str) else repr(mesh.material)
        digest.update(f"{mesh.name}|{material}|{mesh.thickness_m!r}|{mesh.vertices_m.shape}".encode())
        digest.update(mesh.vertices_m.tobytes() + mesh.triangles.tobytes())
        if mesh.scattering:
            digest.update(repr(mesh.scattering).encode())
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
    import trimesh

    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    root = ElementTree.Element("scene", version="2.1.0")
    kinds = slabs_of(meshes)
    identifiers = []
    for index, slab in enumerate(kinds):
        material = slab.homogeneous
        if isinstance(material, ConstantMaterial):
            bsdf = ElementTree.SubElement(root, "bsdf", type="radio-material", id=f"mat-own-{index}")
            for name in ("relative_permittivity", "conductivity_s_m"):
                value = repr(getattr(material, name))
                ElementTree.SubElement(bsdf, "float", name=name.removesuffix("_s_m"), value=value)
        else:
            bsdf = ElementTree.SubElement(root, "bsdf", type="itu-radio-material", id=f"mat-{material}-{index}")
            ElementTree.SubElement(bsdf, "string", name="type", value=material)
        ElementTree.SubElement(bsdf, "float", name="thickness", value=repr(slab.thickness_m))
        identifiers.append(bsdf.get("id", ""))
    for number, (mesh, identifier) in enumerate(zip(meshes, shape_ids(meshes), strict=True)):
        filename = f"meshes/{number:05d}.ply"
        trimesh.Trimesh(mesh.vertices_m, mesh.triangles, process=False).export(folder / filename)
        shape = ElementTree.SubElement(root, "shape", type="ply", id=identifier)
        ElementTree.SubElement(shape, "string", name="filename", value=filename)
        ElementTree.SubElement(shape, "boolean", name="face_normals", value="true")
        ElementTree.SubElement(shape, "ref", id=identifiers[kinds.index(mesh.slab)], name="bsdf")
    xml = folder / "scene.xml"
    ElementTree.ElementTree(root).write(xml)
    return xml
