"""Makes scene `office_cluttered`: the room of `office`, with more objects of an office in use than desks and cabinets.

`python examples/make_office_cluttered.py` writes `scenes/office_cluttered.toml` and its meshes. To see what one kind of
things adds, name a folder and the kinds: `python examples/make_office_cluttered.py FOLDER furniture metal`.
Sizes are those of usual furniture; random positions are drawn with a fixed seed.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from trimesh.visual.material import PBRMaterial
from xfreqbench.examples.make_lounge import board, plant, rod

SCENES = Path(__file__).parents[1] / "scenes"
NAME = "office_cluttered"
DESCRIPTION = "The room of `office` as it is used: chairs, screens, shelves with contents, lamps, plants, people."
HEAD = """# {description}
# Made by examples/make_office_cluttered.py from office.toml.
name = "{name}"
description = "{description}"
scene = "{name}/clutter.glb"
least_patch_area_m2 = 0.1  # what is smaller blocks and does not mirror
"""
MATERIALS = """
# materials; scattering as Degli-Esposti et al. (2007) fitted it to outer walls at 1.3 GHz, for want of values indoors:
# 0.05 to a metal wall, 0.2 to a uniform one of brick, 0.4 to one with windows and doors

[[material]]
name = "concrete"
scattering = {coefficient = 0.2, pattern = "directive", alpha_r = 4}

[[material]]
name = "plasterboard"
scattering = {coefficient = 0.2, pattern = "directive", alpha_r = 4}

[[material]]
name = "chipboard"
thickness_m = 0.018

[[material]]
name = "metal"
thickness_m = 0.001
scattering = {coefficient = 0.05, pattern = "directive", alpha_r = 4}

[[material]]
name = "books"  # paper and cardboard, which P.2040 has not, as wood; a path that passes meets two faces
itu = "wood"
thickness_m = 0.1
scattering = {coefficient = 0.4, pattern = "directive", alpha_r = 3}

[[material]]
name = "leaf"  # as thin wood; a real leaf holds water
itu = "wood"
thickness_m = 0.001
scattering = {coefficient = 0.4, pattern = "directive", alpha_r = 3}

