"""Prints what each ingredient of scene `office_cluttered` adds to the spreads of its channels: minutes on a core.

`python examples/what_clutter_adds.py` takes 30 transmitters, spread over those in sight of the array, the same in every
row. A row has medians at three carriers: delay spread and azimuth spread at the array of paths within 25 dB of the
strongest, those of all paths in brackets, and K.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from xfreqbench.examples.make_office_cluttered import write_scene

import xfreqbench as xb
from xfreqbench.data.statistics import WINDOW_DB, of_paths
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.materials import Scattering
from xfreqbench.scene.placement import place_transmitters
from xfreqbench.scene.visibility import sees
from xfreqbench.tracing.paths import RaggedPaths

FREQS_GHZ = (2.4, 24.25, 77)
SMOOTH = xb.TraceSettings(solver="image")
FOUR = xb.TraceSettings(solver="image", interactions=("specular", "refraction"), max_depth=4)
DIFFUSE = replace(FOUR, interactions=(*FOUR.interactions, "diffuse"))


def made_of(scene: xb.Scene, material: str, thickness_m: float, *names: str) -> xb.Scene:
    """The scene with the surfaces whose names begin so made of another material."""
    surfaces = [
        replace(each, material=material, thickness_m=thickness_m) if each.name.startswith(names) else each
        for each in scene.surface
    ]
    return replace(scene, surface=tuple(surfaces))


def scattering(scene: xb.Scene, by: Scattering | None) -> xb.Scene:
    """The scene with all materials that scatter doing so by one law, or, with None, not at all."""
    materials = [replace(each, scattering=each.scattering and by) for each in scene.material]
    return replace(scene, material=tuple(materials))


def variants(folder: Path) -> Iterator[tuple[str, xb.Scene, xb.TraceSettings]]:
    """Rows of the table: words, scene, and settings."""
    office, uneven = xb.load_scene("office"), xb.load_scene("office_cluttered")
    full = scattering(uneven, None)
    furniture = ("desk", "cabinet")
    yield "shell", replace(office, surface=tuple(s for s in office.surface if not s.name.startswith(furniture))), SMOOTH
    yield "office: desks, cabinets", office, SMOOTH
    kinds = ["furniture", "metal", "plants", "people"]
    for number, words in ((1, "chairs, bookcase"), (2, "metal"), (3, "plants"), (4, "people")):
        scene = scattering(xb.load_scene(str(write_scene(folder / str(number), kinds[:number]))), None)
        yield f"+ {words}", scene, SMOOTH
    yield "without diffraction, depth 8", full, replace(FOUR, max_depth=8)
    yield "without diffraction, depth 4", full, FOUR
    yield "+ scattering as measured", uneven, DIFFUSE
    yield "+ Lambert's law, S = 0.6", scattering(uneven, Scattering(0.6)), DIFFUSE
    yield "walls of concrete", made_of(full, "concrete", 0.2, "wall"), SMOOTH
    yield "coated window", made_of(full, "metal", 0.001, "window"), SMOOTH
    yield "+ metal floor, ceiling", made_of(full, "metal", 0.001, "window", "floor", "ceiling"), SMOOTH
    yield "walls of metal", made_of(full, "metal", 0.001, "wall"), SMOOTH


def main(num_tx: int) -> None:
    """Print the table."""
    full = xb.load_scene("office_cluttered")
    meshes, receiver_m = Geometry.of(full).meshes, np.array(full.receiver.position_m)
    free_m = place_transmitters(full, meshes, 1e9 * FREQS_GHZ[0]).tx_position_m
    free_m = free_m[sees(meshes, free_m, receiver_m)]
    tx_m = free_m[np.linspace(0, len(free_m) - 1, num_tx).astype(int)]
    print("| | delay spread ns | azimuth spread ° | K dB |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for words, scene, settings in variants(Path(folder)):
            tracer = xb.make_tracer(scene, FREQS_GHZ, settings)
            paths = [RaggedPaths.of([tracer.paths(place)], place[None], receiver_m) for place in tx_m]
            cells = []
            for name, unit in (("delay_spread_s", 1e9), ("arrival_azimuth_spread_deg", 1), ("k_factor_db", 1)):
                near, every = (
                    unit * np.nanmedian([[of_paths(each, f, w)[name][0] for f in range(3)] for each in paths], axis=0)
                    for w in (WINDOW_DB, np.inf)
                )
                shown = [
                    f"{a:.1f} ({b:.1f})" if name != "k_factor_db" else f"{a:.1f}"
                    for a, b in zip(near, every, strict=True)
                ]
                cells.append(", ".join(shown))
            print(f"| {words} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 30)
