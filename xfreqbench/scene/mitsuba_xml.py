"""Shapes and materials of a Mitsuba XML, as Blender, Sionna RT and people write them.

`mitsuba.parser` (3.9) does not serve: it follows `<include>` out of the scene's folder, puts no bound on what `$name`
becomes, and refuses unknown properties only where shapes are made. Files of strangers are read within bounds here.
"""

from __future__ import annotations

import difflib
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import cast, get_args

import numpy as np
from jaxtyping import Float
from pydantic import TypeAdapter, ValidationError

from xfreqbench.errors import SceneError, UnknownNameError
from xfreqbench.scene.imported import ImportedShape, StatedMaterial, Triangles, plain_name, slab_of
from xfreqbench.scene.materials import (
    DEFAULT_THICKNESS_M,
    ITU_MATERIALS,
    MAX_CONDUCTIVITY_S_M,
    MAX_PERMITTIVITY,
    MAX_THICKNESS_M,
    ConstantMaterial,
    Material,
    Scattering,
    SceneMaterial,
    material_bands,
)
from xfreqbench.scene.mesh_files import MeshKind, mesh_errors, read_mesh
from xfreqbench.system.files import require_regular
from xfreqbench.types import FloatArray
from xfreqbench.units import parse_number

Element = ElementTree.Element

MAX_INCLUDES = 100  # files that one scene may include in all
MAX_EXPANDED = 1_000_000  # characters that `$name` may become in all
_SCATTERING = {  # fields of `Scattering`, and their names in Sionna RT
    "coefficient": "scattering_coefficient",
    "pattern": "scattering_pattern",
    **{name: name for name in ("xpd_coefficient", "alpha_r", "alpha_i", "lambda_")},
}
_PROPERTIES = {  # of the types of material that Sionna RT has, and the element of each
    **dict.fromkeys(("thickness", "scattering_coefficient", "xpd_coefficient", "lambda_"), "float"),
    **dict.fromkeys(("alpha_r", "alpha_i"), "integer"),
    "scattering_pattern": "string",
}
_OWN_PROPERTIES = {
    "itu-radio-material": {"type": "string"},
    "radio-material": {"relative_permittivity": "float", "conductivity": "float"},
    "absorber-radio-material": {},
}
_FORMS = ("rectangle", "cube", "sphere")
_FILES = get_args(MeshKind)


def read_xml(path: Path, materials: Mapping[str, SceneMaterial]) -> Iterator[ImportedShape]:
    """Shapes of a Mitsuba XML in world coordinates, one after another.

    `materials` is the scene's own table, which comes before what the file says of a material. Raises `SceneError` for
    a file that cannot be read, and for what would not be traced as it is meant.
    """
    elements = list(_Document(path).elements(path))
    bsdfs = _bsdfs(elements, path)
    meshes = cache(read_mesh)
    stated = cache(lambda bsdf: _stated_material(_nested(bsdf, bsdfs), path))
    shapes = [shape for element in elements for shape in element.iter("shape")]
    if not shapes:
        raise SceneError(f"{path} has no <shape>. Give the Mitsuba scene that has the room's meshes.")
    for shape in shapes:
        name = shape.get("id", "unnamed").removeprefix("mesh-")
        where = f"{path}: shape {name!r}"
        if shape.get("type") == "merge" and shape.find("./transform") is None:
            continue  # the shapes in it follow
        kind = shape.get("type", "")
        if kind not in (*_FORMS, *_FILES):
            raise SceneError(
                f"{where} is a {kind!r}. Use {', '.join(_FORMS)}, or export it as one of "
                f"{', '.join(_FILES)} in world coordinates."
            )
        _check_shape(shape, kind, where)
        slab = slab_of(stated(_bsdf_of(shape, bsdfs, where)), materials, where, name)
        if kind in _FORMS:
            triangles, source = _form(shape, kind, where), where
        else:
            filename = _text(shape, "filename")
            file = path.parent / filename
            if "\\" in filename and not file.exists():  # as Windows writes it
                file = path.parent / filename.replace("\\", "/")
            source = f"{path}: the mesh {file} of shape {name!r}"
            with mesh_errors(source, file):  # trimesh raises what its parsers raise
                triangles = meshes(file, cast("MeshKind", kind))
        placed = _placed(triangles, shape, where)
        if shape.find("./boolean[@name='flip_normals'][@value='true']") is not None:
            placed = placed._replace(triangles=placed.triangles[:, ::-1])
        yield ImportedShape(name, slab, placed, source)


