"""Makes the furniture of scene `open_office`: a swivel chair, a screen and a pedestal of steel at each of twelve desks.

`python examples/make_open_office.py` writes `scenes/open_office/furniture.glb`. Sizes are those of usual furniture; how
chairs stand is drawn with a fixed seed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import trimesh
from xfreqbench.examples.make_lounge import board
from xfreqbench.examples.make_office_cluttered import SCENES, chair, screen, write_glb

BENCHES_M = [(x, y) for x in (2.4, 6.0, 9.6) for y in (2.0, 5.6)]  # centres of the tops of two desks, 1.6 × 1.6 m each


def furniture() -> dict[str, tuple[str, list[trimesh.Trimesh]]]:
    """Material and parts of each piece, by name."""
    chance = np.random.default_rng(70)
    desks = [(x, y + side * 0.4, side) for x, y in BENCHES_M for side in (-1, 1)]  # those at a bench face each other
    return {
        "chairs": (
            "chipboard",
            [
                part
                for x, y, side in desks
                for part in chair(
                    x + chance.uniform(-0.2, 0.2),
                    y + side * chance.uniform(0.55, 0.75),
                    -90 * side + chance.uniform(-25, 25),
                )
            ],
        ),
        "screens": (
            "metal",
            [part for x, y, side in desks for part in screen(x, y - side * 0.2, 90 * side + chance.uniform(-12, 12))],
        ),
        "pedestals": ("metal", [board([x + 0.35, y - 0.3, 0.02], [x + 0.75, y + 0.3, 0.58]) for x, y, _ in desks]),
    }


if __name__ == "__main__":
    write_glb((Path(sys.argv[1]) if sys.argv[1:] else SCENES) / "open_office" / "furniture.glb", furniture())
