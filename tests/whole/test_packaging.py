from __future__ import annotations

import tomllib

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support.places import ROOT


def test_every_package_is_in_the_wheel() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    folders = {path.parent for name in ("xfreqbench", "baselines") for path in (ROOT / name).rglob("__init__.py")}
    packages = {".".join(folder.relative_to(ROOT).parts) for folder in folders}
    packages = {name if name.startswith("xfreqbench") else f"xfreqbench.{name}" for name in packages}
    assert set(listed) == packages | {"xfreqbench.examples", "xfreqbench.scenes"}


def test_a_type_checker_reads_the_types_of_an_installed_package() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert "py.typed" in settings["package-data"]["xfreqbench"]
    assert (ROOT / "xfreqbench" / "py.typed").is_file()


def test_what_the_tests_run_with_is_what_the_package_allows() -> None:
    """`constraints.txt` pins versions of dependencies; `pyproject.toml` says which ones may be installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = dict(line.split("==") for line in lines if "==" in line and not line.startswith("#"))
    pinned = {canonicalize_name(name): version.strip() for name, version in pinned.items()}
    needed = [Requirement(each) for each in project["dependencies"]]
    allowed = {each.name: each.specifier.contains(pinned[canonicalize_name(each.name)]) for each in needed}
    assert all(allowed.values()), allowed