class _Document:
    """A scene's file with those that it includes, as one sequence of elements."""

    def __init__(self, path: Path) -> None:
        self.folder = path.parent
        self.defaults: dict[str, str] = {}
        self.num_included = 0
        self.num_expanded = 0

    def elements(self, path: Path) -> Iterator[Element]:
        """Elements below the root, `<include>` replaced by what it names, `$name` by the value of its `<default>`."""
        for element in self._parsed(path):
            if element.tag == "default":
                self.defaults.setdefault(element.get("name", ""), element.get("value", ""))
                continue
            for part in element.iter():
                part.attrib = {key: self._expanded(value, path) for key, value in part.attrib.items()}
            if element.tag == "include":
                yield from self.elements(self._included(element.get("filename", ""), path))
            elif element.find(".//include") is not None:
                raise SceneError(f"{path}: <include> is followed directly below <scene> only; move it there.")
            else:
                yield element

    def _parsed(self, path: Path) -> Element:
        try:
            return ElementTree.parse(require_regular(path)).getroot()
        except OSError as error:
            raise SceneError(f"The Mitsuba scene {path} cannot be read: {error.strerror}.") from error
        except (ElementTree.ParseError, LookupError, ValueError) as error:  # of XML, its encoding, its path
            raise SceneError(
                f"The Mitsuba scene {str(path)!r} cannot be read: {error}. Give a Mitsuba XML, a .glb or an .obj."
            ) from error

    def _included(self, filename: str, path: Path) -> Path:
        """Path of an included file, which is in the scene's folder or below it."""
        self.num_included += 1
        if self.num_included > MAX_INCLUDES:
            raise SceneError(
                f"{path} includes more than {MAX_INCLUDES} files, or itself. Put the scene into fewer files."
            )
        file = self.folder / filename
        try:
            is_below = file.resolve().is_relative_to(self.folder.resolve())
        except (OSError, ValueError, RuntimeError) as error:  # of a name that no file can have, or a ring of links
            raise SceneError(f"{path} includes {filename!r}, which is not the name of a file.") from error
        if not is_below:
            raise SceneError(
                f"{path} includes {filename!r}, which is outside of the scene's folder {self.folder}. "
                "Put a copy of the file into the folder."
            )
        return file

    def _expanded(self, text: str, path: Path) -> str:
        if "$" not in text:
            return text
        expanded = re.sub(r"\$(\w+)", lambda found: self.defaults.get(found[1], found[0]), text)
        self.num_expanded += len(expanded)
        if self.num_expanded > MAX_EXPANDED:
            raise SceneError(
                f"{path}: texts like {text[:40]!r} become more than {MAX_EXPANDED:,} characters. "
                "Write shorter <default> values."
            )
        return expanded


def _bsdfs(elements: list[Element], path: Path) -> dict[str, Element]:
    """Every material by its id, also those inside others, and those that have a second id as an alias."""
    found: dict[str, Element] = {}
    for element in elements:
        for bsdf in element.iter("bsdf"):
            known = found.setdefault(bsdf.get("id", ""), bsdf)
            if known is not bsdf and bsdf.get("id") and not _are_alike(known, bsdf):
                raise SceneError(f"{path}: two materials have the id {bsdf.get('id')!r}; rename one of them.")
    found.pop("", None)
    for element in elements:
        if element.tag == "alias" and element.get("id") in found:
            found[element.get("as", "")] = found[element.get("id", "")]
    return found


def _are_alike(first: Element, second: Element) -> bool:
    return [(part.tag, part.attrib) for part in first.iter()] == [(part.tag, part.attrib) for part in second.iter()]


def _bsdf_of(shape: Element, bsdfs: dict[str, Element], where: str) -> Element:
    referred = [bsdfs[ref.get("id", "")] for ref in shape.findall("./ref") if ref.get("id", "") in bsdfs]
    own = [*shape.findall("./bsdf"), *referred]
    if not own:
        raise SceneError(f"{where} refers to no material of this file; add <ref id='mat-…'/>.")
    if not all(_are_alike(own[0], other) for other in own):
        raise SceneError(f"{where} has {len(own)} materials; leave one, and split the shape if it has several.")
    return own[0]


