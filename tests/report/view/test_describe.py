"""What `info` says of a data set."""

from __future__ import annotations

from pathlib import Path

from tests.support.synthetic import write_dataset
from xfreqbench.data.generate import generate
from xfreqbench.report.view.describe import describe
from xfreqbench.scene.model import load_scene


def test_settings_are_told_in_the_words_of_the_command_line(tmp_path: Path) -> None:
    path = tmp_path / "empty.h5"
    generate(load_scene("empty"), path, [10.0], tx=1, maps=False)
    (settings,) = (line for line in describe(path).splitlines() if line.startswith("settings "))
    assert "extrapolated_materials none, interactions specular+refraction+diffraction, " in settings
    assert "max_depth 6" in settings and "solver image" in settings
    assert "[" not in describe(write_dataset(tmp_path / "waves.h5").path)
