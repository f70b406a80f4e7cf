"""Makes the scene and the table of a flat in which impulse responses were measured, for `bench measured`.

`python examples/make_uwb_flat.py DOWNLOAD FOLDER` reads the logs and tables of M. Kolakowski, "UWB Channel Impulse
Responses Registered in a Furnished Apartment" (doi 10.5281/zenodo.4742391, CC BY 4.0), and writes `uwb_flat.toml` and
`uwb_flat.npz`. Walls and furniture are where the plan of its description has them. It says that the walls are of about
5 cm of concrete. All else is our assumption, and options vary it: heights, what furniture is made of, and the outer
walls, floor and ceiling, of 20 cm of concrete. Windows and door leaves are left out.
"""

from __future__ import annotations

import argparse
import csv
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

NUM_RESPONSES, NUM_TAPS, FIRST_TAP = 40, 230, 30  # of each log; taps are cut so that the first path is behind so many
HEAD = """# The flat of doi 10.5281/zenodo.4742391, made by examples/make_uwb_flat.py.
name = "uwb_flat"
description = "A furnished flat of 9.3 × 9.5 m in which impulse responses were measured at 4 GHz."

[receiver]
position_m = [7.76, 8.1, 1.2]

[[material]]
name = "foam"
relative_permittivity = 1.2
conductivity_s_m = 0.002

[[material]]
name = "bed"
layers = [{material = "chipboard", thickness_m = 0.018}, {material = "foam", thickness_m = 0.25}]
"""
# x and y in metres of one end and of the other
WALLS_M = (
    (0.0, 3.38, 3.02, 3.38),
    (3.81, 3.38, 4.65, 3.38),
    (2.0, 3.38, 2.0, 4.8),
    (1.93, 4.8, 2.0, 4.8),
    (0.0, 4.8, 1.3, 4.8),
    (1.3, 4.8, 1.3, 5.37),
    (1.3, 5.92, 1.3, 6.55),
    (0.0, 6.55, 1.3, 6.55),
    (2.1, 5.88, 2.1, 9.5),
    (2.1, 5.88, 3.2, 5.88),
    (3.89, 5.88, 5.62, 5.88),
    (6.31, 5.88, 7.2, 5.88),
    (4.65, 5.88, 4.65, 9.5),
    (7.2, 4.8, 7.2, 5.08),
    (7.2, 5.78, 7.2, 9.5),
)
DOORS_M = (
    (3.02, 3.38, 3.81, 3.38),
    (1.3, 4.8, 1.93, 4.8),
    (1.3, 5.37, 1.3, 5.92),
    (3.2, 5.88, 3.89, 5.88),
    (5.62, 5.88, 6.31, 5.88),
    (7.2, 5.08, 7.2, 5.78),
)
# x and y of the corners, counter-clockwise, the height, the material, and the number of the side that is a mirror
FURNITURE: dict[str, tuple[tuple[tuple[float, float], ...], float, str, int | None]] = {
    "wardrobe in the east": (((6.57, 5.92), (7.13, 5.92), (7.13, 6.6), (6.57, 6.6)), 2.2, "chipboard", None),
    "wardrobe by the entry": (((7.25, 4.86), (9.24, 4.86), (9.24, 5.52), (7.25, 5.13)), 2.2, "chipboard", None),
    "mirrored wardrobe": (((4.02, 5.95), (4.58, 5.95), (4.58, 6.81), (4.02, 6.81)), 2.2, "chipboard", 3),
    "mirrored wardrobe in the hall": (((2.07, 3.45), (2.98, 3.45), (2.98, 4.49), (2.07, 4.77)), 2.2, "chipboard", 2),
    "bookcase west": (((4.32, 6.83), (4.58, 6.83), (4.58, 7.75), (4.32, 7.75)), 2.0, "wood", None),
    "bookcase in the middle": (((4.72, 6.83), (4.98, 6.83), (4.98, 7.75), (4.72, 7.75)), 2.0, "wood", None),
    "bookcase east": (((6.87, 6.62), (7.13, 6.62), (7.13, 7.54), (6.87, 7.54)), 2.0, "wood", None),
    "cluttered shelves": (((4.72, 5.95), (5.34, 5.95), (5.34, 6.79), (4.72, 6.79)), 2.0, "wood", None),
}
BED_M = (2.26, 5.94, 2.26, 7.99)  # upright at the wall


def surface(name: str, material: str, thickness_m: float | None, corners_m: list[list[float]]) -> str:
    """A surface of the scene's TOML; without thickness it has that of its material."""
    lines = ["", "[[surface]]", f'name = "{name}"', f'material = "{material}"', f"vertices_m = {corners_m}"]
    return "\n".join([*lines, *([f"thickness_m = {thickness_m}"] if thickness_m else []), ""])


def upright(ends_m: Sequence[float], low_m: float, high_m: float) -> list[list[float]]:
    """The corners of an upright rectangle over a stretch of the plan."""
    x, y, x2, y2 = ends_m
    return [[x, y, low_m], [x2, y2, low_m], [x2, y2, high_m], [x, y, high_m]]