def _nested(bsdf: Element, bsdfs: dict[str, Element]) -> list[Element]:
    """A material and all that it wraps, as `twosided` does, or refers to, the outer before the inner."""
    found, met = [bsdf], {id(bsdf)}
    for outer in found:  # which grows
        inner = [*outer.findall("./bsdf"), *(bsdfs.get(ref.get("id", "")) for ref in outer.findall("./ref"))]
        found += [one for one in inner if one is not None and id(one) not in met]
        met.update(map(id, inner))
    return found


def _stated_material(nested: list[Element], path: Path) -> StatedMaterial:
    """What a material and those in it state: of each property the outermost."""
    names = [bsdf.get("id", "") for bsdf in nested]
    of_p2040 = [name for name in names if plain_name(name) in ITU_MATERIALS]
    name = of_p2040[0] if of_p2040 else names[0]
    stated, are_several = StatedMaterial(name), len(set(map(plain_name, of_p2040))) > 1
    for bsdf in nested:
        _check_properties(bsdf, name, path)
        material = _material(bsdf, name, path)
        are_several |= None not in (material, stated.material) and material != stated.material
        stated = StatedMaterial(
            name,
            stated.material or material,
            stated.thickness_m or _number(bsdf, "thickness", path, 0.0, MAX_THICKNESS_M),
            stated.scattering or _scattering(bsdf, name, path),
        )
    if are_several:
        raise SceneError(f"{path}: material {names[0]!r} holds several others, but a surface has one; leave one.")
    return stated


def _check_properties(bsdf: Element, name: str, path: Path) -> None:
    """Raise `SceneError` or `UnknownNameError` for a property that would be passed over, or taken for another.

    Materials of appearance (diffuse, principled, twosided, …) may have any others in addition to a thickness and a
    `type`.
    """
    kind = bsdf.get("type", "")
    if kind not in _OWN_PROPERTIES and re.search("radio|^itu", kind, re.IGNORECASE):
        raise UnknownNameError(f"type of material, as that of {name!r} in {path}, called", kind, _OWN_PROPERTIES)
    known = {**_PROPERTIES, **_OWN_PROPERTIES.get(kind, _OWN_PROPERTIES["itu-radio-material"])}
    longer = [name for name in _PROPERTIES if len(name) > len("alpha_u")]  # materials of looks have no similar names
    met = set[str]()
    for child in bsdf:
        given = child.get("name", "")
        if child.tag in ("bsdf", "ref") or given in ("color", "reflectance", "base_color"):
            continue
        fault = None
        is_own = kind in _OWN_PROPERTIES or any(word in given.lower() for word in ("permittivity", "conductivity"))
        if given not in known and (is_own or difflib.get_close_matches(given.lower(), longer, n=1, cutoff=0.75)):
            if not any(given in own for own in _OWN_PROPERTIES.values()):
                raise UnknownNameError(f"property of material {name!r} in {path}, called", given, known)
            fault = f"is no property of a material of type {kind!r}; change the type, or remove it"
        elif given in known and (child.tag != known[given] or "value" not in child.attrib):
            fault = f"is given as <{child.tag}>; give <{known[given]} name={given!r} value='…'/>"
        elif given in met.intersection(known):
            fault = "is given twice; remove one"
        if fault:
            raise SceneError(f"{path}: material {name!r}, {given}: it {fault}.")
        met.add(given)


def _material(bsdf: Element, name: str, path: Path) -> Material | None:
    """The P.2040 material that a bsdf states, or the one that it defines itself; raises `SceneError`."""
    itu = _text(bsdf, "type")
    if itu:
        material_bands(itu)
        return itu
    if bsdf.get("type") != "radio-material":
        return None
    permittivity = _number(bsdf, "relative_permittivity", path, 1.0, MAX_PERMITTIVITY)
    conductivity_s_m = _number(bsdf, "conductivity", path, 0.0, MAX_CONDUCTIVITY_S_M)
    if permittivity is None:
        raise SceneError(
            f"{path}: material {name!r} has no relative_permittivity. "
            "Add <float name='relative_permittivity' value='…'/>, which holds at every carrier."
        )
    return ConstantMaterial(name, permittivity, conductivity_s_m or 0.0)


