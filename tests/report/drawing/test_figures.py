from __future__ import annotations

from pathlib import Path

import numpy as np

from xfreqbench.maps.grid import AngularGrid
from xfreqbench.report.drawing.figures import plot_pas_maps


def test_pictures_of_maps_are_equal_bytes_for_equal_maps(tmp_path: Path) -> None:
    grid = AngularGrid.hemisphere()
    maps = np.random.default_rng(0).random((2, 90, 360), dtype=np.float32)
    for name in ("a.png", "b.png"):
        plot_pas_maps(maps, grid, ["truth", "predicted"], tmp_path / name)
    plot_pas_maps(maps[::-1], grid, ["truth", "predicted"], tmp_path / "c.png")
    a, b, c = ((tmp_path / name).read_bytes() for name in ("a.png", "b.png", "c.png"))
    assert a == b != c
