from __future__ import annotations

import tomllib

from places import ROOT


def test_every_package_is_in_the_wheel() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    folders = {path.parent for path in (ROOT / "xfreqbench").rglob("__init__.py")}
    packages = {".".join(folder.relative_to(ROOT).parts) for folder in folders}
    assert set(listed) == packages | {"xfreqbench.baselines", "xfreqbench.examples", "xfreqbench.scenes"}
