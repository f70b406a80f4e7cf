"""Makes a furnished bedroom of meshes, as strangers export them: python examples/make_bedroom.py FOLDER.

It writes `bedroom.toml` and its meshes: 146,000 triangles, a sixth of which mirror. Planks, tiles and panels lie
in few planes, but each is a patch of its own, as is each side of every shelf, door and drawer.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from xfreqbench.examples.make_lounge import board, cushion, rod, write_shapes

SIZE_M = 4.5, 3.6, 2.7
SCENE = """# A bedroom furnished with meshes, made by examples/make_bedroom.py.
name = "bedroom"
description = "A bedroom of 4.5 × 3.6 × 2.7 m with planks, tiles, panels and furniture, each of many patches."
scene = "bedroom/bedroom.xml"

[receiver]  # 4×4 under the ceiling, half a wavelength apart at each carrier, looking down
position_m = [2.2, 1.7, 2.5]
boresight = [0.0, 0.0, -1.0]

[transmitters]
min_m = [0.3, 0.3, 0.9]
max_m = [4.2, 3.3, 1.7]
step_m = [0.3, 0.3, 0.4]
clearance_m = 0.1
"""
SHELL = """
[[surface]]
name = "{name}"
material = "{material}"
thickness_m = {thickness_m}
min_m = {low_m}
max_m = {high_m}
"""


def slab(low_m: ArrayLike, high_m: ArrayLike, divisions: int = 1) -> trimesh.Trimesh:
    """A thin box each of whose faces is 2·4^divisions triangles."""
    mesh = board(low_m, high_m)
    for _ in range(divisions):
        mesh = mesh.subdivide()
    return mesh


def tiled(low_m: ArrayLike, high_m: ArrayLike, counts: tuple[int, int, int], gap_m: float) -> list[trimesh.Trimesh]:
    """Slabs in a row or a grid that fill a box, some millimetres apart."""
    low, step = np.asarray(low_m, float), (np.asarray(high_m, float) - low_m) / counts
    gap = gap_m * (np.array(counts) > 1)
    return [
        slab(low + index * step + gap / 2, low + (index + 1) * step - gap / 2, 2)
        for index in np.argwhere(np.ones(counts))
    ]


def carcass(low_m: ArrayLike, high_m: ArrayLike, shelves: int, board_m: float = 0.018) -> list[trimesh.Trimesh]:
    """Two sides, a back at low y, and horizontal boards, floor and top among them."""
    (x, y, z), (x2, y2, z2) = np.asarray(low_m, float), np.asarray(high_m, float)
    sides = [slab([at, y, z], [at + board_m, y2, z2]) for at in (x, x2 - board_m)]
    heights = np.linspace(z, z2 - board_m, shelves + 2)
    levels = [slab([x + board_m, y + 0.008, at], [x2 - board_m, y2, at + board_m]) for at in heights]
    return [*sides, *levels, slab([x + board_m, y, z], [x2 - board_m, y + 0.006, z2])]


def drawers(low_m: ArrayLike, high_m: ArrayLike, number: int) -> list[trimesh.Trimesh]:
    """Boxes without a lid, one above another: front, back, two sides and a bottom each."""
    (x, y, z), (x2, y2, z2) = np.asarray(low_m, float), np.asarray(high_m, float)
    parts, height_m = [], (z2 - z) / number
    for k in range(number):
        low, top = z + k * height_m + 0.003, z + (k + 1) * height_m - 0.003
        parts += [
            slab([x, y2 - 0.018, low], [x2, y2, top]),
            slab([x + 0.01, y, low + 0.02], [x2 - 0.01, y + 0.012, top - 0.03]),
        ]
        parts += [
            slab([at, y + 0.012, low + 0.02], [at + 0.012, y2 - 0.018, top - 0.03]) for at in (x + 0.01, x2 - 0.022)
        ]
        parts.append(slab([x + 0.022, y + 0.012, low + 0.02], [x2 - 0.022, y2 - 0.018, low + 0.026]))
    return parts


def curtain(x_m: tuple[float, float], y_m: float, z_m: tuple[float, float]) -> trimesh.Trimesh:
    """A sheet that waves about a plane of constant y."""
    along, up = np.meshgrid(np.linspace(*x_m, 121), np.linspace(*z_m, 61), indexing="ij")
    depth = y_m + 0.03 * np.sin(70 * along) * (1.1 - (up - z_m[0]) / (z_m[1] - z_m[0]) * 0.4)
    index = np.arange(along.size).reshape(along.shape)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return trimesh.Trimesh(np.stack([along, depth, up], axis=-1).reshape(-1, 3), faces, process=False)


def furniture() -> dict[str, tuple[str, list[trimesh.Trimesh]]]:
    """Material and parts of each object, by name."""
    x, y, z = SIZE_M
    slats = [slab([0.35, 0.3 + 0.09 * k, 0.28], [1.95, 0.37 + 0.09 * k, 0.295]) for k in range(20)]
    bed = [slab([0.3, 0.25, 0.1], [0.33, 2.2, 0.45]), slab([1.97, 0.25, 0.1], [2.0, 2.2, 0.45])]
    bed += [slab([0.3, 0.22, 0.1], [2.0, 0.25, 1.0], 2), slab([0.3, 2.2, 0.1], [2.0, 2.23, 0.5], 2)]
    legs = [rod([dx, dy, 0.013], [dx, dy, 0.72], 0.02, 32) for dx in (2.8, 3.9) for dy in (2.95, 3.48)]
    lamella = [slab([2.3, 0.05, 1.0 + 0.11 * k], [3.6, 0.11, 1.003 + 0.11 * k]) for k in range(12)]
    return {
        "planks": ("wood", tiled([0.02, 0.02, 0.0005], [x - 0.02, y - 0.02, 0.012], (30, 4, 1), 0.002)),
        "tiles": ("plasterboard", tiled([0.02, 0.02, z - 0.05], [x - 0.02, y - 0.02, z - 0.035], (9, 8, 1), 0.004)),
        "panels": (
            "wood",
            [
                *tiled([0.01, 0.03, 0.1], [0.022, y - 0.03, 1.2], (1, 12, 2), 0.004),
                *tiled([x - 0.022, 0.03, 0.1], [x - 0.01, y - 0.03, 1.2], (1, 12, 2), 0.004),
                *tiled([0.03, y - 0.022, 0.1], [x - 0.03, y - 0.01, 1.2], (12, 1, 2), 0.004),
            ],
        ),
        "bed": ("wood", [*bed, *slats]),
        "bedding": (
            "chipboard",
            [
                cushion([0.34, 0.26, 0.3], [1.96, 2.19, 0.52], 5),
                cushion([0.3, 0.9, 0.5], [2.0, 2.2, 0.6], 5),
                *(cushion([left, 0.3, 0.5], [left + 0.7, 0.75, 0.66], 4) for left in (0.4, 1.2)),
            ],
        ),
        "wardrobe": (
            "chipboard",
            [
                *(
                    part
                    for k in range(3)
                    for part in carcass([0.4 + 0.75 * k, 3.0, 0.05], [1.15 + 0.75 * k, 3.55, 2.3], 4)
                ),
                *tiled([0.4, 2.97, 0.06], [2.65, 2.988, 2.29], (6, 1, 1), 0.004),
                *drawers([0.42, 3.02, 0.08], [1.13, 3.5, 0.48], 3),
            ],
        ),
        "shelf": (
            "chipboard",
            [part for k in range(3) for part in carcass([4.1, 0.4 + 0.6 * k, 0.05], [4.45, 1.0 + 0.6 * k, 2.1], 5)],
        ),
        "chest": (
            "wood",
            [
                *carcass([2.3, 0.12, 0.05], [3.6, 0.6, 0.9], 0),
                *drawers([2.33, 0.14, 0.08], [2.95, 0.58, 0.88], 4),
                *drawers([2.96, 0.14, 0.08], [3.57, 0.58, 0.88], 4),
            ],
        ),
        "desk": ("wood", [slab([2.75, 2.9, 0.72], [3.95, 3.54, 0.745], 2), *legs]),
        "screen": (
            "metal",
            [slab([2.9, 3.4, 0.85], [3.5, 3.43, 1.2]), rod([3.2, 3.42, 0.75], [3.2, 3.42, 0.85], 0.03, 64)],
        ),
        "blind": ("metal", lamella),
        "curtains": ("chipboard", [curtain((2.0, 2.3), 0.06, (0.1, 2.4)), curtain((3.6, 4.0), 0.06, (0.1, 2.4))]),
        "lamp": (
            "glass",
            [cushion([2.9, 1.5, 2.2], [3.3, 1.9, 2.45], 4), rod([3.1, 1.7, 2.45], [3.1, 1.7, 2.64], 0.008)],
        ),
    }


def write_scene(folder: Path) -> int:
    """Write `bedroom.toml` and the meshes that it names; returns the number of their triangles."""
    x, y, z = SIZE_M
    (folder / "bedroom").mkdir(parents=True, exist_ok=True)
    number = write_shapes(folder / "bedroom" / "bedroom.xml", furniture())
    walls = [
        ("floor", "concrete", 0.2, [0.0, 0.0, 0.0], [x, y, 0.0]),
        ("ceiling", "concrete", 0.2, [0.0, 0.0, z], [x, y, z]),
        ("west", "plasterboard", 0.1, [0.0, 0.0, 0.0], [0.0, y, z]),
        ("east", "concrete", 0.12, [x, 0.0, 0.0], [x, y, z]),
        ("south", "concrete", 0.24, [0.0, 0.0, 0.0], [x, 0.0, z]),
        ("north", "plasterboard", 0.1, [0.0, y, 0.0], [x, y, z]),
    ]
    names = "name", "material", "thickness_m", "low_m", "high_m"
    shell = [SHELL.format(**dict(zip(names, wall, strict=True))) for wall in walls]
    (folder / "bedroom.toml").write_text("".join([SCENE, *shell]), encoding="utf-8")
    return number


if __name__ == "__main__":
    print(f"{write_scene(Path(sys.argv[1])):,} triangles")