def surfaces(
    height_m: float, material: str, inner_m: float, outer_m: float, furniture: bool, mirrors: bool
) -> Iterator[str]:
    """The surfaces of the flat. Without `mirrors`, the doors that the plan calls mirrored are of chipboard."""
    outline_m = [[0.0, 0.0], [4.65, 0.0], [4.65, 4.8], [9.3, 4.8], [9.3, 9.5], [0.0, 9.5]]
    for name, z_m in (("floor", 0.0), ("ceiling", height_m)):
        yield surface(name, "concrete", 0.2, [[*corner_m, z_m] for corner_m in outline_m])
    for n, ends_m in enumerate(zip(outline_m, outline_m[1:] + outline_m[:1], strict=True)):
        yield surface(f"outer wall {n}", "concrete", outer_m, upright([*ends_m[0], *ends_m[1]], 0.0, height_m))
    for n, ends in enumerate(WALLS_M):
        yield surface(f"wall {n}", material, inner_m, upright(ends, 0.0, height_m))
    for n, ends in enumerate(DOORS_M):
        yield surface(f"lintel {n}", material, inner_m, upright(ends, 2.05, height_m))
    if not furniture:
        return
    yield surface("bed", "bed", None, upright(BED_M, 0.2, 1.6))
    for name, (places_m, top_m, made_of, mirror) in FURNITURE.items():
        thickness_m = 0.1 if made_of == "wood" else 0.018  # books are as wood; what passes a box meets two sides
        for side, (start, end) in enumerate(zip(places_m, (*places_m[1:], places_m[0]), strict=True)):
            corners_m = upright([*start, *end], 0.02, top_m)
            if mirrors and side == mirror:
                yield surface(f"{name}, mirror", "metal", 0.001, corners_m)
            else:
                yield surface(f"{name}, side {side}", made_of, thickness_m, corners_m)
        yield surface(f"{name}, top", made_of, thickness_m, [[x, y, top_m] for x, y in places_m])


def read_log(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The first responses of a log (responses, taps), and the tap of the first path that the receiver found in each.

    A response is a line `RX OK … HLP(tap) …`, one that counts the taps, and a line `real, imaginary` for each.
    """
    text = path.read_text("utf-8", "replace")
    cir, first_tap = [], []
    for first, taps in re.findall(r"RX OK.*HLP\(([\d.]+)\).*\n.*\n((?:-?\d+, *-?\d+\n)+)", text)[:NUM_RESPONSES]:
        start = int(float(first)) - FIRST_TAP
        cir.append(np.array([line.split(",") for line in taps.splitlines()], float)[start : start + NUM_TAPS])
        first_tap.append(float(first) - start)
    return np.array(cir) @ [1, 1j], np.array(first_tap)


def write_table(
    download: Path, path: Path, log: Sequence[int], cir: np.ndarray, first_tap: np.ndarray, z_m: float
) -> None:
    """Write the table of the logs with these numbers; positions and labels are those of the download."""

    def rows(name: str) -> dict[int, list[str]]:
        with (download / name).open(encoding="utf-8") as file:
            return {int(cells[0]): cells[1:] for cells in list(csv.reader(file))[1:]}

    anchors, tags, pairs, labels = (rows(f"{name}.csv") for name in ("anchors", "tags", "pairs", "labels"))
    ends = [(anchors[int(pairs[n][0])], tags[int(pairs[n][1])]) for n in log]
    receiver_m, tx_m = (np.array([[*end, z_m] for end in which], float) for which in zip(*ends, strict=True))
    np.savez_compressed(
        path,
        tx_m=tx_m,
        receiver_m=receiver_m,
        cir=cir.astype(np.complex64),
        first_tap=np.median(first_tap, axis=1).astype(np.float64),
        tap_s=1.0016e-9,  # half a chip
        bandwidth_hz=499.2e6,
        roll_off=0.5,  # of the reference pulse of IEEE 802.15.4, behind its matched filter
        label=[labels[n][0] for n in log],
        name=[f"log {n}" for n in log],
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Write scene and table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("download", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--height", type=float, default=2.6, help="of the rooms, in metres")
    parser.add_argument("--z", type=float, default=1.2, help="of all antennas, in metres")
    parser.add_argument("--material", default="concrete", help="of inner walls")
    parser.add_argument("--wall", type=float, default=0.05, help="thickness of inner walls in metres")
    parser.add_argument("--outer-wall", type=float, default=0.2, help="thickness of outer walls in metres")
    parser.add_argument("--no-furniture", action="store_true")
    parser.add_argument("--no-mirrors", action="store_true")
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    made = surfaces(
        given.height, given.material, given.wall, given.outer_wall, not given.no_furniture, not given.no_mirrors
    )
    (given.folder / "uwb_flat.toml").write_text("".join([HEAD, *made]), encoding="utf-8")
    logs = {int(path.stem): path for path in given.download.glob("*.log")}
    if logs:
        responses = [read_log(path) for _, path in sorted(logs.items())]
        cir, first_tap = (np.stack(parts) for parts in zip(*responses, strict=True))
        write_table(given.download, given.folder / "uwb_flat.npz", sorted(logs), cir, first_tap, given.z)


if __name__ == "__main__":
    main()