[[material]]
name = "person"  # dry skin at 10 GHz (Gabriel et al. 1996); reflects up to 1.5 dB too much at 2.4 and at 77 GHz
relative_permittivity = 31.3
conductivity_s_m = 8.0
thickness_m = 0.05  # lets nothing through
"""


def sheet(low_m: ArrayLike, high_m: ArrayLike) -> trimesh.Trimesh:
    """A rectangle between two corners that agree along one axis."""
    low, high = np.array(low_m, dtype=float), np.array(high_m, dtype=float)
    u, v = np.flatnonzero(high > low)
    corners = np.tile(low, (4, 1))
    corners[[1, 2], u], corners[[2, 3], v] = high[u], high[v]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def turned(parts: Iterable[trimesh.Trimesh], angle_deg: float, place_m: ArrayLike) -> list[trimesh.Trimesh]:
    """Parts about the origin, turned about the vertical and put at a place."""
    move = trimesh.transformations.rotation_matrix(np.radians(angle_deg), [0, 0, 1])
    move[:3, 3] = place_m
    return [part.apply_transform(move) for part in parts]


def chair(x: float, y: float, faces_deg: float) -> list[trimesh.Trimesh]:
    """A swivel chair: seat and back of board on a column with five feet."""
    angles = np.radians(np.arange(0, 360, 72))
    feet = [rod([0, 0, 0.07], [0.3 * np.cos(a), 0.3 * np.sin(a), 0.05], 0.018, 8) for a in angles]
    seat, back = sheet([-0.24, -0.23, 0.47], [0.24, 0.23, 0.47]), sheet([-0.24, -0.22, 0.6], [-0.24, 0.22, 1.1])
    return turned([seat, back, rod([0, 0, 0.08], [0, 0, 0.45], 0.025, 8), *feet], faces_deg, [x, y, 0])


def screen(x: float, y: float, faces_deg: float) -> list[trimesh.Trimesh]:
    """A screen of 24 inches, which is a sheet of metal within, on a foot on a desk."""
    foot = rod([-0.03, 0, 0.765], [-0.03, 0, 1.0], 0.015, 8)
    return turned([sheet([0, -0.265, 0.88], [0, 0.265, 1.19]), foot], faces_deg, [x, y, 0])


def shelves(low_m: ArrayLike, high_m: ArrayLike, num_boards: int = 4) -> list[trimesh.Trimesh]:
    """Boards between two sides, without a back, open towards ±x or ±y: along the shorter side."""
    low, high = np.array(low_m, dtype=float), np.array(high_m, dtype=float)
    along = int(np.argmax(high[:2] - low[:2]))
    sides = []
    for end in (low, high):
        first, last = low.copy(), high.copy()
        first[along] = last[along] = end[along]
        sides.append(sheet(first, last))
    heights = np.linspace(low[2] + 0.05, high[2], num_boards)
    return [*sides, *(sheet([*low[:2], z], [*high[:2], z]) for z in heights)]


def contents(
    chance: np.random.Generator, low_m: ArrayLike, high_m: ArrayLike, num_boards: int = 4
) -> Iterator[trimesh.Trimesh]:
    """Books, binders and boxes of the shelves between the same corners: of random sizes, with gaps."""
    low, high = np.array(low_m, dtype=float), np.array(high_m, dtype=float)
    along = int(np.argmax(high[:2] - low[:2]))
    heights = np.linspace(low[2] + 0.05, high[2], num_boards)
    for z, above in pairwise(heights):
        place = low[along] + 0.02
        while (width := chance.uniform(0.5, 0.9)) < high[along] - 0.02 - place:
            depth = chance.uniform(0.6, 0.95) * (high - low)[1 - along]
            first, last = low.copy(), high.copy()
            first[along], last[along] = place, place + width
            first[2], last[2] = z + 0.01, z + 0.01 + chance.uniform(0.6, 0.9) * (above - z - 0.02)
            first[1 - along] += (high - low)[1 - along] - depth if chance.random() < 0.5 else 0.01
            last[1 - along] = first[1 - along] + depth - 0.01
            if chance.random() < 0.8:
                yield board(first, last)
            place += width + 0.02


def person(x: float, y: float, low_m: float, high_m: float) -> trimesh.Trimesh:
    """A cylinder of 0.36 m, of eight sides, which mirror: on average over places as much as the round one."""
    return rod([x, y, low_m], [x, y, high_m], 0.18, 8)


def clutter() -> dict[str, dict[str, tuple[str, list[trimesh.Trimesh]]]]:
    """Material and parts of each piece, by kind and name."""
    chance = np.random.default_rng(45)
    bookcase, rack = ([2.6, 5.66, 0.01], [4.2, 5.94, 2.0]), ([7.55, 0.3, 0.01], [7.95, 2.3, 2.0])
    seats = [(1.7, 1.95, -90), (1.5, 4.15, 90), (6.4, 3.95, 90), (6.1, 2.55, -90), (5.6, 0.55, 60)]
    looks = [(1.3, 0.9, 90), (1.95, 0.9, 90), (1.5, 5.2, -90), (6.1, 5.0, -90), (6.7, 5.0, -90), (6.1, 1.5, 90)]
    under_desks = [(1.0, 0.8), (0.8, 4.85), (6.7, 4.6), (5.4, 1.4)]
    lamps = [(1.6, 1.1), (1.5, 4.9), (6.2, 1.6), (6.4, 4.7)]
    plants = [(0.45, 0.4), (7.5, 5.5)]
    return {
        "furniture": {
            "chairs": ("chipboard", [part for x, y, a in seats for part in chair(x, y, a + chance.uniform(-25, 25))]),
            "bookcase": ("chipboard", shelves(*bookcase)),
            "files": ("books", list(contents(chance, *bookcase))),
        },
        "metal": {
            "rack": ("metal", shelves(*rack)),
            "boxes": ("books", list(contents(chance, *rack))),
            "screens": ("metal", [part for x, y, a in looks for part in screen(x, y, a + chance.uniform(-12, 12))]),
            "pedestals": ("metal", [board([x, y, 0.02], [x + 0.4, y + 0.55, 0.58]) for x, y in under_desks]),
            "radiators": ("metal", [board([0.05, y, 0.12], [0.15, y + 1.0, 0.72]) for y in (1.6, 2.8)]),
            "lamps": ("metal", [board([x - 0.6, y - 0.15, 2.68], [x + 0.6, y + 0.15, 2.74]) for x, y in lamps]),
            "whiteboard": ("metal", [sheet([5.5, 5.97, 0.9], [7.3, 5.97, 2.1])]),
        },
        "plants": {
            "pots": ("concrete", [rod([x, y, 0.01], [x, y, 0.4], 0.16, 16) for x, y in plants]),
            "leaves": ("leaf", [part for seed, place in enumerate(plants) for part in plant(*place, seed)]),
        },
        "people": {
            "seated": ("person", [person(1.7, 1.95, 0.49, 1.3), person(6.4, 3.95, 0.49, 1.3)]),
            "standing": ("person", [person(3.9, 3.2, 0.01, 1.75)]),
        },
    }


def write_glb(path: Path, pieces: Mapping[str, tuple[str, list[trimesh.Trimesh]]]) -> None:
    """Write pieces, each with its name, its material and its parts, as one glTF file."""
    meshes = trimesh.Scene()
    upwards = trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]).round()  # glTF has y upwards
    for name, (material, parts) in pieces.items():
        mesh = trimesh.util.concatenate(parts).apply_transform(upwards)
        mesh.visual = trimesh.visual.TextureVisuals(material=PBRMaterial(name=material))
        meshes.add_geometry(mesh, node_name=name, geom_name=name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(meshes.export(file_type="glb"))


def write_scene(folder: Path, kinds: Iterable[str] | None = None) -> Path:
    """Write the scene with these kinds of things, all if absent, into a folder; the path of its TOML."""
    wanted = [pieces for kind, pieces in clutter().items() if kinds is None or kind in kinds]
    write_glb(folder / NAME / "clutter.glb", {name: piece for pieces in wanted for name, piece in pieces.items()})
    path = folder / f"{NAME}.toml"
    room = (SCENES / "office.toml").read_text(encoding="utf-8").partition("\n\n")[2]
    head = HEAD.format(name=NAME, description=DESCRIPTION)
    path.write_text(f"{head}\n{room}{MATERIALS}", encoding="utf-8", newline="\n")
    return path


if __name__ == "__main__":
    print(write_scene(Path(sys.argv[1]) if sys.argv[1:] else SCENES, sys.argv[2:] or None))