def _scattering(bsdf: Element, name: str, path: Path) -> Scattering | None:
    """How a material scatters, under the names that Sionna RT has for it; raises `SceneError`."""
    values = {child.get("name", ""): child.get("value", "") for child in bsdf}
    if "scattering_coefficient" not in values:
        return None
    stated = {
        key: values[word] if key == "pattern" else _finite(values[word])
        for key, word in _SCATTERING.items()
        if word in values
    }
    try:
        return TypeAdapter(Scattering).validate_python(stated)
    except ValidationError as error:
        fault = error.errors()[0]
        where = _SCATTERING.get(str(fault["loc"][0]), "") if fault["loc"] else "scattering"
        raise SceneError(f"{path}: material {name!r}, {where}: {fault['msg']}") from error


def _number(bsdf: Element, name: str, path: Path, least: float, most: float) -> float | None:
    """A number of a material, if it is stated: one from `least` to `most`, and a thickness above the least."""
    stated = bsdf.find(f"./float[@name='{name}']")
    if stated is None:
        return None
    text = stated.get("value", "")
    number, is_thickness = _finite(text), name == "thickness"
    if not least <= number <= most or (is_thickness and number == least):
        metres = f"a number of metres above 0, up to {most:g}, or leave it out for {DEFAULT_THICKNESS_M:g}"
        needed = metres if is_thickness else f"a number from {least:g} to {most:g}"
        raise SceneError(f"{path}: the {name} of material {bsdf.get('id', '')!r} is {text!r}. Give {needed}.")
    return number


def _finite(text: str) -> float:
    """The number that a text shows, or nan."""
    try:
        return parse_number(text)
    except ValueError:
        return math.nan


def _check_shape(shape: Element, kind: str, where: str) -> None:
    """Raise `SceneError` or `UnknownNameError` for a property of a shape that would be passed over."""
    # properties that Mitsuba has, and the element of each
    known = dict.fromkeys(("flip_normals", "face_normals", "flip_tex_coords"), "boolean")
    known |= {"silhouette_sampling_weight": "float"} | ({"filename": "string"} if kind in _FILES else {})
    known |= {"center": "point", "radius": "float"} if kind == "sphere" else {}
    objects = "bsdf", "ref", "emitter", "sensor", "medium", "texture", "transform"  # which are not properties
    given = [(child.get("name", ""), child.tag) for child in shape if child.tag not in objects]
    for name, tag in given:
        if name not in known:
            raise UnknownNameError(f"property of a {kind}, as in {where}, called", name, known)
        if tag != known[name] or given.count((name, tag)) > 1:
            raise SceneError(f"{where} has <{tag} name={name!r}/>; give it once, as <{known[name]} name={name!r} …/>.")
    if kind in _FILES and not _text(shape, "filename"):
        raise SceneError(f"{where} names no file; add <string name='filename' value='….{kind}'/>.")


