"""Makes the meshes of scene `lounge`: python examples/make_lounge.py writes scenes/lounge/lounge.xml and its PLY files.

Furniture of curved and thin parts, as a Blender export has it: cushions, legs, a lamp, leaves, boards.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike

FOLDER = Path(__file__).parents[1] / "scenes" / "lounge"
SLABS = {"wood": 0.02, "chipboard": 0.018, "glass": 0.006, "metal": 0.002, "plasterboard": 0.0125}  # metres


def cushion(low_m: ArrayLike, high_m: ArrayLike, subdivisions: int = 4) -> trimesh.Trimesh:
    """A box with round edges: a superellipsoid between two corners."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    direction = ball.vertices / np.linalg.norm(ball.vertices, ord=6, axis=1, keepdims=True)
    low, high = np.asarray(low_m), np.asarray(high_m)
    return trimesh.Trimesh((low + high) / 2 + direction * (high - low) / 2, ball.faces, process=False)


def rod(start_m: ArrayLike, end_m: ArrayLike, radius_m: float, sections: int = 24) -> trimesh.Trimesh:
    """A cylinder between two points."""
    return trimesh.creation.cylinder(radius_m, sections=sections, segment=[start_m, end_m])


def turned(profile_m: ArrayLike, place_m: ArrayLike, sections: int = 64) -> trimesh.Trimesh:
    """A body of revolution about the vertical, from pairs of radius and height."""
    body = trimesh.creation.revolve(np.asarray(profile_m, dtype=float), sections=sections)
    return body.apply_translation(place_m)


def board(low_m: ArrayLike, high_m: ArrayLike) -> trimesh.Trimesh:
    """A thin box."""
    return trimesh.creation.box(bounds=[low_m, high_m])


def sofa(x: float, y: float, width_m: float) -> list[trimesh.Trimesh]:
    """Seat, back, two arms and loose cushions, facing +y."""
    parts = [
        cushion([x, y, 0.12], [x + width_m, y + 0.85, 0.42]),
        cushion([x, y, 0.3], [x + width_m, y + 0.24, 0.85]),
        cushion([x, y, 0.15], [x + 0.2, y + 0.85, 0.62]),
        cushion([x + width_m - 0.2, y, 0.15], [x + width_m, y + 0.85, 0.62]),
    ]
    number = round(width_m / 0.6)
    for k in range(number):
        left = x + 0.2 + k * (width_m - 0.4) / number
        parts.append(cushion([left, y + 0.2, 0.42], [left + (width_m - 0.42) / number, y + 0.34, 0.78], 3))
    return parts


def chair(x: float, y: float) -> list[trimesh.Trimesh]:
    """Seat, back of seven staves and four legs."""
    legs = [rod([x + dx, y + dy, 0.01], [x + dx, y + dy, 0.44], 0.018) for dx in (0, 0.38) for dy in (0, 0.38)]
    staves = [rod([x + k * 0.38 / 6, y, 0.46], [x + k * 0.38 / 6, y - 0.06, 0.9], 0.009) for k in range(7)]
    return [*legs, *staves, cushion([x - 0.02, y - 0.02, 0.44], [x + 0.4, y + 0.4, 0.5], 3)]


def plant(x: float, y: float, seed: int, num_leaves: int = 140) -> list[trimesh.Trimesh]:
    """Leaves of eight triangles each, bent, on a crown."""
    chance = np.random.default_rng(seed)
    leaves = []
    for _ in range(num_leaves):
        along, across = np.meshgrid(np.linspace(0, 1, 5), [-1.0, 1.0], indexing="ij")
        width = 0.035 * np.sin(np.pi * np.clip(along, 0.05, 0.95)) * across
        leaf = np.stack([0.22 * along, width, -0.08 * along**2], axis=-1).reshape(-1, 3)
        faces = [[2 * k + a, 2 * k + b, 2 * k + c] for k in range(4) for a, b, c in ((0, 1, 2), (1, 3, 2))]
        shape = trimesh.Trimesh(leaf, faces, process=False)
        shape.apply_transform(trimesh.transformations.euler_matrix(0, -chance.uniform(0, 1.2), chance.uniform(0, 6.3)))
        leaves.append(shape.apply_translation([x, y, chance.uniform(0.6, 1.3)]))
    return leaves


