"""Makes `blender_room.glb`, a small room as Blender's exporter writes one: python examples/make_blender_room.py

Objects are given in Blender's axes, z upwards, and written with y upwards. Planes and cubes are Blender's, with corners
at ±1, scaled, turned and moved by their nodes; a table hangs from an empty object; copies have names in `.001`.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

PATH = Path(__file__).with_name("blender_room.glb")
PLANE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float), np.array([[0, 1, 2, 3]])
CUBE = (
    np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float),
    np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]),
)
ROUND_A_HOLE = np.array([[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])  # outer corners, then inner ones


class Export:
    """The parts of a GLB, as objects are added to them."""

    def __init__(self) -> None:
        self.binary = b""
        self.materials: list[str] = []
        self.parts: dict[str, list[Any]] = {name: [] for name in ("nodes", "meshes", "accessors", "bufferViews")}

    def add(
        self,
        name: str,
        material: str | None = None,
        shape: tuple[np.ndarray, np.ndarray] | None = None,
        at_m: ArrayLike = (0, 0, 0),
        scale: ArrayLike = (1, 1, 1),
        turn_deg: ArrayLike = (0, 0, 0),
        children: tuple[int, ...] = (),
    ) -> int:
        """Add an object, of four-cornered faces if it has a shape, turned about x, then y, then z; its number."""
        node: dict[str, Any] = {"name": name}
        if shape is not None:
            node["mesh"] = len(self.parts["meshes"])
            self.materials += [material] if material and material not in self.materials else []
            corners, faces = shape
            split = corners[faces].reshape(-1, 3)  # a corner for each face, which has a normal of its own
            normal = np.cross(split[1::4] - split[::4], split[2::4] - split[::4])
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            triangles = (4 * np.arange(len(faces))[:, None] + [0, 1, 2, 0, 2, 3]).ravel()
            attributes = {"POSITION": self._store(y_up(split)), "NORMAL": self._store(y_up(normal.repeat(4, axis=0)))}
            primitive = {"attributes": attributes, "indices": self._store(triangles.astype(np.uint16)[:, None])}
            primitive["material"] = self.materials.index(str(material))
            self.parts["meshes"].append({"name": f"{name} mesh", "primitives": [primitive]})
        x, y, z, w = Rotation.from_euler("xyz", turn_deg, degrees=True).as_quat().tolist()
        steps = {"children": list(children), "rotation": [x, z, -y, w], "scale": np.asarray(scale)[[0, 2, 1]].tolist()}
        usual = {"children": [], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}
        node |= {key: value for key, value in steps.items() if value != usual[key]}
        self.parts["nodes"].append(node | {"translation": y_up(np.asarray(at_m, float)).tolist()})
        return len(self.parts["nodes"]) - 1

    def _store(self, values: np.ndarray) -> int:
        """Add numbers to the buffer; the number of their accessor."""
        kind = {1: "SCALAR", 3: "VEC3"}[values.shape[1]]
        component, target = (5123, 34963) if values.dtype == np.uint16 else (5126, 34962)
        content = values.tobytes() if component == 5123 else values.astype("<f4").tobytes()
        view = {"buffer": 0, "byteLength": len(content), "byteOffset": len(self.binary), "target": target}
        self.binary += content + bytes(-len(content) % 4)
        accessor = {"bufferView": len(self.parts["bufferViews"]), "componentType": component}
        accessor |= {"count": len(values), "type": kind}
        if target == 34962:
            accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        self.parts["bufferViews"].append(view)
        self.parts["accessors"].append(accessor)
        return len(self.parts["accessors"]) - 1

    def content(self, roots: list[int]) -> bytes:
        """The GLB whose scene holds these objects."""
        looks = [{"doubleSided": True, "name": name, "pbrMetallicRoughness": {}} for name in self.materials]
        header = {
            "asset": {"generator": "examples/make_blender_room.py of xfreqbench", "version": "2.0"},
            "scene": 0,
            "scenes": [{"name": "Scene", "nodes": roots}],
            **self.parts,
            "materials": looks,
            "buffers": [{"byteLength": len(self.binary)}],
        }
        text = json.dumps(header, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(self.binary), b"BIN\0")
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks) + len(self.binary)) + chunks + self.binary


def y_up(vectors: np.ndarray) -> np.ndarray:
    """Vectors in glTF's axes, in which y points upwards."""
    return np.stack([vectors[..., 0], vectors[..., 2], -vectors[..., 1]], axis=-1) + 0.0  # no −0


def room() -> bytes:
    """A room of 5 × 4 × 2.6 m, with a window in a wall, a table, a cabinet and a screen."""
    export = Export()
    wall = "itu_plasterboard"
    around = [
        [0, 0, 0],
        [5, 0, 0],
        [5, 0, 2.6],
        [0, 0, 2.6],
        [1.5, 0, 0.9],
        [3.5, 0, 0.9],
        [3.5, 0, 2.1],
        [1.5, 0, 2.1],
    ]
    roots = [
        export.add("Floor", "itu_concrete", PLANE, (2.5, 2, 0), (2.5, 2, 1)),
        export.add("Ceiling", "itu_concrete", PLANE, (2.5, 2, 2.6), (2.5, 2, 1)),
        export.add("Wall", wall, PLANE, (2.5, 0, 1.3), (2.5, 1.3, 1), (90, 0, 0)),
        export.add("Wall.001", wall, PLANE, (0, 2, 1.3), (1.3, 2, 1), (0, 90, 0)),
        export.add("Wall.002", wall, PLANE, (5, 2, 1.3), (1.3, 2, 1), (0, 90, 0)),
        export.add("Wall with window", wall, (np.array(around, float), ROUND_A_HOLE), (0, 4, 0)),
        export.add("Window", "Glass", PLANE, (2.5, 4, 1.5), (1, 0.6, 1), (90, 0, 0)),
        export.add("Cabinet", "itu_metal", CUBE, (4.6, 3.2, 0.92), (0.3, 0.5, 0.9)),
        export.add("Screen", "Plastic.001", CUBE, (1.3, 1.4, 1.02), (0.02, 0.3, 0.2), (0, 0, 25)),
    ]
    top = [export.add("Table top", "Oak", CUBE, (0, 0, 0.74), (0.4, 0.8, 0.02))]
    corners = [(x, y, 0.36) for x in (-0.36, 0.36) for y in (-0.76, 0.76)]
    names = ("Table leg", *(f"Table leg.{number:03d}" for number in (1, 2, 3)))
    legs = [export.add(name, "Oak", CUBE, at_m, (0.02, 0.02, 0.34)) for name, at_m in zip(names, corners, strict=True)]
    roots.append(export.add("Table", at_m=(1.3, 1.4, 0), turn_deg=(0, 0, 25), children=(*top, *legs)))
    return export.content(roots)


if __name__ == "__main__":
    PATH.write_bytes(room())