def _form(shape: Element, kind: str, where: str) -> Triangles:
    """Triangles of a shape that needs no file, as Mitsuba defines it: two units wide about the origin."""
    import trimesh

    if kind == "rectangle":
        corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return Triangles(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    if kind == "cube":
        return Triangles.of(trimesh.creation.box(extents=(2, 2, 2)))
    unit = _unit_sphere()
    centre, radius = shape.find("./point[@name='center']"), shape.find("./float[@name='radius']")
    centre_m = _vector(centre, where) if centre is not None else np.zeros(3)
    radius_m = _vector(radius, where)[0] if radius is not None else 1.0
    if not radius_m > 0:
        raise SceneError(f"{where} has the radius {radius_m:g}; give a number of metres above 0.")
    return Triangles(unit.vertices_m * radius_m + centre_m, unit.triangles)


@cache
def _unit_sphere() -> Triangles:
    import trimesh

    return Triangles.of(trimesh.creation.icosphere(subdivisions=3))  # of 1,280 triangles


def _placed(triangles: Triangles, shape: Element, where: str) -> Triangles:
    """Triangles moved to where the shape's `to_world` puts them, by its steps, the first applied first.

    Raises `SceneError` for a step that is unknown, has no sound numbers, or is not affine, and for steps that leave
    nothing of a shape.
    """
    transforms = shape.findall("./transform")
    if not transforms:
        return triangles
    if len(transforms) > 1 or transforms[0].get("name") != "to_world":
        raise SceneError(f"{where} has a second <transform>; leave one, named 'to_world'.")
    whole = np.eye(4)
    with np.errstate(all="ignore"):  # of numbers that no float holds, which are refused below, or later
        for element in transforms[0]:
            whole = _step(element, where) @ whole
        if not (np.abs(whole) < 1e100).all():  # beyond, the products of three below overflow
            raise SceneError(f"{where} has a <transform> that moves it beyond every number.")
        lengths = np.linalg.norm(whole[:3, :3], axis=0)
        if not abs(np.linalg.det(whole[:3, :3])) > 1e-12 * np.prod(lengths):
            raise SceneError(f"{where} has a <transform> that flattens it; no scale may be 0.")
        return Triangles(triangles.vertices_m @ whole[:3, :3].T + whole[:3, 3], triangles.triangles)


def _text(element: Element, name: str) -> str:
    """Value of an element's `<string>` of a name; empty if there is none."""
    found = element.find(f"./string[@name='{name}']")
    return found.get("value", "") if found is not None else ""


def _vector(element: ElementTree.Element, where: str, default: float = 0.0) -> Float[FloatArray, "3"]:
    """The three numbers of an element: from `x`, `y` and `z`, each with a default, or from one or three in `value`."""
    if unknown := set(element.attrib).difference(("x", "y", "z", "value", "angle", "name", "id")):
        raise SceneError(f"{where} has a <{element.tag}> with {min(unknown)!r}; give x, y and z, or value.")
    if "value" not in element.attrib:
        return np.array([_numbers(element.get(axis, str(default)), element, where, 1)[0] for axis in "xyz"])
    return _numbers(element.get("value", ""), element, where, 1, 3) * np.ones(3)


def _numbers(text: str, element: ElementTree.Element, where: str, *counts: int) -> Float[FloatArray, "n"]:
    """Numbers of a text, separated by blanks or commas."""
    numbers = np.array([_finite(word) for word in text.replace(",", " ").split()])
    if len(numbers) not in counts or not np.isfinite(numbers).all():
        raise SceneError(
            f"{where} has a <{element.tag}> with {text[:60]!r}; give {' or '.join(map(str, counts))} finite numbers."
        )
    return numbers


def _step(element: ElementTree.Element, where: str) -> Float[FloatArray, "4 4"]:
    """Matrix of one step; that of `lookat` is the frame at `origin` whose z looks to `target`, its y towards `up`."""
    from scipy.spatial.transform import Rotation

    matrix, kind = np.eye(4), element.tag
    if kind == "translate":
        matrix[:3, 3] = _vector(element, where)
    elif kind == "rotate":
        axis = _direction(_vector(element, where), "axis", where)
        angle_deg = _numbers(element.get("angle", ""), element, where, 1)[0]
        matrix[:3, :3] = Rotation.from_rotvec(np.radians(angle_deg) * axis).as_matrix()
    elif kind == "scale":
        matrix[:3, :3] = np.diag(_vector(element, where, default=1.0))
    elif kind == "matrix":
        values = _numbers(element.get("value", ""), element, where, 9, 16)
        size = 3 if len(values) == 9 else 4
        matrix[:size, :size] = values.reshape(size, size)
        if matrix[3].tolist() != [0, 0, 0, 1]:
            raise SceneError(f"{where} has a <matrix> whose last row is {matrix[3].tolist()}; it must be 0 0 0 1.")
    elif kind in ("lookat", "lookAt"):
        origin, target, up = (_numbers(element.get(key, ""), element, where, 3) for key in ("origin", "target", "up"))
        forward = _direction(target - origin, "way to its target", where)
        left = _direction(np.cross(up, forward), "turn about its way to the target", where)
        matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    else:
        raise SceneError(
            f"{where} has a <transform> with the step {kind!r}; use translate, rotate, scale, matrix or lookat."
        )
    return matrix


def _direction(vector: Float[FloatArray, "3"], what: str, where: str) -> Float[FloatArray, "3"]:
    length = np.linalg.norm(vector)
    if not length > 0:
        raise SceneError(f"{where} has a <transform> whose {what} has no direction; give one that is not zero.")
    return vector / length
