from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from functools import partial
from pathlib import Path
from subprocess import DEVNULL

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support.places import ROOT

PURELIB = "import sysconfig; print(sysconfig.get_path('purelib'))"
FIRST_STEPS = """
import sys, xfreqbench as xb
from xfreqbench.report.leaderboard.results import results_at
assert xb.__file__.startswith(sys.prefix), xb.__file__
data = xb.load("office")
assert data.pas(3).max() == 1 and "nearest" in xb.methods() and "lounge" in xb.scenes()
xb.run(data, "nearest", targets_ghz=[10], results="results", budget="3steps")
assert results_at("v1").is_relative_to(sys.prefix)
"""


def test_every_package_and_the_mark_of_its_types_is_in_the_wheel() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {path.parent for name in ("xfreqbench", "baselines") for path in (ROOT / name).rglob("__init__.py")}
    packages = {".".join(folder.relative_to(ROOT).parts) for folder in folders}
    packages = {name if name.startswith("xfreqbench") else f"xfreqbench.{name}" for name in packages}
    assert set(settings["packages"]) == packages | {"xfreqbench.examples", "xfreqbench.scenes"}
    assert "py.typed" in settings["package-data"]["xfreqbench"]
    assert (ROOT / "xfreqbench" / "py.typed").is_file()


def test_what_the_tests_run_with_is_what_the_package_allows() -> None:
    """`constraints.txt` pins versions of dependencies; `pyproject.toml` says which ones may be installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = dict(line.split("==") for line in lines if "==" in line and not line.startswith("#"))
    pinned = {canonicalize_name(name): version.strip() for name, version in pinned.items()}
    for needed in map(Requirement, project["dependencies"]):
        assert needed.specifier.contains(pinned[canonicalize_name(needed.name)]), needed


def test_the_version_is_the_same_wherever_it_is_said() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    released = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert version == cited["version"] == released[0]
    assert f"version = {{{version}}}" in (ROOT / "docs" / "questions.md").read_text("utf-8")


def test_the_workflow_tests_every_python_that_is_promised() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text())
    tested = [entry["python"] for entry in workflow["jobs"]["tests"]["strategy"]["matrix"]["include"]]
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["classifiers"]
    assert tested == [words[-1] for words in map(str.split, classifiers) if words[-1].startswith("3.")]


def test_windows_is_told_what_runs_it() -> None:
    program = "import sys; sys.platform = 'win32'; import xfreqbench"
    refused = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert refused.stderr.splitlines()[-1].startswith("ImportError: xfreqbench runs on Linux. On Windows, install")


def test_a_system_that_lacks_what_linux_alone_has_imports_and_helps() -> None:
    """As macOS, which cannot bind a process to cores, and as a Python without modules of Unix."""
    program = """
import os, sys
sys.modules |= dict.fromkeys(["fcntl", "resource"])
del os.sched_getaffinity, os.sched_setaffinity, os.fork
import xfreqbench.system.workers
from xfreqbench.cli.main import app
from xfreqbench.system.machine import hardware
assert int(hardware()["cores"])
app(["--help"])
"""
    helped = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert helped.returncode == 0 and "generate" in helped.stdout, helped.stderr


@pytest.mark.slow
def test_the_wheel_of_the_source_archive_works_outside_the_clone(tmp_path: Path) -> None:
    """In an environment that has our dependencies on its path, but no clone."""
    run = partial(subprocess.run, check=True, cwd=tmp_path)
    for name in ("xfreqbench", "baselines", "scenes", "examples"):
        shutil.copytree(ROOT / name, tmp_path / "source" / name)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path / "source")
    run([sys.executable, "-m", "build", "--no-isolation", "--outdir", "dist", "source"], stdout=DEVNULL, stderr=DEVNULL)
    made = sorted((tmp_path / "dist").iterdir())
    assert [path.suffix for path in made] == [".whl", ".gz"]
    run([sys.executable, "-m", "twine", "check", "--strict", *made])
    run([sys.executable, "-m", "venv", "--without-pip", "clean"])
    clean = tmp_path / "clean/bin/python"
    site = Path(run([clean, "-c", PURELIB], capture_output=True, text=True).stdout.strip())
    (site / "dependencies.pth").write_text("\n".join(path for path in sys.path if path.endswith("site-packages")))
    run([sys.executable, "-m", "pip", "--python", clean, "install", "--quiet", "--no-deps", "--no-index", made[0]])
    run([clean, "-W", "error", "-c", FIRST_STEPS])
    run([clean.with_name("xfreqbench"), "report", "results", "-o", "board.md", "-q"])