def furniture() -> dict[str, tuple[str, list[trimesh.Trimesh]]]:
    """Material and parts of each piece, by name."""
    shelves = [board([0.05, 4.0, z], [0.37, 5.4, z + 0.02]) for z in np.linspace(0.05, 2.0, 7)]
    frame = [board([0.05, y, 0.05], [0.37, y + 0.02, 2.02]) for y in (4.0, 4.7, 5.38)]
    vase = [[0.0, 0.0], [0.07, 0.0], [0.11, 0.08], [0.05, 0.22], [0.06, 0.26]]
    shade = [[0.16, 1.35], [0.22, 1.2], [0.25, 1.1]]
    table = [[0.0, 0.70], [0.6, 0.70], [0.62, 0.715], [0.6, 0.73], [0.0, 0.73]]
    return {
        "sofa": ("wood", sofa(2.2, 0.08, 2.4)),
        "armchair": ("wood", sofa(5.6, 0.1, 0.95)),
        "table": ("wood", [turned(table, [5.4, 4.0, 0]), rod([5.4, 4.0, 0.02], [5.4, 4.0, 0.69], 0.05, 48)]),
        "chairs": ("wood", [part for x, y in ((4.4, 3.9), (6.1, 3.9), (5.2, 3.1)) for part in chair(x, y)]),
        "shelf": ("chipboard", shelves + frame),
        "lamp foot": (
            "metal",
            [rod([1.2, 0.6, 0.02], [1.2, 0.6, 1.3], 0.012, 32), rod([1.2, 0.6, 0.005], [1.2, 0.6, 0.02], 0.16, 48)],
        ),
        "lamp shade": ("chipboard", [turned(shade, [1.2, 0.6, 0], 96)]),
        "vases": (
            "glass",
            [turned(vase, [x, y, z], 72) for x, y, z in ((5.3, 3.9, 0.74), (0.2, 4.3, 1.05), (3.2, 1.6, 0.47))],
        ),
        "low table": ("glass", [cushion([2.8, 1.3, 0.42], [4.0, 1.9, 0.46], 4)]),
        "radiator": ("metal", [rod([7.4, 1.0 + 0.06 * k, 0.15], [7.4, 1.0 + 0.06 * k, 0.7], 0.02) for k in range(22)]),
        "plants": ("chipboard", [*plant(0.7, 2.2, 1), *plant(6.9, 5.3, 2), *plant(6.9, 0.5, 3)]),
        "screen": ("metal", [board([2.6, 5.93, 0.9], [3.9, 5.97, 1.65])]),
    }


def write_shapes(xml: Path, objects: dict[str, tuple[str, list[trimesh.Trimesh]]]) -> int:
    """Write a Mitsuba XML of materials and parts by name, and its PLY files; returns the number of triangles."""
    lines = ['<scene version="2.1.0">']
    used = {material for material, _ in objects.values()}
    for material, thickness_m in SLABS.items():
        if material not in used:
            continue
        lines.append(f'  <bsdf type="itu-radio-material" id="mat-{material}">')
        lines.append(f'    <string name="type" value="{material}"/>')
        lines.append(f'    <float name="thickness" value="{thickness_m}"/>\n  </bsdf>')
    num_triangles = 0
    for name, (material, parts) in objects.items():
        mesh = trimesh.util.concatenate(parts)
        num_triangles += len(mesh.faces)
        filename = f"{name.replace(' ', '_')}.ply"
        mesh.export(xml.parent / filename, encoding="binary", vertex_normal=False)
        lines.append(f'  <shape type="ply" id="mesh-{name}">')
        lines.append(f'    <string name="filename" value="{filename}"/>')
        lines.append(f'    <ref id="mat-{material}" name="bsdf"/>\n  </shape>')
    xml.write_text("\n".join([*lines, "</scene>", ""]), encoding="utf-8")
    return num_triangles


if __name__ == "__main__":
    print(f"{write_shapes(FOLDER / 'lounge.xml', furniture()):,} triangles")
